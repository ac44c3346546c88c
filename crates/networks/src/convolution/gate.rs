use std::f32::consts::LOG2_E;

/// What happens to each value behind a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Gate {
    /// Nothing.
    None,
    /// Negative values become zero.
    Relu,
    /// Scaled exponential linear unit (Klambauer et al., "Self-normalizing neural networks", NIPS 2017).
    Selu,
}

/// Of the scaled exponential linear unit, λ and α in its paper.
const SELU_SCALE: f32 = 1.050_701;
const SELU_ALPHA: f32 = 1.673_263_2;

impl Gate {
    /// Applies it to all values.
    pub fn apply(self, values: &mut [f32]) {
        match self {
            Self::None => {}
            Self::Relu => values.iter_mut().for_each(|v| *v = v.max(0.0)),
            Self::Selu => values.iter_mut().for_each(|v| {
                let below = SELU_ALPHA * (exp_of_negative(v.min(0.0)) - 1.0);
                *v = SELU_SCALE * (v.max(0.0) + below);
            }),
        }
    }
}

/// e^x of x ≤ 0, to 2e-7. Without a branch or a call, so that the compiler takes several at a time.
fn exp_of_negative(x: f32) -> f32 {
    /// Beyond it e^x is smaller than any number that matters.
    const LEAST: f32 = -87.0;
    /// Numbers around 1.5 · 2²³ have no fraction, and their lowest bits are the integer.
    const ROUND: f32 = 12_582_912.0;
    /// ln 2 in two parts, the first short enough that its multiples are exact.
    const LN2_HIGH: f32 = 0.693_359_4;
    const LN2_LOW: f32 = -2.121_944_4e-4;
    const EXPONENT_BIAS: u32 = 127;
    const FRACTION_BITS: u32 = 23;
    let x = x.max(LEAST);
    let rounded = x * LOG2_E + ROUND;
    let power = rounded - ROUND;
    let r = x - power * LN2_HIGH - power * LN2_LOW;
    // The series of e^r, |r| ≤ ln 2 / 2.
    let series = 1.0
        + r * (1.0
            + r * (1.0 / 2.0
                + r * (1.0 / 6.0
                    + r * (1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0 + r / 5040.0))))));
    let bits = rounded.to_bits().wrapping_add(EXPONENT_BIAS) << FRACTION_BITS;
    f32::from_bits(bits) * series
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponentials_and_gates() {
        for i in 0..=90_000 {
            let x = -i as f32 / 1000.0;
            let exact = f64::from(x).exp();
            let error = (f64::from(exp_of_negative(x)) - exact).abs();
            assert!(error <= 2e-7 * exact + 2e-38, "{x}: {error}");
        }
        let mut values = [-1e9, -1.0, -1e-3, 0.0, 2.0];
        Gate::Selu.apply(&mut values);
        // As PyTorch 2 has them.
        let expected = [-1.758_099_3, -1.111_330_7, -1.757_220_6e-3, 0.0, 2.101_402];
        for (value, expected) in values.iter().zip(expected) {
            assert!((value - expected).abs() < 4e-7, "{value} {expected}");
        }
    }
}
