//! Renders ahead of a device, so that it can answer its host meanwhile.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError, sync_channel};
use std::thread::JoinHandle;

use lsfb_types::Image;

use super::thread::spawn;
use crate::{Error, RigSim, Simulation};

/// Triggers rendered ahead.
const AHEAD: usize = 2;

/// Which of the two rigs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Which {
    Scan,
    Glasses,
}

impl Which {
    pub(crate) fn of(self, simulation: &Simulation) -> &RigSim {
        match self {
            Self::Scan => simulation.scan(),
            Self::Glasses => simulation.glasses(),
        }
    }
}

/// The images of one trigger.
#[derive(Debug)]
pub(crate) struct Shot {
    /// Number of the trigger.
    pub frame: u32,
    /// Middle of the exposure, nanoseconds after the beginning.
    pub offset_ns: i64,
    /// One image per camera asked for.
    pub images: Vec<Image>,
}

/// A thread that renders the shots of some cameras, in order.
#[derive(Debug)]
pub(crate) struct ShotFeed {
    shots: Receiver<Shot>,
    thread: Option<JoinHandle<()>>,
}

/// What a feed has for its device.
pub(crate) enum Next {
    Shot(Shot),
    NotYet,
    Over,
}

impl ShotFeed {
    /// Starts rendering `cameras` of a rig.
    pub(crate) fn start(
        name: &str,
        simulation: Arc<Simulation>,
        rig: Which,
        cameras: Vec<usize>,
    ) -> Result<Self, Error> {
        let (sender, shots) = sync_channel(AHEAD);
        let thread = spawn(name, move || {
            let rig = rig.of(&simulation);
            for frame in 0..rig.frame_count() {
                let images = cameras
                    .iter()
                    .filter_map(|&camera| rig.image(simulation.world(), camera, frame))
                    .map(|stamped| stamped.sample)
                    .collect();
                let shot = Shot {
                    frame,
                    offset_ns: rig.frame_offset_ns(frame),
                    images,
                };
                // The device has closed: nobody wants the rest.
                if sender.send(shot).is_err() {
                    return;
                }
            }
        })?;
        Ok(Self {
            shots,
            thread: Some(thread),
        })
    }

    /// The next shot, if it is ready.
    pub(crate) fn poll(&self) -> Next {
        match self.shots.try_recv() {
            Ok(shot) => Next::Shot(shot),
            Err(TryRecvError::Empty) => Next::NotYet,
            Err(TryRecvError::Disconnected) => Next::Over,
        }
    }

    /// The next shot; `None` after the last.
    pub(crate) fn wait(&self) -> Option<Shot> {
        self.shots.recv().ok()
    }
}

impl Drop for ShotFeed {
    fn drop(&mut self) {
        // Closing the channel ends the thread at its next shot.
        let (_, closed) = sync_channel(0);
        self.shots = closed;
        if let Some(thread) = self.thread.take() {
            // A panic there has been reported by the panic hook already.
            let _ = thread.join();
        }
    }
}
