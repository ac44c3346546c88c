//! Whether a walk heard what others heard where it says that it was: floors that look alike have transmitters of their own.
//!
//! What is loudest for the walk must be loud for the others: on another floor that floor's own transmitters are the loudest. Powers themselves tell
//! no floor, as phones read them ten decibels apart and a slab takes hardly more: a walk that heard everything much weaker, as on a floor without
//! transmitters, is doubtful, no more.
//!
//! A walk is judged by its worst stretch: one of which half is on another floor agrees by half in the mean.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;

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
            // Over the worst stretch right walks of a mall, whose places are known to some metres, have 0.40 and more; thirty metres away 98 of a
            // hundred stretches have less than this.
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
/// So many of them in a row, or all of a walk with fewer, refuse it: five of a right walk in a mall had 0.17, six 0.28, eight 0.40.
const STRETCH: usize = 8;
/// So many are doubtful; of a walk with fewer than the eight, as few as judge one.
const SHORT_STRETCH: usize = 5;
/// So much more than the least share is usual in the mean.
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
    /// The eight in a row, or all of fewer, that share the least; `None` where nothing was compared.
    pub worst: Option<RadioStretch>,
    /// The five in a row that share the least, the three where fewer than eight were compared; `None` of fewer.
    pub worst_short: Option<RadioStretch>,
    /// By how much weaker the walk heard what both heard, in the middle of the eight in a row where that is most, decibel; zero of none.
    pub weaker_db: f64,
    /// The settings' least.
    pub least_share: f64,
}

/// What a walk shared with others over some scans and spans in a row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RadioStretch {
    /// When the first reading of it was heard, nanoseconds.
    pub from_ns: i64,
    /// When the last was.
    pub to_ns: i64,
    /// How much of what was loudest for the walk was loud for the others, in the mean.
    pub share: f64,
}

impl RadioStretch {
    fn sentence(&self) -> String {
        format!(
            "{:.0} % from {} to {}",
            100.0 * self.share,
            Timestamp::from_nanos(self.from_ns),
            Timestamp::from_nanos(self.to_ns)
        )
    }
}

impl RadioAgreement {
    /// Whether enough was compared to believe it.
    pub fn is_judged(&self) -> bool {
        self.compared >= FEWEST_COMPARED
    }

    /// The stretch where the walk was elsewhere.
    pub fn elsewhere(&self) -> Option<&RadioStretch> {
        let worst = self.worst.as_ref().filter(|_| self.is_judged())?;
        (worst.share < self.least_share).then_some(worst)
    }

    /// As every command says it.
    pub fn finding(&self) -> Finding {
        let mut what = format!(
            "in {} Wi-Fi scans and Bluetooth intervals, {:.0} % of the strongest signals were also \
             strong for other walks there, and {:.0} dB weaker where it was weakest; for {} more \
             there are no earlier readings nearby",
            self.compared,
            100.0 * self.share,
            self.weaker_db,
            self.unknown
        );
        if !self.is_judged() {
            return Finding::new("radio", Verdict::Unknown, "trajectory", what).remedy(LISTEN);
        }
        let is_less = |stretch: &&RadioStretch| stretch.share < self.least_share;
        let doubtful = self.worst_short.as_ref().filter(is_less);
        let elsewhere = self.elsewhere();
        if let Some(stretch) = elsewhere.or(doubtful) {
            let _ = write!(what, "; but {}", stretch.sentence());
            let verdict = if elsewhere.is_some() {
                Verdict::Fail
            } else {
                Verdict::Warn
            };
            return Finding::new("radio", verdict, "trajectory", what)
                .value(100.0 * stretch.share, "%")
                .limit(Limit::AtLeast(100.0 * self.least_share))
                .remedy("make sure that the walk was on this floor of this building, and that the table belongs to this map");
        }
        if self.weaker_db > MOST_WEAKER_DB {
            return Finding::new("radio", Verdict::Warn, "trajectory", what)
                .value(self.weaker_db, "dB")
                .limit(Limit::AtMost(MOST_WEAKER_DB))
                .remedy(
                    "make sure that the walk was on this floor: ceilings attenuate all signals",
                );
        }
        if self.unknown >= self.compared {
            return Finding::new("radio", Verdict::Warn, "trajectory", what)
                .value(self.unknown as f64, "")
                .limit(Limit::AtMost(self.compared as f64))
                .remedy(LISTEN);
        }
        let usual = USUAL_OF_LEAST * self.least_share;
        let verdict = Verdict::Warn.unless(self.share >= usual);
        Finding::new("radio", verdict, "trajectory", what)
            .value(100.0 * self.share, "%")
            .limit(Limit::AtLeast(100.0 * usual))
            .remedy("make sure that the map is of this floor of this building, and that the table belongs to that map")
    }
}

/// What to do where too little is known.
const LISTEN: &str = "record readings once along the whole walk, and add them to the table";

/// What was heard of each sender in one scan or span.
struct Span<'a> {
    kind: RadioKind,
    from: Timestamp,
    to: Timestamp,
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
    let (mut compared, mut unknown) = (Vec::new(), 0);
    for span in spans(walk, config) {
        let around = radio(others).filter(|r| {
            r.kind == span.kind && (r.position_m - span.position_m).norm() <= config.reach_m
        });
        let around = mean_powers(around);
        let Some(share) = shared(&span.heard, &around) else {
            unknown += 1;
            continue;
        };
        let both = span
            .heard
            .iter()
            .filter_map(|(s, own)| Some((own, around.get(s)?)));
        compared.push(Compared {
            from: span.from,
            to: span.to,
            share,
            weaker_db: both.map(|(own, others)| others - own).collect(),
        });
    }
    let long = STRETCH.min(compared.len()).max(1);
    let short = match long {
        STRETCH => SHORT_STRETCH,
        _ => FEWEST_COMPARED,
    };
    let weaker_db = compared
        .windows(long)
        .filter_map(|row| median(row.iter().flat_map(|c| c.weaker_db.clone()).collect()));
    Ok(RadioAgreement {
        unknown,
        share: mean_share(&compared),
        worst: worst(&compared, long),
        worst_short: worst(&compared, short),
        weaker_db: weaker_db.max_by(f64::total_cmp).unwrap_or(0.0),
        compared: compared.len(),
        least_share: config.least_share,
    })
}

/// A span beside what others heard there.
struct Compared {
    from: Timestamp,
    to: Timestamp,
    share: f64,
    /// Of each sender that both heard, decibel.
    weaker_db: Vec<f64>,
}

fn mean_share(compared: &[Compared]) -> f64 {
    compared.iter().map(|c| c.share).sum::<f64>() / compared.len().max(1) as f64
}

/// So many in a row that share the least.
fn worst(compared: &[Compared], count: usize) -> Option<RadioStretch> {
    let stretches = compared.windows(count).filter_map(|row| {
        Some(RadioStretch {
            from_ns: row.iter().map(|c| c.from).min()?.nanos(),
            to_ns: row.iter().map(|c| c.to).max()?.nanos(),
            share: mean_share(row),
        })
    });
    stretches.min_by(|a, b| a.share.total_cmp(&b.share))
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

/// Scans of Wi-Fi, and advertisements of Bluetooth in spans of equal length, in the order in which they began.
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
        let times = || readings.iter().map(|r| r.time);
        Some(Span {
            kind,
            from: times().min()?,
            to: times().max()?,
            position_m: places / readings.len() as f64,
            heard: mean_powers(readings.into_iter()),
        })
    };
    let mut spans: Vec<Span<'_>> = by_span.into_iter().filter_map(span).collect();
    spans.sort_by_key(|span| span.from);
    spans
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
