//! Whether a rig still fits a recording: no target, no answer but PASS, WARN or FAIL, with the figures behind it.
//!
//! | check | compares | file |
//! | --- | --- | --- |
//! | time offset, rotation | a camera's angular velocity with the gyroscope's | `time_offset.rs` |
//! | LiDAR on image | steps in range with edges of brightness | `alignment.rs` |
//! | epipolar | corners in one camera with their curves in another | `epipolar.rs` |

mod alignment;
mod epipolar;
mod overlay;
mod page;
mod refine;
mod time_offset;

use lsfb_geometry::{Rig, RigCamera, Se3, Vector3, so3};
use lsfb_recording::Recording;
use lsfb_types::{Image, LidarScan, Progress, ProgressFn, Stamped};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::Error;
use alignment::{EdgeImage, Return, Score, StepPoint, View, bins_of, step_weight};
use overlay::Picture;
pub use refine::{Refinement, refine};
use time_offset::{Frame, Gyro, Silent, Turn};

/// Settings of [`verify`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VerifyConfig {
    /// Images per camera compared with the gyroscope at most, from the start.
    pub max_frames: usize,
    /// Images per camera compared with the LiDAR or another camera, spread over the recording.
    pub views: usize,
    /// Time offset beyond the rig's that is a warning, and a failure, milliseconds.
    pub time_offset_ms: [f64; 2],
    /// Rotation of a camera to the gyroscope that is a warning, and a failure, degrees.
    pub imu_rotation_deg: [f64; 2],
    /// Rotation of a camera to the LiDAR that is a warning, and a failure, degrees.
    pub lidar_rotation_deg: [f64; 2],
    /// Median epipolar error that is a warning, and a failure, pixels.
    pub epipolar_px: [f64; 2],
}

impl Default for VerifyConfig {
    fn default() -> Self {
        Self {
            max_frames: 400,
            views: 24,
            // Near things that pass by look like turning: three milliseconds are no finding.
            time_offset_ms: [5.0, 10.0],
            imu_rotation_deg: [1.5, 3.0],
            lidar_rotation_deg: [0.4, 0.8],
            epipolar_px: [1.0, 2.0],
        }
    }
}

/// How a check ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "UPPERCASE")]
pub enum Outcome {
    /// This recording says nothing about it.
    Unknown,
    /// As it should be.
    Pass,
    /// Look at it.
    Warn,
    /// The rig is not that of this recording.
    Fail,
}

/// One check.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Check {
    /// What was compared: `cam0 time offset`.
    pub name: String,
    /// How it ended.
    pub outcome: Outcome,
    /// What was found, in the unit of [`Check::unit`].
    pub value: Option<f64>,
    /// Its standard deviation.
    pub sigma: Option<f64>,
    /// Unit of both.
    pub unit: &'static str,
    /// In words, with what to do.
    pub sentence: String,
}

/// Returns of the LiDAR over an image.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Overlay {
    /// The camera.
    pub camera: String,
    /// The image's time, nanoseconds.
    pub time_ns: i64,
    /// Returns in view.
    pub points: usize,
    /// The picture.
    #[serde(skip)]
    pub png: Vec<u8>,
}

/// All checks of a rig on a recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verification {
    /// The checks.
    pub checks: Vec<Check>,
    /// One picture per camera that sees the LiDAR's returns.
    pub overlays: Vec<Overlay>,
}

impl Verification {
    /// The worst of all checks; [`Outcome::Unknown`] where none says anything.
    pub fn outcome(&self) -> Outcome {
        self.checks
            .iter()
            .map(|c| c.outcome)
            .max()
            .unwrap_or(Outcome::Unknown)
    }
}

