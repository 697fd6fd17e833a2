//! Checks that comments, docs and messages of errors use the words of `docs/GLOSSARY.md` and follow
//! some rules of style.
//!
//! * No word of the glossary's column "not" occurs.
//! * A sentence has at most 30 words.
//! * No sentence begins with What, Whether or Of.
//! * A crate or top folder has at most one `what` in 1000 words.
//! * A line that holds nothing but a comment has at most 100 columns.
//! * No file, of any kind, has a mark of an unfinished merge.
//!
//! All files must follow these rules, except the files in [`EXCEPTIONS`]. `cargo xtask words --all`
//! also reports problems of the exceptions, without failing.

use std::collections::BTreeMap;

use crate::prose::{Block, blocks, sentences, words};
use crate::tools::{Outcome, command, output_of, root};

/// Folders whose files need not follow the rules.
#[rustfmt::skip]
const EXCEPTIONS: &[&str] = &[
    // this folder is built from web/src, which is checked
    "web/dist",
];

/// Largest number of words in a sentence. The style guide demands at most 25; this check is more
/// tolerant.
const LONGEST_SENTENCE: usize = 30;

/// Largest width of a line that has only a comment, characters.
const WIDEST_COMMENT: usize = 100;

/// Words with which no sentence may begin, since they hide its subject.
const NO_BEGINNING: [&str; 3] = ["what", "whether", "of"];

/// Endings of the names of files that have prose.
const READ: [&str; 7] = ["rs", "ts", "js", "mjs", "py", "wgsl", "md"];

/// The lines that git writes around the two sides of a conflict, as a regular expression.
const MERGE_MARK: &str = "^(<{7}|>{7}) ";

/// File with the banned words.
const GLOSSARY: &str = "docs/GLOSSARY.md";

/// A banned phrase and the glossary's term for the thing.
struct Banned {
    phrase: Vec<String>,
    instead: String,
}

/// Counts for one crate or top folder.
#[derive(Default)]
struct Sum {
    words: usize,
    /// Position of each `what`, as `path:line`.
    whats: Vec<String>,
    problems: usize,
}

/// Checks every file. With `all` it also reports problems of [`EXCEPTIONS`], without failing for
/// them.
pub fn check(all: bool) -> Outcome {
    let files = output_of(command("git").args(["ls-files", "--cached", "--others", "--exclude-standard"]))
        .ok_or("git ls-files failed")?;
    let banned = banned_words(&read(GLOSSARY)?);

    // Read every file once, and count words and problems per crate. Exceptions have counts of their
    // own.
    let mut crates = BTreeMap::<(String, bool), Sum>::new();
    let mut failed = 0;
    for path in files.lines().filter(|path| READ.iter().any(|ending| path.ends_with(&format!(".{ending}")))) {
        let excepted = EXCEPTIONS.iter().any(|folder| is_within(path, folder));
        if excepted && !all {
            continue;
        }
        let (problems, sum) = problems_of(path, &read(path)?, &banned);
        for problem in &problems {
            println!("{path}:{problem}");
        }
        failed += if excepted { 0 } else { problems.len() };
        crates.entry((crate_of(path), excepted)).or_default().add(&sum);
    }

    // Find marks of a merge. `git grep` fails if it finds none, which is the normal case.
    for mark in output_of(command("git").args(["grep", "-InE", MERGE_MARK])).unwrap_or_default().lines() {
        println!("{mark}: expected no mark of an unfinished merge, found one");
        failed += 1;
    }

    println!("{:>8} {:>16} {:>8}  crate", "words", "what per 1000", "problems");
    for ((name, excepted), sum) in &crates {
        let note = if *excepted { " (an exception)" } else { "" };
        println!("{:8} {:16.1} {:8}  {name}{note}", sum.words, sum.per_thousand(), sum.problems);
    }
    // A crate may use `what` once, even if it has fewer than 1000 words.
    let checked = crates.iter().filter(|((_, excepted), _)| !excepted);
    for ((name, _), sum) in checked.filter(|(_, sum)| sum.whats.len() > 1 && sum.per_thousand() > 1.0) {
        failed += 1;
        println!("{name}: \"what\" more than once in 1000 words: {}", sum.whats.join(", "));
    }
    match failed {
        0 => Ok(()),
        count => Err(format!(
            "words: number of problems: {count}; docs/GLOSSARY.md has the terms, CONTRIBUTING.md the rules"
        )),
    }
}

