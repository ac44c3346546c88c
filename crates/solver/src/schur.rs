use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::layout::{Layout, POINT, Place};
use crate::problem::Problem;

/// Points per parallel task. Fixed, so that results do not depend on the number of threads.
const CHUNK: usize = 128;

/// Diagonal entries below this share of the largest are damped as if they were there.
const SMALLEST_DAMPED_SHARE: f64 = 1e-12;

/// The normal equations `H δ = −g`, with eliminated points apart from the reduced blocks.
pub(crate) struct NormalEquations {
    /// `H` and `g` of the points.
    point_hessian: Vec<Matrix3<f64>>,
    pub point_gradient: Vec<Vector3<f64>>,
    /// `H` between reduced blocks and points, `tangent × 3` by pair, columns first.
    coupling: Vec<f64>,
    /// Lower triangle of `H` between reduced blocks, in the order of [`Layout::row_index`].
    hessian: Vec<f64>,
    pub gradient: Vec<f64>,
    diagonal: Vec<f64>,
    /// Damping of entries that are smaller.
    floor: f64,
}

/// The reduced system for one damping.
pub(crate) struct ReducedSystem {
    /// Lower triangle of the Schur complement.
    pub matrix: Vec<f64>,
    pub right_side: Vec<f64>,
    point_inverse: Vec<Matrix3<f64>>,
    /// Coupling times inverse.
    gain: Vec<f64>,
}

/// A step in all free blocks.
pub(crate) struct Step {
    pub reduced: Vec<f64>,
    pub points: Vec<Vector3<f64>>,
}

impl NormalEquations {
    pub fn new(layout: &Layout) -> Self {
        Self {
            point_hessian: vec![Matrix3::zeros(); layout.points.len()],
            point_gradient: vec![Vector3::zeros(); layout.points.len()],
            coupling: vec![0.0; layout.pair_len],
            hessian: vec![0.0; layout.row_index.len()],
            gradient: vec![0.0; layout.dimension()],
            diagonal: vec![0.0; layout.dimension()],
            floor: 0.0,
        }
    }

    /// Sums the records up. Every sum is made by one thread in the order of the residuals.
    pub fn assemble(&mut self, problem: &Problem, layout: &Layout, records: &[f64]) {
        self.assemble_points(problem, layout, records);
        self.assemble_reduced(problem, layout, records);
        let points = self
            .point_hessian
            .iter()
            .flat_map(|h| [h[(0, 0)], h[(1, 1)], h[(2, 2)]]);
        self.floor = SMALLEST_DAMPED_SHARE
            * points
                .chain(self.diagonal.iter().copied())
                .fold(0.0, f64::max);
    }

    fn assemble_points(&mut self, problem: &Problem, layout: &Layout, records: &[f64]) {
        split_by_points(layout, &mut self.coupling)
            .into_par_iter()
            .zip(self.point_hessian.par_chunks_mut(CHUNK))
            .zip(self.point_gradient.par_chunks_mut(CHUNK))
            .enumerate()
            .for_each(|(chunk, ((coupling, hessians), gradients))| {
                coupling.fill(0.0);
                let first = chunk * CHUNK;
                let base = layout
                    .pairs
                    .get(layout.pairs_of_point[first])
                    .map_or(0, |pair| pair.start);
                for (offset, (h, g)) in hessians.iter_mut().zip(gradients).enumerate() {
                    let point = first + offset;
                    let pairs = layout.pairs_at(point);
                    *h = Matrix3::zeros();
                    *g = Vector3::zeros();
                    for incidence in layout.by_point.get(point) {
                        let k = incidence.residual;
                        let record = &records[layout.record_start[k]..layout.record_start[k + 1]];
                        let dimension = problem.residuals[k].dimension;
                        let by_point = &record[incidence.jacobian..][..dimension * POINT];
                        for (r, row) in record[..dimension].iter().zip(by_point.chunks_exact(POINT))
                        {
                            let row = Vector3::from_column_slice(row);
                            *h += row * row.transpose();
                            *g += row * *r;
                        }
                        for slot in layout.slots_of(k) {
                            let Place::Reduced(i) = layout.places[slot.block] else {
                                continue;
                            };
                            let Ok(found) = pairs.binary_search_by_key(&i, |pair| pair.reduced)
                            else {
                                continue;
                            };
                            let n = layout.tangent(i);
                            let block = &mut coupling[pairs[found].start - base..][..POINT * n];
                            let jacobian = &record[slot.jacobian..][..dimension * n];
                            for (row, by_point) in
                                jacobian.chunks_exact(n).zip(by_point.chunks_exact(POINT))
                            {
                                for (column, factor) in block.chunks_exact_mut(n).zip(by_point) {
                                    add_scaled(column, row, *factor);
                                }
                            }
                        }
                    }
                }
            });
    }

