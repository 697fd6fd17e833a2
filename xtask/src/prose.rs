//! Extracts the prose of files: comments in sources, text in Markdown, messages of errors.
//!
//! A block is one paragraph, list item, table cell, picture, trailing comment or message. Fenced
//! code, indented code and doctests are ignored, and a span in backticks is regarded as one word.

/// A block of prose. `line` is the number of its first line, from 1; `text` has its lines, joined
/// by `\n`.
#[derive(Debug, PartialEq)]
pub struct Block {
    pub line: usize,
    pub text: String,
}

/// A sentence, and the number of the line on which it begins.
#[derive(Debug, PartialEq)]
pub struct Sentence<'a> {
    pub line: usize,
    pub text: &'a str,
}

/// Words after which a full stop does not end the sentence.
const ABBREVIATIONS: [&str; 14] =
    ["e.g", "i.e", "eq", "eqs", "fig", "figs", "sec", "ch", "no", "vol", "p", "pp", "al", "vs"];

/// Extracts the prose of a file. The ending of its name selects the language; files of other
/// languages have no prose.
pub fn blocks(path: &str, text: &str) -> Vec<Block> {
    match path.rsplit_once('.').map(|(_, ending)| ending) {
        Some("rs") => c_like(text, &['"'], true),
        Some("ts" | "js" | "mjs") => c_like(text, &['"', '\'', '`'], false),
        Some("wgsl") => c_like(text, &[], false),
        Some("py") => python(text),
        Some("md") => paragraphs(text.lines().enumerate().map(|(index, line)| (index + 1, line.to_owned())).collect()),
        _ => Vec::new(),
    }
}

/// Splits a block into sentences. A sentence ends at `.`, `!` or `?` at the end of the block, or
/// before a space and a capital, a digit or an opening sign such as `(`. A sign in code ends no
/// sentence, and the full stop of an abbreviation ends no sentence.
pub fn sentences(block: &Block) -> Vec<Sentence<'_>> {
    let text = &block.text;
    let (mut found, mut start, mut in_code) = (Vec::new(), 0, false);
    for (at, letter) in text.char_indices() {
        in_code ^= letter == '`';
        if in_code || at < start || !".!?".contains(letter) {
            continue;
        }
        let after = &text[at + letter.len_utf8()..];
        let rest = after.trim_start_matches([')', '"', '*', '_', '”']);
        let next = rest.trim_start().chars().next();
        let begins = next.is_none_or(|next| next.is_uppercase() || next.is_numeric() || "`[*(\"“".contains(next));
        let word = text[start..at].rsplit(|c: char| c.is_whitespace() || c == '(').next().unwrap_or_default();
        let abbreviated = ABBREVIATIONS.contains(&word.to_lowercase().as_str());
        let apart = rest.is_empty() || rest.starts_with(char::is_whitespace);
        if apart && begins && !abbreviated {
            let end = text.len() - rest.len();
            found.push((start, end));
            start = end;
        }
    }
    found.push((start, text.len()));
    let sentence = |(start, end): (usize, usize)| {
        let begin = start + text[start..end].len() - text[start..end].trim_start().len();
        let line = block.line + text[..begin].matches('\n').count();
        Sentence { line, text: text[begin..end].trim_end() }
    };
    found.into_iter().map(sentence).filter(|sentence| !words(sentence.text).is_empty()).collect()
}

/// Returns the words of a text. A span in backticks becomes the word "`", and of a link only its
/// text remains.
pub fn words(text: &str) -> Vec<String> {
    let mut found = Vec::new();
    for (index, part) in text.split('`').enumerate() {
        if index % 2 == 1 {
            found.push("`".to_owned());
            continue;
        }
        for token in part.split_whitespace() {
            let token = token.split_once("](").map_or(token, |(name, _)| name);
            let is_word = |word: &&str| word.contains(char::is_alphanumeric) && !word.contains("://");
            let pieces = token.split(|c: char| !(c.is_alphanumeric() || "'’-".contains(c) || c == ':'));
            found.extend(pieces.filter(is_word).map(|word| word.trim_matches([':', '\'', '-']).to_lowercase()));
        }
    }
    found
}

