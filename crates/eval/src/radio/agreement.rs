//! Whether a walk heard what others heard where it says that it was: floors that look alike have transmitters of their own.
//!
//! What is loudest for the walk must be loud for the others: on another floor that floor's own transmitters are the loudest. Powers themselves tell
//! no floor, as phones read them ten decibels apart and a slab takes hardly more: a walk that heard everything much weaker, as on a floor without
//! transmitters, is doubtful, no more.

use std::collections::{BTreeMap, BTreeSet};

use lsfb_geometry::Vector3;
use lsfb_types::{Bounds, Finding, Limit, Timestamp, Verdict, median};
use serde::{Deserialize, Serialize};

use super::placing::{PlacedReading, RadioKind};
use crate::Error;

/// How a walk is held against readings of others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RadioAgreementConfig {
    /// Readings of others within this distance say what is heard at a place, metres.
    pub reach_m: f64,
    /// Advertisements of Bluetooth are compared in spans of this length, seconds.
    pub span_secs: f64,
    /// Where less than this of what is loudest is the same, the walk was elsewhere.
    pub least_share: f64,
}

lsfb_types::bounds! {
    RadioAgreementConfig {
        reach_m: number(Bounds::Within(0.1, 100.0)),
        span_secs: number(Bounds::Within(0.1, 600.0)),
        least_share: number(Bounds::Within(0.0, 1.0)),
    }
}

impl Default for RadioAgreementConfig {
    fn default() -> Self {
        Self {
            reach_m: 5.0,
            span_secs: 2.0,
            // Right walks of a mall, whose places are known to some metres, have 0.44 and more; thirty metres away it is 0.19 at most, but for one.
            least_share: 0.3,
        }
    }
}

/// Fewer senders than this on either side say nothing of their order.
const FEWEST_SENDERS: usize = 3;
/// The loudest third counts, but no more senders than this: four names of one access point are one fact.
const MOST_LOUDEST: usize = 8;
/// They are looked for among so many times as many of the other side.
const AMONG: usize = 3;
/// Spans and scans that must have been compared before a walk is judged by them.
const FEWEST_COMPARED: usize = 3;
/// So much more than the least share is usual.
const USUAL_OF_LEAST: f64 = 1.4;
/// So much weaker than others no phone reads, decibel.
const MOST_WEAKER_DB: f64 = 10.0;

/// What a walk heard beside what others heard there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RadioAgreement {
    /// Scans of Wi-Fi and spans of Bluetooth that were compared.
    pub compared: usize,
    /// Those where the table has too little around the walk's place.
    pub unknown: usize,
    /// How much of what was loudest for the walk was loud for the others, in the mean; zero of none.
    pub share: f64,
    /// By how much weaker the walk heard what both heard, in the middle, decibel; zero of none.
    pub weaker_db: f64,
    /// The settings' least.
    pub least_share: f64,
}

impl RadioAgreement {
    /// Whether enough was compared to believe it.
    pub fn is_judged(&self) -> bool {
        self.compared >= FEWEST_COMPARED
    }

    /// Whether the walk was elsewhere.
    pub fn contradicts(&self) -> bool {
        self.is_judged() && self.share < self.least_share
    }

    /// As every command says it.
    pub fn finding(&self) -> Finding {
        let what = format!(
            "in {} scans of Wi-Fi and spans of Bluetooth {:.0} % of what was loudest was loud for others there, and {:.0} dB weaker in the middle; at {} \
             more nobody listened around there before",
            self.compared,
            100.0 * self.share,
            self.weaker_db,
            self.unknown
        );
        if !self.is_judged() {
            return Finding::new("radio", Verdict::Unknown, "trajectory", what)
                .remedy("listen along the whole way once, and add those readings to the table");
        }
        if !self.contradicts() && self.weaker_db > MOST_WEAKER_DB {
            return Finding::new("radio", Verdict::Warn, "trajectory", what)
                .value(self.weaker_db, "dB")
                .limit(Limit::AtMost(MOST_WEAKER_DB))
                .remedy("make sure that the walk was on this floor: through a slab everything is weaker");
        }
        let usual = USUAL_OF_LEAST * self.least_share;
        let verdict = match (self.contradicts(), self.share < usual) {
            (true, _) => Verdict::Fail,
            (false, true) => Verdict::Warn,
            (false, false) => Verdict::Pass,
        };
        let limit = if verdict == Verdict::Fail {
            self.least_share
        } else {
            usual
        };
        Finding::new("radio", verdict, "trajectory", what)
            .value(100.0 * self.share, "%")
            .limit(Limit::AtLeast(100.0 * limit))
            .remedy("make sure that the map is of this floor of this building, and the table of that map")
    }
}

/// What was heard of each sender in one scan or span.
struct Span<'a> {
    kind: RadioKind,
    position_m: Vector3<f64>,
    heard: Powers<'a>,
}