    fn assemble_reduced(&mut self, problem: &Problem, layout: &Layout, records: &[f64]) {
        let tasks: Vec<_> =
            split_by_blocks(layout, &mut self.hessian, |i| layout.values_of(i).len())
                .into_iter()
                .zip(split_by_blocks(layout, &mut self.gradient, |i| {
                    layout.tangent(i)
                }))
                .zip(split_by_blocks(layout, &mut self.diagonal, |i| {
                    layout.tangent(i)
                }))
                .collect();
        tasks.into_par_iter().enumerate().for_each_init(
            || vec![0; layout.reduced.len()],
            |row_of, (i, ((hessian, gradient), diagonal))| {
                hessian.fill(0.0);
                gradient.fill(0.0);
                let mut panel = Panel::new(layout, i, hessian, row_of);
                for incidence in layout.by_reduced.get(i) {
                    let k = incidence.residual;
                    let record = &records[layout.record_start[k]..layout.record_start[k + 1]];
                    let dimension = problem.residuals[k].dimension;
                    let own = &record[incidence.jacobian..][..dimension * panel.columns];
                    for (row, r) in own.chunks_exact(panel.columns).zip(&record[..dimension]) {
                        add_scaled(gradient, row, *r);
                    }
                    for slot in layout.slots_of(k) {
                        if let Place::Reduced(j) = layout.places[slot.block]
                            && j >= i
                        {
                            let n = layout.tangent(j);
                            let other = &record[slot.jacobian..][..dimension * n];
                            for (own, other) in
                                own.chunks_exact(panel.columns).zip(other.chunks_exact(n))
                            {
                                for (c, factor) in own.iter().enumerate() {
                                    panel.add_scaled(row_of[j], c, other, *factor);
                                }
                            }
                        }
                    }
                }
                for (c, entry) in diagonal.iter_mut().enumerate() {
                    *entry = panel.column(c)[0];
                }
            },
        );
    }

    /// Largest entry of the gradient.
    pub fn gradient_max_norm(&self) -> f64 {
        self.point_gradient
            .iter()
            .map(Vector3::amax)
            .chain(self.gradient.iter().map(|g| g.abs()))
            .fold(0.0, f64::max)
    }

    fn damping(&self, diagonal: f64, lambda: f64) -> f64 {
        lambda * diagonal.max(self.floor)
    }

    /// Eliminates the points from `(H + λ diag H) δ = −g`.
    pub fn reduce(&self, layout: &Layout, lambda: f64, system: &mut ReducedSystem) {
        self.invert_points(layout, lambda, system);
        let ReducedSystem {
            matrix,
            right_side,
            gain,
            ..
        } = system;
        let tasks: Vec<_> = split_by_blocks(layout, matrix, |i| layout.values_of(i).len())
            .into_iter()
            .zip(split_by_blocks(layout, right_side, |i| layout.tangent(i)))
            .collect();
        tasks.into_par_iter().enumerate().for_each_init(
            || vec![0; layout.reduced.len()],
            |row_of, (i, (matrix, right_side))| {
                let rows = layout.row_start[i]..layout.row_start[i + 1];
                matrix.copy_from_slice(&self.hessian[layout.values_of(i)]);
                for (right, g) in right_side.iter_mut().zip(&self.gradient[rows.clone()]) {
                    *right = -g;
                }
                let mut panel = Panel::new(layout, i, matrix, row_of);
                let n = panel.columns;
                for (c, diagonal) in self.diagonal[rows].iter().enumerate() {
                    panel.column(c)[0] += self.damping(*diagonal, lambda);
                }
                for &q in layout.pairs_of_reduced.get(i) {
                    let pair = layout.pairs[q];
                    let gain = &gain[pair.start..][..POINT * n];
                    let point_gradient = &self.point_gradient[pair.point];
                    for (column, g) in gain.chunks_exact(n).zip(point_gradient.iter()) {
                        add_scaled(right_side, column, *g);
                    }
                    // Pairs of a point are in order of block: those from this one on are the lower triangle.
                    for other in &layout.pairs[q..layout.pairs_of_point[pair.point + 1]] {
                        let m = layout.tangent(other.reduced);
                        let coupling = &self.coupling[other.start..][..POINT * m];
                        panel.subtract_product(row_of[other.reduced], coupling, m, gain);
                    }
                }
            },
        );
    }

