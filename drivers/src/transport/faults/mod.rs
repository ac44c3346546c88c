//! Faults on the way between any source and its decoder: what real links do, on purpose and reproducibly.
//!
//! A [`Faulty`] source does one thing to the packets of the source inside it; faults are combined by putting one around
//! the other. What it does depends on the seed and on the packets alone, never on a clock of the host: time here is the
//! packets' own arrival, so that a recording replayed twice suffers the same twice, as fast as it can be read.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use lsfb_types::{Packet, Timestamp};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::PacketSource;
use crate::Error;

/// What happens to packets. Probabilities are per packet, from 0 (never) to 1 (always); times count from the arrival of
/// the first packet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// It vanishes.
    Drop {
        /// How often.
        probability: f64,
    },
    /// It comes twice.
    Duplicate {
        /// How often.
        probability: f64,
    },
    /// It is overtaken.
    Reorder {
        /// How often.
        probability: f64,
        /// By how many packets.
        places: u32,
    },
    /// Some of its bits are flipped.
    Corrupt {
        /// How often.
        probability: f64,
        /// How many bits, each at a random place.
        bits: u32,
    },
    /// Its end is missing, from a random byte on.
    Truncate {
        /// How often.
        probability: f64,
    },
    /// It arrives later. Packets keep their order.
    Delay {
        /// Always by this much, nanoseconds.
        delay_ns: i64,
        /// And by up to this much more, nanoseconds.
        jitter_ns: i64,
    },
    /// For a while nothing comes, and then everything at once: a batch.
    Stall {
        /// When it begins, nanoseconds.
        start_ns: i64,
        /// How long it takes, nanoseconds.
        length_ns: i64,
        /// Time from the beginning of one stall to that of the next, nanoseconds; 0 for a single one.
        period_ns: i64,
    },
    /// The device is lost, for good.
    Disconnect {
        /// When, nanoseconds.
        after_ns: i64,
    },
    /// The host's clock is set.
    ClockStep {
        /// When, nanoseconds.
        after_ns: i64,
        /// By how much, nanoseconds.
        step_ns: i64,
    },
}

/// What was done so far: the truth for tests of what notices it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FaultCounts {
    /// Packets taken from the source inside.
    pub packets: u64,
    /// Packets that were dropped, doubled, overtaken, damaged, held back or stamped otherwise.
    pub affected: u64,
}

/// A source that suffers a [`Fault`].
#[derive(Debug)]
pub struct Faulty<S> {
    source: S,
    fault: Fault,
    random: ChaCha8Rng,
    counts: FaultCounts,
    first_arrival: Option<Timestamp>,
    /// Stamp of the packet that went out last: none may be earlier, but for a clock that is set.
    last_out: Option<Timestamp>,
    out: VecDeque<Packet>,
    overtaken: Vec<Overtaken>,
    stalled: VecDeque<Packet>,
    /// What the source inside said when it ended; told once everything held back is out.
    ended: Option<Error>,
    disconnected: bool,
}

#[derive(Debug)]
struct Overtaken {
    packet: Packet,
    /// Packets that go first.
    places: u32,
}

impl<S: PacketSource> Faulty<S> {
    /// Puts `fault` on the packets of `source`. The same seed does the same again.
    pub fn new(source: S, fault: Fault, seed: u64) -> Self {
        Self {
            source,
            fault,
            random: ChaCha8Rng::seed_from_u64(seed),
            counts: FaultCounts::default(),
            first_arrival: None,
            last_out: None,
            out: VecDeque::new(),
            overtaken: Vec::new(),
            stalled: VecDeque::new(),
            ended: None,
            disconnected: false,
        }
    }

    /// What was done so far.
    pub fn counts(&self) -> FaultCounts {
        self.counts
    }

    /// The source inside.
    pub fn source(&self) -> &S {
        &self.source
    }

    /// The source inside, without what is still held back.
    pub fn into_source(self) -> S {
        self.source
    }

