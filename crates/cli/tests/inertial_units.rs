//! Units whose packets are made here: played in one process, recorded in another, unplugged.

mod running;
mod units;
