use std::ops::Range;

use crate::divide::on_pool;
use crate::layout::{Layout, POINT};
use crate::linear_system::{LinearSystem, Solver};
use crate::normal::{NormalEquations, Step};
use crate::problem::{BlockId, Problem};
use crate::{Report, Undetermined};

/// Damping under which the matrix is factored: what is determined by less counts as not determined.
const DAMPING: f64 = 1e-15;

/// Eigenvalue of the scaled matrix below which a direction is not determined. What is free has 1e-14 or less, of rounding; the end of a walk that
/// hangs on the IMU by hundreds of frames has 1e-10, and is determined: its standard deviation is some decimetres.
const SMALLEST: f64 = 1e-13;

/// Directions looked for at a time, and rounds of inverse iteration.
const DIRECTIONS: usize = 16;
const ROUNDS: usize = 4;

/// Undetermined parameters named at most.
const MOST_NAMED: usize = 64;

/// Condition and undetermined parameters at the last linearization.
pub(crate) fn diagnose(
    problem: &Problem,
    layout: &Layout,
    normal: &NormalEquations,
    system: &mut LinearSystem,
    report: &mut Report,
) {
    let spectrum = on_pool(|| Spectrum::of(layout, normal, system));
    report.condition = spectrum
        .as_ref()
        .map(|s| s.largest / s.smallest)
        .filter(|condition| condition.is_finite());
    report.undetermined = all_undetermined(problem, layout, normal, spectrum.as_ref());
}

/// Parameters that a linearization does not determine.
pub(crate) fn undetermined(
    problem: &Problem,
    layout: &Layout,
    normal: &NormalEquations,
    system: &mut LinearSystem,
) -> Vec<Undetermined> {
    let spectrum = on_pool(|| Spectrum::of(layout, normal, system));
    all_undetermined(problem, layout, normal, spectrum.as_ref())
}

fn all_undetermined(
    problem: &Problem,
    layout: &Layout,
    normal: &NormalEquations,
    spectrum: Option<&Spectrum>,
) -> Vec<Undetermined> {
    let mut found = undetermined_points(problem, layout, normal);
    for row in spectrum.iter().flat_map(|s| &s.undetermined) {
        // Blocks without free components share the row of the next.
        let i = layout.row_start.partition_point(|start| start <= row) - 1;
        found.push(name(problem, layout.reduced[i], row - layout.row_start[i]));
    }
    found.truncate(MOST_NAMED);
    found
}

fn name(problem: &Problem, block: usize, column: usize) -> Undetermined {
    let component = problem.blocks[block].component(column);
    let block = BlockId(block);
    Undetermined {
        block,
        component,
        block_name: problem.block_name(block),
        component_name: problem.component_name(block, component),
    }
}

/// Points whose own observations leave a direction free: the weakest coordinate is named.
fn undetermined_points(
    problem: &Problem,
    layout: &Layout,
    normal: &NormalEquations,
) -> Vec<Undetermined> {
    let mut found = Vec::new();
    for (hessian, block) in normal.point_hessian.iter().zip(&layout.points) {
        // Elimination with the largest remaining share first; what is left of the last is what determines it.
        let mut rest = *hessian;
        let mut open = [true; POINT];
        for _ in 0..POINT {
            let share = |d: usize| rest[(d, d)] / hessian[(d, d)].max(f64::MIN_POSITIVE);
            let Some(pivot) = (0..POINT)
                .filter(|d| open[*d])
                .max_by(|a, b| share(*a).total_cmp(&share(*b)))
            else {
                break;
            };
            if !(share(pivot) > SMALLEST) {
                let column = (0..POINT).rfind(|d| open[*d]).unwrap_or(pivot);
                found.push(name(problem, *block, column));
                break;
            }
            open[pivot] = false;
            let column = rest.column(pivot) / rest[(pivot, pivot)];
            let row = rest.row(pivot).into_owned();
            rest -= column * row;
        }
        if found.len() >= MOST_NAMED {
            break;
        }
    }
    found
}

