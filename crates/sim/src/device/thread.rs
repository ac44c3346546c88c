//! The threads of the devices.

use std::thread::{self, JoinHandle};

use crate::Error;

/// Starts a named thread.
pub(crate) fn spawn<T: Send + 'static>(
    name: &str,
    run: impl FnOnce() -> T + Send + 'static,
) -> Result<JoinHandle<T>, Error> {
    thread::Builder::new()
        .name(name.to_owned())
        .spawn(run)
        .map_err(|cause| Error::Thread {
            name: name.to_owned(),
            problem: cause.to_string(),
        })
}
