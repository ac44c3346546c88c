//! What a command that refuses must do: one sentence, and nothing else changed.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Output;

use lsfb_recording::sha256_of;

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

/// Runs a command that must fail, saying all of `words`, and touch nothing though it might: what it would have replaced may
/// stand aside as `NAME.old`, so that it does not look new.
pub fn refused(folder: &Path, arguments: &[&str], words: &[&str]) {
    let before = contents(folder);
    let output = lsfb(folder, &[arguments, &["--force"]].concat());
    let sentence = sentence(&output);
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {sentence}");
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
}
