//! The page of a ground truth: the trajectory in its map, how certain it is over time, and what was left out of it.

use lsfb_eval::report::{Distribution, Figure, Marks, Report, Stretch, Table, Timeline, Upward};
use lsfb_geometry::{StampedPose, Trajectory};
use lsfb_pipeline::ground_truth::{
    CameraRefinement, GroundTruth, ImuRefinement, LocalizedInstant, ReprojectionErrors, Span,
};
use lsfb_pipeline::hd_map::HdMap;
use lsfb_recording::Provenance;
use lsfb_types::{Finding, Timestamp};

use super::map_report::track;
use crate::pages;

/// What the page is made from.
pub struct WalkPage<'a> {
    pub name: &'a str,
    pub map: &'a HdMap,
    pub found: &'a GroundTruth,
    pub findings: Vec<Finding>,
    pub provenance: &'a Provenance,
}

impl WalkPage<'_> {
    /// The page as text.
    pub fn to_html(&self) -> String {
        let found = self.found;
        let report = &found.report;
        let clock = Clock::of(found);
        let reprojection = |title: &str, errors: &ReprojectionErrors| Distribution {
            title: title.to_owned(),
            quantity: "reprojection error".to_owned(),
            unit: "px".to_owned(),
            values: spread(errors),
        };
        let accepted = found.localizations.iter().filter(|l| l.is_accepted);
        let alone = accepted.map(|l| StampedPose {
            time: l.time,
            world_from_rig: l.world_from_rig,
        });
        let tracks = vec![
            track("trajectory", found.trajectory.poses().to_vec()),
            track("visual localization only", alone.collect()),
        ];
        let mut timelines = vec![clock.outcome(found)];
        timelines.extend(clock.certainty(found));
        timelines.push(clock.halves(found));
        timelines.push(clock.localization(found));
        Report {
            title: format!("Ground truth of {}", self.name),
            figures: figures(found),
            map_points: self.map.positions().collect(),
            tracks: tracks
                .into_iter()
                .filter(|track| !track.estimate.is_empty())
                .collect(),
            timelines,
            histograms: vec![
                reprojection("Reprojection of map points", &report.map_errors),
                reprojection("Reprojection of local points", &report.local_errors),
            ],
            tables: vec![
                left_out(&clock, &report.left_out),
                cameras(&report.cameras),
                imu(report.imu.as_ref()),
            ],
            findings: self.findings.clone(),
            provenance: pages::settings(self.provenance),
            ..Report::default()
        }
        .to_html()
    }
}

/// Seconds since the first instant of a walk that something is said of.
struct Clock {
    start: Timestamp,
    end_secs: f64,
    left_out: Vec<Stretch>,
}

impl Clock {
    fn of(found: &GroundTruth) -> Self {
        let poses = found.trajectory.poses().iter().map(|p| p.time);
        let spans = found.report.left_out.iter();
        let ends = spans.flat_map(|s| [s.from_ns, s.to_ns].map(Timestamp::from_nanos));
        let times: Vec<Timestamp> = poses.chain(ends).collect();
        let start = times.iter().min().copied().unwrap_or_default();
        let last = times.iter().max().copied().unwrap_or_default();
        let mut clock = Self {
            start,
            end_secs: last.secs_since(start).max(1e-3),
            left_out: Vec::new(),
        };
        let stretch = |span: &Span| Stretch {
            name: reason(span),
            secs: clock.span_secs(span),
            row: None,
        };
        clock.left_out = found.report.left_out.iter().map(stretch).collect();
        clock
    }

    fn secs(&self, time: Timestamp) -> f64 {
        time.secs_since(self.start)
    }

    fn span_secs(&self, span: &Span) -> [f64; 2] {
        [span.from_ns, span.to_ns].map(|ns| self.secs(Timestamp::from_nanos(ns)))
    }

    /// Which instants were localized, which have a pose, and why others have none.
    fn outcome(&self, found: &GroundTruth) -> Timeline {
        const NAMES: [&str; 4] = ["left out", "pose", "reject", "agree"];
        let [left_out, pose, rejected, agreeing] = [0, 1, 2, 3];
        let row = |name: &str, row: usize, times: Vec<Timestamp>| Marks {
            name: name.to_owned(),
            points: times.iter().map(|t| [self.secs(*t), row as f64]).collect(),
            is_line: row == pose,
        };
        let localized = |is_accepted: bool| {
            let own = found.localizations.iter();
            let own = own.filter(|l| l.is_accepted == is_accepted);
            own.map(|l| l.time).collect()
        };
        let poses = found.trajectory.poses().iter();
        Timeline {
            title: "Localized, exported and left out".to_owned(),
            upward: Upward::Rows(NAMES.map(str::to_owned).to_vec()),
            secs: [0.0, self.end_secs],
            marks: vec![
                row("localized, agrees", agreeing, localized(true)),
                row("localized, rejected", rejected, localized(false)),
                row("pose", pose, poses.map(|p| p.time).collect()),
            ],
            stretches: self
                .left_out
                .iter()
                .map(|stretch| Stretch {
                    row: Some(left_out),
                    ..stretch.clone()
                })
                .collect(),
        }
    }