/// Mean power of each sender, dBm.
type Powers<'a> = BTreeMap<&'a str, f64>;

/// Holds a walk's readings at the places of its trajectory against readings of others, placed in the same world.
///
/// [`Error::CopiedScans`] where the walk itself is among the others.
pub fn radio_agreement(
    walk: &[PlacedReading],
    others: &[PlacedReading],
    config: &RadioAgreementConfig,
) -> Result<RadioAgreement, Error> {
    let fact = |r: &PlacedReading| (r.kind, r.time, r.source.clone(), r.rssi_dbm);
    let known: BTreeSet<_> = radio(others).map(fact).collect();
    let copied = radio(walk).filter(|r| known.contains(&fact(r))).count();
    if copied > 0 {
        return Err(Error::CopiedScans { scans: copied });
    }
    let (mut shares, mut weaker_db, mut unknown) = (Vec::new(), Vec::new(), 0);
    for span in spans(walk, config) {
        let around = radio(others).filter(|r| {
            r.kind == span.kind && (r.position_m - span.position_m).norm() <= config.reach_m
        });
        let around = mean_powers(around);
        match shared(&span.heard, &around) {
            Some(share) => shares.push(share),
            None => unknown += 1,
        }
        let both = span
            .heard
            .iter()
            .filter_map(|(s, own)| Some((own, around.get(s)?)));
        weaker_db.extend(both.map(|(own, others)| others - own));
    }
    let compared = shares.len();
    Ok(RadioAgreement {
        compared,
        unknown,
        share: shares.iter().sum::<f64>() / compared.max(1) as f64,
        weaker_db: median(weaker_db).unwrap_or(0.0),
        least_share: config.least_share,
    })
}

/// Wi-Fi, and beacons that have a number.
fn radio(readings: &[PlacedReading]) -> impl Iterator<Item = &PlacedReading> {
    readings.iter().filter(|r| match r.kind {
        RadioKind::Wifi => true,
        RadioKind::Ble => !is_address(&r.source),
        RadioKind::Magnetic => false,
    })
}

/// Whether a sender is known by its address alone, as what people carry is, which changes it every quarter of an hour.
fn is_address(source: &str) -> bool {
    source.len() == 17 && source.split(':').all(|part| part.len() == 2)
}

/// Scans of Wi-Fi, and advertisements of Bluetooth in spans of equal length.
fn spans<'a>(walk: &'a [PlacedReading], config: &RadioAgreementConfig) -> Vec<Span<'a>> {
    let first: Timestamp = radio(walk).map(|r| r.time).min().unwrap_or_default();
    let number = |r: &PlacedReading| match r.kind {
        RadioKind::Wifi => i64::from(r.scan),
        _ => (r.time.secs_since(first) / config.span_secs) as i64,
    };
    let mut by_span: BTreeMap<(RadioKind, i64), Vec<&PlacedReading>> = BTreeMap::new();
    for reading in radio(walk) {
        by_span
            .entry((reading.kind, number(reading)))
            .or_default()
            .push(reading);
    }
    let span = |((kind, _), readings): ((RadioKind, i64), Vec<&'a PlacedReading>)| {
        let places: Vector3<f64> = readings.iter().map(|r| r.position_m).sum();
        Span {
            kind,
            position_m: places / readings.len() as f64,
            heard: mean_powers(readings.into_iter()),
        }
    };
    by_span.into_iter().map(span).collect()
}

fn mean_powers<'a>(readings: impl Iterator<Item = &'a PlacedReading>) -> Powers<'a> {
    let mut sums: BTreeMap<&str, (f64, f64)> = BTreeMap::new();
    for reading in readings {
        let (sum, count) = sums.entry(&reading.source).or_default();
        *sum += f64::from(reading.rssi_dbm);
        *count += 1.0;
    }
    let mean = |(source, (sum, count))| (source, sum / count);
    sums.into_iter().map(mean).collect()
}

/// How much of the loudest of a walk's is loud for the others; `None` of too few.
fn shared(walk: &Powers<'_>, others: &Powers<'_>) -> Option<f64> {
    let fewer = walk.len().min(others.len());
    if fewer < FEWEST_SENDERS {
        return None;
    }
    let count = fewer.div_ceil(3).clamp(2, MOST_LOUDEST);
    let (walk, others) = (loudest(walk), loudest(others));
    let loud = &others[..others.len().min(AMONG * count)];
    let known = walk.iter().take(count).filter(|s| loud.contains(s)).count();
    Some(known as f64 / count as f64)
}

/// Senders from the loudest on; of equally loud ones in the order of their names.
fn loudest<'a>(powers: &Powers<'a>) -> Vec<&'a str> {
    let mut all: Vec<(&str, f64)> = powers.iter().map(|(s, p)| (*s, *p)).collect();
    all.sort_by(|a, b| b.1.total_cmp(&a.1));
    all.into_iter().map(|(source, _)| source).collect()
}
