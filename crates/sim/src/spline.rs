//! Uniform quintic B-splines: four times continuously differentiable, so that velocity and acceleration are exact and
//! smooth.

/// Value and first two derivatives by time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Jet<const N: usize> {
    pub value: [f64; N],
    pub rate: [f64; N],
    pub acceleration: [f64; N],
}

/// A curve in N dimensions over `[0, duration]`.
#[derive(Clone, Debug)]
pub(crate) struct QuinticSpline<const N: usize> {
    knot_s: f64,
    control: Vec<[f64; N]>,
}

/// Control points before a knot interval that bear on it.
const BEFORE: i64 = 2;

impl<const N: usize> QuinticSpline<N> {
    /// The curve that follows (and smooths) `target`, asked at multiples of `knot_s`.
    pub(crate) fn following(
        duration_s: f64,
        knot_s: f64,
        target: impl Fn(f64) -> [f64; N],
    ) -> Self {
        let intervals = (duration_s / knot_s).ceil() as i64;
        let control = (-BEFORE..=intervals + 3)
            .map(|k| target(k as f64 * knot_s))
            .collect();
        Self { knot_s, control }
    }

    /// Value and derivatives at `time_s`; outside the curve those at its nearer end.
    pub(crate) fn at(&self, time_s: f64) -> Jet<N> {
        let last = (self.control.len() - 6) as f64;
        let position = (time_s / self.knot_s).clamp(0.0, last + 1.0);
        let interval = position.floor().min(last);
        let u = position - interval;
        let first = interval as usize;
        let basis = Basis::at(u);
        let mut jet = Jet {
            value: [0.0; N],
            rate: [0.0; N],
            acceleration: [0.0; N],
        };
        let inverse = 1.0 / self.knot_s;
        for (k, control) in self.control[first..first + 6].iter().enumerate() {
            for (n, c) in control.iter().enumerate() {
                jet.value[n] += basis.value[k] * c;
                jet.rate[n] += basis.first[k] * inverse * c;
                jet.acceleration[n] += basis.second[k] * inverse * inverse * c;
            }
        }
        jet
    }
}

/// The six basis functions over one interval and their derivatives by `u`.
struct Basis {
    value: [f64; 6],
    first: [f64; 6],
    second: [f64; 6],
}

impl Basis {
    fn at(u: f64) -> Self {
        // Cox–de Boor on a uniform knot vector: N_{k,p}(u) from N_{k,p-1}.
        let mut cubic = [0.0; 6];
        let mut quartic = [0.0; 6];
        let mut n = [0.0; 6];
        n[0] = 1.0;
        for degree in 1..=5 {
            let p = degree as f64;
            let mut next = [0.0; 6];
            for k in 0..=degree {
                // Function k of this degree starts `degree − k` knots before the interval.
                let x = u + (degree - k) as f64;
                if k < degree {
                    next[k] += (p + 1.0 - x) / p * n[k];
                }
                if k > 0 {
                    next[k] += x / p * n[k - 1];
                }
            }
            n = next;
            match degree {
                3 => cubic = n,
                4 => quartic = n,
                _ => {}
            }
        }
        // d/du N_{k,p} = N_{k-1,p-1} − N_{k,p-1} in this numbering.
        let before =
            |a: &[f64; 6], k: usize, back: usize| k.checked_sub(back).map_or(0.0, |i| a[i]);
        let first = std::array::from_fn(|k| before(&quartic, k, 1) - quartic[k]);
        let second =
            std::array::from_fn(|k| before(&cubic, k, 2) - 2.0 * before(&cubic, k, 1) + cubic[k]);
        Self {
            value: n,
            first,
            second,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn basis_is_a_partition_of_unity_and_reproduces_lines_and_parabolas() {
        let line = QuinticSpline::following(2.0, 0.1, |t| [3.0 * t - 1.0, t * t]);
        for i in 0..200 {
            let t = 0.01 * f64::from(i);
            let jet = line.at(t);
            assert!((jet.value[0] - (3.0 * t - 1.0)).abs() < 1e-12, "{t}");
            assert!((jet.rate[0] - 3.0).abs() < 1e-11 && jet.acceleration[0].abs() < 1e-9);
            // A B-spline of control values t² is t² plus a constant.
            assert!(
                (jet.rate[1] - 2.0 * t).abs() < 1e-11 && (jet.acceleration[1] - 2.0).abs() < 1e-9
            );
        }
    }

    #[test]
    fn derivatives_match_numeric_differences_also_across_knots() {
        let curve = QuinticSpline::following(2.0, 0.1, |t| [(7.0 * t).sin()]);
        let h = 1e-5;
        for i in 1..190 {
            let t = 0.01 * f64::from(i);
            let (a, m, b) = (curve.at(t - h), curve.at(t), curve.at(t + h));
            assert!(((b.value[0] - a.value[0]) / (2.0 * h) - m.rate[0]).abs() < 1e-7);
            assert!(((b.rate[0] - a.rate[0]) / (2.0 * h) - m.acceleration[0]).abs() < 1e-6);
        }
    }
}
