//! A system's command: words with placeholders, started without a shell.

use std::collections::BTreeMap;

/// Splits a command as a shell does: blanks separate, quotes join, a backslash takes the next letter as it is outside single quotes.
pub(super) fn words(command: &str) -> Result<Vec<String>, String> {
    let mut words = Vec::new();
    let mut word: Option<String> = None;
    let mut quote = None;
    let mut letters = command.chars();
    while let Some(letter) = letters.next() {
        match (letter, quote) {
            ('\\', None | Some('"')) => {
                let next = letters.next().ok_or("the command ends with a backslash")?;
                word.get_or_insert_default().push(next);
            }
            ('"' | '\'', None) => {
                quote = Some(letter);
                word.get_or_insert_default();
            }
            (letter, Some(open)) if letter == open => quote = None,
            (letter, None) if letter.is_whitespace() => words.extend(word.take()),
            (letter, _) => word.get_or_insert_default().push(letter),
        }
    }
    if quote.is_some() {
        return Err("a quote is not closed".to_owned());
    }
    words.extend(word);
    match words.is_empty() {
        true => Err("the command is empty".to_owned()),
        false => Ok(words),
    }
}

/// Puts values in place of `{name}`; a name that is not known is an error, and `{{` is a brace.
pub(super) fn filled(word: &str, values: &BTreeMap<&str, String>) -> Result<String, String> {
    let mut out = String::new();
    let mut rest = word;
    while let Some((before, after)) = rest.split_once('{') {
        out += before;
        if let Some(after) = after.strip_prefix('{') {
            out.push('{');
            rest = after;
            continue;
        }
        let (name, after) = after
            .split_once('}')
            .ok_or_else(|| format!("'{word}' has a brace that is not closed"))?;
        let value = values.get(name).ok_or_else(|| {
            let known: Vec<&str> = values.keys().copied().collect();
            format!("{{{name}}} is not a placeholder; use {}", known.join(", "))
        })?;
        out += value;
        rest = after;
    }
    Ok(out + &rest.replace("}}", "}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_split_as_a_shell_does() {
        let of = |text: &str| words(text).expect("words");
        assert_eq!(of("a  b\tc"), ["a", "b", "c"]);
        assert_eq!(
            of("a 'b c' \"d 'e\" f\\ g ''"),
            ["a", "b c", "d 'e", "f g", ""]
        );
        for wrong in ["", "  ", "a 'b", "a\\"] {
            assert!(words(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn placeholders_are_filled_and_nothing_is_run() {
        let values = BTreeMap::from([("input", "/a b/$(rm)".to_owned()), ("run", "2".to_owned())]);
        let fill = |word: &str| filled(word, &values);
        assert_eq!(
            fill("{input}/mav0-{run}").as_deref(),
            Ok("/a b/$(rm)/mav0-2")
        );
        assert_eq!(fill("{{run}}").as_deref(), Ok("{run}"));
        assert!(
            fill("{inputs}")
                .expect_err("unknown")
                .contains("use input, run")
        );
        assert!(fill("{input").is_err());
    }
}
