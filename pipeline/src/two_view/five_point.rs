//! Essential matrices from five pairs of rays.
//!
//! The five epipolar constraints leave `E = x X + y Y + z Z + W`. That `E` is essential, `det E = 0` and
//! `2 E Eᵀ E − tr(E Eᵀ) E = 0`, are ten cubic equations in `x`, `y`, `z`: solved for the ten cubic monomials, they say what a
//! multiplication by `x` does to the ten others, whose values at the solutions are the eigenvectors of that action.

use lsfb_geometry::{Matrix3, Vector3};
use nalgebra::{DMatrix, SMatrix, SVector, Schur};

/// Monomials up to the third degree; the first ten are the cubic ones.
const MONOMIALS: [[u8; 3]; 20] = [
    [3, 0, 0],
    [2, 1, 0],
    [1, 2, 0],
    [0, 3, 0],
    [2, 0, 1],
    [1, 1, 1],
    [0, 2, 1],
    [1, 0, 2],
    [0, 1, 2],
    [0, 0, 3],
    [2, 0, 0],
    [1, 1, 0],
    [0, 2, 0],
    [1, 0, 1],
    [0, 1, 1],
    [0, 0, 2],
    [1, 0, 0],
    [0, 1, 0],
    [0, 0, 1],
    [0, 0, 0],
];
/// Where `x`, `y`, `z` and 1 are among them.
const LINEAR: [usize; 4] = [16, 17, 18, 19];
/// `x` times each of the last ten monomials: a cubic one, or one of the last ten again.
const TIMES_X: [usize; 10] = [0, 1, 2, 4, 5, 7, 10, 11, 13, 16];

/// Coefficients of the monomials.
type Polynomial = SVector<f64, 20>;
type Matrix10 = SMatrix<f64, 10, 10>;

/// Every essential matrix, of norm √2, with `secondᵀ E first = 0` for five pairs of unit rays: at most ten. None where the pairs do
/// not leave a finite number, as pairs that repeat, or rays that no motion but a rotation separates.
pub fn essential_matrices(
    first: &[Vector3<f64>; 5],
    second: &[Vector3<f64>; 5],
) -> Vec<Matrix3<f64>> {
    let Some(basis) = null_space(first, second) else {
        return Vec::new();
    };
    let equations = constraints(&basis);
    let Some(action) = action_of_x(&equations) else {
        return Vec::new();
    };
    let mut found: Vec<Matrix3<f64>> = Vec::new();
    for value in real_eigenvalues(&action) {
        let Some(at) = eigenvector(&action, value).and_then(|at| polished(&equations, at)) else {
            continue;
        };
        let essential = basis[0] * at.x + basis[1] * at.y + basis[2] * at.z + basis[3];
        let essential = essential * (std::f64::consts::SQRT_2 / essential.norm());
        // Two eigenvalues that nearly coincide may lead to one solution.
        let again = |e: &Matrix3<f64>| (e - essential).norm().min((e + essential).norm()) < 1e-9;
        if essential.iter().all(|v| v.is_finite()) && !found.iter().any(again) {
            found.push(essential);
        }
    }
    found
}

/// Four matrices that span all with `secondᵀ E first = 0`.
fn null_space(first: &[Vector3<f64>; 5], second: &[Vector3<f64>; 5]) -> Option<[Matrix3<f64>; 4]> {
    let mut rows = SMatrix::<f64, 9, 9>::zeros();
    for (row, (a, b)) in first.iter().zip(second).enumerate() {
        let product = b * a.transpose();
        for (column, value) in product.iter().enumerate() {
            rows[(row, column)] = *value;
        }
    }
    if !rows.iter().all(|v| v.is_finite()) {
        return None;
    }
    let svd = rows.try_svd(false, true, f64::EPSILON, 300)?;
    let right = svd.v_t?;
    let mut order: Vec<usize> = (0..9).collect();
    order.sort_by(|a, b| svd.singular_values[*b].total_cmp(&svd.singular_values[*a]));
    // A pair that says what the others say leaves more than four.
    if svd.singular_values[order[4]] < 1e-10 * svd.singular_values[order[0]] {
        return None;
    }
    let matrix = |k: usize| Matrix3::from_iterator(right.row(order[5 + k]).iter().copied());
    Some([matrix(0), matrix(1), matrix(2), matrix(3)])
}

