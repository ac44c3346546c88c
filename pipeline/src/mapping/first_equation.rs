//! Eq. (4) of a recording's first round: as the mapping solves it, and as text by which another solver can be held against ours.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use lsfb_geometry::{Rig, Se3, Vector3};
use lsfb_recording::Recording;
use lsfb_solver::Problem;
use lsfb_types::ProgressFn;

use super::adjustment::{IMAGE_KERNEL_SCALE, SCAN_KERNEL_SCALE, Terms, equation, steps};
use super::keyframe_scans::add_lidar_features;
use super::keyframes::{Keyframes, choose_keyframes, find_cameras};
use super::report::MappingReport;
use super::residuals_by_part::Regions;
use super::rounds::{Run, first_terms};
use super::scan_source::ScanSource;
use super::{MappingConfig, walk};
use crate::error::Error;
use crate::features::FeatureDetector;
use crate::hd_map::MapPoint;
use crate::kept_stages::KeptStages;
use crate::odometry::Damages;

/// Eq. (4) of the first round of a recording, without what only some settings ask for: the IMU, control points. Its terms are written to `path`.
///
/// The text is words and numbers, one line each:
///
/// ```text
/// lenses N              model, fx fy cx cy, distortion; camera_from_rig as qx qy qz qw tx ty tz
/// poses N               world_from_rig; the first is held
/// points N              x y z in the world
/// observations N σ s    point, pose, lens, u v; σ in pixels, s the scale of Huber's kernel
/// planes N σ s          poses m and n, point in n, point in m, normal in m; σ in metres, s the scale of Cauchy's kernel
/// edges N σ s           poses m and n, point in n, point in m, direction in m
/// steps N               poses a and b, a_from_b, σ of its rotation and of its translation
/// ```
pub fn write_first_equation(
    recording: &Recording,
    config: &MappingConfig,
    path: &Path,
    progress: ProgressFn<'_>,
) -> Result<Problem, Error> {
    let rig = recording.rig()?;
    let (mut missing, mut damages) = (Vec::new(), Damages::default());
    let cameras = find_cameras(recording, &rig, &mut missing)?;
    let (trajectory, report) = walk(recording, config, progress)?;
    let detector = FeatureDetector::new(&config.sift, config.learned.as_ref())?;
    let mut keyframes = choose_keyframes(
        recording,
        &cameras,
        &trajectory,
        &detector,
        config,
        &mut damages,
        progress,
    )?;
    let source = ScanSource::Recorded(recording);
    if let Some(lidar) = rig.lidar() {
        let frames = &mut keyframes.frames;
        add_lidar_features(source, lidar, frames, &trajectory, config, progress)?;
    }
    let run = Run {
        source,
        given: false,
        stages: &KeptStages::none(),
        name: "rounds",
        control: None,
        imu: None,
        regions: &Regions::of(&keyframes.poses()),
    };
    first_terms(
        &rig,
        &mut keyframes,
        &trajectory,
        config,
        MappingReport {
            odometry: report.odometry,
            ..MappingReport::default()
        },
        &run,
        progress,
        |keyframes, points, terms| {
            let text = EquationText {
                rig: &rig,
                keyframes,
                points,
                terms,
                config,
            };
            let file = File::create(path).map_err(Error::io(path))?;
            text.write(&mut BufWriter::new(file))
                .map_err(Error::io(path))?;
            Ok(equation(&rig, keyframes, points, terms, config)?.problem)
        },
    )
}

/// What the text is of.
struct EquationText<'a> {
    rig: &'a Rig,
    keyframes: &'a Keyframes,
    points: &'a [MapPoint],
    terms: &'a Terms<'a>,
    config: &'a MappingConfig,
}

