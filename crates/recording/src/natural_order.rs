//! Names in the order in which people count: `pose10` follows `pose9`.

use std::path::PathBuf;

/// Sorts files by their names; numbers in names count as numbers.
pub fn sort_naturally(files: &mut [PathBuf]) {
    files.sort_by_cached_key(|p| natural_key(&p.to_string_lossy()));
}

/// Text cut into words and numbers: numbers compare by value, then all by text.
fn natural_key(name: &str) -> (Vec<(String, u128)>, String) {
    let mut parts: Vec<(String, u128)> = Vec::new();
    let mut word = String::new();
    let mut digits = String::new();
    for c in name.chars().chain(['\0']) {
        if c.is_ascii_digit() {
            digits.push(c);
            continue;
        }
        if !digits.is_empty() {
            let number = digits.parse().unwrap_or(u128::MAX);
            parts.push((std::mem::take(&mut word), number));
            digits.clear();
        }
        word.push(c);
    }
    parts.push((word, 0));
    (parts, name.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_ordered_by_their_numbers() {
        let names = ["img10.png", "img9.png", "a2", "img2b", "img2", "10", "2"];
        let mut files: Vec<PathBuf> = names.iter().map(PathBuf::from).collect();
        sort_naturally(&mut files);
        let expected = ["2", "10", "a2", "img2", "img2b", "img9.png", "img10.png"];
        assert_eq!(files, expected.map(PathBuf::from));
    }
}
