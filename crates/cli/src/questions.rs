//! Questions on the terminal, for what options do not say.

use std::io::{BufRead, IsTerminal, Write};

use lumistack_pipeline::PipelineError;

use crate::console::tell;

/// Whether a command asks: when told so, or when somebody is there to answer.
pub(crate) fn asks(questions: bool, no_questions: bool) -> bool {
    questions || (!no_questions && std::io::stdin().is_terminal())
}

/// Asks where an option is missing.
pub(crate) struct Questions<'a> {
    /// The command that asks, for errors.
    pub(crate) command: &'static str,
    /// Where answers come from; without it nothing is asked.
    pub(crate) input: Option<&'a mut dyn BufRead>,
}

impl Questions<'_> {
    /// The option, else the answer, else the default; `flag` is what would have said it.
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
        let Some(input) = &mut self.input else {
            let missing = || PipelineError::value(self.command, flag, question, "nothing, and no terminal to ask");
            return default.map(|(_, value)| value).ok_or_else(missing);
        };
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
                _ if ended => return Err(PipelineError::value(self.command, flag, question, "no answer")),
                _ => tell!("  that is not one; try again"),
            }
        }
    }
}