/// Compares a rig with a recording.
pub fn verify(
    recording: &Recording,
    rig: &Rig,
    config: &VerifyConfig,
    progress: ProgressFn,
) -> Result<Verification, Error> {
    let gyro = gyro(recording)?;
    let scans = scans(recording, rig, config)?;
    let mut checks = Vec::new();
    let mut overlays = Vec::new();
    let present: Vec<(&String, &RigCamera)> = rig
        .cameras
        .iter()
        .filter(|(name, _)| recording.images(name).is_ok())
        .collect();
    for (k, (name, mounted)) in present.iter().enumerate() {
        progress(Progress {
            stage: "cameras",
            done: k as u64,
            total: present.len() as u64,
        });
        let seen = Seen::read(recording, name, mounted, &scans, config, progress)?;
        checks.extend(against_gyro(
            name,
            mounted,
            &seen.turns,
            gyro.as_ref(),
            config,
        ));
        if !scans.is_empty() {
            let (check, overlay) =
                against_lidar(name, mounted, &seen, &scans, gyro.as_ref(), config)?;
            checks.push(check);
            overlays.extend(overlay);
        }
    }
    for (i, (first, a)) in present.iter().enumerate() {
        for (second, b) in present.iter().skip(i + 1) {
            checks.extend(pair(recording, (first, a), (second, b), config)?);
        }
    }
    if checks.is_empty() {
        checks.push(Check {
            name: "recording".to_owned(),
            outcome: Outcome::Unknown,
            value: None,
            sigma: None,
            unit: "",
            sentence: "none of the rig's cameras is in this recording: check the names".to_owned(),
        });
    }
    Ok(Verification { checks, overlays })
}

fn unreadable(recording: &Recording) -> impl Fn(lsfb_recording::Error) -> Error + '_ {
    |e| Error::Parse {
        path: recording.path().display().to_string(),
        problem: e.to_string(),
    }
}

/// Seconds of a time in nanoseconds after the recording's first.
fn seconds(time_ns: i64, recording: &Recording) -> f64 {
    let start = recording.arrival_range().map_or(0, |r| r.start.nanos());
    time_ns.saturating_sub(start) as f64 * 1e-9
}

fn gyro(recording: &Recording) -> Result<Option<Gyro>, Error> {
    let Ok(samples) = recording.imu() else {
        return Ok(None);
    };
    let mut rates = Vec::new();
    for sample in samples {
        let sample = sample.map_err(unreadable(recording))?;
        let rate = Vector3::from(sample.sample.angular_velocity_rad_s);
        rates.push((seconds(sample.time.nanos(), recording), rate));
    }
    rates.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok((rates.len() > 2).then(|| Gyro::new(&rates)))
}

/// A scan with its start in seconds.
struct TimedScan {
    start_s: f64,
    scan: LidarScan,
}

/// Scans spread over the recording; none where the rig has no LiDAR.
fn scans(recording: &Recording, rig: &Rig, config: &VerifyConfig) -> Result<Vec<ScanInRig>, Error> {
    let Some(lidar) = &rig.lidar else {
        return Ok(Vec::new());
    };
    let count = match recording.scans() {
        Ok(scans) => scans.count(),
        Err(_) => return Ok(Vec::new()),
    };
    let every = (count / config.views.max(1)).max(1);
    let mut out = Vec::new();
    let all = recording.scans().map_err(unreadable(recording))?;
    for scan in all.skip(every / 2).step_by(every) {
        let scan = scan.map_err(unreadable(recording))?;
        let timed = TimedScan {
            start_s: seconds(scan.time.nanos(), recording),
            scan: scan.sample,
        };
        out.push(ScanInRig::new(&timed, &lidar.rig_from_lidar));
    }
    Ok(out)
}

/// A scan in the rig, each return with its own time.
struct ScanInRig {
    middle_s: f64,
    points: Vec<TimedPoint>,
}

#[derive(Clone, Copy)]
struct TimedPoint {
    time_s: f64,
    in_rig: Vector3<f64>,
    /// Weight of the step in range beside it, where there is one.
    step: Option<f64>,
    /// Bin of its reflectivity.
    bin: usize,
}

