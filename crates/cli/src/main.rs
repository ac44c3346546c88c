//! The `lsfb` binary.
fn main() {}
