//! Values of an option that are a library's enum: its own list and its own names, so that neither is written twice.

use clap::builder::{PossibleValuesParser, TypedValueParser};

/// Takes one of `all` by its name; help, completions and what is said of another value list them.
pub fn one_of<T: Copy + Send + Sync + 'static>(
    all: &'static [T],
    name: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T> {
    PossibleValuesParser::new(all.iter().map(|value| name(*value))).try_map(move |text| {
        let found = all.iter().copied().find(|value| name(*value) == text);
        found.ok_or("no such value")
    })
}
