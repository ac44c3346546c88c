//! What a phone's own clocks said of its messages, and what the rig's said of those clocks.

use std::collections::BTreeMap;

use lsfb_recording::{DEVICE_TIME, Recording, message};
use lsfb_types::Timestamp;

use super::WalkClock;
use crate::clock::{Exchange, ExchangedClock, ExchangedTime, StampOrder, StampPair};
use crate::sidecar::{TIME_SYNC, decode_exchange};
use crate::{Error, topics};

/// Clock of a device whose stamps are taken as they are.
const UTC: &str = lsfb_drivers::sidecar::model::CLOCK_UTC;

/// The device's own stamp of a message.
#[derive(Clone, Debug)]
pub(super) struct Stamp {
    /// The message's time while it was recorded, and its arrival: by both it is found.
    pub(super) recorded: Timestamp,
    pub(super) arrival: Timestamp,
    /// On the device's clock, nanoseconds.
    pub(super) device_ns: i64,
    /// Name of that clock.
    pub(super) clock_id: String,
    /// Its time by the exchanges; `None` where they do not tell it.
    pub(super) found: Option<ExchangedTime>,
}

/// All stamps of a device.
#[derive(Debug, Default)]
pub(super) struct Stamps {
    /// By the topic of the messages, in the order in which they were sent.
    topics: BTreeMap<String, Vec<Stamp>>,
    /// By name.
    pub(super) clocks: BTreeMap<String, Clock>,
}

/// A clock of a device.
#[derive(Debug, Default)]
pub(super) struct Clock {
    /// Exchanges that were recorded.
    recorded: u64,
    /// What they say; `None` of too few.
    pub(super) exchanged: Option<ExchangedClock>,
    /// By how much stamps of UTC differ from the rig's at most, nanoseconds.
    apart_ns: Option<i64>,
}

impl Stamps {
    pub(super) fn read(recording: &Recording, device: &str) -> Result<Self, Error> {
        let prefix = format!("/sidecar/{device}/");
        let mut topics: BTreeMap<String, Vec<Stamp>> = BTreeMap::new();
        for beside in recording.topics() {
            let topic = beside.topic.strip_suffix(DEVICE_TIME);
            if let Some(topic) = topic.filter(|topic| topic.starts_with(&prefix)) {
                topics.insert(topic.to_owned(), stamps(recording, &beside.topic)?);
            }
        }
        let mut clocks = clocks(recording, &format!("/sidecar/{device}{TIME_SYNC}"))?;
        for stamp in topics.values().flatten() {
            if !clocks.contains_key(&stamp.clock_id) {
                clocks.insert(stamp.clock_id.clone(), Clock::default());
            }
        }
        for (clock_id, clock) in &mut clocks {
            // Messages of UTC have no second stamp.
            if clock_id != UTC
                && let Some(exchanged) = clock.exchanged.take()
            {
                clock.exchanged = Some(find_times(&mut topics, clock_id, exchanged));
            }
        }
        Ok(Self { topics, clocks })
    }

    /// Those of a topic's messages; `None` where they have none.
    pub(super) fn of(&mut self, topic: &str) -> Option<Vec<Stamp>> {
        self.topics.remove(topic)
    }
}

impl Clock {
    /// What is told of it, beside what its messages add.
    pub(super) fn told(&self, clock_id: &str) -> WalkClock {
        let known = self.exchanged.as_ref();
        WalkClock {
            clock_id: clock_id.to_owned(),
            exchanges: known.map_or(0, |clock| clock.exchanges),
            unusable: known.map_or(self.recorded, |clock| clock.unusable),
            sigma_us: None,
            asymmetry_at_most_us: known.map(|clock| clock.shortest_round_trip_ns as f64 / 2e3),
            steps: known.map_or(0, ExchangedClock::steps),
            utc_apart_us: self.apart_ns.map(|apart| apart as f64 / 1e3),
        }
    }
}

/// The stamps of a topic beside that of the messages.
fn stamps(recording: &Recording, topic: &str) -> Result<Vec<Stamp>, Error> {
    // A stamp that is damaged is missing beside its message, which is counted there.
    let messages = recording.messages(topic)?.filter_map(Result::ok);
    let stamps = messages.filter_map(|message| {
        let reference = message::decode_time_reference(&message.bytes).ok()?;
        Some(Stamp {
            recorded: message.time,
            arrival: message.arrival,
            device_ns: i64::try_from(reference.device_ticks).ok()?,
            clock_id: reference.source,
            found: None,
        })
    });
    Ok(stamps.collect())
}

/// The clocks of a device, by the exchanges that were recorded.
fn clocks(recording: &Recording, topic: &str) -> Result<BTreeMap<String, Clock>, Error> {
    let mut exchanges: BTreeMap<String, Vec<Exchange>> = BTreeMap::new();
    if recording.topics().iter().any(|t| t.topic == topic) {
        for message in recording.messages(topic)? {
            // One that cannot be read is one of many.
            let Ok(message) = message else { continue };
            if let Ok((clock_id, exchange)) = decode_exchange(&message.bytes) {
                exchanges.entry(clock_id).or_default().push(exchange);
            }
        }
    }
    let clock = |(clock_id, of): (String, Vec<Exchange>)| {
        let exchanged = ExchangedClock::fit(&of);
        let is_utc = clock_id == UTC;
        let known = exchanged.as_ref().filter(|_| is_utc);
        let clock = Clock {
            recorded: of.len() as u64,
            apart_ns: known.and_then(|clock| apart_ns(clock, &of)),
            exchanged,
        };
        (clock_id, clock)
    };
    Ok(exchanges.into_iter().map(clock).collect())
}

/// By how much a device's UTC differs from the rig's, where most, nanoseconds.
fn apart_ns(clock: &ExchangedClock, exchanges: &[Exchange]) -> Option<i64> {
    let asked = exchanges.iter().map(|exchange| StampPair {
        device_ns: exchange.t1_ns,
        arrival: Timestamp::from_nanos(exchange.t2_ns),
    });
    let asked: Vec<StampPair> = asked.collect();
    let times = clock.times(&asked, StampOrder::Rising).into_iter();
    let apart = times.zip(&asked).filter_map(|(found, asked)| {
        let own = Timestamp::from_nanos(asked.device_ns);
        Some(own - found?.time)
    });
    apart.max_by_key(|apart| apart.unsigned_abs())
}

/// Gives each stamp of a clock its time.
fn find_times(
    topics: &mut BTreeMap<String, Vec<Stamp>>,
    clock_id: &str,
    clock: ExchangedClock,
) -> ExchangedClock {
    let own = topics.iter().map(|(topic, stamps)| {
        let order = match topics::is_occasional(topic) {
            true => StampOrder::Any,
            false => StampOrder::Rising,
        };
        let of_clock = stamps.iter().filter(|stamp| stamp.clock_id == clock_id);
        let pairs = of_clock.map(|stamp| StampPair {
            device_ns: stamp.device_ns,
            arrival: stamp.arrival,
        });
        (pairs.collect(), order)
    });
    let own: Vec<(Vec<StampPair>, StampOrder)> = own.collect();
    let clock = clock.with_messages(&own);
    for (stamps, (pairs, order)) in topics.values_mut().zip(&own) {
        let of_clock = stamps.iter_mut().filter(|s| s.clock_id == clock_id);
        for (stamp, found) in of_clock.zip(clock.times(pairs, *order)) {
            stamp.found = found;
        }
    }
    clock
}
