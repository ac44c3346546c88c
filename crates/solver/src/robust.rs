use lsfb_types::{Bounds, OutOfBounds};

use crate::Error;

/// A robust kernel: the cost of a residual with squared norm `s` is `½ ρ(s)`. Scales are in units of the residual's
/// norm, after its own weight.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Kernel {
    /// `ρ = s`.
    #[default]
    Squared,
    /// `s` up to `scale²`, linear in the norm beyond.
    Huber {
        /// Norm at which the cost turns linear.
        scale: f64,
    },
    /// `scale² ln(1 + s/scale²)`.
    Cauchy {
        /// Norm at which the weight has fallen to one half.
        scale: f64,
    },
    /// `s / (1 + s/scale²)`, never above `scale²`.
    GemanMcClure {
        /// Norm at which the weight has fallen to one quarter.
        scale: f64,
    },
}

/// A kernel's value and slope.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Robust {
    /// `ρ(s)`.
    pub cost: f64,
    /// `ρ'(s)`: the weight of the squared residual.
    pub weight: f64,
}

impl Kernel {
    pub(crate) fn check(&self) -> Result<(), Error> {
        match *self {
            Kernel::Squared => Ok(()),
            Kernel::Huber { scale } | Kernel::Cauchy { scale } | Kernel::GemanMcClure { scale } => {
                let bounds = Bounds::POSITIVE;
                if bounds.hold(scale) {
                    return Ok(());
                }
                Err(OutOfBounds::new("kernel", "scale", &scale, &bounds).into())
            }
        }
    }

    /// The kernel with the square of its scale multiplied, where it can lose outliers for good: the surrogate of
    /// graduated non-convexity, convex for large factors.
    pub(crate) fn relaxed(self, factor: f64) -> Self {
        match self {
            Kernel::GemanMcClure { scale } if factor != 1.0 => Kernel::GemanMcClure {
                scale: scale * factor.sqrt(),
            },
            other => other,
        }
    }

    /// Share by which curvature along the residual falls short of that across it, `1 + 2 s ρ''/ρ'` taken away from 1, at
    /// the squared norm `s` (Triggs et al., Bundle Adjustment – A Modern Synthesis, 2000, eq. 11): 0 where the kernel is
    /// quadratic, more than 1 where it is not convex.
    pub(crate) fn shortfall(&self, s: f64) -> f64 {
        match *self {
            Kernel::Squared => 0.0,
            Kernel::Huber { scale } => f64::from(u8::from(s > scale * scale)),
            Kernel::Cauchy { scale } => {
                let ratio = s / (scale * scale);
                2.0 * ratio / (1.0 + ratio)
            }
            Kernel::GemanMcClure { scale } => {
                let ratio = s / (scale * scale);
                4.0 * ratio / (1.0 + ratio)
            }
        }
    }

    /// Norm up to which the kernel is quadratic.
    pub(crate) fn quadratic_until(&self) -> f64 {
        match *self {
            Kernel::Squared => f64::INFINITY,
            Kernel::Huber { scale } => scale,
            Kernel::Cauchy { .. } | Kernel::GemanMcClure { .. } => 0.0,
        }
    }

    /// `ρ` and `ρ'` at the squared norm `s`.
    pub fn at(&self, s: f64) -> Robust {
        match *self {
            Kernel::Squared => Robust {
                cost: s,
                weight: 1.0,
            },
            Kernel::Huber { scale } => {
                if s <= scale * scale {
                    Robust {
                        cost: s,
                        weight: 1.0,
                    }
                } else {
                    let norm = s.sqrt();
                    Robust {
                        cost: scale * (2.0 * norm - scale),
                        weight: scale / norm,
                    }
                }
            }
            Kernel::Cauchy { scale } => {
                let ratio = s / (scale * scale);
                Robust {
                    cost: scale * scale * ratio.ln_1p(),
                    weight: 1.0 / (1.0 + ratio),
                }
            }
            Kernel::GemanMcClure { scale } => {
                let weight = 1.0 / (1.0 + s / (scale * scale));
                Robust {
                    cost: s * weight,
                    weight: weight * weight,
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weight_is_the_slope_and_small_residuals_are_squared() {
        for kernel in [
            Kernel::Squared,
            Kernel::Huber { scale: 1.3 },
            Kernel::Cauchy { scale: 1.3 },
            Kernel::GemanMcClure { scale: 1.3 },
        ] {
            for s in [0.01, 0.5, 1.6, 1.8, 10.0, 1e4] {
                let h = 1e-6 * s;
                let slope = (kernel.at(s + h).cost - kernel.at(s - h).cost) / (2.0 * h);
                assert!(
                    (slope - kernel.at(s).weight).abs() < 1e-7,
                    "{kernel:?} at {s}"
                );
            }
            for s in [0.01, 0.5, 1.6, 1.8, 10.0, 1e4] {
                let h = 1e-6 * s;
                let bend = (kernel.at(s + h).weight - kernel.at(s - h).weight) / (2.0 * h);
                let shortfall = -2.0 * s * bend / kernel.at(s).weight;
                assert!((shortfall - kernel.shortfall(s)).abs() < 1e-6);
            }
            let tiny = kernel.at(1e-9);
            assert!((tiny.cost - 1e-9).abs() < 1e-17 && (tiny.weight - 1.0).abs() < 1e-8);
        }
    }

    #[test]
    fn kernels_are_quadratic_as_far_as_they_say_and_no_farther() {
        assert_eq!(Kernel::Squared.quadratic_until(), f64::INFINITY);
        for kernel in [
            Kernel::Huber { scale: 1.3 },
            Kernel::Cauchy { scale: 1.3 },
            Kernel::GemanMcClure { scale: 1.3 },
        ] {
            let norm = kernel.quadratic_until();
            assert_eq!(kernel.at(norm * norm).cost, norm * norm, "{kernel:?}");
            let beyond = (norm + 0.1_f64).powi(2);
            assert!(kernel.at(beyond).cost < beyond, "{kernel:?}");
        }
    }

    #[test]
    fn scales_mean_what_they_say() {
        assert_eq!(Kernel::Huber { scale: 2.0 }.at(16.0).weight, 0.5);
        assert_eq!(Kernel::Cauchy { scale: 2.0 }.at(4.0).weight, 0.5);
        assert_eq!(Kernel::GemanMcClure { scale: 2.0 }.at(4.0).weight, 0.25);
        assert!(Kernel::GemanMcClure { scale: 2.0 }.at(1e12).cost <= 4.0);
    }
}