impl ScanInRig {
    fn new(timed: &TimedScan, rig_from_lidar: &Se3) -> Self {
        let points = &timed.scan.points;
        let mut by_ring = std::collections::BTreeMap::<u16, Vec<usize>>::new();
        for (k, point) in points.iter().enumerate() {
            by_ring.entry(point.ring).or_default().push(k);
        }
        let range = |k: usize| Vector3::from(points[k].position_m).map(f64::from).norm();
        let ray = |k: usize| {
            Vector3::from(points[k].position_m)
                .map(f64::from)
                .normalize()
        };
        let mut steps = vec![None; points.len()];
        for ring in by_ring.values() {
            for w in ring.windows(3) {
                let own = range(w[1]);
                // Neighbours in direction: a lost return is no step.
                let beside = |k: usize| ray(k).dot(&ray(w[1])) > 0.99985;
                let farther = [w[0], w[2]]
                    .into_iter()
                    .filter(|k| beside(*k))
                    .map(|k| range(k) - own)
                    .fold(0.0, f64::max);
                steps[w[1]] = step_weight(farther);
            }
        }
        let last = points.iter().map(|p| p.time_offset_ns).max().unwrap_or(0);
        let reflectivity: Vec<u8> = points.iter().map(|p| p.intensity).collect();
        let bins = bins_of(&reflectivity);
        let placed = points.iter().zip(&steps).filter_map(|(p, step)| {
            let position = Vector3::from(p.position_m).map(f64::from);
            (position.norm() > 0.3).then(|| TimedPoint {
                time_s: timed.start_s + f64::from(p.time_offset_ns) * 1e-9,
                in_rig: *rig_from_lidar * position,
                step: *step,
                bin: bins[usize::from(p.intensity)],
            })
        });
        Self {
            middle_s: timed.start_s + 0.5e-9 * f64::from(last),
            points: placed.collect(),
        }
    }

    /// The returns as the rig would have them at a time, as far as the gyroscope knows how it turned.
    fn at(&self, time_s: f64, gyro: Option<&Gyro>) -> Vec<TimedPoint> {
        let now = gyro.and_then(|g| g.angle(time_s));
        self.points
            .iter()
            .map(|p| {
                let then = gyro.and_then(|g| g.angle(p.time_s));
                let turn = match (now, then) {
                    (Some(now), Some(then)) => so3::exp(&(then - now)),
                    _ => Default::default(),
                };
                TimedPoint {
                    in_rig: turn * p.in_rig,
                    ..*p
                }
            })
            .collect()
    }
}

/// What is kept of a camera's images.
struct Seen {
    turns: Vec<Turn>,
    /// By scan: the image nearest in time, with its time.
    near_scan: Vec<Option<(f64, i64, Image)>>,
}

impl Seen {
    fn read(
        recording: &Recording,
        name: &str,
        mounted: &RigCamera,
        scans: &[ScanInRig],
        config: &VerifyConfig,
        progress: ProgressFn,
    ) -> Result<Self, Error> {
        const AT_ONCE: usize = 32;
        let offset_s = mounted.timing.rig_from_camera_s;
        let mut near_scan: Vec<Option<(f64, i64, Image)>> = vec![None; scans.len()];
        let mut frames: Vec<Frame> = Vec::new();
        let mut batch: Vec<Stamped<Image>> = Vec::with_capacity(AT_ONCE);
        let flush = |batch: &mut Vec<Stamped<Image>>, frames: &mut Vec<Frame>| {
            let made: Vec<Frame> = batch
                .par_iter()
                .map(|i| {
                    let time_s = seconds(i.time.nanos(), recording) + offset_s;
                    Frame::new(time_s, &i.sample, &mounted.camera)
                })
                .collect();
            frames.extend(made);
            batch.clear();
            progress(Progress {
                stage: "images",
                done: frames.len() as u64,
                total: config.max_frames as u64,
            });
        };
        for image in recording.images(name).map_err(unreadable(recording))? {
            let image = image.map_err(unreadable(recording))?;
            let size = (image.sample.width, image.sample.height);
            if size != (mounted.camera.width, mounted.camera.height) {
                return Err(Error::Parse {
                    path: recording.path().display().to_string(),
                    problem: format!(
                        "camera {name}: images of {} × {} pixels, the rig's lens is for {} × {}",
                        size.0, size.1, mounted.camera.width, mounted.camera.height
                    ),
                });
            }
            let time_s = seconds(image.time.nanos(), recording) + offset_s;
            for (scan, near) in scans.iter().zip(&mut near_scan) {
                let off = (time_s - scan.middle_s).abs();
                let nearer = near
                    .as_ref()
                    .is_none_or(|n| off < (n.0 - scan.middle_s).abs());
                if off < 0.06 && nearer {
                    *near = Some((time_s, image.time.nanos(), image.sample.clone()));
                }
            }
            if frames.len() + batch.len() < config.max_frames {
                batch.push(image);
                if batch.len() == AT_ONCE {
                    flush(&mut batch, &mut frames);
                }
            }
        }
        flush(&mut batch, &mut frames);
        let turns: Vec<Option<Turn>> = frames
            .par_windows(2)
            .map(|w| time_offset::turn(&w[0], &w[1]).filter(|t| t.to_s - t.from_s < 0.3))
            .collect();
        Ok(Self {
            turns: turns.into_iter().flatten().collect(),
            near_scan,
        })
    }
}