/// Collects lines of comment text into blocks.
#[derive(Default)]
struct Collector {
    lines: Vec<(usize, String)>,
    blocks: Vec<Block>,
}

impl Collector {
    fn line(&mut self, number: usize, text: &str) {
        // a gap of a line or more between two lines of comment ends the block
        if self.lines.last().is_some_and(|(last, _)| last + 1 != number) {
            self.end();
        }
        self.lines.push((number, text.to_owned()));
    }

    fn end(&mut self) {
        self.blocks.extend(paragraphs(std::mem::take(&mut self.lines)));
    }

    /// Adds a text that is a block of its own: a trailing comment or a message.
    fn alone(&mut self, number: usize, text: &str) {
        self.end();
        self.line(number, text);
        self.end();
    }
}

/// Splits lines of Markdown into paragraphs, items and cells, and removes code.
fn paragraphs(lines: Vec<(usize, String)>) -> Vec<Block> {
    let (mut blocks, mut open, mut fenced, mut in_list) = (Vec::<Block>::new(), false, false, false);
    let mut in_doctest = false;
    for (number, text) in lines {
        let trimmed = text.trim();
        if trimmed.starts_with("```") {
            (fenced, open) = (!fenced, false);
            continue;
        }
        // a doctest of Python includes its output, and ends at an empty line
        in_doctest = trimmed.starts_with(">>>") || (in_doctest && !trimmed.is_empty());
        if in_doctest {
            open = false;
            continue;
        }
        let indent = text.len() - text.trim_start().len();
        if fenced || trimmed.is_empty() || (indent >= 4 && !open && !in_list) {
            open = false;
            continue;
        }
        if trimmed.starts_with('|') {
            let cells = trimmed.split('|').filter(|cell| !words(cell).is_empty());
            blocks.extend(cells.map(|cell| Block { line: number, text: cell.trim().to_owned() }));
            open = false;
            continue;
        }
        let number_ends = trimmed.trim_start_matches(|c: char| c.is_ascii_digit());
        let numbered = number_ends.len() < trimmed.len() && number_ends.starts_with(". ");
        let item = trimmed.starts_with("- ") || trimmed.starts_with("* ") || numbered;
        let alone = trimmed.starts_with('#') || trimmed.starts_with("![");
        in_list = item || (in_list && indent > 0);
        let text = if item { trimmed.split_once(' ').map_or("", |(_, rest)| rest) } else { trimmed };
        match blocks.last_mut() {
            Some(block) if open && !item && !alone => {
                block.text.push('\n');
                block.text.push_str(text);
            }
            _ => blocks.push(Block { line: number, text: text.trim_start_matches('#').trim().to_owned() }),
        }
        open = !alone;
    }
    blocks
}

/// Extracts comments of Rust, TypeScript and WGSL, and messages of `#[error("...")]` in Rust.
fn c_like(text: &str, quotes: &[char], rust: bool) -> Vec<Block> {
    let mut found = Collector::default();
    let (mut at, mut line, mut code) = (0, 1, String::new());
    while at < text.len() {
        let rest = &text[at..];
        let first = rest.chars().next().unwrap_or_default();
        let length = if rest.starts_with("//") {
            let end = rest.find('\n').unwrap_or(rest.len());
            let comment = rest[2..end].trim_start_matches(['/', '!']);
            let comment = comment.strip_prefix(' ').unwrap_or(comment);
            if code.is_empty() {
                found.line(line, comment)
            } else {
                found.alone(line, comment)
            }
            end
        } else if rest.starts_with("/*") {
            let end = rest.find("*/").map_or(rest.len(), |end| end + 2);
            let comment = rest[2..end].trim_end_matches("*/");
            if !code.is_empty() {
                found.end();
            }
            for (index, text) in comment.lines().enumerate() {
                found.line(line + index, text.trim().trim_start_matches('*').trim_start());
            }
            end
        } else if let Some(length) = raw_string(rest).filter(|_| rust) {
            length
        } else if quotes.contains(&first) {
            let length = string(rest, first);
            if rust && message_follows(&text[..at]) {
                let message = rest[1..length].trim_end_matches('"').replace("\\\n", "\n");
                let message = message.lines().map(str::trim).collect::<Vec<_>>().join("\n");
                found.alone(line, &placeholders(&message));
            }
            length
        } else if rust && first == '\'' {
            character(rest)
        } else {
            first.len_utf8()
        };
        let passed = &rest[..length];
        line += passed.matches('\n').count();
        match passed.rfind('\n') {
            Some(_) => code.clear(),
            None if passed.starts_with("//") || passed.trim().is_empty() => {}
            None => code.push_str(passed),
        }
        at += length;
    }
    found.end();
    found.blocks
}

