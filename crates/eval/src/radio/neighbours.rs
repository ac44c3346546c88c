//! Where a phone is by the Wi-Fi it hears: the nearest neighbours among the scans of other walks. The baseline that every better method
//! is compared with.

use std::collections::{BTreeMap, BTreeSet};

use lsfb_geometry::Vector3;
use lsfb_types::{Bounds, Finding, Limit, Timestamp, Verdict};
use serde::{Deserialize, Serialize};

use super::placing::{PlacedReading, RadioKind};
use crate::{Error, Statistics};

/// How scans are compared.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NeighbourConfig {
    /// Scans whose places are averaged.
    pub neighbours: usize,
    /// Readings older than the newest of their scan by more are left out, seconds: Android hands out what it heard up to half a minute ago.
    pub oldest_secs: f64,
    /// Power below which nothing counts, dBm.
    pub floor_dbm: f64,
    /// Power of the power above the floor in the cosine of two scans.
    pub exponent: f64,
}

lsfb_types::bounds! {
    NeighbourConfig {
        neighbours: number(Bounds::Within(1.0, 100.0)),
        oldest_secs: number(Bounds::Within(0.0, 3600.0)),
        floor_dbm: number(Bounds::Within(-150.0, 0.0)),
        exponent: number(Bounds::Within(0.1, 10.0)),
    }
}

impl Default for NeighbourConfig {
    fn default() -> Self {
        Self {
            neighbours: 3,
            oldest_secs: 4.0,
            floor_dbm: -95.0,
            exponent: 1.5,
        }
    }
}

/// Distances to the nearest scan of another walk within which errors are told apart, metres.
const REACHES_M: [f64; 2] = [5.0, 10.0];
/// Cosines that differ by less are alike.
const SMALLEST: f64 = 1e-3;
/// Senders from which on no two phones hear the same powers by chance.
const CHANCE: usize = 3;
/// Share of the scans that should have another walk's within ten metres.
const LEAST_REACHED: f64 = 0.8;

/// Errors of the scans that have one of another walk near them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Reach {
    /// Within this, metres.
    pub within_m: f64,
    /// Horizontal errors, metres; `None` where there is no such scan.
    pub errors_m: Option<Statistics>,
}

/// What the neighbours said.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NeighbourFigures {
    /// Walks.
    pub walks: usize,
    /// Scans with a place.
    pub scans: usize,
    /// Scans that share no sender with any other walk: no place is said.
    pub unheard: usize,
    /// Horizontal errors of all that are said, metres.
    pub errors_m: Statistics,
    /// Of those within reach of another walk: a place where nobody else was cannot be said.
    pub reaches: Vec<Reach>,
    /// How far the scans' places themselves are known, root mean square of their σ, metres.
    pub place_sigma_m: f64,
    /// What a reader should know.
    #[serde(skip)]
    pub findings: Vec<Finding>,
}

/// A scan at its place.
struct Scan {
    walk: usize,
    /// Of its newest reading.
    time: Timestamp,
    position_m: Vector3<f64>,
    sigma_m: f64,
    /// Powers above the floor, raised, and divided by their norm.
    heard: BTreeMap<String, f64>,
}

