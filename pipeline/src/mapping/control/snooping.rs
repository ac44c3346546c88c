//! Which control points agree: blunders found by what all others say, before any of them pulls at the map.
//!
//! Each mark has a place in the map, with a covariance that goes together with those of the others (the map may drift), and a surveyed one. A rigid
//! transform between both is fitted by generalised least squares; what a mark is off by against all others, and how many of its standard deviations that is, is the
//! test of Baarda (1968) in three dimensions. The worst is left out while one is beyond the limit. Then those that the rest does not contradict come back: two
//! blunders make right marks look wrong.
//!
//! Many marks that are a little off are a map that is worse known than it says (a start that drifts where nothing corrected it); a few that are far off are blunders. So the same is
//! done with the map worse known by some factors, and of all these the likeliest counts, where five or more marks agree in it.

use std::f64::consts::TAU;

use lsfb_geometry::align::{Scale, umeyama};
use lsfb_geometry::{Matrix3, Se3, Vector3, Vector6};
use lsfb_perception::projection::moved_by_pose;
use lsfb_solver::gauss_newton::{Next, NormalEquations, minimise};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix6};

use super::{FEWEST, TELLING};

/// Steps of the fit: the first transform is right to how far the map is bent.
const STEPS: u32 = 5;
/// Factors by which a map may be worse known than it says: powers of this.
const FACTOR_STEP: f64 = 1.25;
const FACTOR_STEPS: i32 = 30;
/// A blunder lies anywhere within this along each axis, metres, and one of so many marks is one.
const BLUNDER_M: f64 = 1.0;
const BLUNDER_SHARE: f64 = 0.05;
/// Directions of an error that the others tell worse than this many metres are not told.
const UNTOLD_M: f64 = 1e3;

/// A mark as the map and the survey have it.
#[derive(Clone, Debug)]
pub(super) struct Surveyed {
    /// In the map's world.
    pub in_world: Vector3<f64>,
    /// In the frame of the site.
    pub in_site: Vector3<f64>,
    pub sigmas_m: Vector3<f64>,
}

/// How far a mark is from where all others have it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Off {
    /// The map's place less the surveyed one, along the axes of the site.
    pub metres: Vector3<f64>,
    /// How well that is known where it is known worst, 1 σ; infinite where nothing tells it along a direction.
    pub worst_sigma_m: f64,
    /// How many standard deviations it is.
    pub sigmas: f64,
}

/// The marks that agree.
#[derive(Clone, Debug)]
pub(super) struct Snooped {
    pub site_from_world: Se3,
    /// Which of the marks hold.
    pub holding: Vec<usize>,
    /// By how much the map is worse known than it says: 1 where it is as it says, or too few marks tell.
    pub map_factor: f64,
    /// By how much residuals are still larger than that says.
    pub sigma0: f64,
    /// Of every mark; `None` where the others do not tell.
    pub off: Vec<Option<Off>>,
}

/// Finds the marks that agree: not fewer than three, nor than half of them. `covariance_m2` is that of all places in the map, in their order. `None` where
/// no three of them determine the transform.
pub(super) fn snoop(
    marks: &[Surveyed],
    covariance_m2: &DMatrix<f64>,
    limit_sigmas: f64,
) -> Option<Snooped> {
    let mut network = Network {
        marks,
        covariance_m2,
        map_factor: 1.0,
    };
    let mut best = network.agreeing(limit_sigmas)?;
    let mut least = network.unlikely(&best);
    for step in 1..=FACTOR_STEPS {
        let worse = Network {
            map_factor: FACTOR_STEP.powi(step),
            ..network
        };
        let found = worse.agreeing(limit_sigmas)?;
        let unlikely = worse.unlikely(&found);
        if found.0.len() >= TELLING && unlikely < least {
            (best, least) = (found, unlikely);
            network.map_factor = worse.map_factor;
        }
    }
    let found = best;
    let (holding, fit) = found;
    Some(Snooped {
        site_from_world: fit.site_from_world,
        map_factor: network.map_factor,
        sigma0: fit.sigma0(),
        off: (0..marks.len())
            .map(|k| match holding.iter().position(|held| *held == k) {
                Some(place) => fit.off(place),
                None => network.off(&holding, k),
            })
            .collect(),
        holding,
    })
}