impl EquationText<'_> {
    fn write(&self, out: &mut impl Write) -> io::Result<()> {
        self.write_lenses(out)?;
        writeln!(out, "poses {}", self.keyframes.frames.len())?;
        for keyframe in &self.keyframes.frames {
            line(out, &[], pose(&keyframe.world_from_rig))?;
        }
        writeln!(out, "points {}", self.points.len())?;
        for point in self.points {
            line(out, &[], numbers([&point.point_in_world]))?;
        }
        self.write_observations(out)?;
        self.write_scans(out)?;
        let steps = steps(self.keyframes, self.terms, self.config);
        writeln!(out, "steps {}", steps.len())?;
        for (k, step) in steps {
            let sigmas = [0, 3].map(|row| 1.0 / step.sqrt_information[(row, row)]);
            line(out, &[k, k + 1], pose(&step.a_from_b).chain(sigmas))?;
        }
        out.flush()
    }

    fn write_lenses(&self, out: &mut impl Write) -> io::Result<()> {
        writeln!(out, "lenses {}", self.rig.cameras.len())?;
        for mounted in self.rig.cameras.values() {
            let lens = &mounted.camera.lens;
            let parameters = lens.parameters();
            let parameters = parameters.values.into_iter().take(parameters.count);
            write!(out, "{} ", lens.model().name())?;
            let camera_from_rig = mounted.rig_from_camera.inverse();
            line(out, &[], parameters.chain(pose(&camera_from_rig)))?;
        }
        Ok(())
    }

    fn write_observations(&self, out: &mut impl Write) -> io::Result<()> {
        let names = self.rig.cameras.keys().map(String::as_str);
        let lenses: &BTreeMap<&str, usize> = &names.zip(0..).collect();
        let all = self.points.iter().enumerate().flat_map(|(number, point)| {
            let seen = point.observations.iter();
            seen.filter_map(move |o| {
                let image = self.keyframes.images.get(o.image)?;
                let keypoint = image.features.keypoints.get(o.keypoint as usize)?;
                let lens = lenses.get(image.camera.as_str())?;
                Some(([number, image.keyframe, *lens], keypoint.pixel_f64()))
            })
        });
        let count = match self.config.terms.images {
            true => all.clone().count(),
            false => 0,
        };
        let sigma_px = self.terms.weights.pixel_sigma_px;
        writeln!(out, "observations {count} {sigma_px} {IMAGE_KERNEL_SCALE}")?;
        for (indices, pixel) in all.take(count) {
            line(out, &indices, [pixel.x, pixel.y])?;
        }
        Ok(())
    }

    fn write_scans(&self, out: &mut impl Write) -> io::Result<()> {
        let (taken, weights) = (self.config.terms, &self.terms.weights);
        let scans = |taken: bool| self.terms.scans.iter().filter(move |_| taken);
        let planes = scans(taken.planes).map(|(_, found)| found.planes.len());
        let (planes, sigma_m) = (planes.sum::<usize>(), weights.plane_sigma_m);
        writeln!(out, "planes {planes} {sigma_m} {SCAN_KERNEL_SCALE}")?;
        for (pair, found) in scans(taken.planes) {
            for plane in &found.planes {
                let r = plane.residual(sigma_m);
                let vectors = numbers([&r.point_in_n, &r.point_in_m, &r.normal_in_m]);
                line(out, &[pair.m, pair.n], vectors)?;
            }
        }
        let edges = scans(taken.edges).map(|(_, found)| found.edges.len());
        let (edges, sigma_m) = (edges.sum::<usize>(), weights.edge_sigma_m);
        writeln!(out, "edges {edges} {sigma_m} {SCAN_KERNEL_SCALE}")?;
        for (pair, found) in scans(taken.edges) {
            for edge in &found.edges {
                let r = edge.residual(sigma_m);
                let vectors = numbers([&r.point_in_n, &r.point_in_m, &r.direction_in_m]);
                line(out, &[pair.m, pair.n], vectors)?;
            }
        }
        Ok(())
    }
}

/// Writes one line; numbers read back are the same to the last bit.
fn line(
    out: &mut impl Write,
    indices: &[usize],
    numbers: impl IntoIterator<Item = f64>,
) -> io::Result<()> {
    let mut gap = "";
    let mut put = |value: &dyn Display| {
        let written = write!(out, "{gap}{value}");
        gap = " ";
        written
    };
    indices.iter().try_for_each(|index| put(index))?;
    numbers.into_iter().try_for_each(|number| put(&number))?;
    writeln!(out)
}

fn numbers<const N: usize>(vectors: [&Vector3<f64>; N]) -> impl Iterator<Item = f64> {
    vectors.into_iter().flat_map(|v| [v.x, v.y, v.z])
}

/// `qx qy qz qw tx ty tz`.
fn pose(pose: &Se3) -> impl Iterator<Item = f64> {
    let [x, y, z, w] = pose.rotation.coords.into();
    let t = &pose.translation;
    [x, y, z, w, t.x, t.y, t.z].into_iter()
}

#[cfg(test)]
mod tests {
    use std::str::SplitWhitespace;
    use std::sync::Arc;

    use lsfb_geometry::{UnitQuaternion, Vector2};
    use lsfb_perception::RelativePose;
    use lsfb_solver::{BlockId, Kernel, SolveConfig, solve};
    use lsfb_types::no_progress;
    use nalgebra::Quaternion;

    use super::*;
    use crate::mapping::tests::{record, rig};
    use crate::residuals::{LidarEdge, LidarPlane, ObservingCamera, Reprojection};