/// The outcome of a value with limits. What its own spread explains passes; what is known worse than the outer limit says
/// nothing.
fn judged(value: f64, sigma: f64, limits: [f64; 2]) -> Outcome {
    if sigma > limits[1] {
        Outcome::Unknown
    } else if value <= limits[0].max(2.0 * sigma) {
        Outcome::Pass
    } else if value <= limits[1].max(3.0 * sigma) {
        Outcome::Warn
    } else {
        Outcome::Fail
    }
}

/// What is said where an answer is too uncertain to be one.
fn unclear(sigma: f64, unit: &str) -> String {
    format!(
        "known to {sigma:.1} {unit} only: more turning and less walking, before distant things, would tell"
    )
}

fn against_gyro(
    name: &str,
    mounted: &RigCamera,
    turns: &[Turn],
    gyro: Option<&Gyro>,
    config: &VerifyConfig,
) -> Vec<Check> {
    let Some(gyro) = gyro else {
        return Vec::new();
    };
    let check = |what: &str, unit| Check {
        name: format!("{name} {what}"),
        outcome: Outcome::Unknown,
        value: None,
        sigma: None,
        unit,
        sentence: String::new(),
    };
    let mut time = check("time offset", "ms");
    let mut rotation = check("rotation to the IMU", "°");
    match time_offset::agree(turns, gyro) {
        Ok(found) => {
            let offset_ms = found.offset_s * 1e3;
            let sigma_ms = found.offset_sigma_s * 1e3;
            time.outcome = judged(offset_ms.abs(), sigma_ms, config.time_offset_ms);
            time.value = Some(offset_ms);
            time.sigma = Some(sigma_ms);
            time.sentence = match time.outcome {
                Outcome::Unknown => unclear(sigma_ms, "ms"),
                Outcome::Pass => format!(
                    "images and gyroscope agree in time over {} pairs of images",
                    found.pairs
                ),
                _ => format!(
                    "images were taken {:.1} ms {} than the rig says: check triggers and clocks, or calibrate camera and IMU again",
                    offset_ms.abs(),
                    if offset_ms > 0.0 { "later" } else { "earlier" }
                ),
            };
            let expected = mounted.rig_from_camera.rotation.inverse();
            let off = so3::log(&(expected.inverse() * found.camera_from_rig));
            let sigma_deg = found.rotation_sigma_rad.to_degrees();
            rotation.outcome = judged(off.norm().to_degrees(), sigma_deg, config.imu_rotation_deg);
            rotation.value = Some(off.norm().to_degrees());
            rotation.sigma = Some(sigma_deg);
            rotation.sentence = match rotation.outcome {
                Outcome::Unknown => unclear(sigma_deg, "°"),
                Outcome::Pass => "the camera turns as the gyroscope does".to_owned(),
                _ => format!(
                    "the camera is turned by {:.1}° about the rig's {} axis: it was moved, or the rig is another's",
                    off.norm().to_degrees(),
                    ["x", "y", "z"][off.iamax()]
                ),
            };
        }
        Err(silent) => {
            let why = match silent {
                Silent::TooFewPairs(n) => format!(
                    "{n} pairs of images follow the gyroscope, 30 are needed: a longer recording, and something to see, would tell"
                ),
                Silent::TooLittleTurning(rate) => format!(
                    "it turns by {rate:.3} rad/s only about a second axis: turning more would tell"
                ),
                Silent::EndOfSearch(offset_s) => {
                    time.outcome = Outcome::Fail;
                    format!(
                        "no time offset within {:.0} ms makes images follow the gyroscope: the clocks are not those of one rig",
                        offset_s.abs() * 1e3
                    )
                }
            };
            time.sentence.clone_from(&why);
            rotation.sentence = why;
        }
    }
    vec![time, rotation]
}

