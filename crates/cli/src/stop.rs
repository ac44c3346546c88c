//! Being told to stop, by a signal.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use anyhow::Context as _;
use lsfb_types::Stopped;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::flag;

/// Exit codes of processes that a signal ended begin here, as shells have it.
const SIGNAL_EXIT: u8 = 128;

/// What asks for an orderly end.
pub const SIGNALS: [i32; 3] = [SIGINT, SIGTERM, SIGHUP];

/// 128 and the number of a signal.
pub fn exit_code(signal: i32) -> u8 {
    SIGNAL_EXIT.saturating_add(u8::try_from(signal).unwrap_or_default())
}

/// Whether, and by which signal.
#[derive(Clone)]
pub struct StopSignal {
    asked: Arc<AtomicBool>,
    number: Arc<AtomicUsize>,
}

impl StopSignal {
    /// From now on Ctrl-C, SIGTERM and SIGHUP ask for an orderly end; a second one ends the process at once.
    pub fn install() -> anyhow::Result<Self> {
        let new = Self {
            asked: Arc::new(AtomicBool::new(false)),
            number: Arc::new(AtomicUsize::new(0)),
        };
        for signal in SIGNALS {
            let exit = i32::from(exit_code(signal));
            // What is registered first is done first: the exit only where the flag is set already.
            flag::register_conditional_shutdown(signal, exit, Arc::clone(&new.asked))
                .and_then(|_| {
                    let number = usize::try_from(signal).unwrap_or_default();
                    flag::register_usize(signal, Arc::clone(&new.number), number)
                })
                .and_then(|_| flag::register(signal, Arc::clone(&new.asked)))
                .context("cannot listen for Ctrl-C and SIGTERM")?;
        }
        Ok(new)
    }

    /// Fails where an end was asked for.
    pub fn check(&self) -> Result<(), Stopped> {
        match self.asked.load(Ordering::SeqCst) {
            true => Err(Stopped),
            false => Ok(()),
        }
    }

    /// What to call the signal that came; nothing where none has.
    pub fn name(&self) -> Option<&'static str> {
        match i32::try_from(self.number.load(Ordering::SeqCst)) {
            Ok(SIGINT) => Some("Ctrl-C"),
            Ok(SIGTERM) => Some("SIGTERM"),
            Ok(SIGHUP) => Some("its terminal closing (SIGHUP)"),
            _ => None,
        }
    }

    /// See [`exit_code`], of the signal that came.
    pub fn exit_code(&self) -> u8 {
        exit_code(i32::try_from(self.number.load(Ordering::SeqCst)).unwrap_or_default())
    }
}