    struct Words<'a>(SplitWhitespace<'a>);

    impl Words<'_> {
        fn number(&mut self) -> f64 {
            let word = self.0.next().expect("a number");
            word.parse().expect("a number")
        }

        fn numbers<const N: usize>(&mut self) -> [f64; N] {
            std::array::from_fn(|_| self.number())
        }

        fn vector(&mut self) -> Vector3<f64> {
            self.numbers::<3>().into()
        }

        fn pose(&mut self) -> Se3 {
            let [x, y, z, w] = self.numbers();
            let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z));
            Se3::new(rotation, self.vector())
        }

        /// One of a list.
        fn of<T: Copy>(&mut self, all: &[T]) -> T {
            all[self.number() as usize]
        }

        fn heading(&mut self, name: &str) -> usize {
            assert_eq!(self.0.next(), Some(name));
            self.number() as usize
        }
    }

    /// The problem as it stands in the text.
    fn read(text: &str, cameras: &[Arc<ObservingCamera>]) -> Problem {
        let mut words = Words(text.split_whitespace());
        let mut problem = Problem::new();
        for camera in &cameras[..words.heading("lenses")] {
            assert_eq!(words.0.next(), Some("kannala-brandt"));
            let lens = camera.camera().lens.parameters();
            assert_eq!(words.numbers::<8>(), lens.values[..8]);
            assert_eq!(words.pose(), camera.camera_from_rig());
        }
        let count = words.heading("poses");
        let poses: Vec<_> = (0..count)
            .map(|_| problem.add_block(words.pose()))
            .collect();
        problem.set_constant(poses[0]);
        let poses: Vec<BlockId> = poses.iter().map(|block| block.id()).collect();
        let count = words.heading("points");
        let points: Vec<BlockId> = (0..count)
            .map(|_| problem.add_eliminated_point(words.vector()).id())
            .collect();
        let mut added = 0;
        let (count, sigma_px) = (words.heading("observations"), words.number());
        let kernel = Kernel::Huber {
            scale: words.number(),
        };
        added += count;
        for _ in 0..count {
            let (point, pose) = (words.of(&points), words.of(&poses));
            let residual = Reprojection {
                camera: cameras[words.number() as usize].clone(),
                pixel: Vector2::from(words.numbers::<2>()),
                sigma_px,
            };
            let added = problem.add_residual(residual, &[pose, point], kernel);
            added.expect("blocks fit");
        }
        let (count, sigma_m) = (words.heading("planes"), words.number());
        let kernel = Kernel::Cauchy {
            scale: words.number(),
        };
        added += count;
        for _ in 0..count {
            let blocks = [words.of(&poses), words.of(&poses)];
            let residual = LidarPlane {
                point_in_n: words.vector(),
                point_in_m: words.vector(),
                normal_in_m: words.vector(),
                sigma_m,
            };
            let added = problem.add_residual(residual, &blocks, kernel);
            added.expect("blocks fit");
        }
        let (count, sigma_m) = (words.heading("edges"), words.number());
        let kernel = Kernel::Cauchy {
            scale: words.number(),
        };
        added += count;
        for _ in 0..count {
            let blocks = [words.of(&poses), words.of(&poses)];
            let residual = LidarEdge {
                point_in_n: words.vector(),
                point_in_m: words.vector(),
                direction_in_m: words.vector(),
                sigma_m,
            };
            let added = problem.add_residual(residual, &blocks, kernel);
            added.expect("blocks fit");
        }
        let count = words.heading("steps");
        added += count;
        for _ in 0..count {
            let blocks = [words.of(&poses), words.of(&poses)];
            let residual = RelativePose::isotropic(words.pose(), words.number(), words.number());
            let added = problem.add_residual(residual, &blocks, Kernel::Squared);
            added.expect("blocks fit");
        }
        assert_eq!(words.0.next(), None);
        assert_eq!(problem.residual_count(), added);
        problem
    }

    #[test]
    fn the_text_is_what_is_solved() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("scan.mcap");
        record(&path, 3.0, &["cam0", "cam1"], 0.03);
        let recording = Recording::open(&path).expect("recording");
        let (config, out) = (MappingConfig::default(), folder.path().join("eq4.txt"));
        let solved = write_first_equation(&recording, &config, &out, &no_progress);
        let mut solved = solved.expect("written");
        let text = std::fs::read_to_string(&out).expect("text");
        let rig = rig();
        let cameras: Vec<_> = rig.cameras.values().map(ObservingCamera::new).collect();
        let mut found = read(&text, &cameras);
        assert_eq!(found.residual_count(), solved.residual_count());
        assert_eq!(found.stored_values(), solved.stored_values());
        let one = SolveConfig {
            max_iterations: 1,
            ..config.solver
        };
        let [found, solved] = [&mut found, &mut solved].map(|problem| {
            let report = solve(problem, &one).expect("solves");
            [report.initial_cost, report.final_cost]
        });
        for (found, solved) in found.into_iter().zip(solved) {
            assert!((found / solved - 1.0).abs() < 1e-12, "{found} {solved}");
        }
    }
}
