//! Units whose packets are made here: played in one process, recorded in another, unplugged.

mod buses;
mod recorded;
mod told_at_once;