/// The ten equations, each divided by its norm.
fn constraints(basis: &[Matrix3<f64>; 4]) -> SMatrix<f64, 10, 20> {
    let e: [[Polynomial; 3]; 3] = std::array::from_fn(|r| {
        std::array::from_fn(|c| {
            let mut p = Polynomial::zeros();
            for (place, matrix) in LINEAR.into_iter().zip(basis) {
                p[place] = matrix[(r, c)];
            }
            p
        })
    });
    let product: [[Polynomial; 3]; 3] = std::array::from_fn(|r| {
        std::array::from_fn(|c| (0..3).map(|k| times(&e[r][k], &e[c][k])).sum())
    });
    let trace = product[0][0] + product[1][1] + product[2][2];
    let mut equations = SMatrix::<f64, 10, 20>::zeros();
    let mut put = |row: usize, p: &Polynomial| {
        let norm = p.norm().max(f64::MIN_POSITIVE);
        equations.set_row(row, &(p / norm).transpose());
    };
    for (r, of_row) in product.iter().enumerate() {
        for (c, entry) in e[r].iter().enumerate() {
            let cubed: Polynomial = (0..3).map(|k| times(&of_row[k], &e[k][c])).sum();
            put(3 * r + c, &(cubed * 2.0 - times(&trace, entry)));
        }
    }
    let minor = |a: usize, b: usize| times(&e[1][a], &e[2][b]) - times(&e[1][b], &e[2][a]);
    let determinant = times(&minor(1, 2), &e[0][0])
        + times(&minor(2, 0), &e[0][1])
        + times(&minor(0, 1), &e[0][2]);
    put(9, &determinant);
    equations
}

/// A product of at most the third degree; what lies beyond is left out.
fn times(a: &Polynomial, b: &Polynomial) -> Polynomial {
    let mut product = Polynomial::zeros();
    for (i, x) in a.iter().enumerate().filter(|(_, x)| **x != 0.0) {
        for (j, y) in b.iter().enumerate().filter(|(_, y)| **y != 0.0) {
            let exponents: [u8; 3] = std::array::from_fn(|k| MONOMIALS[i][k] + MONOMIALS[j][k]);
            if let Some(place) = place_of(exponents) {
                product[place] += x * y;
            }
        }
    }
    product
}

/// Where a monomial is in [`MONOMIALS`].
fn place_of(exponents: [u8; 3]) -> Option<usize> {
    const PLACES: [u8; 64] = {
        let mut places = [u8::MAX; 64];
        let mut k = 0;
        while k < MONOMIALS.len() {
            let [x, y, z] = MONOMIALS[k];
            places[(x * 16 + y * 4 + z) as usize] = k as u8;
            k += 1;
        }
        places
    };
    let [x, y, z] = exponents.map(usize::from);
    let place = *PLACES.get(x * 16 + y * 4 + z)?;
    let in_table = x < 4 && y < 4 && z < 4 && place != u8::MAX;
    in_table.then_some(usize::from(place))
}

/// What a multiplication by `x` does to the last ten monomials, at the solutions.
fn action_of_x(equations: &SMatrix<f64, 10, 20>) -> Option<Matrix10> {
    let cubic: Matrix10 = equations.fixed_columns::<10>(0).into_owned();
    let others: Matrix10 = equations.fixed_columns::<10>(10).into_owned();
    let solved = cubic.full_piv_lu().solve(&others)?;
    let mut action = Matrix10::zeros();
    for (row, place) in TIMES_X.into_iter().enumerate() {
        match place.checked_sub(10) {
            None => action.set_row(row, &-solved.row(place)),
            Some(again) => action[(row, again)] = 1.0,
        }
    }
    action.iter().all(|v| v.is_finite()).then_some(action)
}