/// Extreme eigenvalues of the reduced matrix, scaled to what each parameter alone is determined by.
struct Spectrum {
    smallest: f64,
    largest: f64,
    /// Rows that stand for the directions of vanishing eigenvalues.
    undetermined: Vec<usize>,
}

impl Spectrum {
    fn of(layout: &Layout, normal: &NormalEquations, system: &mut LinearSystem) -> Option<Self> {
        let n = layout.dimension();
        let mut step = Step::new(layout);
        let mut damping = DAMPING;
        if n == 0 || !matches!(system.solver, Solver::Direct(_)) {
            return None;
        }
        if normal.diagonal.iter().all(|d| *d == 0.0) {
            return Some(Self {
                smallest: 0.0,
                largest: 0.0,
                undetermined: (0..n.min(MOST_NAMED)).collect(),
            });
        }
        match system.factored {
            Some(small) if small <= DAMPING => {}
            _ => {
                while !system.solve(normal, layout, damping, &mut step) {
                    damping *= 100.0;
                    if damping > 1e-4 {
                        return None;
                    }
                }
            }
        }
        let Solver::Direct(factorization) = &mut system.solver else {
            return None;
        };
        let scale: Vec<f64> = (0..n)
            .map(|k| normal.damping(normal.diagonal[k], 1.0).sqrt())
            .map(|s| if s > 0.0 { s } else { 1.0 })
            .collect();
        // x ← D½ (S + ε D)⁻¹ D½ x. The factor is that of S + ε D, so that eigenvalues are found ε too large.
        let mut solve = |x: &mut [f64]| {
            x.iter_mut().zip(&scale).for_each(|(x, s)| *x *= s);
            factorization.solve(x);
            x.iter_mut().zip(&scale).for_each(|(x, s)| *x *= s);
        };
        // One direction is enough to see that nothing is free.
        let mut basis = vec![start(0, n)];
        let first = inverse_iterate(&mut basis, &mut solve);
        let mut undetermined = Vec::new();
        let smallest_allowed = SMALLEST.max(100.0 * damping);
        let mut smallest = first[0];
        if smallest < smallest_allowed {
            // As many directions as it takes to find one that is determined.
            let mut count = DIRECTIONS.min(n);
            loop {
                basis = (0..count).map(|k| start(k, n)).collect();
                let values = inverse_iterate(&mut basis, &mut solve);
                let free = values.iter().filter(|v| **v < smallest_allowed).count();
                smallest = values.iter().copied().fold(smallest, f64::min);
                if free < count || count == n || count >= MOST_NAMED {
                    let directions: Vec<Vec<f64>> = basis
                        .into_iter()
                        .zip(&values)
                        .filter(|(_, value)| **value < smallest_allowed)
                        .map(|(vector, _)| vector)
                        .collect();
                    undetermined = representatives(directions);
                    break;
                }
                count = (2 * count).min(n).min(MOST_NAMED);
            }
        }
        let largest = largest_eigenvalue(layout, &system.reduced.matrix, &scale);
        Some(Self {
            smallest,
            largest,
            undetermined,
        })
    }
}

/// A start that leans on no parameter: numbers without pattern, but the same each time.
fn start(seed: usize, n: usize) -> Vec<f64> {
    let mut state = (seed as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    (0..n)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        })
        .collect()
}

