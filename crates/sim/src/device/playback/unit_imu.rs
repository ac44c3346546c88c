//! What the IMU inside a camera unit measured, from the recorded answers to its host's polls.
//!
//! A mock's host polls at instants of its own, so that the answers are made again from their segments, each queued when it was
//! measured. An answer that was damaged when it was recorded has no segments; it is given as it came.

use lsfb_drivers::mynt_s::wire::{ImuProtocol, ImuResponse, ImuSegment, TimeSource, XuDevice};
use lsfb_recording::{RecordedPacket, Recording};
use lsfb_types::Timestamp;

use super::{CameraPlan, Play};
use crate::Error;

/// Units repeat segments that are not confirmed; going back further than this is a unit that began anew.
const MOST_REPEATED: u32 = 1_000;

/// The segments still to come, in order.
pub(super) struct RecordedImu<'a> {
    answers: Option<Box<dyn Iterator<Item = Result<RecordedPacket, lsfb_recording::Error>> + 'a>>,
    protocol: ImuProtocol,
    play: &'a Play,
    /// Add this to the unit's own time, nanoseconds.
    time_from_device_ns: i64,
    last_serial: Option<u32>,
    waiting: std::collections::VecDeque<Event>,
    queued: u64,
    unreadable: u64,
}

/// Something that the unit has for its host from a time on, nanoseconds after the start.
struct Event {
    at_ns: i64,
    what: What,
}

enum What {
    Segment(ImuSegment),
    Damaged(Vec<u8>),
}

impl<'a> RecordedImu<'a> {
    /// Nothing at all for a unit whose IMU was not recorded.
    pub(super) fn new(
        recording: &'a Recording,
        plan: &CameraPlan,
        protocol: ImuProtocol,
        play: &'a Play,
    ) -> Result<Self, Error> {
        let answers = match &plan.imu {
            Some(imu) => Some(Box::new(recording.packets(imu)?) as Box<_>),
            None => None,
        };
        // Frames and segments are stamped by one counter.
        let first = recording
            .frame_meta(plan.first_name())?
            .find_map(Result::ok);
        let time_from_device_ns =
            first.map_or(0, |meta| meta.time.nanos() - device_ns(meta.device_ticks));
        Ok(Self {
            answers,
            protocol,
            play,
            time_from_device_ns,
            last_serial: None,
            waiting: Default::default(),
            queued: 0,
            unreadable: 0,
        })
    }

    /// When the next segment was measured, nanoseconds after the start.
    pub(super) fn next_ns(&mut self) -> Option<i64> {
        self.fill();
        self.waiting.front().map(|event| event.at_ns)
    }

    /// Gives the unit everything that was measured up to a time.
    pub(super) fn queue_until(&mut self, end_ns: i64, xu: &mut XuDevice) {
        while self.next_ns().is_some_and(|at_ns| at_ns <= end_ns) {
            match self.waiting.pop_front().map(|event| event.what) {
                Some(What::Segment(segment)) => {
                    xu.push_imu(segment);
                    self.queued += 1;
                }
                Some(What::Damaged(answer)) => xu.push_imu_answer(&answer),
                None => return,
            }
        }
    }

    /// Segments given so far.
    pub(super) fn queued(&self) -> u64 {
        self.queued
    }

    /// Messages of the recording that could not be read.
    pub(super) fn unreadable(&self) -> u64 {
        self.unreadable
    }

    /// Takes answers until one of them says something new.
    fn fill(&mut self) {
        while self.waiting.is_empty()
            && let Some(answer) = self.answers.as_mut().and_then(Iterator::next)
        {
            match answer {
                Ok(answer) => self.take(&answer),
                Err(_) => self.unreadable += 1,
            }
        }
    }

    fn take(&mut self, answer: &RecordedPacket) {
        let bytes = &answer.packet.bytes;
        match ImuResponse::parse(self.protocol, bytes) {
            Ok(response) => {
                for segment in response.segments {
                    if self.is_new(segment.serial) {
                        let at_ns = self.play.offset_ns(self.time_of(&segment));
                        let what = What::Segment(segment);
                        self.waiting.push_back(Event { at_ns, what });
                    }
                }
            }
            Err(_) => self.waiting.push_back(Event {
                at_ns: self.play.offset_ns(answer.time),
                what: What::Damaged(bytes.clone()),
            }),
        }
    }

    /// Protocol 1 repeats what its host has not confirmed.
    fn is_new(&mut self, serial: u32) -> bool {
        let step = self.last_serial.map_or(1, |last| serial.wrapping_sub(last));
        let repeated = step == 0 || step > u32::MAX - MOST_REPEATED;
        if !repeated {
            self.last_serial = Some(serial);
        }
        !repeated
    }

    fn time_of(&self, segment: &ImuSegment) -> Timestamp {
        let device_ns = device_ns(segment.timestamp_us);
        Timestamp::from_nanos(match segment.time_source {
            TimeSource::External => device_ns,
            TimeSource::Device => device_ns.saturating_add(self.time_from_device_ns),
        })
    }
}

fn device_ns(ticks_us: u64) -> i64 {
    i64::try_from(ticks_us)
        .unwrap_or(i64::MAX)
        .saturating_mul(1_000)
}