/// A map that is another size than its survey differs from it by this share at least, and by so much less once that is taken out.
const LEAST_SCALE_OFF: f64 = 0.005;
const SCALE_EXPLAINS: f64 = 0.5;

/// How many times as large as the map its survey is, where that explains most of what is between them: another unit, or a tape that is wrong.
pub(super) fn scale_of_survey(marks: &[Surveyed]) -> Option<f64> {
    let (world, site): (Vec<_>, Vec<_>) = marks.iter().map(|m| (m.in_world, m.in_site)).unzip();
    let left = |scale: Scale| {
        let fit = umeyama(&world, &site, scale)?;
        let pairs = world.iter().zip(&site);
        let off = pairs.map(|(world, site)| (fit.apply(world) - site).norm_squared());
        Some((fit.scale, off.sum::<f64>().sqrt()))
    };
    let ((scale, scaled), (_, rigid)) = (left(Scale::Free)?, left(Scale::Fixed)?);
    let is_other = (scale - 1.0).abs() > LEAST_SCALE_OFF && scaled < SCALE_EXPLAINS * rigid;
    is_other.then_some(scale)
}

struct Network<'a> {
    marks: &'a [Surveyed],
    covariance_m2: &'a DMatrix<f64>,
    /// By how much the map is worse known than its covariance says.
    map_factor: f64,
}

impl Network<'_> {
    /// The marks that agree, and the transform that fits them.
    fn agreeing(&self, limit_sigmas: f64) -> Option<(Vec<usize>, Fit)> {
        let (network, marks) = (self, self.marks);
        let fewest = FEWEST.max(marks.len().div_ceil(2));
        let mut holding: Vec<usize> = (0..marks.len()).collect();
        let mut fit = network.fit(&holding)?;
        while holding.len() > fewest {
            let sigmas = |k: &usize| fit.off(*k).map_or(0.0, |off| off.sigmas);
            let worst = (0..holding.len()).max_by(|a, b| sigmas(a).total_cmp(&sigmas(b)))?;
            if sigmas(&worst) <= limit_sigmas {
                break;
            }
            let mut rest = holding.clone();
            rest.remove(worst);
            let Some(of_rest) = network.fit(&rest) else {
                break;
            };
            (holding, fit) = (rest, of_rest);
        }
        // Back with those that the others do not contradict, the least doubtful first.
        loop {
            let limit = limit_sigmas * fit.sigma0().max(1.0);
            let left_out = (0..marks.len()).filter(|k| !holding.contains(k));
            let doubts = left_out.filter_map(|k| Some((network.off(&holding, k)?.sigmas, k)));
            let Some((sigmas, back)) = doubts.min_by(|a, b| a.0.total_cmp(&b.0)) else {
                break;
            };
            if sigmas > limit {
                break;
            }
            holding.push(back);
            holding.sort_unstable();
            fit = network.fit(&holding)?;
        }
        Some((holding, fit))
    }

    /// Minus twice the logarithm of how likely the marks are: those that hold by map and survey, each of the others anywhere near.
    fn unlikely(&self, (holding, fit): &(Vec<usize>, Fit)) -> f64 {
        let left_out = (self.marks.len() - holding.len()) as f64;
        let as_normal = fit.log_determinant + fit.squares() + fit.residuals.len() as f64 * TAU.ln();
        as_normal + left_out * (6.0 * (2.0 * BLUNDER_M).ln() - 2.0 * BLUNDER_SHARE.ln())
    }
}

/// A transform and what is left of its marks.
struct Fit {
    site_from_world: Se3,
    /// The map's places less the surveyed ones.
    residuals: DVector<f64>,
    /// Inverse of their covariance, with the transform free: `D⁻¹ − D⁻¹ A (Aᵀ D⁻¹ A)⁻¹ Aᵀ D⁻¹`.
    weights: DMatrix<f64>,
    /// Of that covariance.
    log_determinant: f64,
}

