//! Puts data packets that overtook each other on the network back in order.

use std::collections::VecDeque;

use lsfb_types::Packet;

use super::device_ns;
use crate::lidar::{LATE_NS, elapsed_ns};

/// Packets that are held back: five milliseconds of most sensors.
const WINDOW: usize = 8;

/// Holds the last packets back, so that one that comes a little late still finds its place.
#[derive(Default)]
pub struct Reorder {
    held: VecDeque<(i64, Packet)>,
    moved: u64,
}

impl Reorder {
    /// Takes the packet that arrived next and gives those that may go on.
    pub fn push(&mut self, packet: Packet) -> Vec<Packet> {
        let newest_ns = self.held.back().map(|(held_ns, _)| *held_ns);
        // What has no time of its own keeps its place.
        let Some(time_ns) = device_ns(&packet.bytes).or(newest_ns) else {
            return vec![packet];
        };
        let mut out = Vec::new();
        if newest_ns.is_some_and(|newest_ns| elapsed_ns(newest_ns, time_ns) < -LATE_NS) {
            out = self.finish();
        }
        let later = |held_ns: i64| elapsed_ns(held_ns, time_ns) < 0;
        let place = self.held.iter().rposition(|(held_ns, _)| !later(*held_ns));
        let place = place.map_or(0, |before| before + 1);
        // One that comes in front of all of a full window comes too late.
        let fits = place > 0 || self.held.len() < WINDOW;
        self.moved += u64::from(place < self.held.len() && fits);
        self.held.insert(place, (time_ns, packet));
        while self.held.len() > WINDOW {
            out.extend(self.held.pop_front().map(|(_, packet)| packet));
        }
        out
    }

    /// What is still held, in order.
    pub fn finish(&mut self) -> Vec<Packet> {
        self.held.drain(..).map(|(_, packet)| packet).collect()
    }

    /// Packets that were put in front of others.
    pub fn moved(&self) -> u64 {
        self.moved
    }
}
