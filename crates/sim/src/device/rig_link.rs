//! How a simulated app finds its rig.

use std::thread;
use std::time::{Duration, Instant};

use lsfb_drivers::sidecar::{ClientConfig, SidecarClient};

use super::clock::SimClock;
use crate::Error;

/// Between two attempts to connect.
const RETRY: Duration = Duration::from_millis(100);

/// Connects, looking for the rig as long as `patience`. `None`: the session was stopped before.
pub(super) fn connect(
    rig: &ClientConfig,
    patience: Duration,
    clock: &SimClock,
) -> Result<Option<SidecarClient>, Error> {
    let began = Instant::now();
    loop {
        match SidecarClient::connect(rig.clone()) {
            Ok(client) => return Ok(Some(client)),
            Err(
                e @ lsfb_drivers::Error::Refused {
                    may_pass: false, ..
                },
            ) => return Err(e.into()),
            Err(e) if began.elapsed() > patience => return Err(e.into()),
            Err(_) if clock.is_stopped() => return Ok(None),
            Err(_) => thread::sleep(RETRY),
        }
    }
}
