//! When and where each laser of one packet fired: rotor motion, gaps of a field-of-view window, dual returns.

use lsfb_types::Echo;

use super::model::Model;
use super::wire::{BLOCKS, CHANNELS, DataPacket, Returns, TURN_CENTIDEG};
use crate::lidar::turn;

/// A step of the rotor below this is never a gap, however slow it turns.
const SMALLEST_GAP_CENTIDEG: u16 = 50;

/// One distance of a packet that is not empty, as raw as it can be placed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Return {
    /// Block of the packet it stands in.
    pub block: usize,
    /// Channel of the block.
    pub channel: usize,
    /// Rank of the laser by elevation.
    pub ring: u16,
    /// Distance in the model's unit.
    pub range_raw: u16,
    /// Reflectivity.
    pub reflectivity: u8,
    /// Which echo.
    pub echo: Echo,
    /// Where the beam pointed, 0.01° clockwise from the sensor's front: encoder, motion since, and the laser's offset.
    pub azimuth_centideg: f32,
    /// Firing time after the packet's timestamp, nanoseconds.
    pub time_ns: i64,
}

/// Timing and rotor motion of one packet. A group is a block, or in dual mode a pair of blocks.
#[derive(Clone, Debug, PartialEq)]
pub struct PacketLayout {
    pub(super) model: Model,
    pub(super) mode: Returns,
    azimuth_centideg: [u16; BLOCKS],
    step_centideg: [f32; BLOCKS],
    time_ns: [i64; BLOCKS],
    gap: Option<usize>,
    pause_ns: i64,
}

impl PacketLayout {
    /// Reads the rotor's motion out of a packet's azimuths.
    pub fn new<T: AsRef<[u8]>>(packet: &DataPacket<T>, model: Model, mode: Returns) -> Self {
        let stride = stride(mode);
        let groups = BLOCKS / stride;
        let mut azimuth_centideg = [0; BLOCKS];
        let mut time_ns = [0; BLOCKS];
        for group in 0..groups {
            azimuth_centideg[group] = packet.azimuth_centideg(group * stride);
            time_ns[group] = i64::from(model.block_time_ns(mode, group * stride));
        }
        let mut moved = [0u16; BLOCKS];
        for group in 1..groups {
            moved[group - 1] = turn(azimuth_centideg[group - 1], azimuth_centideg[group]);
        }
        let moved = &moved[..groups - 1];
        let mut sorted = [0u16; BLOCKS];
        let sorted = &mut sorted[..groups - 1];
        sorted.copy_from_slice(moved);
        sorted.sort_unstable();
        let median = sorted[sorted.len() / 2];
        let threshold = median.saturating_mul(2).max(SMALLEST_GAP_CENTIDEG);
        let steady = || moved.iter().filter(|step| **step <= threshold);
        let mean =
            steady().map(|step| f32::from(*step)).sum::<f32>() / steady().count().max(1) as f32;

        let mut layout = Self {
            model,
            mode,
            azimuth_centideg,
            step_centideg: [mean; BLOCKS],
            time_ns,
            gap: None,
            pause_ns: 0,
        };
        for (group, step) in moved.iter().enumerate() {
            if *step <= threshold {
                layout.step_centideg[group] = f32::from(*step);
            } else {
                layout.open_gap(group + 1, *step, mean);
            }
        }
        // The motion during the last block is not known yet; the rotor keeps its pace.
        if layout.gap != Some(groups - 1) {
            layout.step_centideg[groups - 1] = layout.step_centideg[groups - 2];
        }
        layout
    }

    /// Moves the groups from `first` on by the time the rotor needs for `step`.
    fn open_gap(&mut self, first: usize, step: u16, mean: f32) {
        self.gap = Some(first);
        if mean > 0.0 {
            let period = f64::from(self.model.table().block_period_ns);
            let pause = (f64::from(step) / f64::from(mean) - 1.0) * period;
            self.pause_ns += pause as i64;
            for time in &mut self.time_ns[first..] {
                *time += pause as i64;
            }
        }
    }

    /// Times the groups after the gap backwards from the next packet, where that one follows at once.
    pub fn time_gap_from_next(&mut self, elapsed_ns: i64) {
        let Some(first) = self.gap else { return };
        let correction = elapsed_ns - self.span_ns();
        if correction.abs() < self.packet_period_ns() {
            self.pause_ns += correction;
            for time in &mut self.time_ns[first..] {
                *time += correction;
            }
        }
    }

    /// Groups in the packet: 12, or 6 in dual mode.
    pub fn groups(&self) -> usize {
        BLOCKS / stride(self.mode)
    }

    /// Encoder angle of a group's first firing, 0.01°.
    pub fn group_azimuth(&self, group: usize) -> u16 {
        self.azimuth_centideg[group]
    }