/// Returns true if the code so far ends with `#[error(`, so that a message follows.
fn message_follows(code: &str) -> bool {
    code.trim_end().ends_with("#[error(")
}

/// Replaces every `{...}` in a message by a span in backticks.
fn placeholders(message: &str) -> String {
    let (mut text, mut depth) = (String::new(), 0);
    for letter in message.chars() {
        match letter {
            '{' => depth += 1,
            '}' => {
                depth -= 1;
                if depth == 0 {
                    text.push_str("`x`");
                }
            }
            _ if depth == 0 && letter != '`' => text.push(letter),
            _ => {}
        }
    }
    text
}

/// Returns the length of the string at the start of `text`, with its quotes.
fn string(text: &str, quote: char) -> usize {
    let mut escaped = false;
    for (at, letter) in text.char_indices().skip(1) {
        if letter == quote && !escaped {
            return at + letter.len_utf8();
        }
        escaped = letter == '\\' && !escaped;
    }
    text.len()
}

/// Returns the length of Rust's raw string at the start of `text`; `None` if there is none.
fn raw_string(text: &str) -> Option<usize> {
    let inner = text.strip_prefix("br").or_else(|| text.strip_prefix('r'))?;
    let hashes = inner.len() - inner.trim_start_matches('#').len();
    let body = inner[hashes..].strip_prefix('"')?;
    let close = format!("\"{}", "#".repeat(hashes));
    let start = text.len() - body.len();
    Some(body.find(&close).map_or(text.len(), |end| start + end + close.len()))
}

/// Returns the length of Rust's character literal at the start of `text`. If `text` begins with a
/// lifetime instead, the function returns 1, the length of the quote.
fn character(text: &str) -> usize {
    let mut letters = text.char_indices().skip(1);
    match (letters.next(), letters.next()) {
        (Some((_, '\\')), Some(_)) => text[3..].find('\'').map_or(1, |end| end + 4),
        (Some(_), Some((at, '\''))) => at + 1,
        _ => 1,
    }
}