    /// Standard deviations of position and attitude.
    fn certainty(&self, found: &GroundTruth) -> [Timeline; 2] {
        let sigmas = found.worst_sigmas();
        let of = |k: usize, factor: f64| sigmas.iter().map(|s| factor * s[k]).collect();
        let name = "in the worst direction";
        [
            self.of_poses(
                found,
                ("Standard deviation of positions", "σ", "mm"),
                name,
                of(1, 1e3),
            ),
            self.of_poses(
                found,
                ("Standard deviation of attitudes", "σ", "°"),
                name,
                of(0, 1f64.to_degrees()),
            ),
        ]
    }

    /// How far halves of the map move poses.
    fn halves(&self, found: &GroundTruth) -> Timeline {
        let moved_mm = found.disagreements_m.iter().map(|m| 1e3 * m);
        self.of_poses(
            found,
            ("Agreement between halves of the map", "moved", "mm"),
            "position change, half of the map's points withheld",
            moved_mm.collect(),
        )
    }

    /// A value for each pose.
    fn of_poses(
        &self,
        found: &GroundTruth,
        (title, quantity, unit): (&str, &str, &str),
        name: &str,
        values: Vec<f64>,
    ) -> Timeline {
        let times = found.trajectory.poses().iter().map(|p| self.secs(p.time));
        let points = times.zip(values).map(|(secs, value)| [secs, value]);
        self.of_points(
            (title, quantity, unit),
            Marks {
                name: name.to_owned(),
                points: points.collect(),
                is_line: true,
            },
        )
    }

    fn of_points(&self, (title, quantity, unit): (&str, &str, &str), marks: Marks) -> Timeline {
        Timeline {
            title: title.to_owned(),
            upward: Upward::Values {
                quantity: quantity.to_owned(),
                unit: unit.to_owned(),
            },
            secs: [0.0, self.end_secs],
            marks: vec![marks],
            stretches: self.left_out.clone(),
        }
    }

    /// How far single images that agree were localized from where the trajectory has them.
    fn localization(&self, found: &GroundTruth) -> Timeline {
        let accepted = found.localizations.iter().filter(|l| l.is_accepted);
        let apart = accepted
            .filter_map(|l| Some([self.secs(l.time), apart_m(l, &found.trajectory)? * 1e3]));
        self.of_points(
            ("Single-image localization vs. trajectory", "apart", "mm"),
            Marks {
                name: "frames that agree".to_owned(),
                points: apart.collect(),
                is_line: false,
            },
        )
    }
}

/// `None` where the trajectory has no pose at the instant.
fn apart_m(localized: &LocalizedInstant, trajectory: &Trajectory) -> Option<f64> {
    let poses = trajectory.poses();
    let at = poses
        .binary_search_by_key(&localized.time, |p| p.time)
        .ok()?;
    let place = poses[at].world_from_rig.translation;
    Some((localized.world_from_rig.translation - place).norm())
}

fn figures(found: &GroundTruth) -> Vec<Figure> {
    let report = &found.report;
    let count = |name: &str, value: u64| Figure::new(name, value as f64, "");
    let sigmas = found.worst_sigmas();
    let largest = |k: usize| sigmas.iter().map(|s| s[k]).fold(0.0, f64::max);
    let mut figures = vec![
        count("frames", report.frames),
        count("poses", report.poses),
        count("poses from IMU and local points only", report.bridged),
        count("frames localized", report.localized),
        count("localizations rejected", report.rejected_localizations),
        Figure::new("path length", report.path_length_m, "m"),
        Figure::new("position σ, max", 1e3 * largest(1), "mm"),
        Figure::new("attitude σ, max", largest(0).to_degrees(), "°"),
        Figure::new(
            "position change between halves of the map, max",
            1e3 * report.largest_disagreement_m,
            "mm",
        ),
        Figure::new(
            "reprojection of map points, rms",
            report.map_errors.rms_px,
            "px",
        ),
        count("observations of map points", report.map_errors.count),
        Figure::new(
            "reprojection of local points, rms",
            report.local_errors.rms_px,
            "px",
        ),
        count("observations of local points", report.local_errors.count),
        count("unused observations", report.outliers),
        count("map points that should be in view", report.points_in_view),
        Figure::new("of these absent", 100.0 * report.absent_share, "%"),
    ];
    if let Some(scale) = report.map.and_then(|map| map.scale) {
        figures.push(Figure::new(
            "map scale relative to the IMU",
            scale.too_large_percent,
            "%",
        ));
    }
    figures
}

