//! What else than noise would explain errors, each cause alone.

use lsfb_geometry::Camera;
use nalgebra::DVector;

use super::sums::{BENT, GAP, PROFILE, RINGS, SAME, SHUTTER, STRETCH, Sums, inverse};
use crate::board::Target;

/// Share of what views' own poses explain that their times alone must, and of all squares: by chance a sixth, and a hundredth.
const TIMES_OF_POSES: f64 = 0.7;
const LEAST_OF_TIMES: f64 = 0.15;
/// Change of the gap between tags, as a share of their edge, that is no inaccuracy of a print.
const ANOTHER_GAP: f64 = 0.02;

/// One thing that would explain errors.
struct Cause {
    /// First of its columns and how many it has.
    columns: [usize; 2],
    words: fn(&Target, &DVector<f64>) -> String,
}

const CAUSES: [Cause; 5] = [
    Cause {
        columns: [GAP, 1],
        words: |target, by| match *target {
            Target::AprilGrid { spacing_ratio, .. } => format!(
                "gaps of {:.3} of a tag's edge instead of {spacing_ratio}: measure a tag and a gap, and correct tagSpacing",
                spacing_ratio + by[0]
            ),
            Target::Checkerboard { .. } | Target::Charuco { .. } => String::new(),
        },
    },
    Cause {
        columns: [STRETCH, 2],
        words: |_, by| {
            format!(
                "a board that is {:+.2} % longer along y, with corners {:+.2}° off right angles: measure both of its edges and diagonals",
                by[0] * 100.0,
                by[1].atan().to_degrees()
            )
        },
    },
    Cause {
        columns: [BENT, 3],
        words: |target, by| {
            let half = target.corners_size().map(|s| 0.5 * s);
            let bends = [
                by[0] * half[0] * half[0],
                by[1] * half[0] * half[1],
                by[2] * half[1] * half[1],
            ];
            let most = bends.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
            format!(
                "a board bent by {:.1} mm: glue it to a stiff plate",
                most * 1e3
            )
        },
    },
    Cause {
        columns: [SHUTTER, 1],
        words: |_, by| {
            format!(
                "a rolling shutter with {:.1} ms readout: set readout_s in the rig, or estimate it (readout = \"estimated\")",
                by[0] * 1e3
            )
        },
    },
    Cause {
        columns: [PROFILE, RINGS],
        words: |_, _| "another lens model: try another --model".to_owned(),
    },
];

/// A cause, and the share of the squares that it takes off.
pub(super) struct Explained {
    pub share: f64,
    pub words: String,
    /// Whether it is a gap between tags that no print of the board said has.
    pub is_another_gap: bool,
}

/// A readout time with its standard deviation.
pub(super) struct Shutter {
    pub readout_s: f64,
    pub sigma_s: f64,
}

impl Sums {
    /// Views that were not taken when their stamps say, if that is what keeps them off the IMU's motion.
    pub fn off_their_stamps(&self) -> Option<Explained> {
        let share = self.of_times / (self.of_poses + self.squares).max(1e-12);
        let dominant = self.of_times > TIMES_OF_POSES * self.of_poses;
        (dominant && share > LEAST_OF_TIMES).then(|| Explained {
            share,
            words: format!(
                "views taken {:.1} ms rms off their stamps, which jitter or jump",
                (self.times[0] / self.times[1].max(1.0)).sqrt() * 1e3
            ),
            is_another_gap: false,
        })
    }

    /// The readout time that fits best, one step from none; `None` where nothing moves. `variance` is that of a corner in one direction, px².
    pub fn shutter(&self, camera: &Camera, variance: f64) -> Option<Shutter> {
        let reduced = self.reduced(camera);
        let own = reduced.matrix[(SHUTTER, SHUTTER)];
        (own > SAME * reduced.size[SHUTTER]).then(|| Shutter {
            readout_s: -reduced.gradient[SHUTTER] / own,
            sigma_s: (variance / own).sqrt(),
        })
    }

    /// The cause that explains most; `None` where nothing can be said.
    pub fn explain(&self, target: &Target, camera: &Camera) -> Option<Explained> {
        let reduced = self.reduced(camera);
        let of_views = Explained {
            share: self.of_poses / (self.of_poses + self.squares).max(1e-12),
            words: format!(
                "poses of the views that do not follow the IMU (reprojection error of each alone is {:.2} px): the board has another size, the specified IMU noise is too small, or clocks jump",
                (self.squares / self.corners.max(1.0)).max(0.0).sqrt()
            ),
            is_another_gap: false,
        };
        let explained = CAUSES.iter().map(|cause| {
            let [first, count] = cause.columns;
            let own = reduced.matrix.view((first, first), (count, count));
            let size = reduced.size.rows(first, count).into_owned();
            let gradient = reduced.gradient.rows(first, count).into_owned();
            let step = -(inverse(&own.into_owned(), &size) * &gradient);
            Explained {
                share: -gradient.dot(&step) / reduced.squares.max(1e-12),
                words: (cause.words)(target, &step),
                is_another_gap: first == GAP && step[0].abs() > ANOTHER_GAP,
            }
        });
        let explained = explained.chain([of_views]);
        explained.max_by(|a, b| a.share.total_cmp(&b.share))
    }
}