/// Extracts comments and docstrings of Python.
fn python(text: &str) -> Vec<Block> {
    let mut found = Collector::default();
    let (mut at, mut line, mut code) = (0, 1, String::new());
    while at < text.len() {
        let rest = &text[at..];
        let first = rest.chars().next().unwrap_or_default();
        let triple = ["\"\"\"", "'''"].into_iter().find(|quotes| rest.starts_with(quotes));
        let length = if first == '#' {
            let end = rest.find('\n').unwrap_or(rest.len());
            let comment = rest[1..end].strip_prefix(' ').unwrap_or(&rest[1..end]);
            if code.is_empty() {
                found.line(line, comment)
            } else {
                found.alone(line, comment)
            }
            end
        } else if let Some(quotes) = triple {
            let body = &rest[3..];
            let end = body.find(quotes).unwrap_or(body.len());
            if code.trim_matches(['r', 'f']).is_empty() {
                found.end();
                let indent = |text: &&str| text.len() - text.trim_start().len();
                let margin = body[..end].lines().skip(1).filter(|text| !text.trim().is_empty());
                let margin = margin.map(|text| indent(&text)).min().unwrap_or(0);
                for (index, text) in body[..end].lines().enumerate() {
                    found.line(line + index, &text[margin.min(indent(&text))..]);
                }
                found.end();
            }
            (end + 6).min(rest.len())
        } else if first == '"' || first == '\'' {
            string(rest, first)
        } else {
            first.len_utf8()
        };
        let passed = &rest[..length];
        line += passed.matches('\n').count();
        match passed.rfind('\n') {
            Some(_) => code.clear(),
            None if first == '#' || passed.trim().is_empty() => {}
            None => code.push_str(passed),
        }
        at += length;
    }
    found.end();
    found.blocks
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(path: &str, text: &str) -> Vec<(usize, String)> {
        blocks(path, text).into_iter().map(|block| (block.line, block.text)).collect()
    }

    fn block(line: usize, text: &str) -> (usize, String) {
        (line, text.to_owned())
    }

    #[test]
    fn comments_of_rust_are_found_and_strings_are_not() {
        let text = "//! One\n//! two.\n//!\n//! Three.\nlet a = \"// no\"; // trailing\n// next\nlet b = '\"'; /* four */\n\
                    fn f<'a>(x: &'a str) {} // five\nlet r = r#\"// \"no\" \"#; // six\nlet c = '\\''; // seven\n";
        let expected = [
            block(1, "One\ntwo."),
            block(4, "Three."),
            block(5, "trailing"),
            block(6, "next"),
            block(7, "four"),
            block(8, "five"),
            block(9, "six"),
            block(10, "seven"),
        ];
        assert_eq!(found("a.rs", text), expected);
    }

    #[test]
    fn messages_of_errors_are_found() {
        let text = "#[error(\"{path}: no key {key:?} \\\n  here\")]\n#[error(\n  \"second\"\n)]\n#[doc = \"no\"]\n";
        assert_eq!(found("a.rs", text), [block(1, "`x`: no key `x`\nhere"), block(4, "second")]);
    }

    #[test]
    fn code_in_docs_is_no_prose() {
        let text = "/// Before:\n/// ```\n/// let what = 1;\n/// ```\n/// After.\n///\n///     x = what\n\
                    ///\n/// * item one\n///   goes on\n/// * item two\n/// | a | b |\n";
        let expected = [
            block(1, "Before:"),
            block(5, "After."),
            block(9, "item one\ngoes on"),
            block(11, "item two"),
            block(12, "a"),
            block(12, "b"),
        ];
        assert_eq!(found("a.rs", text), expected);
    }

    #[test]
    fn docstrings_and_comments_of_python_are_found() {
        let text = "def f():\n    \"\"\"Returns x.\n\n    More:\n        code()\n    \"\"\"\n    y = '# no'  # why\n    z = \"\"\"no\"\"\"\n";
        assert_eq!(found("a.py", text), [block(2, "Returns x."), block(4, "More:\ncode()"), block(7, "why")]);
    }

    #[test]
    fn doctests_are_no_prose() {
        let text = "def f():\n    \"\"\"Returns x.\n\n    >>> what()\n    1\n\n    After.\n    \"\"\"\n";
        assert_eq!(found("a.py", text), [block(2, "Returns x."), block(7, "After.")]);
    }

    #[test]
    fn pictures_are_blocks_of_their_own() {
        assert_eq!(found("a.md", "![One](a)\n![Two](b)\n"), [block(1, "![One](a)"), block(2, "![Two](b)")]);
    }

    #[test]
    fn markdown_splits_into_headings_and_paragraphs() {
        let text = "# Title\nOne\ntwo.\n\n```\ncode\n```\n1. first\n   on\n2. second\n";
        let expected = [block(1, "Title"), block(2, "One\ntwo."), block(8, "first\non"), block(10, "second")];
        assert_eq!(found("a.md", text), expected);
    }

    #[test]
    fn sentences_end_at_a_full_stop_before_a_capital() {
        let text = "See eq. 5 of the paper, e.g. this. `f.g. H` ends here!\nThe value\nis 1.5 (low). Last";
        let block = Block { line: 7, text: text.to_owned() };
        let found: Vec<(usize, &str)> = sentences(&block).iter().map(|s| (s.line, s.text)).collect();
        let expected = [
            (7, "See eq. 5 of the paper, e.g. this."),
            (7, "`f.g. H` ends here!"),
            (8, "The value\nis 1.5 (low)."),
            (9, "Last"),
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn code_counts_as_one_word() {
        let found = words("The `a b c` of [a link](https://x.y/z), isn't well-known: 3 m/s");
        assert_eq!(found, ["the", "`", "of", "a", "link", "isn't", "well-known", "3", "m", "s"]);
    }
}
