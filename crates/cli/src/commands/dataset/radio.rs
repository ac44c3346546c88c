//! `lsfb dataset radio`: what a phone heard, and where.

use std::path::{Path, PathBuf};

use lsfb_eval::radio::{
    KnownPlace, PlacedReading, PlacingConfig, RadioKind, place, table, waypoints,
};
use lsfb_eval::{ReadOptions, read_trajectory};
use lsfb_types::{Finding, Limit, Verdict, median};
use serde::Serialize;

use crate::bad_argument::BadArgument;
use crate::context::Context;
use crate::files::write;
use crate::outcome::Outcome;
use crate::refused::Refused;

/// Locate every Wi-Fi, Bluetooth and magnetic reading of a walk, with its standard deviation.
///
/// Positions come from a trajectory, or without one from the waypoints of an imported walk of Indoor
/// Location 2.0. A scan takes seconds; each reading is placed at its own time. sigma_m is per
/// coordinate, and includes the uncertainty of the known positions, of the time between reception and
/// stamp at the current speed, and of the motion between known positions. Readings outside the
/// trajectory or in its gaps get no position, and are counted. Magnetic fields are in the sensor's
/// axes.
///
/// Examples:
///   lsfb dataset radio walk.mcap --trajectory walk.tum --out radio.csv
///   lsfb dataset radio mall.mcap --place-sigma-m 0.5 --out mall.csv
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The recording.
    #[arg(value_name = "MCAP")]
    recording: PathBuf,
    /// Trajectory of the phone, on the recording's clock; by default the recording's waypoints are used.
    #[arg(long, value_name = "TUM")]
    trajectory: Option<PathBuf>,
    /// Standard deviation per coordinate of known positions that have none of their own.
    #[arg(long, value_name = "M", default_value_t = PlacingConfig::default().place_sigma_m)]
    place_sigma_m: f64,
    /// Table to write.
    #[arg(long, value_name = "CSV")]
    out: PathBuf,
}

#[derive(Serialize)]
struct Found<'a> {
    table: &'a Path,
    known_places: usize,
    wifi: usize,
    ble: usize,
    magnetic: usize,
    outside: usize,
    in_gaps: usize,
    /// Root mean square of the readings' standard deviations, metres.
    sigma_rms_m: Option<f64>,
}

/// So many known positions, at least, have a reading between them.
const LEAST_KNOWN: usize = 2;

/// Faster than this nobody moves who listens for radio, m/s: places in centimetres, or of another clock.
const FASTEST_M_S: f64 = 30.0;

/// Reads, places, writes, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let out = &arguments.out;
    let inputs: Vec<&Path> = std::iter::once(arguments.recording.as_path())
        .chain(arguments.trajectory.as_deref())
        .collect();
    context.claim(out, &inputs)?;
    let config = PlacingConfig {
        place_sigma_m: arguments.place_sigma_m,
        ..PlacingConfig::default()
    };
    BadArgument::check(config.check_bounds(""), &[])?;
    let recording = context.open(&arguments.recording)?;
    let known = match &arguments.trajectory {
        Some(path) => of_trajectory(path, context)?,
        None => waypoints(&recording)?,
    };
    let refused = |code, what: String| {
        let subject = arguments.recording.display().to_string();
        Finding::new(code, Verdict::Fail, subject, what)
    };
    if known.len() < LEAST_KNOWN {
        let count = known.len() as f64;
        let finding = refused("known-positions", format!("{count} known positions"))
            .value(count, "")
            .limit(Limit::AtLeast(LEAST_KNOWN as f64))
            .remedy("give a trajectory with --trajectory");
        return Err(Refused(finding).into());
    }
    let speeds = known.windows(2).map(|pair| {
        let moved_m = (pair[1].position_m - pair[0].position_m).norm();
        moved_m / pair[1].time.secs_since(pair[0].time).max(1e-3)
    });
    let usual_m_s = median(speeds.collect()).unwrap_or(0.0);
    if usual_m_s >= FASTEST_M_S {
        let what = format!("{usual_m_s:.0} m/s between known positions");
        let finding = refused("speed", what)
            .value(usual_m_s, "m/s")
            .limit(Limit::AtMost(FASTEST_M_S))
            .remedy("check that positions are in metres, and times on the recording's clock");
        return Err(Refused(finding).into());
    }
    let placed = place(&recording, &known, &config)?;
    if placed.readings.is_empty() {
        let what = format!(
            "no reading could be placed: {} outside the time of the known positions, {} in gaps",
            placed.outside, placed.in_gaps
        );
        let finding = refused("no-readings", what).remedy("check that both use one clock");
        return Err(Refused(finding).into());
    }
    context.check_stop()?;
    write(out, table(&placed.readings))?;
    let of = |kind| placed.readings.iter().filter(|r| r.kind == kind).count();
    let squares: f64 = placed.readings.iter().map(|r| r.sigma_m * r.sigma_m).sum();
    let found = Found {
        table: out,
        known_places: known.len(),
        wifi: of(RadioKind::Wifi),
        ble: of(RadioKind::Ble),
        magnetic: of(RadioKind::Magnetic),
        outside: placed.outside,
        in_gaps: placed.in_gaps,
        sigma_rms_m: Some((squares / placed.readings.len() as f64).sqrt()),
    };
    context.print(&found, || text(&found, &placed.readings))?;
    Ok(Outcome::Done)
}

fn of_trajectory(path: &Path, context: &Context) -> anyhow::Result<Vec<KnownPlace>> {
    let file = read_trajectory(path, &ReadOptions::default())?;
    for finding in &file.findings {
        context.say(&format!("warning: {}: {}", finding.subject, finding.what));
    }
    let mut known: Vec<KnownPlace> = file
        .poses
        .iter()
        .enumerate()
        .map(|(i, pose)| KnownPlace {
            time: pose.time,
            position_m: pose.world_from_rig.translation,
            // The trace does not depend on the frame.
            sigma_m: file.covariances.get(i).map(|covariance| {
                let own = (3..6).map(|k| covariance[(k, k)]).sum::<f64>();
                (own / 3.0).max(0.0).sqrt()
            }),
        })
        .collect();
    known.dedup_by_key(|k| k.time);
    Ok(known)
}

fn text(found: &Found<'_>, readings: &[PlacedReading]) -> String {
    let mut text = format!(
        "{}: placed {} Wi-Fi, {} Bluetooth and {} magnetic readings",
        found.table.display(),
        found.wifi,
        found.ble,
        found.magnetic
    );
    let widest = readings.iter().map(|r| r.sigma_m).fold(0.0, f64::max);
    if let Some(sigma_m) = found.sigma_rms_m {
        text += &format!("; σ {sigma_m:.3} m rms, {widest:.3} m at most");
    }
    if found.outside + found.in_gaps > 0 {
        text += &format!(
            "\n{} readings could not be placed: {} before or after the known positions, {} in gaps",
            found.outside + found.in_gaps,
            found.outside,
            found.in_gaps
        );
    }
    text
}
