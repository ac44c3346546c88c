//! What is written to stdout and stderr, and in which colours. Nothing here panics where either is closed or full.

use std::io::{ErrorKind, IsTerminal, Write};

use anyhow::Context as _;

/// Colours of the words that matter, as every terminal has them.
const RED: &str = "\x1b[1;31m";
const YELLOW: &str = "\x1b[1;33m";
const GREEN: &str = "\x1b[1;32m";
const PLAIN: &str = "\x1b[0m";

/// Writes text for people to stdout, in colour where that helps.
pub fn print(text: &str) -> anyhow::Result<()> {
    match is_coloured(&std::io::stdout()) {
        true => print_plain(&painted(text)),
        false => print_plain(text),
    }
}

/// Writes text for programs and a line end to stdout. Whoever closed the other end has read enough; anything else is an error.
pub fn print_plain(text: &str) -> anyhow::Result<()> {
    let mut stdout = std::io::stdout().lock();
    match writeln!(stdout, "{text}").and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(error).context("cannot write to standard output")
        }
        _ => Ok(()),
    }
}

/// Writes a line to stderr; where that fails there is nobody left to tell.
pub fn say(line: &str) {
    let mut stderr = std::io::stderr().lock();
    let coloured = is_coloured(&stderr).then(|| painted(line));
    let _ = writeln!(stderr, "{}", coloured.as_deref().unwrap_or(line));
}

/// The same lines, in colour where stderr shows colours: for what is drawn there in place.
pub fn for_stderr(lines: &str) -> String {
    match stderr_is_coloured() {
        true => painted(lines),
        false => lines.to_owned(),
    }
}

/// Whether progress may be drawn in colour.
pub fn stderr_is_coloured() -> bool {
    is_coloured(&std::io::stderr())
}

/// Colours are for terminals, and for people who want them (<https://no-color.org>).
fn is_coloured(stream: &impl IsTerminal) -> bool {
    let unwanted = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    let plain = std::env::var_os("TERM").is_some_and(|term| term == "dumb");
    stream.is_terminal() && !unwanted && !plain
}

/// The verdicts and what begins a line of trouble, in colour.
fn painted(text: &str) -> String {
    let mut out = String::with_capacity(text.len() + 64);
    for piece in text.split_inclusive(|c: char| c.is_whitespace() || c == ':' || c == ',') {
        let word = piece.trim_end_matches(|c: char| c.is_whitespace() || c == ':' || c == ',');
        let colour = match word {
            "PASS" | "✓" => GREEN,
            "WARN" | "UNKNOWN" | "warning" => YELLOW,
            "FAIL" | "LOST" | "error" | "✗" => RED,
            _ => "",
        };
        if colour.is_empty() {
            out.push_str(piece);
        } else {
            let rest = &piece[word.len()..];
            out.extend([colour, word, PLAIN, rest]);
        }
    }
    out
}

/// Words from a file, without anything that a terminal would obey.
pub fn printable(text: &str) -> String {
    let shown = |c: char| match c {
        '\n' | '\t' => c,
        c if c.is_control() => char::REPLACEMENT_CHARACTER,
        c => c,
    };
    text.chars().map(shown).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_whole_words_are_coloured_and_nothing_is_lost() {
        let text = "FAIL: cam0, PASSAGE\n  WARN  x\terrors\n";
        let painted = painted(text);
        assert!(painted.starts_with("\x1b[1;31mFAIL\x1b[0m: cam0, PASSAGE\n"));
        assert!(painted.contains("\x1b[1;33mWARN\x1b[0m  x\terrors\n"));
        let mut plain = painted;
        for code in [RED, YELLOW, GREEN, PLAIN] {
            plain = plain.replace(code, "");
        }
        assert_eq!(plain, text);
    }

    #[test]
    fn a_recording_cannot_command_the_terminal() {
        let said = printable("\u{1b}]0;owned\u{7} /imu\u{9b}31m\n");
        assert_eq!(said, "\u{fffd}]0;owned\u{fffd} /imu\u{fffd}31m\n");
    }
}
