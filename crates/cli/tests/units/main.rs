//! Units whose packets are made here: played in one process, recorded in another, unplugged.

mod buses;
#[path = "../../../../tests/tests/fake_kernel/library.rs"]
mod library;
mod recorded;
#[path = "../running/mod.rs"]
mod running;
mod told_at_once;