impl Sum {
    fn add(&mut self, other: &Sum) {
        self.words += other.words;
        self.whats.extend_from_slice(&other.whats);
        self.problems += other.problems;
    }

    fn per_thousand(&self) -> f64 {
        1000.0 * self.whats.len() as f64 / self.words.max(1) as f64
    }
}

fn read(path: &str) -> Outcome<String> {
    std::fs::read_to_string(root().join(path)).map_err(|error| format!("{path}: {error}"))
}

fn is_within(path: &str, folder: &str) -> bool {
    path.strip_prefix(folder).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
}

/// Returns the crate or top folder of a file: `crates/core`, `docs`; `.` for the root's files.
fn crate_of(path: &str) -> String {
    let parts: Vec<&str> = path.split('/').collect();
    match parts.as_slice() {
        [top @ ("crates" | "plugins" | "examples"), name, _, ..] => format!("{top}/{name}"),
        [top, _, ..] => (*top).to_owned(),
        _ => ".".to_owned(),
    }
}

/// Reads the last column of the glossary's tables.
///
/// Words in italics also have right uses, so the check skips them.
fn banned_words(glossary: &str) -> Vec<Banned> {
    let mut banned = Vec::new();
    let mut in_table = false;
    for line in glossary.lines() {
        let cells: Vec<&str> = line.trim().trim_matches('|').split('|').map(str::trim).collect();
        let [term, _, _, not] = cells.as_slice() else {
            in_table = false;
            continue;
        };
        if *not == "not" {
            in_table = true;
        } else if in_table {
            let phrases = not.split(',').map(str::trim).filter(|phrase| !phrase.contains('*'));
            let phrases = phrases.map(words).filter(|phrase| !phrase.is_empty());
            let instead = term.replace('*', "");
            banned.extend(phrases.map(|phrase| Banned { phrase, instead: instead.clone() }));
        }
    }
    banned
}

/// Finds the problems of a file, each as "line: problem", and counts its words.
fn problems_of(path: &str, text: &str, banned: &[Banned]) -> (Vec<String>, Sum) {
    let mut found: Vec<(usize, String)> = Vec::new();
    let mut sum = Sum::default();
    for block in blocks(path, text) {
        sum.words += words(&block.text).len();
        // Skip the glossary's tables, which contain the banned words.
        if path == GLOSSARY && is_row(text, &block) {
            continue;
        }
        problems_of_block(path, &block, banned, &mut found, &mut sum);
    }
    if !path.ends_with(".md") {
        found.extend(wide_comments(path, text));
    }
    found.sort();
    sum.problems = found.len();
    (found.into_iter().map(|(line, problem)| format!("{line}: {problem}")).collect(), sum)
}

fn is_row(text: &str, block: &Block) -> bool {
    text.lines().nth(block.line - 1).is_some_and(|line| line.starts_with('|'))
}

fn problems_of_block(path: &str, block: &Block, banned: &[Banned], found: &mut Vec<(usize, String)>, sum: &mut Sum) {
    for sentence in sentences(block) {
        let words = words(sentence.text);
        let whats = words.iter().filter(|word| *word == "what");
        sum.whats.extend(whats.map(|_| format!("{path}:{}", sentence.line)));
        if words.len() > LONGEST_SENTENCE {
            found.push((
                sentence.line,
                format!("expected a sentence of at most {LONGEST_SENTENCE} words, found {} words", words.len()),
            ));
        }
        if let Some(first) = words.first().filter(|first| NO_BEGINNING.contains(&first.as_str())) {
            found.push((sentence.line, format!("a sentence begins with \"{first}\", which the style guide forbids")));
        }
        for Banned { phrase, instead } in banned {
            if words.windows(phrase.len()).any(|window| window == phrase) {
                found.push((
                    sentence.line,
                    format!("expected {instead}, the glossary's word, found \"{}\"", phrase.join(" ")),
                ));
            }
        }
    }
}