impl Network<'_> {
    fn fit(&self, holding: &[usize]) -> Option<Fit> {
        let chosen = || holding.iter().map(|k| &self.marks[*k]);
        let (world, site): (Vec<_>, Vec<_>) = chosen().map(|m| (m.in_world, m.in_site)).unzip();
        let start = umeyama(&world, &site, Scale::Fixed)?.target_from_source;
        let mut last = None;
        let terms = |site_from_world: &Se3| {
            let spread = self.spread(holding, site_from_world)?;
            let log_determinant = 2.0 * spread.l_dirty().diagonal().map(f64::ln).sum();
            let inverse = spread.inverse();
            let mut by_site = DMatrix::zeros(3 * holding.len(), 6);
            let mut residuals = DVector::zeros(3 * holding.len());
            for (k, mark) in chosen().enumerate() {
                let by = moved_by_pose(site_from_world, &mark.in_world);
                by_site.fixed_view_mut::<3, 6>(3 * k, 0).copy_from(&by);
                let off = *site_from_world * mark.in_world - mark.in_site;
                residuals.fixed_rows_mut::<3>(3 * k).copy_from(&off);
            }
            let weighted = &inverse * &by_site;
            let normal: Matrix6<f64> = by_site.tr_mul(&weighted).fixed_view::<6, 6>(0, 0).into();
            let covariance = normal.cholesky()?.inverse();
            let right: Vector6<f64> = weighted.tr_mul(&residuals).fixed_rows::<6>(0).into();
            let inner = DMatrix::from_column_slice(6, 6, covariance.as_slice());
            last = Some(Fit {
                site_from_world: *site_from_world,
                residuals,
                log_determinant,
                weights: inverse - &weighted * inner * weighted.transpose(),
            });
            Some(NormalEquations {
                information: normal,
                gradient: right,
            })
        };
        minimise(start, STEPS, terms, |_| Next::Iterate)?;
        last
    }

    /// Covariance of the residuals: what map and survey say of both places.
    fn spread(&self, holding: &[usize], site_from_world: &Se3) -> Option<Cholesky<f64, Dyn>> {
        let turn = site_from_world.rotation_matrix();
        let mut spread = DMatrix::zeros(3 * holding.len(), 3 * holding.len());
        for (row, a) in holding.iter().enumerate() {
            for (column, b) in holding.iter().enumerate() {
                let of_map: Matrix3<f64> = self
                    .covariance_m2
                    .fixed_view::<3, 3>(3 * a, 3 * b)
                    .into_owned();
                let factor = self.map_factor * self.map_factor;
                let mut both = turn * of_map * turn.transpose() * factor;
                if a == b {
                    let of_survey = self.marks[*a].sigmas_m.map(|sigma| sigma * sigma);
                    both += Matrix3::from_diagonal(&of_survey);
                }
                spread
                    .fixed_view_mut::<3, 3>(3 * row, 3 * column)
                    .copy_from(&both);
            }
        }
        spread.cholesky()
    }

    /// How far a mark that is not among those that hold is from where these have it.
    fn off(&self, holding: &[usize], mark: usize) -> Option<Off> {
        let with = [holding, &[mark]].concat();
        self.fit(&with)?.off(holding.len())
    }
}

impl Fit {
    fn squares(&self) -> f64 {
        self.residuals.dot(&(&self.weights * &self.residuals))
    }

    /// How many times as large the residuals are as they should be.
    fn sigma0(&self) -> f64 {
        let squares = self.squares();
        // As many as there are more numbers than the six of the transform.
        let spare = self.residuals.len().saturating_sub(6).max(1);
        (squares / spare as f64).max(0.0).sqrt()
    }

    /// The error of a mark that explains the residuals best: what it is off by against all others.
    fn off(&self, place: usize) -> Option<Off> {
        let own: Matrix3<f64> = self
            .weights
            .fixed_view::<3, 3>(3 * place, 3 * place)
            .into_owned();
        let right = &self.weights * &self.residuals;
        let right: Vector3<f64> = right.fixed_rows::<3>(3 * place).into_owned();
        let told = own.symmetric_eigen();
        let (mut metres, mut squares, mut worst) = (Vector3::zeros(), 0.0, 0.0f64);
        for (information, axis) in told.eigenvalues.iter().zip(told.eigenvectors.column_iter()) {
            if *information < 1.0 / (UNTOLD_M * UNTOLD_M) {
                worst = f64::INFINITY;
                continue;
            }
            let along = axis.dot(&right);
            metres += axis * (along / information);
            squares += along * along / information;
            worst = worst.max(1.0 / information.sqrt());
        }
        (squares.is_finite() && squares > 0.0).then(|| Off {
            metres,
            worst_sigma_m: worst,
            sigmas: squares.sqrt(),
        })
    }
}