/// Each image with what the scan of its time shows.
fn views(mounted: &RigCamera, seen: &Seen, scans: &[ScanInRig], gyro: Option<&Gyro>) -> Vec<View> {
    let camera_from_rig = mounted.rig_from_camera.inverse();
    scans
        .par_iter()
        .zip(&seen.near_scan)
        .filter_map(|(scan, near)| {
            let (time_s, _, image) = near.as_ref()?;
            // What this camera may see, also when it is turned a little.
            let mut ahead = scan.at(*time_s, gyro);
            ahead.retain(|p| (camera_from_rig * p.in_rig).z > 0.0);
            Some(View {
                steps: ahead
                    .iter()
                    .filter_map(|p| {
                        Some(StepPoint {
                            position: p.in_rig,
                            weight: p.step?,
                        })
                    })
                    .collect(),
                returns: ahead
                    .iter()
                    .map(|p| Return {
                        position: p.in_rig,
                        bin: p.bin,
                    })
                    .collect(),
                edges: EdgeImage::new(image, &mounted.camera),
            })
        })
        .collect()
}

fn against_lidar(
    name: &str,
    mounted: &RigCamera,
    seen: &Seen,
    scans: &[ScanInRig],
    gyro: Option<&Gyro>,
    config: &VerifyConfig,
) -> Result<(Check, Option<Overlay>), Error> {
    let camera_from_rig = mounted.rig_from_camera.inverse();
    let views = views(mounted, seen, scans, gyro);
    let mut overlay = None;
    // The picture of the middle of the recording.
    let middle = scans.len() / 2;
    let near = seen.near_scan.iter().enumerate().filter(|n| n.1.is_some());
    if let Some((k, Some((time_s, time_ns, image)))) = near.min_by_key(|(k, _)| k.abs_diff(middle))
    {
        let points: Vec<Vector3<f64>> = scans[k]
            .at(*time_s, gyro)
            .iter()
            .map(|p| p.in_rig)
            .collect();
        let (picture, points) = Picture::new(image, &mounted.camera, &camera_from_rig, &points);
        overlay = Some(Overlay {
            camera: name.to_owned(),
            time_ns: *time_ns,
            points,
            png: picture.to_png()?,
        });
    }
    let mut check = Check {
        name: format!("{name} rotation to the LiDAR"),
        outcome: Outcome::Unknown,
        value: None,
        sigma: None,
        unit: "°",
        sentence: String::new(),
    };
    match alignment::misalignment(&views, &camera_from_rig, Score::Edges) {
        Some(found) => {
            let off = found.turn.norm().to_degrees();
            let sigma = found.sigma_rad.norm().to_degrees();
            check.value = Some(off);
            check.sigma = Some(sigma);
            // An answer that differs from view to view is none.
            check.outcome = if sigma > config.lidar_rotation_deg[1] {
                Outcome::Unknown
            } else {
                judged(off, sigma, config.lidar_rotation_deg)
            };
            check.sentence = match check.outcome {
                Outcome::Unknown => format!(
                    "edges of LiDAR and images fit in too many ways (σ {sigma:.1}°): look at the overlay, or record a place with posts, doors and furniture"
                ),
                Outcome::Pass => {
                    format!("{} steps in range lie on edges of the images", found.steps)
                }
                _ => format!(
                    "steps in range fit the images {:.0} % better when the camera is turned by {off:.2}° about its {} axis: it was moved, or calibrate LiDAR and camera again",
                    100.0 * (found.best_score - found.score) / found.score.abs().max(1e-6),
                    ["x", "y", "z"][found.turn.iamax()]
                ),
            };
        }
        None => {
            check.sentence =
                "too few scans and images of the same time with steps in range".to_owned();
        }
    }
    Ok((check, overlay))
}

