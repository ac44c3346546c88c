//! Whether all views were taken through one lens: not by two cameras, nor while zoom or focus moved.
//!
//! Each view, once its pose is its own, says something of the lens: information and gradient. The views are divided into two groups so that
//! a lens for each takes most off the squares: k-means with lenses for means, started from every view's own lens. Any division takes off
//! something, and more where the model lacks something (a bent board moves the lens of each view a little). What counts is by how much
//! less views pull away from the lenses of their groups than from one lens, and how far apart these lenses are for that pull.
//!
//! Two cameras of one kind differ by a hundredth in focal length and by pixels in the principal point; most of that is taken up
//! by the poses of the views, so that one lens meets all corners to a tenth of a pixel, and is neither's.

use lsfb_geometry::Camera;
use lsfb_types::{Finding, Limit, Verdict};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Views needed, and in each group.
const LEAST_VIEWS: usize = 6;
const LEAST_OF_A_GROUP: usize = 2;
/// How many times less views must pull away from two lenses than from one, and by how many standard deviations a focal length or
/// principal point must differ: to be warned of, and to fail. No real camera exceeds both (TUM VI's two, OpenCV's two, camodocal's: at
/// most 1.7 times less, then by 3.4 standard deviations, or 5.1 of them, then 1.5 times); images of two mixed do by 2.1 times
/// and 4.6 with 13 images, and by 3 times and 17 with 58.
const WORRYING: Apart = Apart {
    times_less: 1.8,
    deviations: 4.0,
};
const FAILED: Apart = Apart {
    times_less: 2.5,
    deviations: 8.0,
};
/// By how much they must be apart for that, as a share of the focal length. What a lens model does not know moves a lens by less: it is
/// decentred, and five seconds of TUM VI, taken alone, move by 0.2 % with where in the image the board was (a principal point 0.4 px
/// off, by 8 standard deviations, as neighbouring views err alike). Its two cameras differ by 1.2 %, OpenCV's by 2.6 %.
const LEAST_APART: f64 = 0.004;
/// What lenses may differ by: focal lengths as a share, the principal point as a share of the image's width, distortion. Weak enough to
/// leave views alone, it holds what few corners do not tell.
const USUAL_SIGMAS: [f64; 3] = [0.05, 0.05, 0.1];
/// Focal lengths and the principal point come first in every model.
const COMPARED: usize = 4;
const ROUNDS: usize = 30;
/// Views named.
const NAMED: usize = 3;

/// What one view says of the lens, its pose moving along.
pub(super) struct LensOfView {
    /// Which view it is.
    pub number: usize,
    pub information: DMatrix<f64>,
    pub gradient: DVector<f64>,
    pub squares: f64,
    pub corners: f64,
}

/// How clearly two lenses differ.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Apart {
    times_less: f64,
    deviations: f64,
}

impl Apart {
    fn exceeds(&self, limit: &Self) -> bool {
        self.times_less > limit.times_less && self.deviations > limit.deviations
    }
}

/// Two groups of views, each with a lens of its own.
struct Division {
    /// Whether each view belongs to the second group.
    second: Vec<bool>,
    /// Steps of both lenses from that of all views.
    steps: [DVector<f64>; 2],
    /// Squares left, but for those that no lens changes.
    cost: f64,
}

/// Views as one lens has them.
struct Views<'a> {
    views: &'a [LensOfView],
    prior: DVector<f64>,
}

impl Views<'_> {
    fn factor(&self, mut information: DMatrix<f64>) -> Option<Cholesky<f64, Dyn>> {
        for (k, weight) in self.prior.iter().enumerate() {
            information[(k, k)] += weight;
        }
        information.cholesky()
    }

    /// Information and gradient of some views together.
    fn sum(&self, counts: impl Fn(usize) -> bool) -> (DMatrix<f64>, DVector<f64>) {
        let size = self.prior.len();
        let none = (DMatrix::zeros(size, size), DVector::zeros(size));
        let own = self.views.iter().enumerate().filter(|(k, _)| counts(*k));
        own.fold(none, |(information, gradient), (_, view)| {
            (information + &view.information, gradient + &view.gradient)
        })
    }

    /// The lens of some views, as a step from that of all.
    fn step(&self, counts: impl Fn(usize) -> bool) -> Option<DVector<f64>> {
        let (information, gradient) = self.sum(counts);
        Some(-self.factor(information)?.solve(&gradient))
    }

    fn divide_from(&self, seed: usize) -> Option<Division> {
        let mut steps = [self.step(|_| true)?, self.step(|k| k == seed)?];
        let mut second = vec![false; self.views.len()];
        for _ in 0..ROUNDS {
            let nearer = |view: &LensOfView| view.cost(&steps[1]) < view.cost(&steps[0]);
            let next: Vec<bool> = self.views.iter().map(nearer).collect();
            if next == second {
                break;
            }
            second = next;
            steps = [self.step(|k| !second[k])?, self.step(|k| second[k])?];
        }
        let costs = self.views.iter().zip(&second);
        let cost = costs.map(|(v, s)| v.cost(&steps[usize::from(*s)])).sum();
        Some(Division {
            second,
            steps,
            cost,
        })
    }

    /// The division that leaves least; the first of several.
    fn divide(&self) -> Option<Division> {
        let divisions = (0..self.views.len()).filter_map(|seed| self.divide_from(seed));
        divisions
            .filter(|division| {
                let second = division.second.iter().filter(|s| **s).count();
                second.min(self.views.len() - second) >= LEAST_OF_A_GROUP
            })
            .min_by(|a, b| a.cost.total_cmp(&b.cost))
    }

    /// By how much more than noise views pull away from lenses: 1 where each parameter moves by its own noise alone.
    fn pull(&self, lenses: usize, step: impl Fn(usize) -> DVector<f64>) -> Option<f64> {
        let size = self.prior.len() as f64;
        let mut pull = 0.0;
        for (k, view) in self.views.iter().enumerate() {
            let step = step(k);
            let gradient = &view.gradient + &view.information * &step;
            let own = self.factor(view.information.clone())?.solve(&gradient);
            let taken = gradient.dot(&own);
            let left = view.squares + view.cost(&step) - taken;
            let freedom = (2.0 * view.corners - 6.0 - size).max(1.0);
            pull += taken * freedom / left.max(1e-12);
        }
        Some(pull / (size * (self.views.len() - lenses) as f64))
    }
}

