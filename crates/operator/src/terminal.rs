//! The screen's state as a few lines of text.

use std::fmt::Write as _;

use crate::coverage::Reason;
use crate::state::{Level, Phase, ScreenState, Tracking};

/// A few lines, without a newline at the end: what the recorder does, then one line per device, then what needs attention.
pub fn lines(state: &ScreenState) -> String {
    let mut out = match state.phase {
        Phase::Ready => "READY".to_owned(),
        Phase::Starting => "STARTING".to_owned(),
        Phase::Recording => format!("RECORDING {} {}", clock(state.recording_s), state.file),
        Phase::Stopping => "STOPPING".to_owned(),
    };
    let _ = write!(out, " · lost {}", state.lost);
    match state.sync.spread_ms {
        Some(spread_ms) => {
            let _ = write!(out, " · sync {}{spread_ms:.1} ms", mark(state.sync.level));
        }
        None => out.push_str(" · sync –"),
    }
    if let Some(storage) = &state.storage {
        let _ = write!(
            out,
            " · disk {}{:.1} GB",
            mark(storage.level),
            storage.free_bytes as f64 / 1e9
        );
        if let Some(full_in_s) = storage.full_in_s {
            let _ = write!(out, ", full in {}", clock(full_in_s));
        }
    }
    if let Some(battery) = &state.battery {
        let charging = if battery.charging { "+" } else { "" };
        let _ = write!(
            out,
            " · battery {}{:.0} %{charging}",
            mark(battery.level),
            battery.percent
        );
    }
    for stream in &state.streams {
        let _ = write!(
            out,
            "\n  {:<12} {}{:7.1} Hz {:>9}",
            stream.name,
            mark(stream.level),
            stream.rate_hz,
            stream.samples
        );
        if stream.lost > 0 {
            let _ = write!(out, "  lost {}", stream.lost);
        }
        if !stream.problem.is_empty() {
            let _ = write!(out, "  {}", stream.problem);
        }
    }
    if let Some(pose) = &state.pose {
        let warning = match state.tracking {
            Tracking::None | Tracking::Good => "",
            Tracking::Lost => " !LOST",
            Tracking::Frozen => " !FROZEN",
        };
        let _ = write!(
            out,
            "\n  map{warning}          {:.0} m walked, {:.0} of {:.0} m² well covered",
            state.path_m, state.coverage.good_m2, state.coverage.seen_m2
        );
        if state.skipped_scans > 0 {
            let _ = write!(out, ", {} scans skipped", state.skipped_scans);
        }
        if state.loop_count > 0 {
            let _ = write!(out, ", {} loops", state.loop_count);
        }
        for spot in &state.coverage.go_back {
            let (dx_m, dy_m) = (spot.x_m - pose.x_m, spot.y_m - pose.y_m);
            let _ = write!(
                out,
                "\n  go back      {:.0} m {}: {:.0} m² {}",
                dx_m.hypot(dy_m),
                direction(dy_m.atan2(dx_m) - pose.yaw_rad),
                spot.area_m2,
                lacks(spot.reason)
            );
        }
    }
    let disk = state.storage.as_ref().map_or("", |s| &s.problem);
    for problem in [
        disk,
        &state.sync.problem,
        &state.tracking_problem,
        &state.message,
    ] {
        if !problem.is_empty() {
            let _ = write!(out, "\n  {problem}");
        }
    }
    out
}

fn mark(level: Level) -> &'static str {
    match level {
        Level::Unknown | Level::Good => "",
        Level::Warning => "?",
        Level::Bad => "!",
    }
}

/// Hours, minutes and seconds.
fn clock(secs: f64) -> String {
    let secs = secs.max(0.0) as u64;
    match secs / 3600 {
        0 => format!("{}:{:02}", secs / 60, secs % 60),
        hours => format!("{hours}:{:02}:{:02}", secs / 60 % 60, secs % 60),
    }
}

/// Where something is for who looks along the rig's x axis.
fn direction(angle_rad: f64) -> &'static str {
    const NAMES: [&str; 8] = [
        "ahead",
        "ahead left",
        "left",
        "behind left",
        "behind",
        "behind right",
        "right",
        "ahead right",
    ];
    let octant = (angle_rad / std::f64::consts::FRAC_PI_4).round() as i64;
    NAMES
        .get(octant.rem_euclid(8) as usize)
        .copied()
        .unwrap_or_default()
}

fn lacks(reason: Reason) -> &'static str {
    match reason {
        Reason::Far => "seen from far away only",
        Reason::Unfaced => "not seen by a camera",
        Reason::OneSided => "seen from one side only",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coverage::GoBack;
    use crate::state::{
        BatteryState, CoverageState, PoseState, StorageState, StreamState, SyncState,
    };

    #[test]
    fn everything_that_needs_attention_is_in_the_lines() {
        let state = ScreenState {
            phase: Phase::Recording,
            file: "scan.mcap".to_owned(),
            recording_s: 3725.9,
            lost: 3,
            streams: vec![StreamState {
                name: "lidar".to_owned(),
                level: Level::Bad,
                rate_hz: 9.96,
                samples: 37_000,
                lost: 3,
                problem: "silent for 4 s".to_owned(),
            }],
            sync: SyncState {
                level: Level::Good,
                spread_ms: Some(0.44),
                problem: String::new(),
            },
            storage: Some(StorageState {
                level: Level::Warning,
                free_bytes: 12_300_000_000,
                rate_bytes_s: 1e8,
                full_in_s: Some(123.0),
                problem: String::new(),
            }),
            battery: Some(BatteryState {
                level: Level::Good,
                percent: 83.0,
                charging: false,
            }),
            pose: Some(PoseState::default()),
            path_m: 40.2,
            skipped_scans: 7,
            loop_count: 3,
            coverage: CoverageState {
                seen_m2: 120.0,
                good_m2: 90.0,
                go_back: vec![GoBack {
                    x_m: 0.0,
                    y_m: 5.0,
                    area_m2: 6.0,
                    reason: Reason::Far,
                }],
            },
            ..ScreenState::default()
        };
        let text = lines(&state);
        for words in [
            "RECORDING 1:02:05 scan.mcap · lost 3 · sync 0.4 ms · disk ?12.3 GB, full in 2:03 · battery 83 %",
            "lidar        !   10.0 Hz     37000  lost 3  silent for 4 s",
            "go back      5 m left: 6 m² seen from far away only",
            "40 m walked, 90 of 120 m² well covered, 7 scans skipped, 3 loops",
        ] {
            assert!(text.contains(words), "{words:?} is not in\n{text}");
        }
        assert!(lines(&ScreenState::default()).starts_with("READY · lost 0 · sync –"));
    }
}
