//! What stands beside the library: its examples and the rules that name devices.

mod examples;
mod udev_rules;
