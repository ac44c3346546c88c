//! Blocks of returns → scans: cut where the rotor passes a given angle.

use std::collections::VecDeque;

use lsfb_types::{LidarPoint, LidarScan, Timestamp};

use super::Counters;
use crate::Decoded;

/// Sensors count time from the top of the hour; so do the ticks of a scan.
pub(crate) const HOUR_NS: i64 = 3_600_000_000_000;
/// One turn in hundredths of a degree.
pub const TURN_CENTIDEG: u16 = 36_000;
/// The slowest motor settings, 300 rpm, turn in 0.2 s: a longer scan means a stopped rotor, or blocks that are missing.
const LONGEST_SCAN_NS: i64 = 300_000_000;
/// Between blocks of a packet, and from packet to packet, lie at most a few milliseconds: after more, blocks are missing.
const SILENCE_NS: i64 = 50_000_000;
/// Encoder jitter around a stop may step back this far.
const JITTER_CENTIDEG: u16 = 30;

/// The scan being built, and those that are finished.
pub(crate) struct ScanBuilder {
    cut_azimuth_centideg: u16,
    scan: Option<Building>,
    previous_azimuth: Option<u16>,
    ready: VecDeque<Decoded<LidarScan>>,
    /// Points of the last scan: room for the next.
    usual_points: usize,
}

struct Building {
    first_ns: i64,
    /// Time of the last block.
    last_ns: i64,
    arrival: Timestamp,
    points: Vec<LidarPoint>,
}

/// Where the returns of a block go.
pub(crate) struct Block<'a> {
    pub points: &'a mut Vec<LidarPoint>,
    /// Time of the block's first firing after the scan's, nanoseconds.
    pub offset_ns: u32,
}

impl ScanBuilder {
    /// A scan ends where the rotor passes `cut_azimuth_centideg`.
    pub fn new(cut_azimuth_centideg: u16) -> Self {
        Self {
            cut_azimuth_centideg: cut_azimuth_centideg % TURN_CENTIDEG,
            scan: None,
            previous_azimuth: None,
            ready: VecDeque::new(),
            usual_points: 0,
        }
    }

    /// The place for the returns of the next block, whose first laser fired at `fired_ns` past the hour.
    pub fn block(
        &mut self,
        azimuth_centideg: u16,
        fired_ns: i64,
        arrival: Timestamp,
        counters: &mut Counters,
    ) -> Block<'_> {
        self.cut_before(azimuth_centideg, fired_ns, counters);
        let scan = self.scan.get_or_insert_with(|| Building {
            first_ns: fired_ns.rem_euclid(HOUR_NS),
            last_ns: fired_ns,
            arrival,
            points: Vec::with_capacity(self.usual_points),
        });
        scan.last_ns = fired_ns;
        Block {
            offset_ns: (fired_ns - scan.first_ns).rem_euclid(HOUR_NS) as u32,
            points: &mut scan.points,
        }
    }

    /// Ends the scan where the rotor passed the cut since the last block, or did not come round for too long.
    fn cut_before(&mut self, azimuth: u16, time_ns: i64, counters: &mut Counters) {
        if let Some(scan) = &self.scan
            && (time_ns - scan.first_ns).rem_euclid(HOUR_NS) > LONGEST_SCAN_NS
        {
            let silence_ns = (time_ns - scan.last_ns).rem_euclid(HOUR_NS);
            counters.overlong += u64::from(silence_ns < SILENCE_NS);
            self.flush(counters);
        }
        let Some(previous) = self.previous_azimuth else {
            self.previous_azimuth = Some(azimuth);
            return;
        };
        let moved = turn(previous, azimuth);
        if moved > TURN_CENTIDEG - JITTER_CENTIDEG {
            return;
        }
        let to_cut = turn(previous, self.cut_azimuth_centideg);
        if to_cut > 0 && to_cut <= moved {
            self.flush(counters);
        }
        self.previous_azimuth = Some(azimuth);
    }

    /// Ends the scan.
    pub fn flush(&mut self, counters: &mut Counters) {
        if let Some(scan) = self.scan.take() {
            counters.scans += 1;
            // Revolutions differ by a few blocks: with room for these the next one need not move.
            self.usual_points = scan.points.len() + scan.points.len() / 16;
            self.ready.push_back(Decoded {
                arrival: scan.arrival,
                device_ticks: scan.first_ns as u64,
                sample: LidarScan {
                    points: scan.points,
                },
            });
        }
    }

    /// Forgets the scan: what was put into it is not to be believed.
    pub fn discard(&mut self) {
        self.scan = None;
    }

    /// The oldest finished scan.
    pub fn next_scan(&mut self) -> Option<Decoded<LidarScan>> {
        self.ready.pop_front()
    }
}

/// How far the rotor turns forward from `from` to `to`, both hundredths of a degree below a turn.
pub(crate) fn turn(from: u16, to: u16) -> u16 {
    (u32::from(to) + u32::from(TURN_CENTIDEG) - u32::from(from)).rem_euclid(TURN_CENTIDEG.into())
        as u16
}