    fn invert_points(&self, layout: &Layout, lambda: f64, system: &mut ReducedSystem) {
        split_by_points(layout, &mut system.gain)
            .into_par_iter()
            .zip(system.point_inverse.par_chunks_mut(CHUNK))
            .enumerate()
            .for_each(|(chunk, (gain, inverses))| {
                let first = chunk * CHUNK;
                let base = layout
                    .pairs
                    .get(layout.pairs_of_point[first])
                    .map_or(0, |pair| pair.start);
                for (offset, inverse) in inverses.iter_mut().enumerate() {
                    let mut damped = self.point_hessian[first + offset];
                    for d in 0..POINT {
                        damped[(d, d)] += self.damping(damped[(d, d)], lambda);
                    }
                    // A point that cannot be inverted even so is held: its gain is zero.
                    *inverse = damped
                        .try_inverse()
                        .filter(|m| m.iter().all(|x| x.is_finite()))
                        .unwrap_or_else(Matrix3::zeros);
                    for pair in layout.pairs_at(first + offset) {
                        let n = layout.tangent(pair.reduced);
                        let coupling = &self.coupling[pair.start..][..POINT * n];
                        let gain = &mut gain[pair.start - base..][..POINT * n];
                        for (c, column) in gain.chunks_exact_mut(n).enumerate() {
                            column.fill(0.0);
                            for (k, source) in coupling.chunks_exact(n).enumerate() {
                                add_scaled(column, source, inverse[(k, c)]);
                            }
                        }
                    }
                }
            });
    }

    /// Points' part of the step, given that of the reduced blocks.
    pub fn back_substitute(&self, layout: &Layout, system: &ReducedSystem, step: &mut Step) {
        let reduced = &step.reduced;
        step.points
            .par_chunks_mut(CHUNK)
            .enumerate()
            .for_each(|(chunk, points)| {
                for (offset, delta) in points.iter_mut().enumerate() {
                    let point = chunk * CHUNK + offset;
                    let mut right = -self.point_gradient[point];
                    for pair in layout.pairs_at(point) {
                        let rows =
                            layout.row_start[pair.reduced]..layout.row_start[pair.reduced + 1];
                        let n = rows.len();
                        let coupling = &self.coupling[pair.start..][..POINT * n];
                        for (entry, column) in right.iter_mut().zip(coupling.chunks_exact(n)) {
                            *entry -= dot(column, &reduced[rows.clone()]);
                        }
                    }
                    *delta = system.point_inverse[point] * right;
                }
            });
    }

    /// Decrease of the cost that the quadratic model foresees: `½ δᵀ(λ diag H δ − g)`.
    pub fn predicted_decrease(&self, step: &Step, lambda: f64) -> f64 {
        let term = |delta: f64, diagonal: f64, gradient: f64| {
            0.5 * delta * (self.damping(diagonal, lambda) * delta - gradient)
        };
        let mut decrease = 0.0;
        for ((delta, diagonal), gradient) in
            step.reduced.iter().zip(&self.diagonal).zip(&self.gradient)
        {
            decrease += term(*delta, *diagonal, *gradient);
        }
        for ((delta, hessian), gradient) in step
            .points
            .iter()
            .zip(&self.point_hessian)
            .zip(&self.point_gradient)
        {
            for d in 0..POINT {
                decrease += term(delta[d], hessian[(d, d)], gradient[d]);
            }
        }
        decrease
    }
}