impl LensOfView {
    /// What a step of the lens adds to the squares.
    fn cost(&self, step: &DVector<f64>) -> f64 {
        2.0 * self.gradient.dot(step) + step.dot(&(&self.information * step))
    }
}

/// Views that need another lens than the rest.
pub(super) struct OtherLens {
    /// Numbers of all views, and whether they are such.
    all: Vec<usize>,
    these: Vec<bool>,
    apart: Apart,
    /// The parameter that differs most clearly: its place, and its value for the others, for these, and the standard deviation of their difference.
    parameter: usize,
    values: [f64; 2],
    sigma: f64,
}

impl OtherLens {
    /// Where views do not agree on one lens.
    pub fn find(camera: &Camera, views: &[LensOfView]) -> Option<Self> {
        let lens = camera.lens.parameters();
        if views.len() < LEAST_VIEWS {
            return None;
        }
        let squares: f64 = views.iter().map(|v| v.squares).sum();
        let corners: f64 = views.iter().map(|v| v.corners).sum();
        let freedom = 2.0 * corners - 6.0 * views.len() as f64 - lens.count as f64;
        let variance = squares / freedom.max(1.0);
        let of = Views {
            views,
            prior: DVector::from_fn(lens.count, |k, _| {
                let usual = match k {
                    0 | 1 => USUAL_SIGMAS[0] * lens.values[k],
                    2 | 3 => USUAL_SIGMAS[1] * f64::from(camera.width),
                    _ => USUAL_SIGMAS[2],
                };
                variance / (usual * usual)
            }),
        };
        let mut division = of.divide()?;
        // Those that are fewer are the others.
        if 2 * division.second.iter().filter(|s| **s).count() > views.len() {
            division.second.iter_mut().for_each(|s| *s = !*s);
            division.steps.swap(0, 1);
        }
        let one = of.step(|_| true)?;
        let pull_of_one = of.pull(1, |_| one.clone())?;
        let own = |k: usize| division.steps[usize::from(division.second[k])].clone();
        let pull_of_two = of.pull(2, own)?;
        let inverse = |second: bool| {
            let (information, _) = of.sum(|k| division.second[k] == second);
            Some(of.factor(information)?.inverse())
        };
        let covariance = (inverse(false)? + inverse(true)?) * variance * pull_of_two.max(1.0);
        let differs = |k: usize| (division.steps[1][k] - division.steps[0][k]).abs();
        let sigma = |k: usize| covariance[(k, k)].max(0.0).sqrt().max(1e-12);
        let deviations = |k: usize| differs(k) / sigma(k);
        let least_px = LEAST_APART * camera.focal_px()[0];
        let is_apart = |k: &usize| differs(*k) > least_px;
        let parameter = (0..COMPARED)
            .filter(is_apart)
            .max_by(|a, b| deviations(*a).total_cmp(&deviations(*b)))?;
        let apart = Apart {
            times_less: pull_of_one / pull_of_two.max(1e-12),
            deviations: deviations(parameter),
        };
        apart.exceeds(&WORRYING).then(|| Self {
            all: views.iter().map(|v| v.number).collect(),
            these: division.second,
            apart,
            parameter,
            values: [0, 1].map(|of| lens.values[parameter] + division.steps[of][parameter]),
            sigma: sigma(parameter),
        })
    }

    /// In words; `names` are those of all views.
    pub fn finding(&self, name: &str, camera: &Camera, names: &[&str]) -> Finding {
        let verdict = match self.apart.exceeds(&FAILED) {
            true => Verdict::Fail,
            false => Verdict::Warn,
        };
        let [others, these] = self.values;
        let what = format!(
            "not all images were taken with one lens: {} of {} ({}) have {} = {these:.1} px, the others {others:.1} px, {:.1} ± {:.1} px apart: images of two cameras are mixed, or zoom or focus changed",
            self.these.iter().filter(|s| **s).count(),
            self.all.len(),
            self.named(names),
            camera.lens.model().parameter_names()[self.parameter],
            (these - others).abs(),
            self.sigma
        );
        let finding = Finding::new("one-lens", verdict, name, what);
        let finding = finding
            .value((these - others).abs(), "px")
            .sigma(self.sigma)
            .limit(Limit::AtMost(WORRYING.deviations * self.sigma));
        finding.remedy("calibrate each camera from its own images only, with zoom and focus fixed")
    }

    /// Which these are: a stretch of all, or the first of them.
    fn named(&self, names: &[&str]) -> String {
        let of_these = self.all.iter().zip(&self.these).filter(|(_, s)| **s);
        let named = of_these.filter_map(|(number, _)| names.get(*number).copied());
        let named: Vec<&str> = named.collect();
        let changes = self.these.windows(2).filter(|w| w[0] != w[1]).count();
        let is_stretch = changes == 1 || changes == 2 && !self.these[0];
        match (&named[..], is_stretch) {
            ([first, .., last], true) => format!("{first} to {last}"),
            _ => format!("{} and so on", named[..named.len().min(NAMED)].join(", ")),
        }
    }
}
