//! One camera: its images, its corners, its pose, and whether that is given out.

use lsfb_geometry::{Camera, Matrix6, RigCamera, Se3, Vector2, Vector3, Vector6};
use lsfb_perception::image::Gray;
use lsfb_perception::statistics::median;
use lsfb_recording::Recording;
use lsfb_types::{Image, Progress, ProgressFn};

use super::RefineConfig;
use super::adjustment::{Adjusted, Block, Shared, adjusted};
use super::estimate::{Estimate, estimate};
use super::landmarks::{Keyframe, Reach, landmarks};
use super::lidar_path::LidarPath;
use super::refusal::Refusal;
use super::report::{Component, Evidence, NAMES, Refinement, Transfer};
use super::scan::Scan;
use crate::coverage::COVERAGE_CELLS;
use crate::overlapping_planes::OverlappingPlanes;
use crate::overlay::Picture;
use crate::recorded::{expect_size, seconds, unreadable};
use crate::{Error, Overlay, TransformEdge};

/// Widest image in which corners are looked for, pixels.
const FINE_WIDTH: u32 = 640;
/// Half the time over which the LiDAR's velocity at an image is taken, seconds.
const BESIDE_S: f64 = 0.02;
/// Corners that the best image has where a camera sees anything.
const LEAST_IN_IMAGE: usize = 8;
/// Corners on surfaces, and blocks that say something, that a camera needs.
const LEAST_CORNERS: usize = 60;
const LEAST_BLOCKS: usize = 3;
/// What a pose by hand may be wrong by at most before the result is no longer believed (rad, m).
const FARTHEST: [f64; 2] = [0.07, 0.12];
/// Spreads beyond which corners and surfaces do not fit: pixels, metres, radians, metres.
const LARGEST_SPREADS: [f64; 4] = [0.7, 0.02, 6e-3, 0.02];
/// By how much worse corners may be transferred after than before, where both are good: a share, and pixels.
const WORSE: [f64; 2] = [1.1, 0.1];
/// Squared normalized change of six numbers below which the rig was right: 95 % of chance.
const UNCHANGED: f64 = 12.59;

/// A camera and what the LiDAR saw.
pub(super) struct CameraRefinement<'a> {
    pub name: &'a str,
    pub mounted: &'a RigCamera,
    /// The camera's pose on the LiDAR as the rig has it.
    pub start: Se3,
    pub path: &'a LidarPath<'a>,
    pub place: &'a OverlappingPlanes,
    pub scans: &'a [Scan],
    pub config: &'a RefineConfig,
}

/// Images of a recording that are looked at.
struct Images {
    keyframes: Vec<Keyframe>,
    /// The one with the most corners as it was.
    shown: Option<Shown>,
}

struct Shown {
    time_s: f64,
    time_ns: i64,
    image: Image,
    corners: usize,
}

/// What was found for good.
struct Found {
    adjusted: Adjusted,
    estimate: Estimate,
    held: Vec<usize>,
}

