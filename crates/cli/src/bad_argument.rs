//! Arguments that are refused by their values, once the command line was understood: the exit code is that of a command line that is not.

use std::error::Error;
use std::fmt;

use lsfb_types::OutOfBounds;

/// What was asked for wrongly. The same in a file of settings is none: the file could not be used.
#[derive(Debug)]
pub struct BadArgument(String);

impl BadArgument {
    /// `message` names the argument, and says what it may be.
    pub fn new(message: impl Into<String>) -> Self {
        Self(message.into())
    }

    /// Settings that options alone make, refused as [`Self::of_option`] says it.
    pub fn check(checked: Result<(), OutOfBounds>, named: &[(&str, &str)]) -> Result<(), Self> {
        checked.map_err(|error| Self::of_option(&error, named))
    }

    /// For settings that options alone make, which are called as the options are (`window_secs` is `--window-secs`) unless `named` has
    /// the setting with another option.
    pub fn of_option(error: &OutOfBounds, named: &[(&str, &str)]) -> Self {
        let OutOfBounds {
            field,
            value,
            bounds,
        } = error;
        let other = named.iter().find(|(setting, _)| setting == field);
        let option = match other {
            Some((_, option)) => (*option).to_owned(),
            None => format!("--{}", field.replace(['.', '_'], "-")),
        };
        Self(format!("{option} is {value}: it must be {bounds}"))
    }
}

impl fmt::Display for BadArgument {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl Error for BadArgument {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_called_as_their_options() {
        let refused = OutOfBounds::new("rpe", "delta", &0, &"more than 0");
        let said = |named| BadArgument::of_option(&refused, named).to_string();
        assert_eq!(said(&[]), "--rpe-delta is 0: it must be more than 0");
        let named = [("rpe.delta", "--every")];
        assert_eq!(said(&named), "--every is 0: it must be more than 0");
    }
}
