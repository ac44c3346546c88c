//! What a command that refuses must do: one sentence, and nothing else changed.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Output;

use lsfb_recording::sha256_of;
use serde_json::Value;

use crate::process::lsfb;

/// SHA-256 of every file below a folder.
pub fn contents(folder: &Path) -> BTreeMap<PathBuf, String> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(folder).expect("folder") {
        let path = entry.expect("file").path();
        if path.is_dir() {
            found.extend(contents(&path));
        } else {
            found.insert(path.clone(), sha256_of(&path).expect("file"));
        }
    }
    found
}

/// The one sentence on stderr, after which nothing comes.
fn sentence(output: &Output) -> String {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!text.contains("panicked"), "{text}");
    let errors: Vec<&str> = text
        .lines()
        .filter(|line| line.starts_with("error: "))
        .collect();
    assert_eq!(errors.len(), 1, "{text}");
    assert_eq!(text.lines().last(), Some(errors[0]), "{text}");
    errors[0].to_owned()
}

/// Runs a command that cannot do what it is asked, and must say all of `words` and touch nothing though it might: what it would
/// have replaced may stand aside as `NAME.old`, so that it does not look new.
pub fn refused(folder: &Path, arguments: &[&str], words: &[&str]) {
    let found = fails(folder, arguments, words, 1);
    assert!(found.get("verdict").is_none(), "{found}");
}

/// The same of arguments that are refused by their values.
pub fn badly_asked(folder: &Path, arguments: &[&str], words: &[&str]) {
    let found = fails(folder, arguments, words, 2);
    assert!(found.get("verdict").is_none(), "{found}");
}

/// The same of one that finds its data unfit; gives the finding.
pub fn found_unfit(folder: &Path, arguments: &[&str], words: &[&str]) -> Value {
    let found = fails(folder, arguments, words, 4);
    assert_eq!(found["verdict"], "fail", "{found}");
    let finding = found["findings"][0].clone();
    let what = finding["what"].as_str().expect("what was found");
    let message = found["error"].as_str().expect("a message");
    assert!(message.contains(what), "{found}");
    assert!(
        finding["code"].is_string() && finding["remedy"].is_string(),
        "{found}"
    );
    finding
}

fn fails(folder: &Path, arguments: &[&str], words: &[&str], code: i32) -> Value {
    let before = contents(folder);
    let output = lsfb(folder, &[arguments, &["--force", "--json"]].concat());
    let sentence = sentence(&output);
    assert_eq!(
        output.status.code(),
        Some(code),
        "{arguments:?}: {sentence}"
    );
    let found: Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    assert!(found["error"].is_string(), "{found}");
    for word in words {
        assert!(
            sentence.contains(word),
            "{arguments:?} does not say {word:?}: {sentence}"
        );
    }
    let after = contents(folder);
    for (path, hash) in before {
        let aside = PathBuf::from(format!("{}.old", path.display()));
        let now = after.get(&path).or_else(|| after.get(&aside));
        assert_eq!(now, Some(&hash), "{arguments:?} changed {}", path.display());
    }
    found
}