fn reason(span: &Span) -> String {
    span.reason.code().replace('-', " ")
}

fn words<const N: usize>(words: [&str; N]) -> Vec<String> {
    words.map(str::to_owned).to_vec()
}

fn left_out(clock: &Clock, spans: &[Span]) -> Table {
    let rows = spans.iter().map(|span| {
        let [from, to] = clock.span_secs(span);
        vec![reason(span), format!("{from:.2}"), format!("{to:.2}")]
    });
    Table {
        title: "Left out".to_owned(),
        head: words(["reason", "from, s", "to, s"]),
        rows: rows.collect(),
    }
}

fn axes(values: &[f64; 3], factor: f64, digits: usize) -> String {
    values
        .map(|value| format!("{:+.digits$}", factor * value))
        .join(", ")
        .replace('-', "−")
}

fn with_sigma(value: f64, sigma: f64, factor: f64, digits: usize) -> String {
    let (value, sigma) = (factor * value, factor * sigma);
    format!("{value:+.digits$} ± {sigma:.digits$}").replace('-', "−")
}

fn cameras(cameras: &[CameraRefinement]) -> Table {
    let rows = cameras.iter().map(|c| {
        vec![
            c.camera.clone(),
            axes(&c.turn_deg, 1.0, 3),
            axes(&c.shift_m, 1e3, 2),
            with_sigma(c.focal_share, c.focal_sigma, 1e2, 3),
            with_sigma(c.clock_s, c.clock_sigma_s, 1e3, 2),
            with_sigma(c.readout_s, c.readout_sigma_s, 1e3, 2),
            format!("{:.1}", c.largest_sigmas),
        ]
    });
    Table {
        title: "Cameras relative to the rig file".to_owned(),
        head: words([
            "camera",
            "rotation about x, y, z, °",
            "translation along x, y, z, mm",
            "focal length, %",
            "clock, ms",
            "readout, ms",
            "largest, in σ of the rig file",
        ]),
        rows: rows.collect(),
    }
}

fn imu(imu: Option<&ImuRefinement>) -> Table {
    let rows = imu.map(|imu| {
        [
            ("gyroscope scale, x, y, z, %", axes(&imu.gyro_scale, 1e2, 2)),
            ("accelerometer scale, %", axes(&imu.accel_scale, 1e2, 2)),
            (
                "gyroscope shear, yz, xz, xy, %",
                axes(&imu.gyro_shear, 1e2, 2),
            ),
            ("accelerometer shear, %", axes(&imu.accel_shear, 1e2, 2)),
            (
                "rotation of accelerometer relative to gyroscope, °",
                axes(&imu.accel_turn_deg, 1.0, 3),
            ),
            (
                "delay of accelerometer relative to gyroscope, ms",
                format!("{:+.2}", 1e3 * imu.accel_delay_s).replace('-', "−"),
            ),
            ("measured gravity, m/s²", format!("{:.3}", imu.gravity_m_s2)),
            (
                "largest of these errors, in σ of the settings",
                format!("{:.1}", imu.imu_error_sigmas),
            ),
            (
                "largest bias change, gyroscope and accelerometer, in σ of its noise",
                format!(
                    "{:.1}, {:.1}",
                    imu.bias_wander.gyro.sigmas, imu.bias_wander.accel.sigmas
                ),
            ),
            (
                "difference of images and IMU, in σ of its noise",
                format!("{:.2}", imu.imu_left_sigmas),
            ),
        ]
    });
    let rows = rows.into_iter().flatten();
    Table {
        title: "IMU errors (corrected in the trajectory)".to_owned(),
        head: words(["", "found"]),
        rows: rows
            .map(|(name, value)| vec![name.to_owned(), value])
            .collect(),
    }
}

/// A value for each error, spread evenly over its bin.
pub fn spread(errors: &ReprojectionErrors) -> Vec<f64> {
    let bins = errors.histogram.iter().enumerate();
    bins.flat_map(|(bin, &count)| {
        (0..count).map(move |k| {
            (bin as f64 + (k as f64 + 0.5) / count as f64) * ReprojectionErrors::BIN_PX
        })
    })
    .collect()
}
