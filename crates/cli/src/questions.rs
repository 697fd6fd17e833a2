//! Questions on the terminal about missing options.

use std::io::{BufRead, IsTerminal, Write};

use lumistack_pipeline::PipelineError;

use crate::console::tell;

/// Returns whether a command asks questions: with `--questions`, or if standard input is a
/// terminal, unless `--no-questions` is given.
pub(crate) fn asks(questions: bool, no_questions: bool) -> bool {
    questions || (!no_questions && std::io::stdin().is_terminal())
}

/// Asks questions about missing options.
pub(crate) struct Questions<'a> {
    /// Name of the command, for errors.
    pub(crate) command: &'static str,
    /// Source of the answers; `None` if no questions may be asked.
    pub(crate) input: Option<&'a mut dyn BufRead>,
}

impl Questions<'_> {
    /// Returns the option's value, otherwise the answer, otherwise the default. `flag` names the
    /// option in errors.
    pub(crate) fn value<T>(
        &mut self,
        flag: &str,
        question: &str,
        given: Option<T>,
        default: Option<(String, T)>,
        read: impl Fn(&str) -> Option<T>,
    ) -> Result<T, PipelineError> {
        if let Some(given) = given {
            return Ok(given);
        }
        // Without questions, only the default remains.
        let Some(input) = &mut self.input else {
            let missing = || {
                PipelineError::value(
                    self.command,
                    flag,
                    format!("a value for this option ({question})"),
                    "none; without a terminal or with --no-questions, no question is asked",
                )
            };
            return default.map(|(_, value)| value).ok_or_else(missing);
        };
        // Repeat the question until the answer is valid, or until the input ends.
        loop {
            let hint = default.as_ref().map_or(String::new(), |(text, _)| format!(" [{text}]"));
            eprint!("{question}{hint}: ");
            let _ = std::io::stderr().flush();
            let mut line = String::new();
            let ended = input.read_line(&mut line).map_or(true, |count| count == 0);
            let answer = line.trim();
            if answer.is_empty()
                && let Some((_, default)) = default
            {
                return Ok(default);
            }
            match read(answer) {
                Some(value) if !answer.is_empty() => return Ok(value),
                _ if ended => {
                    return Err(PipelineError::value(
                        self.command,
                        flag,
                        format!("an answer ({question})"),
                        "no answer",
                    ));
                }
                _ => tell!("  this answer is not valid; try again"),
            }
        }
    }
}