/// Steps of the QR iteration at most.
const SCHUR_STEPS: usize = 500;
/// Share of an eigenvalue that may be imaginary: of two that coincide, rounding makes a complex pair.
const IMAGINARY: f64 = 1e-5;

fn real_eigenvalues(action: &Matrix10) -> Vec<f64> {
    let dynamic = DMatrix::from_column_slice(10, 10, action.as_slice());
    let Some(schur) = Schur::try_new(dynamic, f64::EPSILON, SCHUR_STEPS) else {
        return Vec::new();
    };
    let values = schur.complex_eigenvalues();
    let real = values
        .iter()
        .filter(|v| v.im.abs() <= IMAGINARY * (1.0 + v.re.abs()));
    real.map(|v| v.re).collect()
}

/// `x`, `y` and `z` at a solution, by inverse iteration.
fn eigenvector(action: &Matrix10, value: f64) -> Option<Vector3<f64>> {
    // Off the eigenvalue by as much as it is uncertain: the system is then as good as singular, and can be solved.
    let shifted = action - Matrix10::identity() * (value + 1e-10 * (1.0 + value.abs()));
    let factors = shifted.lu();
    let mut vector = SVector::<f64, 10>::repeat(1.0);
    for _ in 0..3 {
        vector = factors.solve(&vector)?;
        vector /= vector.norm();
    }
    let found = Vector3::new(vector[6], vector[7], vector[8]) / vector[9];
    found.iter().all(|v| v.is_finite()).then_some(found)
}

/// Newton's steps on the ten equations: what rounding in the elimination has taken away.
fn polished(equations: &SMatrix<f64, 10, 20>, mut at: Vector3<f64>) -> Option<Vector3<f64>> {
    const STEPS: usize = 10;
    /// Of equations of unit norm, in units of the largest monomial: what is no solution is far above.
    const SOLVED: f64 = 1e-9;
    let mut residual = f64::INFINITY;
    for _ in 0..STEPS {
        let (monomials, derivatives) = monomials_at(&at);
        let scale = monomials.amax();
        let errors = equations * monomials;
        let next = errors.amax() / scale;
        if next >= residual {
            break;
        }
        residual = next;
        let jacobian = equations * derivatives;
        let Some(step) = jacobian.svd(true, true).solve(&errors, 1e-14).ok() else {
            break;
        };
        at -= step;
    }
    let (monomials, _) = monomials_at(&at);
    let left = (equations * monomials).amax() / monomials.amax();
    (left <= SOLVED).then_some(at)
}