/// Turns `basis` towards the smallest eigenvalues, which it returns: Rayleigh quotients of an orthonormal basis that
/// diagonalises the matrix on its span.
fn inverse_iterate(basis: &mut [Vec<f64>], solve: &mut impl FnMut(&mut [f64])) -> Vec<f64> {
    let count = basis.len();
    let mut values = vec![f64::INFINITY; count];
    orthonormalize(basis);
    for _ in 0..ROUNDS {
        let before: Vec<Vec<f64>> = basis.to_vec();
        basis.iter_mut().for_each(|x| solve(x));
        // The inverse on the span, whose eigenvalues are the inverses of those looked for.
        let projected = nalgebra::DMatrix::from_fn(count, count, |r, c| {
            0.5 * (product(&before[r], &basis[c]) + product(&before[c], &basis[r]))
        });
        if !projected.iter().all(|x| x.is_finite()) {
            return values;
        }
        let eigen = nalgebra::SymmetricEigen::new(projected);
        let turned: Vec<Vec<f64>> = (0..count)
            .map(|k| {
                let mut sum = vec![0.0; before[0].len()];
                for (x, factor) in basis.iter().zip(eigen.eigenvectors.column(k).iter()) {
                    sum.iter_mut().zip(x).for_each(|(s, x)| *s += factor * x);
                }
                sum
            })
            .collect();
        for (k, x) in turned.into_iter().enumerate() {
            values[k] = 1.0 / eigen.eigenvalues[k].max(f64::MIN_POSITIVE);
            basis[k] = x;
        }
        orthonormalize(basis);
    }
    values
}

fn product(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

fn orthonormalize(basis: &mut [Vec<f64>]) {
    for k in 0..basis.len() {
        let (done, rest) = basis.split_at_mut(k);
        let x = &mut rest[0];
        // Twice is enough.
        for _ in 0..2 {
            for y in done.iter() {
                let share = product(x, y);
                x.iter_mut().zip(y).for_each(|(x, y)| *x -= share * y);
            }
        }
        let length = product(x, x).sqrt();
        if length > 0.0 {
            x.iter_mut().for_each(|x| *x /= length);
        }
    }
}

/// One row for each direction: the one that moves most, taken out of the other directions before the next.
fn representatives(mut directions: Vec<Vec<f64>>) -> Vec<usize> {
    let mut rows = Vec::new();
    while !directions.is_empty() {
        let mut best = (0, 0, 0.0);
        for (d, direction) in directions.iter().enumerate() {
            for (row, x) in direction.iter().enumerate() {
                if x.abs() > best.2 {
                    best = (d, row, x.abs());
                }
            }
        }
        let (d, row, size) = best;
        if !(size > 1e-6) {
            break;
        }
        let pivot = directions.swap_remove(d);
        for direction in &mut directions {
            let share = direction[row] / pivot[row];
            direction
                .iter_mut()
                .zip(&pivot)
                .for_each(|(x, p)| *x -= share * p);
            direction[row] = 0.0;
        }
        rows.push(row);
    }
    rows.sort_unstable();
    rows
}

/// Largest eigenvalue of the scaled matrix, by the power method: within a few percent.
fn largest_eigenvalue(layout: &Layout, matrix: &[f64], scale: &[f64]) -> f64 {
    let mut x = start(0, scale.len());
    let mut value = 1.0;
    for _ in 0..8 {
        let length = product(&x, &x).sqrt();
        let scaled: Vec<f64> = x.iter().zip(scale).map(|(x, s)| x / (s * length)).collect();
        let mut moved = vec![0.0; scale.len()];
        for i in 0..layout.reduced.len() {
            for (k, block) in layout.columns.get(i).iter().enumerate() {
                add_symmetric(
                    matrix,
                    block.start,
                    layout.rows(block.row as usize),
                    layout.rows(i),
                    k > 0,
                    &scaled,
                    &mut moved,
                );
            }
        }
        moved.iter_mut().zip(scale).for_each(|(m, s)| *m /= s);
        value = product(&moved, &moved).sqrt();
        x = moved;
    }
    value
}

/// Adds the product of one block, and of its mirror image, to `moved`.
fn add_symmetric(
    matrix: &[f64],
    start: usize,
    rows: Range<usize>,
    columns: Range<usize>,
    mirrored: bool,
    x: &[f64],
    moved: &mut [f64],
) {
    for (c, column) in columns.zip(matrix[start..].chunks_exact(rows.len().max(1))) {
        for (r, value) in rows.clone().zip(column) {
            moved[r] += value * x[c];
            if mirrored {
                moved[c] += value * x[r];
            }
        }
    }
}
