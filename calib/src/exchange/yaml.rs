//! YAML as other programs write it: OpenCV's head `%YAML:1.0` and its tags, several documents as `ros2 topic echo` prints them;
//! and what of it was not used.

use std::collections::BTreeMap;

use serde::de::DeserializeOwned;
use serde_norway::Value;

use super::{not_used, parse_error};
use crate::Error;

/// Keys that no reader knew.
pub(super) type Others = BTreeMap<String, Value>;

/// Reads the one document of a file. Further ones must say the same, but for their `header`: messages of one topic.
pub(super) fn read<T: DeserializeOwned>(text: &str, path: &str) -> Result<T, Error> {
    let documents = documents(text);
    let Some((first, others)) = documents.split_first() else {
        return Err(parse_error(path, "the file is empty"));
    };
    let wrong = |e: serde_norway::Error| parse_error(path, e);
    if !others.is_empty() {
        let without_header = |document: &String| -> Result<Value, Error> {
            let mut value: Value = serde_norway::from_str(document).map_err(wrong)?;
            if let Value::Mapping(entries) = &mut value {
                entries.remove("header");
            }
            Ok(value)
        };
        let said = without_header(first)?;
        for (k, other) in others.iter().enumerate() {
            if without_header(other)? != said {
                return Err(parse_error(
                    path,
                    format!(
                        "document {} of {} differs from the first: keep one of them",
                        k + 2,
                        documents.len()
                    ),
                ));
            }
        }
    }
    // A key that stands twice is refused here; a map of our own types would take the last.
    serde_norway::from_str::<Value>(first).map_err(wrong)?;
    serde_norway::from_str(first).map_err(wrong)
}

/// The documents that say something, each with its lines where they are in the file.
fn documents(text: &str) -> Vec<String> {
    let mut all = vec![String::new()];
    for (number, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let ends = matches!(line.trim_end(), "---" | "...");
        if ends {
            all.push("\n".repeat(number));
        }
        if let Some(document) = all.last_mut() {
            // OpenCV's head is no YAML directive, and its matrices are mappings like any other.
            if !ends && !line.starts_with('%') {
                *document += &line.replace("!!opencv-matrix", "");
            }
            document.push('\n');
        }
    }
    let says_something = |line: &str| !line.trim().is_empty() && !line.trim().starts_with('#');
    all.retain(|document| document.lines().any(says_something));
    all
}

/// A note on the keys of `what` that were not used; `None` where there are none. A zero, a zero matrix and an identity change
/// nothing and are not mentioned.
pub(super) fn unused(what: &str, others: &Others) -> Option<String> {
    let names: Vec<&str> = others
        .iter()
        .filter(|(_, value)| !is_neutral(value))
        .map(|(name, _)| name.as_str())
        .collect();
    (!names.is_empty()).then(|| not_used(what, &names))
}

fn is_neutral(value: &Value) -> bool {
    match value {
        Value::Null => true,
        Value::Number(n) => n.as_f64() == Some(0.0),
        Value::Sequence(rows) => {
            let is_row = |(i, row): (usize, &Value)| match row {
                Value::Sequence(row) => row.iter().enumerate().all(|(j, x)| {
                    let expected = if i == j { 1.0 } else { 0.0 };
                    x.as_f64() == Some(expected)
                }),
                _ => false,
            };
            rows.iter().all(is_neutral) || rows.iter().enumerate().all(is_row)
        }
        _ => false,
    }
}