/// All monomials, and their derivatives.
fn monomials_at(at: &Vector3<f64>) -> (Polynomial, SMatrix<f64, 20, 3>) {
    let power = |axis: usize, exponent: u8| at[axis].powi(i32::from(exponent));
    let mut values = Polynomial::zeros();
    let mut derivatives = SMatrix::zeros();
    for (row, exponents) in MONOMIALS.iter().enumerate() {
        values[row] = (0..3).map(|k| power(k, exponents[k])).product();
        for axis in (0..3).filter(|k| exponents[*k] > 0) {
            let others = (0..3)
                .filter(|k| *k != axis)
                .map(|k| power(k, exponents[k]));
            let own = f64::from(exponents[axis]) * power(axis, exponents[axis] - 1);
            derivatives[(row, axis)] = own * others.product::<f64>();
        }
    }
    (values, derivatives)
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Se3, Vector6, so3};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// How far the nearest of the solutions is from the truth, for points of the first camera's frame.
    fn distance(points: &[Vector3<f64>; 5], second_from_first: &Se3) -> (f64, usize) {
        let first = points.map(|p| p.normalize());
        let second = points.map(|p| (*second_from_first * p).normalize());
        let truth = so3::hat(&second_from_first.translation.normalize())
            * second_from_first.rotation_matrix();
        let found = essential_matrices(&first, &second);
        for e in &found {
            for (a, b) in first.iter().zip(&second) {
                assert!(b.dot(&(e * a)).abs() < 1e-12);
            }
            assert!(e.determinant().abs() < 1e-8);
        }
        let off = |e: &Matrix3<f64>| (e - truth).norm().min((e + truth).norm());
        let least = found.iter().map(off).fold(f64::INFINITY, f64::min);
        (least, found.len())
    }

    fn any(rng: &mut ChaCha8Rng, reach: f64) -> f64 {
        rng.random_range(-reach..reach)
    }

    /// Deviations of many noiseless samples, ascending.
    fn distances(mut sample: impl FnMut(&mut ChaCha8Rng) -> ([Vector3<f64>; 5], Se3)) -> Vec<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let found = (0..500).map(|_| {
            let (points, pose) = sample(&mut rng);
            distance(&points, &pose).0
        });
        let mut found: Vec<f64> = found.collect();
        found.sort_by(f64::total_cmp);
        found
    }

    fn anywhere(rng: &mut ChaCha8Rng) -> [Vector3<f64>; 5] {
        std::array::from_fn(|_| Vector3::new(any(rng, 2.0), any(rng, 2.0), 4.0 + any(rng, 2.0)))
    }

    fn motion(rng: &mut ChaCha8Rng) -> Se3 {
        let turn: [f64; 6] = std::array::from_fn(|k| any(rng, if k < 3 { 0.5 } else { 1.0 }));
        Se3::exp(&Vector6::from(turn))
    }

    #[test]
    fn noiseless_samples_contain_the_truth() {
        let found = distances(|rng| (anywhere(rng), motion(rng)));
        // A few of five hundred samples lie next to a degenerate one, where rounding is what it is.
        assert!(found[489] < 1e-8, "{:e} {:e}", found[489], found[499]);
        assert!(found[499] < 1e-4, "{:e}", found[499]);
    }

    #[test]
    fn so_do_samples_of_a_plane() {
        let found = distances(|rng| {
            let tilt = [any(rng, 0.3), any(rng, 0.3)];
            let points =
                anywhere(rng).map(|p| Vector3::new(p.x, p.y, 4.0 + tilt[0] * p.x + tilt[1] * p.y));
            (points, motion(rng))
        });
        assert!(found[489] < 1e-8, "{:e} {:e}", found[489], found[499]);
    }

    #[test]
    fn so_do_samples_of_a_camera_that_goes_straight_ahead() {
        let found = distances(|rng| {
            let ahead = Vector6::new(
                any(rng, 0.05),
                any(rng, 0.05),
                any(rng, 0.05),
                0.0,
                0.0,
                -0.5,
            );
            (anywhere(rng), Se3::exp(&ahead))
        });
        assert!(found[489] < 1e-8, "{:e} {:e}", found[489], found[499]);
    }

    #[test]
    fn what_determines_nothing_gives_nothing() {
        let ray = |x: f64, y: f64| Vector3::new(x, y, 1.0).normalize();
        let rays = [
            ray(0.1, 0.2),
            ray(-0.3, 0.1),
            ray(0.4, -0.2),
            ray(0.0, 0.3),
            ray(0.2, 0.2),
        ];
        let repeated = [rays[0], rays[0], rays[2], rays[3], rays[4]];
        assert!(essential_matrices(&repeated, &repeated).is_empty());
        let none = [Vector3::zeros(); 5];
        assert!(essential_matrices(&none, &none).is_empty());
        let mut torn = rays;
        torn[3].x = f64::NAN;
        assert!(essential_matrices(&torn, &rays).is_empty());
        // Nothing has moved: whatever is found is no reason to fall over.
        for e in essential_matrices(&rays, &rays) {
            assert!(e.iter().all(|v| v.is_finite()));
        }
    }
}
