//! Names in settings that become folders, files or topics: each is plain, and there once.

use std::collections::BTreeSet;

use crate::OutOfBounds;

/// What names may be.
#[derive(Clone, Copy, Debug)]
pub struct Names {
    /// Whether a letter may stand in one.
    pub holds: fn(char) -> bool,
    /// Those letters in words: `letters, digits and underscores`.
    pub letters: &'static str,
}

impl Names {
    /// Refuses a name that is empty, begins with a dot or has other letters, and one that was there already. Each comes with its setting,
    /// as `lidar.name`.
    pub fn check<'a>(
        self,
        names: impl IntoIterator<Item = (&'a str, &'a str)>,
    ) -> Result<(), OutOfBounds> {
        let mut known = BTreeSet::new();
        for (setting, name) in names {
            let bounds = if name.is_empty() || !name.chars().all(self.holds) {
                format!("a name of {}", self.letters)
            } else if name.starts_with('.') {
                "a name without a dot in front".to_owned()
            } else if !known.insert(name) {
                "a name that nothing else has".to_owned()
            } else {
                continue;
            };
            return Err(OutOfBounds::new("", setting, &format!("{name:?}"), &bounds));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NAMES: Names = Names {
        holds: |c| c.is_ascii_alphanumeric() || c == '.',
        letters: "letters, digits and dots",
    };

    #[test]
    fn names_are_plain_and_there_once() {
        let check = |names: [&str; 2]| {
            let names = names.iter().map(|name| ("device.name", *name));
            NAMES.check(names).map_err(|e| e.to_string())
        };
        assert_eq!(check(["a.b", "c"]), Ok(()));
        for name in ["", "../up", "a b"] {
            let refused = check(["a", name]).expect_err(name);
            let expected = format!(
                "setting device.name is {name:?}: it must be a name of letters, digits and dots"
            );
            assert_eq!(refused, expected);
        }
        assert_eq!(
            check(["a", ".b"]).expect_err("hidden"),
            "setting device.name is \".b\": it must be a name without a dot in front"
        );
        assert_eq!(
            check(["a", "a"]).expect_err("twice"),
            "setting device.name is \"a\": it must be a name that nothing else has"
        );
    }
}