impl CameraRefinement<'_> {
    pub fn refined(
        &self,
        recording: &Recording,
        progress: ProgressFn,
    ) -> Result<Refinement, Error> {
        let images = self.images(recording, progress)?;
        if images.keyframes.len() < LEAST_BLOCKS * self.config.block_images / 2 {
            let images = images.keyframes.len();
            return Ok(self.without_result(Refusal::FewImages { images }));
        }
        if images
            .shown
            .as_ref()
            .is_none_or(|s| s.corners < LEAST_IN_IMAGE)
        {
            return Ok(self.without_result(Refusal::Blank));
        }
        let mut keyframes = images.keyframes;
        let lens = keyframes[0].levels[1].camera;
        let mut blocks = Vec::new();
        while !keyframes.is_empty() {
            let rest = keyframes.split_off(keyframes.len().min(self.config.block_images));
            blocks.push(Block::new(keyframes));
            keyframes = rest;
        }
        let mut refinement = match self.found(&lens, &mut blocks) {
            Err(why) => self.without_result(why),
            Ok(found) => self.judged(&lens, &blocks, &found),
        };
        if let Some(after) = refinement.lidar_from_camera
            && let Some(shown) = &images.shown
        {
            let returns = self.returns_at(shown.time_s);
            let drawn = |pose: &Se3| -> Result<Overlay, Error> {
                let (picture, points) = Picture::new(
                    &shown.image,
                    &self.mounted.camera,
                    &pose.inverse(),
                    &returns,
                );
                Ok(Overlay {
                    camera: self.name.to_owned(),
                    time_ns: shown.time_ns,
                    points,
                    png: picture.to_png()?,
                })
            };
            refinement.overlays = Some([drawn(&self.start)?, drawn(&after)?]);
        }
        Ok(refinement)
    }

    fn without_result(&self, why: Refusal) -> Refinement {
        self.refinement(why.to_string())
    }

    fn refinement(&self, sentence: String) -> Refinement {
        Refinement {
            camera: self.name.to_owned(),
            components: Vec::new(),
            evidence: None,
            advice: None,
            lidar_from_camera: None,
            edge: None,
            overlays: None,
            sentence,
        }
    }

    fn images(&self, recording: &Recording, progress: ProgressFn) -> Result<Images, Error> {
        let mut keyframes: Vec<Keyframe> = Vec::new();
        let mut shown: Option<Shown> = None;
        let [first_s, last_s] = self.path.span_s();
        for image in recording.images(self.name).map_err(unreadable(recording))? {
            let image = image.map_err(unreadable(recording))?;
            expect_size(recording, self.name, self.mounted, &image.sample)?;
            let offset_s = self.mounted.timing.rig_from_camera_s;
            let time_s = seconds(image.time.nanos(), recording) + offset_s;
            let near = keyframes
                .last()
                .is_some_and(|l| time_s - l.time_s < 0.99 * self.config.image_gap_s);
            if near || time_s - BESIDE_S < first_s || time_s + BESIDE_S > last_s {
                continue;
            }
            let at = |time_s: f64| self.path.at(time_s);
            let (Some(before), Some(now), Some(after)) =
                (at(time_s - BESIDE_S), at(time_s), at(time_s + BESIDE_S))
            else {
                continue;
            };
            let factor = image.sample.width.div_ceil(FINE_WIDTH).max(1);
            let keyframe = Keyframe {
                time_s,
                levels: [2 * factor, factor]
                    .map(|f| Gray::reduced(&image.sample, &self.mounted.camera, f)),
                world_from_lidar: now,
                twist: before.local(&after) / (2.0 * BESIDE_S),
                information: self.path.information(time_s),
            };
            let corners = keyframe.corners();
            keyframes.push(keyframe);
            if shown.as_ref().is_none_or(|s| corners > s.corners) {
                shown = Some(Shown {
                    time_s,
                    time_ns: image.time.nanos(),
                    image: image.sample,
                    corners,
                });
            }
            progress(Progress {
                stage: "images",
                done: (time_s - first_s).max(0.0) as u64,
                total: (last_s - first_s).max(0.0) as u64,
            })?;
        }
        Ok(Images { keyframes, shown })
    }

    fn returns_at(&self, time_s: f64) -> Vec<Vector3<f64>> {
        let off = |s: &&Scan| (s.middle_s - time_s).abs();
        let nearest = self.scans.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
        nearest.map_or_else(Vec::new, |scan| self.path.returns_at(scan, time_s))
    }

    /// From corners in neighbouring images to those far apart, and without what is not determined.
    fn found(&self, lens: &Camera, blocks: &mut [Block]) -> Result<Found, Refusal> {
        let mut shared = Shared {
            lidar_from_camera: self.start,
            delay_s: 0.0,
        };
        let mut last = None;
        for reach in [Reach::Near(2), Reach::All, Reach::All] {
            for block in blocks.iter_mut() {
                let pose = shared.lidar_from_camera.inverse();
                block.take(landmarks(&block.frames, &pose, self.place, reach));
            }
            let corners: usize = blocks.iter().map(|b| b.landmarks.len()).sum();
            if corners < LEAST_CORNERS {
                return Err(Refusal::FewCorners {
                    corners,
                    needed: LEAST_CORNERS,
                });
            }
            let found = self.adjusted(lens, blocks, &shared, &[])?;
            shared = found.shared;
            last = Some(found);
        }
        let mut found = last.ok_or(Refusal::Unsettled)?;
        let mut held: Vec<usize> = Vec::new();
        loop {
            let worth = estimate(&found, &self.start, &held).ok_or(Refusal::Unsettled)?;
            let sigma = |k: usize| worth.covariance[(k, k)].sqrt();
            // What others are not known without is not known either.
            let lost: Vec<usize> = (0..6)
                .filter(|k| !held.contains(k) && sigma(*k) > self.largest(*k))
                .collect();
            if lost.is_empty() {
                return Ok(Found {
                    adjusted: found,
                    estimate: worth,
                    held,
                });
            }
            held.extend(lost);
            found = self.adjusted(lens, blocks, &shared, &held)?;
        }
    }

    fn adjusted(
        &self,
        lens: &Camera,
        blocks: &mut [Block],
        first: &Shared,
        held: &[usize],
    ) -> Result<Adjusted, Refusal> {
        adjusted(lens, blocks, &self.start, first, held).ok_or(Refusal::Unsettled)
    }

    fn largest(&self, k: usize) -> f64 {
        if k < 3 {
            self.config.largest_sigma_deg.to_radians()
        } else {
            self.config.largest_sigma_m
        }
    }

    /// What is said of it, and whether it is given out.
    fn judged(&self, lens: &Camera, blocks: &[Block], found: &Found) -> Refinement {
        let pose = found.adjusted.shared.lidar_from_camera;
        let sigma = |k: usize| found.estimate.covariance[(k, k)].sqrt();
        let change = self.start.local(&pose);
        // Numbers held move a little with the axes in which they are counted.
        let components = (0..6).map(|k| Component {
            name: NAMES[k],
            change: (!found.held.contains(&k)).then(|| change[k]),
            sigma: sigma(k),
        });
        let evidence = self.evidence(lens, blocks, found);
        let mut refinement = Refinement {
            components: components.collect(),
            lidar_from_camera: Some(pose),
            ..self.refinement(String::new())
        };
        refinement.advice = evidence.advice(&refinement.components);
        let refusal = self.refusal(&change, found, &evidence);
        refinement.sentence = match &refusal {
            Some(why) => why.to_string(),
            None if found.is_no_change(&change) => format!(
                "no significant change to the rig; {}",
                refinement.in_words()
            ),
            None => refinement.in_words(),
        };
        if refusal.is_none() && found.held.iter().all(|k| *k > 2) {
            refinement.edge = Some(self.edge(&pose, &found.estimate));
        }
        refinement.evidence = Some(evidence);
        refinement
    }

    /// Why the pose is not given out.
    fn refusal(
        &self,
        change: &Vector6<f64>,
        found: &Found,
        evidence: &Evidence,
    ) -> Option<Refusal> {
        let noise = &found.adjusted.noise;
        let spreads = [noise.pixel_px, noise.plane_m, noise.turn_rad, noise.shift_m];
        let mut large = spreads.iter().zip(LARGEST_SPREADS);
        let (turn_rad, shift_m) = (
            change.fixed_rows::<3>(0).norm(),
            change.fixed_rows::<3>(3).norm(),
        );
        let Transfer {
            before_px,
            after_px,
            ..
        } = evidence.transfer;
        let (parts, halves) = (found.estimate.blocks, &found.estimate.halves);
        if parts < LEAST_BLOCKS {
            Some(Refusal::FewParts {
                parts,
                needed: LEAST_BLOCKS,
            })
        } else if large.any(|(s, most)| *s > most) {
            Some(Refusal::PoorFit(*noise))
        } else if turn_rad > FARTHEST[0] || shift_m > FARTHEST[1] {
            Some(Refusal::FarAway { turn_rad, shift_m })
        } else if after_px > WORSE[0] * before_px + WORSE[1] {
            Some(Refusal::NoBetter {
                before_px,
                after_px,
            })
        } else if halves.disagree() {
            let square = halves.square;
            Some(Refusal::HalvesDisagree { square })
        } else {
            None
        }
    }

    fn evidence(&self, lens: &Camera, blocks: &[Block], found: &Found) -> Evidence {
        let (adjusted, worth) = (&found.adjusted, &found.estimate);
        let pose = &adjusted.shared.lidar_from_camera;
        let all = |pose: &Se3| -> Vec<f64> {
            let camera_from_lidar = pose.inverse();
            let own = blocks.iter();
            let own = own.flat_map(|b| b.transfers_px(lens, &camera_from_lidar));
            own.collect()
        };
        let held_back = (0..2).flat_map(|half: usize| {
            let pose = adjusted
                .shared
                .moved(&worth.halves.steps[half])
                .lidar_from_camera
                .inverse();
            let others = blocks.iter().skip(1 - half).step_by(2);
            others.flat_map(move |b| b.transfers_px(lens, &pose))
        });
        let rotation = pose.rotation.inverse();
        let center = pose.translation;
        let (mut turning, mut speed, mut images) = (Vector3::zeros(), Vector3::zeros(), 0.0);
        for frame in blocks.iter().flat_map(|b| &b.frames) {
            let turn: Vector3<f64> = frame.twist.fixed_rows::<3>(0).into();
            let way = frame.twist.fixed_rows::<3>(3) + turn.cross(&center);
            let square = |v: Vector3<f64>| v.component_mul(&v);
            turning += square(rotation * turn);
            speed += square(rotation * way);
            images += 1.0;
        }
        let mean = |sum: Vector3<f64>| <[f64; 3]>::from(sum.map(|s| (s / images).sqrt()));
        let errors: Vec<[Vector2<f64>; 2]> = blocks
            .iter()
            .flat_map(|b| b.errors(lens, &adjusted.shared))
            .collect();
        let (coverage, cell_errors_px) = by_cell(lens, &errors, adjusted.noise.pixel_px);
        Evidence {
            images: images as usize,
            corners: blocks.iter().map(|b| b.landmarks.len()).sum(),
            observations: errors.len(),
            blocks: worth.blocks,
            pixel_px: adjusted.noise.pixel_px,
            plane_m: adjusted.noise.plane_m,
            image_turn_rad: adjusted.noise.turn_rad,
            image_shift_m: adjusted.noise.shift_m,
            inflation: worth.inflation,
            clock_s: [adjusted.shared.delay_s, worth.covariance[(6, 6)].sqrt()],
            transfer: Transfer {
                before_px: median_px(all(&self.start)),
                after_px: median_px(all(pose)),
                held_back_px: median_px(held_back.collect()),
            },
            halves: worth.halves.difference.into(),
            halves_square: worth.halves.square,
            turning_rad_s: mean(turning),
            speed_m_s: mean(speed),
            normalized: errors
                .iter()
                .flat_map(|[_, e]| [e.x, e.y])
                .map(|e| e / adjusted.noise.pixel_px)
                .collect(),
            coverage,
            cell_errors_px,
            size_px: [lens.width, lens.height],
        }
    }

    /// The transform for the joint graph.
    fn edge(&self, lidar_from_camera: &Se3, worth: &Estimate) -> TransformEdge {
        let covariance = worth.covariance.fixed_view::<6, 6>(0, 0).into_owned();
        // (E exp(δ))⁻¹ = E⁻¹ exp(−Ad(E) δ): from the camera's axes to those of the LiDAR.
        let through = lidar_from_camera.adjoint();
        let covariance: Matrix6<f64> = through * covariance * through.transpose();
        TransformEdge {
            target: self.name.to_owned(),
            source: crate::transform::LIDAR.to_owned(),
            target_from_source: lidar_from_camera.inverse(),
            covariance: Some(0.5 * (covariance + covariance.transpose())),
        }
    }
}