    fn happens(&mut self, probability: f64) -> bool {
        // 53 bits: every value is a distinct `f64` below 1.
        let drawn = (self.random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        drawn < probability
    }

    /// A number below `end`; 0 where there is none.
    fn below(&mut self, end: u64) -> u64 {
        ((u128::from(self.random.next_u64()) * u128::from(end)) >> 64) as u64
    }

    fn take(&mut self, mut packet: Packet) {
        self.counts.packets += 1;
        let first = *self.first_arrival.get_or_insert(packet.arrival);
        let since_ns = packet.arrival - first;
        match self.fault {
            Fault::Drop { probability } => {
                if self.happens(probability) {
                    self.counts.affected += 1;
                } else {
                    self.out.push_back(packet);
                }
            }
            Fault::Duplicate { probability } => {
                if self.happens(probability) {
                    self.counts.affected += 1;
                    self.out.push_back(packet.clone());
                }
                self.out.push_back(packet);
            }
            Fault::Reorder {
                probability,
                places,
            } => {
                if places > 0 && self.happens(probability) {
                    self.counts.affected += 1;
                    self.overtaken.push(Overtaken { packet, places });
                } else {
                    let passing = packet.arrival;
                    self.out.push_back(packet);
                    self.let_go(passing);
                }
            }
            Fault::Corrupt { probability, bits } => {
                if self.happens(probability) && !packet.bytes.is_empty() {
                    self.counts.affected += 1;
                    for _ in 0..bits {
                        let bit = self.below(8 * packet.bytes.len() as u64);
                        packet.bytes[(bit / 8) as usize] ^= 1 << (bit % 8);
                    }
                }
                self.out.push_back(packet);
            }
            Fault::Truncate { probability } => {
                if self.happens(probability) && !packet.bytes.is_empty() {
                    self.counts.affected += 1;
                    let kept = self.below(packet.bytes.len() as u64) as usize;
                    packet.bytes.truncate(kept);
                }
                self.out.push_back(packet);
            }
            Fault::Delay {
                delay_ns,
                jitter_ns,
            } => {
                self.counts.affected += 1;
                let jitter_ns = self.below(u64::try_from(jitter_ns).unwrap_or(0).saturating_add(1));
                let late = packet
                    .arrival
                    .plus_nanos(delay_ns)
                    .plus_nanos(jitter_ns as i64);
                packet.arrival = self.last_out.map_or(late, |last| late.max(last));
                self.last_out = Some(packet.arrival);
                self.out.push_back(packet);
            }
            Fault::Stall { .. } => match stall_end_ns(self.fault, since_ns) {
                Some(end_ns) => {
                    self.counts.affected += 1;
                    packet.arrival = first.plus_nanos(end_ns);
                    let batch = self.stalled.front().map(|waiting| waiting.arrival);
                    if batch.is_some_and(|batch| batch != packet.arrival) {
                        self.out.append(&mut self.stalled);
                    }
                    self.stalled.push_back(packet);
                }
                None => {
                    self.out.append(&mut self.stalled);
                    self.out.push_back(packet);
                }
            },
            Fault::Disconnect { after_ns } => {
                if since_ns >= after_ns {
                    self.counts.affected += 1;
                    self.disconnected = true;
                } else {
                    self.out.push_back(packet);
                }
            }
            Fault::ClockStep { after_ns, step_ns } => {
                if since_ns >= after_ns {
                    self.counts.affected += 1;
                    packet.arrival = packet.arrival.plus_nanos(step_ns);
                }
                self.out.push_back(packet);
            }
        }
    }

    /// One more packet has gone past those that are held; who has been passed by enough of them follows.
    fn let_go(&mut self, passing: Timestamp) {
        for held in &mut self.overtaken {
            held.places -= 1;
        }
        let is_due = |held: &mut Overtaken| held.places == 0;
        for mut held in self.overtaken.extract_if(.., is_due) {
            held.packet.arrival = held.packet.arrival.max(passing);
            self.out.push_back(held.packet);
        }
    }

    /// Nothing can overtake any more.
    fn release_all(&mut self) {
        self.out.append(&mut self.stalled);
        let left = std::mem::take(&mut self.overtaken);
        self.out.extend(left.into_iter().map(|held| held.packet));
    }

    fn lost() -> Error {
        Error::Lost {
            device: "a source that was disconnected on purpose".to_owned(),
            cause: std::io::ErrorKind::NotConnected.into(),
        }
    }
}

/// When the stall ends in which a packet comes; `None` outside of stalls.
fn stall_end_ns(fault: Fault, since_ns: i64) -> Option<i64> {
    let Fault::Stall {
        start_ns,
        length_ns,
        period_ns,
    } = fault
    else {
        return None;
    };
    let after_start = since_ns.checked_sub(start_ns).filter(|after| *after >= 0)?;
    let into = if period_ns > 0 {
        after_start % period_ns
    } else {
        after_start
    };
    (into < length_ns).then(|| since_ns - into + length_ns)
}

impl<S: PacketSource> PacketSource for Faulty<S> {
    fn recv(&mut self, timeout: Duration) -> Result<Option<Packet>, Error> {
        let deadline = Instant::now() + timeout;
        loop {
            if let Some(packet) = self.out.pop_front() {
                return Ok(Some(packet));
            }
            if self.disconnected {
                return Err(Self::lost());
            }
            if let Some(error) = self.ended.take() {
                return Err(error);
            }
            let left = deadline.saturating_duration_since(Instant::now());
            match self.source.recv(left) {
                Ok(Some(packet)) => self.take(packet),
                Ok(None) => return Ok(None),
                Err(error) => {
                    self.release_all();
                    self.ended = Some(error);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