/// Places every scan by the scans of all other walks.
///
/// [`Error::CopiedScans`] where a scan stands in two walks, [`Error::TooFewMatches`] where no two walks share a sender.
pub fn judge_neighbours(
    walks: &[Vec<PlacedReading>],
    config: &NeighbourConfig,
) -> Result<NeighbourFigures, Error> {
    let scans: Vec<Scan> = walks
        .iter()
        .enumerate()
        .flat_map(|(walk, readings)| scans_of(walk, readings, config))
        .collect();
    let is_copy = |scan: &&Scan| {
        let mut earlier = scans.iter().take_while(|other| other.walk < scan.walk);
        scan.heard.len() >= CHANCE
            && earlier.any(|other| other.time == scan.time && other.heard == scan.heard)
    };
    let copied = scans.iter().filter(is_copy).count();
    if copied > 0 {
        return Err(Error::CopiedScans { scans: copied });
    }
    let (mut errors_m, mut nearest_m, mut unheard) = (Vec::new(), Vec::new(), 0);
    for scan in &scans {
        let mut others: Vec<(f64, &Scan)> = scans
            .iter()
            .filter(|other| other.walk != scan.walk)
            .map(|other| (1.0 - cosine(scan, other), other))
            .collect();
        // In a stable order, so that equal ones are always chosen alike.
        others.sort_by(|a, b| a.0.total_cmp(&b.0));
        others.truncate(config.neighbours);
        others.retain(|(apart, _)| *apart < 1.0);
        let weights: f64 = others.iter().map(|(d, _)| 1.0 / (d + SMALLEST)).sum();
        if others.is_empty() {
            unheard += 1;
            continue;
        }
        let sum: Vector3<f64> = others
            .iter()
            .map(|(d, other)| other.position_m / (d + SMALLEST))
            .sum();
        errors_m.push(horizontal(&(sum / weights - scan.position_m)));
        let near = scans.iter().filter(|other| other.walk != scan.walk);
        let near = near.map(|other| horizontal(&(other.position_m - scan.position_m)));
        nearest_m.push(near.fold(f64::INFINITY, f64::min));
    }
    let all = Statistics::of(&errors_m).ok_or(Error::TooFewMatches {
        matched: 0,
        needed: 1,
        purpose: "Wi-Fi localization: no scan of one walk shares a transmitter with one of another",
    })?;
    let reaches: Vec<Reach> = REACHES_M
        .iter()
        .map(|&within_m| {
            let near = errors_m.iter().zip(&nearest_m);
            let near: Vec<f64> = near
                .filter(|(_, nearest)| **nearest < within_m)
                .map(|(error, _)| *error)
                .collect();
            Reach {
                within_m,
                errors_m: Statistics::of(&near),
            }
        })
        .collect();
    let widest = reaches.last().and_then(|r| r.errors_m);
    let reached = widest.map_or(0, |w| w.count) as f64 / scans.len() as f64;
    let what = format!(
        "{:.0} % of the scans have a scan of another walk within {} m: elsewhere no method could know the place",
        100.0 * reached,
        REACHES_M[1]
    );
    let finding = Finding::new(
        "radio-coverage",
        Verdict::Warn.unless(reached >= LEAST_REACHED),
        "walks",
        what,
    );
    let squares: f64 = scans.iter().map(|s| s.sigma_m * s.sigma_m).sum();
    Ok(NeighbourFigures {
        walks: scans.iter().map(|s| s.walk).collect::<BTreeSet<_>>().len(),
        scans: scans.len(),
        unheard,
        errors_m: all,
        reaches,
        place_sigma_m: (squares / scans.len() as f64).sqrt(),
        findings: vec![
            finding
                .value(100.0 * reached, "%")
                .limit(Limit::AtLeast(100.0 * LEAST_REACHED))
                .remedy("walk where the others walked, or evaluate only the scans within reach"),
        ],
    })
}

fn horizontal(of: &Vector3<f64>) -> f64 {
    of.x.hypot(of.y)
}

/// The scans of a walk, each at the mean place of its readings.
fn scans_of(walk: usize, readings: &[PlacedReading], config: &NeighbourConfig) -> Vec<Scan> {
    let mut scans: BTreeMap<u32, Vec<&PlacedReading>> = BTreeMap::new();
    for reading in readings.iter().filter(|r| r.kind == RadioKind::Wifi) {
        scans.entry(reading.scan).or_default().push(reading);
    }
    let scan = |mut readings: Vec<&PlacedReading>| {
        let newest = readings.iter().map(|r| r.time).max()?;
        readings.retain(|r| newest.secs_since(r.time) <= config.oldest_secs);
        let count = readings.len() as f64;
        let mut heard = BTreeMap::new();
        for reading in &readings {
            let above = (f64::from(reading.rssi_dbm) - config.floor_dbm).max(0.0);
            let strength: &mut f64 = heard.entry(reading.source.clone()).or_default();
            *strength = strength.max(above.powf(config.exponent));
        }
        let norm = heard.values().map(|v| v * v).sum::<f64>().sqrt();
        for strength in heard.values_mut() {
            *strength /= norm;
        }
        (norm > 0.0).then(|| Scan {
            walk,
            time: newest,
            position_m: readings.iter().map(|r| r.position_m).sum::<Vector3<f64>>() / count,
            sigma_m: readings.iter().map(|r| r.sigma_m).sum::<f64>() / count,
            heard,
        })
    };
    scans.into_values().filter_map(scan).collect()
}

fn cosine(a: &Scan, b: &Scan) -> f64 {
    let shared = a.heard.iter();
    let product = shared.filter_map(|(source, own)| Some(own * b.heard.get(source)?));
    product.sum::<f64>().clamp(0.0, 1.0)
}