/// Finds lines that have only a comment and are too wide. Lines with an address, and rows of
/// tables, cannot be broken, so they may be wide.
fn wide_comments(path: &str, text: &str) -> impl Iterator<Item = (usize, String)> {
    // a line that begins with `*` is code in Rust and a comment in TypeScript
    let marks: &[&str] = match path.rsplit_once('.') {
        Some((_, "py")) => &["# "],
        Some((_, "ts" | "js" | "mjs")) => &["//", "* "],
        _ => &["//"],
    };
    text.lines().enumerate().filter_map(move |(index, line)| {
        let trimmed = line.trim_start();
        let is_comment = marks.iter().any(|mark| trimmed.starts_with(mark));
        let text = trimmed.trim_start_matches(['/', '!', '#', '*', ' ']);
        let unbreakable = text.starts_with('|') || trimmed.contains("://");
        let width = line.chars().count();
        let wide = is_comment && width > WIDEST_COMMENT && !unbreakable;
        wide.then(|| {
            (index + 1, format!("expected a comment line of at most {WIDEST_COMMENT} columns, found {width} columns"))
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const GLOSSARY_TEXT: &str = "\
| term | meaning | unit, symbol | not |
|---|---|---|---|
| **hit** | a ray's nearest intersection | | met, *meeting* |
| exposure and tone curve | maps radiance to 0..1 | | the look |
";

    fn problems(text: &str) -> Vec<String> {
        problems_of("a.rs", text, &banned_words(GLOSSARY_TEXT)).0
    }

    #[test]
    fn banned_words_are_found_in_comments_alone() {
        assert_eq!(
            problems("// the triangle that is met\nlet met = 1;\n"),
            ["1: expected hit, the glossary's word, found \"met\""]
        );
        let across = problems("/// Applies the\n/// look.\nfn look() {}\n");
        assert_eq!(across, ["1: expected exposure and tone curve, the glossary's word, found \"the look\""]);
        assert!(problems("// the meeting of `met` and metre\n").is_empty());
    }

    #[test]
    fn long_sentences_and_beginnings_are_found() {
        let long = format!("// Short one. Word\n{}// end.\n", "// and word\n".repeat(15));
        assert_eq!(problems(&long), ["1: expected a sentence of at most 30 words, found 32 words"]);
        let beginnings = problems("/// Fine.\n/// What it does.\n/// Whether it does.\n/// Of all, one.\n");
        assert_eq!(beginnings.len(), 3);
        assert_eq!(beginnings[0], "2: a sentence begins with \"what\", which the style guide forbids");
    }

    #[test]
    fn wide_comments_are_found_and_addresses_may_be_wide() {
        let line = format!("    // {}\n", "a".repeat(94));
        assert_eq!(problems(&line), ["1: expected a comment line of at most 100 columns, found 101 columns"]);
        assert!(problems(&format!("/// | {} |\n", "a".repeat(94))).is_empty());
        assert!(problems(&format!("// https://{}\n", "a".repeat(94))).is_empty());
        assert!(problems(&format!("let a = \"{}\";\n", "a".repeat(94))).is_empty());
    }

    #[test]
    fn every_exception_exists() {
        for folder in EXCEPTIONS {
            assert!(root().join(folder).exists(), "{folder} is in the list and not in the repository");
        }
    }

    #[test]
    fn files_belong_to_their_crate() {
        assert_eq!(crate_of("crates/core/src/lib.rs"), "crates/core");
        assert_eq!(crate_of("docs/plugins/a.md"), "docs");
        assert_eq!(crate_of("README.md"), ".");
        assert!(is_within("crates/core/src/lib.rs", "crates/core"));
        assert!(!is_within("crates/core-x/src/lib.rs", "crates/core"));
    }
}