impl ReducedSystem {
    pub fn new(layout: &Layout) -> Self {
        Self {
            matrix: vec![0.0; layout.row_index.len()],
            right_side: vec![0.0; layout.dimension()],
            point_inverse: vec![Matrix3::zeros(); layout.points.len()],
            gain: vec![0.0; layout.pair_len],
        }
    }
}

/// The columns of one block in the lower triangle: column `c` begins at the diagonal.
struct Panel<'a> {
    values: &'a mut [f64],
    columns: usize,
    rows: usize,
}

impl<'a> Panel<'a> {
    /// Also fills in the panel row at which each coupled block begins.
    fn new(layout: &Layout, block: usize, values: &'a mut [f64], row_of: &mut [usize]) -> Self {
        let mut rows = 0;
        for &j in layout.coupled.get(block) {
            row_of[j] = rows;
            rows += layout.tangent(j);
        }
        Self {
            values,
            columns: layout.tangent(block),
            rows,
        }
    }

    fn start(&self, column: usize) -> usize {
        column * self.rows - (column * column - column) / 2
    }

    /// Column `c` from its diagonal entry on.
    fn column(&mut self, c: usize) -> &mut [f64] {
        let start = self.start(c);
        &mut self.values[start..start + self.rows - c]
    }

    /// Adds `factor * source` to column `c` at panel row `row`, leaving out what lies above the diagonal.
    fn add_scaled(&mut self, row: usize, c: usize, source: &[f64], factor: f64) {
        let skip = c.saturating_sub(row);
        let end = row + source.len() - c;
        let column = self.column(c);
        add_scaled(&mut column[row + skip - c..end], &source[skip..], factor);
    }

    /// Subtracts `left * rightᵀ` at panel row `row`; both have three columns, `left` has `left_rows` rows.
    fn subtract_product(&mut self, row: usize, left: &[f64], left_rows: usize, right: &[f64]) {
        let (left0, rest) = left.split_at(left_rows);
        let (left1, left2) = rest.split_at(left_rows);
        let (right0, rest) = right.split_at(self.columns);
        let (right1, right2) = rest.split_at(self.columns);
        for c in 0..self.columns {
            let skip = c.saturating_sub(row);
            let (a, b, d) = (right0[c], right1[c], right2[c]);
            let target = &mut self.column(c)[row + skip - c..row + left_rows - c];
            for (((t, x), y), z) in target
                .iter_mut()
                .zip(&left0[skip..])
                .zip(&left1[skip..])
                .zip(&left2[skip..])
            {
                *t -= x * a + y * b + z * d;
            }
        }
    }
}

fn add_scaled(target: &mut [f64], source: &[f64], factor: f64) {
    for (t, s) in target.iter_mut().zip(source) {
        *t += s * factor;
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Pair values by chunk of points.
fn split_by_points<'a>(layout: &Layout, mut values: &'a mut [f64]) -> Vec<&'a mut [f64]> {
    let count = layout.points.len();
    let start_of = |point: usize| {
        layout
            .pairs
            .get(layout.pairs_of_point[point])
            .map_or(layout.pair_len, |pair| pair.start)
    };
    (0..count)
        .step_by(CHUNK)
        .map(|first| {
            let end = (first + CHUNK).min(count);
            let (own, rest) =
                std::mem::take(&mut values).split_at_mut(start_of(end) - start_of(first));
            values = rest;
            own
        })
        .collect()
}

/// One slice per reduced block.
fn split_by_blocks<'a>(
    layout: &Layout,
    mut values: &'a mut [f64],
    len: impl Fn(usize) -> usize,
) -> Vec<&'a mut [f64]> {
    (0..layout.reduced.len())
        .map(|i| {
            let (own, rest) = std::mem::take(&mut values).split_at_mut(len(i));
            values = rest;
            own
        })
        .collect()
}
