//! Whether a camera is the same all along a recording: its clock, and how it is turned.
//!
//! Time offset and rotation are found in each part of the recording alone, and these are held against each other. A clock that drifts or jumps, and a
//! camera that is knocked, agree with the rig on the whole, or in the part that was looked at.

use lsfb_geometry::{IntegratedGyro, RigCamera, so3};
use lsfb_perception::image::Pair;
use lsfb_types::Verdict;

use super::camera_images::PARTS;
use super::judgement::judged;
use super::time_offset::{self, Agreement};
use super::{Check, VerifyConfig, mount_drift_name, time_drift_name};

/// Pairs of images of a part: eight seconds of them. Fewer do not tell how well they know what they say.
const PAIRS: usize = 80;
/// Of ten pairs of parts the one that differs most is judged: chance explains more of it than of a single one, by this factor.
const WORST_OF_TEN: f64 = 4.0 / 3.0;

/// What a part of the recording says.
struct Part {
    from_s: f64,
    to_s: f64,
    found: Agreement,
}

/// How two parts differ.
struct Difference<'a> {
    value: f64,
    sigma: f64,
    verdict: Verdict,
    parts: [&'a Part; 2],
}

/// Both checks, one of the clock and one of the mount.
pub(super) fn steadiness(
    name: &str,
    mounted: &RigCamera,
    pairs: &[Pair],
    gyro: Option<&IntegratedGyro>,
    config: &VerifyConfig,
) -> Vec<Check> {
    let mut time = Check::unknown(
        "time-drift",
        time_drift_name(name),
        "ms",
        config.time_offset_ms,
    );
    let mut mount = Check::unknown(
        "mount-drift",
        mount_drift_name(name),
        "°",
        config.imu_rotation_deg,
    );
    let parts = gyro.map_or_else(Vec::new, |gyro| parts(mounted, pairs, gyro));
    for (check, difference) in [
        (&mut time, time_difference as fn(&Part, &Part) -> [f64; 2]),
        (&mut mount, mount_difference),
    ] {
        match largest(&parts, check.limits, difference) {
            Some(found) => judge(check, &found),
            None => {
                check.sentence = format!(
                    "{} parts of the recording are usable on their own, but two are needed: record longer, with rotation throughout",
                    parts.len()
                );
            }
        }
    }
    vec![time, mount]
}

/// The parts that tell by themselves.
fn parts(mounted: &RigCamera, pairs: &[Pair], gyro: &IntegratedGyro) -> Vec<Part> {
    let (Some(first), Some(last)) = (pairs.first(), pairs.last()) else {
        return Vec::new();
    };
    let parts = (pairs.len() / PAIRS).clamp(2, PARTS);
    let part_s = (last.to_s - first.from_s) / parts as f64;
    let part_of = |pair: &Pair| ((pair.from_s - first.from_s) / part_s) as usize;
    let parts = pairs.chunk_by(|a, b| part_of(a) == part_of(b));
    let parts = parts.filter_map(|pairs| {
        Some(Part {
            from_s: pairs.first()?.from_s,
            to_s: pairs.last()?.to_s,
            found: time_offset::agree(pairs, mounted, gyro).ok()?,
        })
    });
    parts.collect()
}

/// Of all pairs of parts that which differs most, for certain.
fn largest<'a>(
    parts: &'a [Part],
    limits: [f64; 2],
    difference: fn(&Part, &Part) -> [f64; 2],
) -> Option<Difference<'a>> {
    let pairs = (0..parts.len()).flat_map(|b| (0..b).map(move |a| [&parts[a], &parts[b]]));
    let differences = pairs.map(|parts| {
        let [value, sigma] = difference(parts[0], parts[1]);
        Difference {
            value,
            sigma,
            verdict: judged(value, WORST_OF_TEN * sigma, limits),
            parts,
        }
    });
    differences.max_by(|a, b| {
        (a.verdict, a.value)
            .partial_cmp(&(b.verdict, b.value))
            .unwrap_or(std::cmp::Ordering::Equal)
    })
}

/// Milliseconds, and their standard deviation.
fn time_difference(a: &Part, b: &Part) -> [f64; 2] {
    let (a, b) = (&a.found, &b.found);
    let sigma_s = a.offset_sigma_s.hypot(b.offset_sigma_s);
    [(a.offset_s - b.offset_s).abs() * 1e3, sigma_s * 1e3]
}

/// Degrees, and their standard deviation.
fn mount_difference(a: &Part, b: &Part) -> [f64; 2] {
    let (a, b) = (&a.found, &b.found);
    let off = so3::local(&a.camera_from_rig, &b.camera_from_rig);
    let sigma_rad = a.rotation_sigma_rad.hypot(b.rotation_sigma_rad);
    [off.norm().to_degrees(), sigma_rad.to_degrees()]
}

fn judge(check: &mut Check, found: &Difference<'_>) {
    check.outcome = found.verdict;
    check.value = Some(found.value);
    check.sigma = Some(found.sigma);
    let [a, b] = found.parts;
    let when = format!(
        "between {:.0}–{:.0} s and {:.0}–{:.0} s of the recording",
        a.from_s, a.to_s, b.from_s, b.to_s
    );
    let (value, unit) = (found.value, check.unit);
    check.sentence = match (found.verdict, check.code) {
        (Verdict::Unknown, _) => format!(
            "{when}, standard deviation is {:.1} {unit}, too large: rotate more throughout",
            found.sigma
        ),
        (Verdict::Pass, _) => format!("changes by at most {value:.1} {unit} {when}"),
        (_, "time-drift") => format!(
            "{when}, the time offset changes by {value:.1} ms: the camera's clock drifts or jumped, and no fixed offset in the rig is right"
        ),
        _ => format!(
            "{when}, the camera rotates by {value:.1}° relative to the IMU: it was knocked, or its mount is loose"
        ),
    };
}
