use crate::layout::Layout;
use crate::linear_system::LinearSystem;
use crate::normal::{NormalEquations, Step};

/// Powell's dogleg in coordinates scaled by the square root of the normal matrix's diagonal.
pub(crate) struct Dogleg {
    radius: f64,
    /// Damping of the Gauss–Newton step, as small as the factorization bears.
    damping: f64,
    newton: Step,
    descent: Step,
    newton_length: f64,
    descent_length: f64,
    /// Whether both are those of the present linearization.
    found: bool,
    refused: bool,
    last_length: f64,
}

const LEAST_DAMPING: f64 = 1e-12;
const MOST_DAMPING: f64 = 1e-2;

impl Dogleg {
    pub fn new(layout: &Layout, radius: f64) -> Self {
        Self {
            radius,
            damping: LEAST_DAMPING,
            newton: Step::new(layout),
            descent: Step::new(layout),
            newton_length: 0.0,
            descent_length: 0.0,
            found: false,
            refused: false,
            last_length: 0.0,
        }
    }

    pub fn radius(&self) -> f64 {
        self.radius
    }

    pub fn was_refused(&self) -> bool {
        self.refused
    }

    /// A new linearization.
    pub fn begin(&mut self) {
        self.found = false;
        self.refused = false;
    }

    pub fn taken(&mut self, quality: f64) {
        if quality > 0.75 {
            self.radius = self.radius.max(3.0 * self.last_length);
        } else if quality < 0.25 {
            self.radius *= 0.5;
        }
    }

    pub fn refused(&mut self) {
        self.refused = true;
        self.radius = 0.5 * self.radius.min(self.last_length.max(self.radius * 1e-3));
    }

    /// Writes the step and returns the decrease that the quadratic model foresees.
    pub fn step(
        &mut self,
        normal: &NormalEquations,
        layout: &Layout,
        system: &mut LinearSystem,
        step: &mut Step,
    ) -> Option<f64> {
        if !self.found {
            self.find(normal, layout, system)?;
        }
        if self.newton_length <= self.radius {
            copy(&self.newton, step);
        } else if self.descent_length >= self.radius {
            combine(
                &self.descent,
                self.radius / self.descent_length,
                &self.newton,
                0.0,
                step,
            );
        } else {
            let share = self.share(normal);
            combine(&self.descent, 1.0 - share, &self.newton, share, step);
        }
        self.last_length = scaled_product(normal, step, step).sqrt();
        let model = normal.quadratic(layout, step);
        Some(-model.slope - 0.5 * model.square)
    }

    fn find(
        &mut self,
        normal: &NormalEquations,
        layout: &Layout,
        system: &mut LinearSystem,
    ) -> Option<()> {
        while !system.solve(normal, layout, self.damping, &mut self.newton) {
            self.damping *= 10.0;
            if self.damping > MOST_DAMPING {
                return None;
            }
        }
        self.damping = (0.1 * self.damping).max(LEAST_DAMPING);
        let down = |gradient: f64, diagonal: f64| -gradient / normal.damping(diagonal, 1.0);
        let gradients = normal.gradient.iter().zip(&normal.diagonal);
        for (d, (g, h)) in self.descent.reduced.iter_mut().zip(gradients) {
            *d = if *g == 0.0 { 0.0 } else { down(*g, *h) };
        }
        let gradients = normal.point_gradient.iter().zip(&normal.point_hessian);
        for (d, (g, h)) in self.descent.points.iter_mut().zip(gradients) {
            for k in 0..3 {
                d[k] = if g[k] == 0.0 {
                    0.0
                } else {
                    down(g[k], h[(k, k)])
                };
            }
        }
        let model = normal.quadratic(layout, &self.descent);
        if !(model.square > 0.0) {
            return None;
        }
        let length = -model.slope / model.square;
        self.descent.reduced.iter_mut().for_each(|d| *d *= length);
        self.descent.points.iter_mut().for_each(|d| *d *= length);
        self.newton_length = scaled_product(normal, &self.newton, &self.newton).sqrt();
        self.descent_length = scaled_product(normal, &self.descent, &self.descent).sqrt();
        self.found = true;
        Some(())
    }

    /// Where the way from the descent to the Gauss–Newton step leaves the radius.
    fn share(&self, normal: &NormalEquations) -> f64 {
        let mixed = scaled_product(normal, &self.descent, &self.newton);
        let inner = self.descent_length.powi(2);
        let across = inner - 2.0 * mixed + self.newton_length.powi(2);
        let along = mixed - inner;
        let room = self.radius.powi(2) - inner;
        let root = (along * along + across * room).max(0.0).sqrt();
        let share = if along > 0.0 {
            room / (along + root)
        } else {
            (root - along) / across
        };
        share.clamp(0.0, 1.0)
    }
}

fn copy(from: &Step, to: &mut Step) {
    to.reduced.copy_from_slice(&from.reduced);
    to.points.copy_from_slice(&from.points);
}

/// `target = a x + b y`.
fn combine(x: &Step, a: f64, y: &Step, b: f64, target: &mut Step) {
    for (t, (x, y)) in target
        .reduced
        .iter_mut()
        .zip(x.reduced.iter().zip(&y.reduced))
    {
        *t = a * x + b * y;
    }
    for (t, (x, y)) in target.points.iter_mut().zip(x.points.iter().zip(&y.points)) {
        *t = a * x + b * y;
    }
}

/// Product in scaled coordinates.
fn scaled_product(normal: &NormalEquations, x: &Step, y: &Step) -> f64 {
    let mut sum = 0.0;
    for ((x, y), h) in x.reduced.iter().zip(&y.reduced).zip(&normal.diagonal) {
        sum += x * y * normal.damping(*h, 1.0);
    }
    for ((x, y), h) in x.points.iter().zip(&y.points).zip(&normal.point_hessian) {
        for k in 0..3 {
            sum += x[k] * y[k] * normal.damping(h[(k, k)], 1.0);
        }
    }
    sum
}