    /// Time of a group's first firing after the packet's timestamp, nanoseconds.
    pub fn group_time_ns(&self, group: usize) -> i64 {
        self.time_ns[group]
    }

    /// Encoder angles before and after the gap of a field-of-view window inside the packet.
    pub fn gap(&self) -> Option<(u16, u16)> {
        self.gap.map(|first| {
            (
                self.azimuth_centideg[first - 1],
                self.azimuth_centideg[first],
            )
        })
    }

    pub(super) fn first_azimuth(&self) -> u16 {
        self.azimuth_centideg[0]
    }

    pub(super) fn last_azimuth(&self) -> u16 {
        self.azimuth_centideg[self.groups() - 1]
    }

    /// Time from one packet to the next while the sensor fires.
    pub(super) fn packet_period_ns(&self) -> i64 {
        i64::from(self.model.packet_period_ns(self.mode))
    }

    /// Time from this packet to the next, with the gap inside.
    pub(super) fn span_ns(&self) -> i64 {
        self.packet_period_ns() + self.pause_ns
    }

    /// Time that the rotor needs for an angle at the pace of this packet, nanoseconds.
    pub(super) fn time_to_turn_ns(&self, centideg: u16) -> i64 {
        let steps = &self.step_centideg[..self.groups()];
        let mean = steps.iter().map(|step| f64::from(*step)).sum::<f64>() / steps.len() as f64;
        let period = f64::from(self.model.table().block_period_ns);
        match mean > 0.0 {
            true => (f64::from(centideg) / mean * period) as i64,
            false => 0,
        }
    }

    /// Whether the rotor went on into `next` as it did inside this packet, so that nothing but whole turns can be missing between.
    pub(super) fn reaches(&self, next: &Self) -> bool {
        let moved = f32::from(turn(self.last_azimuth(), next.first_azimuth()));
        let pace = self.step_centideg[self.groups() - 1];
        pace > 0.0 && moved <= 1.5 * pace
    }

    /// Motion of the rotor while a group fires, centidegrees per nanosecond.
    pub(super) fn pace_centideg_ns(&self, group: usize) -> f32 {
        self.step_centideg[group] / self.model.table().block_period_ns as f32
    }
}

/// All returns of a packet in firing order.
pub fn returns<'a, T: AsRef<[u8]>>(
    packet: &'a DataPacket<T>,
    layout: &'a PacketLayout,
) -> impl Iterator<Item = Return> + 'a {
    (0..layout.groups()).flat_map(move |group| group_returns(packet, layout, group))
}

/// The returns of one block, or in dual mode of a pair of blocks, in firing order.
fn group_returns<'a, T: AsRef<[u8]>>(
    packet: &'a DataPacket<T>,
    layout: &'a PacketLayout,
    group: usize,
) -> impl Iterator<Item = Return> + 'a {
    let table = layout.model.table();
    let stride = stride(layout.mode);
    let azimuth = f32::from(layout.azimuth_centideg[group]);
    let pace = layout.pace_centideg_ns(group);
    (0..CHANNELS).flat_map(move |channel| {
        let laser = &table.channels[channel];
        let place = |block: usize, echo: Echo| Return {
            block,
            channel,
            ring: laser.ring,
            range_raw: packet.distance_raw(block, channel),
            reflectivity: packet.reflectivity(block, channel),
            echo,
            azimuth_centideg: wrap(
                azimuth + pace * laser.firing_ns as f32 + laser.azimuth_offset_deg as f32 * 100.0,
            ),
            time_ns: layout.time_ns[group] + i64::from(laser.firing_ns),
        };
        let first = group * stride;
        let candidates = match layout.mode {
            Returns::Strongest => [Some(place(first, Echo::Strongest)), None],
            Returns::Last => [Some(place(first, Echo::Last)), None],
            // Even block last, odd block strongest (VLP-32C 63-9325 p. 59).
            Returns::Dual
                if packet.distance_raw(first, channel)
                    == packet.distance_raw(first + 1, channel) =>
            {
                [Some(place(first, Echo::Both)), None]
            }
            Returns::Dual => [
                Some(place(first, Echo::Last)),
                Some(place(first + 1, Echo::Strongest)),
            ],
        };
        candidates
            .into_iter()
            .flatten()
            .filter(|hit| hit.range_raw > 0)
    })
}

fn wrap(centideg: f32) -> f32 {
    let turn = f32::from(TURN_CENTIDEG);
    if centideg < 0.0 {
        centideg + turn
    } else if centideg >= turn {
        centideg - turn
    } else {
        centideg
    }
}

pub(super) const fn stride(mode: Returns) -> usize {
    match mode {
        Returns::Dual => 2,
        Returns::Strongest | Returns::Last => 1,
    }
}