/// Cameras that see much of the same: their epipolar error.
fn pair(
    recording: &Recording,
    (first, a): (&str, &RigCamera),
    (second, b): (&str, &RigCamera),
    config: &VerifyConfig,
) -> Result<Option<Check>, Error> {
    const LEAST_OVERLAP: f64 = 0.1;
    const LEAST_MATCHES: usize = 40;
    let second_from_first = b.rig_from_camera.inverse() * a.rig_from_camera;
    let shared = epipolar::overlap(&a.camera, &b.camera, &second_from_first);
    // Without a baseline there is no curve.
    if shared < LEAST_OVERLAP || second_from_first.translation.norm() < 0.01 {
        return Ok(None);
    }
    let all = recording
        .images_of(&[first, second])
        .map_err(unreadable(recording))?;
    let mut pairs: Vec<(Image, Image)> = Vec::new();
    let mut before: Option<(usize, Stamped<Image>)> = None;
    let mut met = 0usize;
    let count = recording
        .images(first)
        .map_err(unreadable(recording))?
        .count();
    let every = (count / config.views.max(1)).max(1);
    for image in all {
        let image = image.map_err(unreadable(recording))?;
        let own = image.camera;
        if let Some((other, earlier)) = before.take()
            && other != own
            && (image.image.time - earlier.time).abs() < 2_000_000
        {
            met += 1;
            if (met - 1).is_multiple_of(every) {
                let (mut x, mut y) = (earlier.sample, image.image.sample);
                if own == 0 {
                    std::mem::swap(&mut x, &mut y);
                }
                pairs.push((x, y));
            }
            continue;
        }
        before = Some((own, image.image));
    }
    let errors: Vec<Vec<f64>> = pairs
        .par_iter()
        .map(|(x, y)| epipolar::errors_px((x, &a.camera), (y, &b.camera), &second_from_first))
        .collect();
    let mut errors: Vec<f64> = errors.into_iter().flatten().collect();
    let mut check = Check {
        name: format!("{first}–{second} epipolar"),
        outcome: Outcome::Unknown,
        value: None,
        sigma: None,
        unit: "px",
        sentence: String::new(),
    };
    if errors.len() < LEAST_MATCHES {
        check.sentence = format!(
            "{} corners of {} pairs of images were found in both: {LEAST_MATCHES} are needed",
            errors.len(),
            pairs.len()
        );
        return Ok(Some(check));
    }
    errors.sort_by(f64::total_cmp);
    let signed = errors[errors.len() / 2];
    let mut sizes: Vec<f64> = errors.iter().map(|e| e.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let median = sizes[sizes.len() / 2];
    let sigma = 1.25 * median / (errors.len() as f64).sqrt();
    check.value = Some(median);
    check.sigma = Some(sigma);
    check.outcome = judged(median, sigma, config.epipolar_px);
    check.sentence = match check.outcome {
        Outcome::Pass => format!(
            "{} corners lie on their curves (median {signed:+.2} px)",
            errors.len()
        ),
        _ => format!(
            "{} corners miss their curves by {signed:+.2} px in the median: one of the two cameras was moved, or they are not triggered together",
            errors.len()
        ),
    };
    Ok(Some(check))
}

#[cfg(test)]
mod tests;