impl Found {
    /// Whether all that was found may be chance.
    fn is_no_change(&self, change: &Vector6<f64>) -> bool {
        let covariance = self.estimate.covariance.fixed_view::<6, 6>(0, 0);
        let weighted = covariance.into_owned().cholesky().map(|c| c.solve(change));
        weighted.is_some_and(|w| change.dot(&w) < UNCHANGED)
    }
}

fn median_px(values: Vec<f64>) -> f64 {
    median(values).unwrap_or(0.0)
}

/// Corners and their mean error by cell of the image; outliers are no part of the mean.
fn by_cell(
    lens: &Camera,
    errors: &[[Vector2<f64>; 2]],
    pixel_px: f64,
) -> (Vec<u32>, Vec<[f64; 2]>) {
    const OUTLIER: f64 = 5.0;
    let [columns, rows] = COVERAGE_CELLS;
    let mut counts = vec![0u32; columns * rows];
    let mut sums = vec![Vector2::zeros(); columns * rows];
    for [pixel, error] in errors.iter().filter(|[_, e]| e.norm() < OUTLIER * pixel_px) {
        let cell = |at: f64, size: u32, cells: usize| {
            ((at + 0.5) / f64::from(size) * cells as f64).clamp(0.0, cells as f64 - 1.0) as usize
        };
        let at = cell(pixel.y, lens.height, rows) * columns + cell(pixel.x, lens.width, columns);
        counts[at] += 1;
        sums[at] += error;
    }
    let means = sums.iter().zip(&counts);
    let means = means.map(|(sum, n)| (sum / f64::from((*n).max(1))).into());
    (counts.clone(), means.collect())
}
