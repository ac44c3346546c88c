//! Products of small blocks: the inner loops of the solver, compiled for fused multiply-add where the processor has it.

use pulp::{Simd, WithSimd};

use crate::layout::POINT;

/// Runs `$body`, which takes one tuple, compiled twice: for the vector units of this processor, with `FUSED` true, or
/// plainly.
macro_rules! vectorized {
    ($body:ident ( $($argument:expr),* $(,)? )) => {{
        let arguments = ($($argument,)*);
        match pulp::Arch::new() {
            pulp::Arch::Scalar => $body::<false>(arguments),
            arch => arch.dispatch($crate::kernels::Vectorized($body::<true>, arguments)),
        }
    }};
}
pub(crate) use vectorized;

/// A function and what it is called with. Not a closure, since nothing could force that to be inlined where the vector
/// instructions are.
pub(crate) struct Vectorized<F, A>(pub F, pub A);

impl<R, A, F: FnOnce(A) -> R> WithSimd for Vectorized<F, A> {
    type Output = R;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> R {
        (self.0)(self.1)
    }
}

/// `a b + c`, in one instruction where the caller is compiled for it.
#[inline(always)]
pub(crate) fn multiply_add<const FUSED: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

/// `target += factor * source`.
#[inline(always)]
pub(crate) fn add_scaled<const FUSED: bool>(target: &mut [f64], source: &[f64], factor: f64) {
    for (t, s) in target.iter_mut().zip(source) {
        *t = multiply_add::<FUSED>(*s, factor, *t);
    }
}

/// Scalar product.
#[inline(always)]
pub(crate) fn dot<const FUSED: bool>(a: &[f64], b: &[f64]) -> f64 {
    let mut sum = 0.0;
    for (x, y) in a.iter().zip(b) {
        sum = multiply_add::<FUSED>(*x, *y, sum);
    }
    sum
}

/// Scalar product of long vectors, in four partial sums, which do not wait for one another.
#[inline(always)]
pub(crate) fn long_dot<const FUSED: bool>(a: &[f64], b: &[f64]) -> f64 {
    let length = a.len().min(b.len());
    let (a, a_rest) = a[..length].as_chunks::<4>();
    let (b, b_rest) = b[..length].as_chunks::<4>();
    let mut sums = [0.0; 4];
    for (a, b) in a.iter().zip(b) {
        for (sum, (x, y)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum = multiply_add::<FUSED>(*x, *y, *sum);
        }
    }
    let mut sum = (sums[0] + sums[1]) + (sums[2] + sums[3]);
    for (x, y) in a_rest.iter().zip(b_rest) {
        sum = multiply_add::<FUSED>(*x, *y, sum);
    }
    sum
}

#[inline(always)]
fn add_outer_fixed<const FUSED: bool, const M: usize, const N: usize>(
    target: &mut [f64],
    left: &[f64],
    right: &[f64],
) {
    let (targets, _) = target.as_chunks_mut::<M>();
    let (lefts, _) = left.as_chunks::<M>();
    let (rights, _) = right.as_chunks::<N>();
    for (c, target) in targets.iter_mut().take(N).enumerate() {
        let mut sum = *target;
        for (left, right) in lefts.iter().zip(rights) {
            for (s, l) in sum.iter_mut().zip(left) {
                *s = multiply_add::<FUSED>(*l, right[c], *s);
            }
        }
        *target = sum;
    }
}

/// `target += leftᵀ right`: `target` is `m × n`, columns first; `left` and `right` are Jacobians, rows first.
#[inline(always)]
pub(crate) fn add_product<const FUSED: bool>(
    target: &mut [f64],
    left: &[f64],
    m: usize,
    right: &[f64],
    n: usize,
) {
    match (m, n) {
        (3, 1) => add_outer_fixed::<FUSED, 3, 1>(target, left, right),
        (6, 1) => add_outer_fixed::<FUSED, 6, 1>(target, left, right),
        (9, 1) => add_outer_fixed::<FUSED, 9, 1>(target, left, right),
        (3, 3) => add_outer_fixed::<FUSED, 3, 3>(target, left, right),
        (3, 6) => add_outer_fixed::<FUSED, 3, 6>(target, left, right),
        (6, 3) => add_outer_fixed::<FUSED, 6, 3>(target, left, right),
        (6, 6) => add_outer_fixed::<FUSED, 6, 6>(target, left, right),
        (9, 3) => add_outer_fixed::<FUSED, 9, 3>(target, left, right),
        (9, 9) => add_outer_fixed::<FUSED, 9, 9>(target, left, right),
        _ => {
            for (left, right) in left.chunks_exact(m).zip(right.chunks_exact(n)) {
                for (target, factor) in target.chunks_exact_mut(m).zip(right) {
                    add_scaled::<FUSED>(target, left, *factor);
                }
            }
        }
    }
}

#[inline(always)]
fn subtract_fixed<const FUSED: bool, const M: usize, const N: usize>(
    target: &mut [f64],
    left: &[f64],
    right: &[f64],
) {
    let (targets, _) = target.as_chunks_mut::<M>();
    let (lefts, _) = left.as_chunks::<M>();
    let (rights, _) = right.as_chunks::<N>();
    let (&[x, y, z], &[a, b, d]) = (lefts, rights) else {
        return;
    };
    for (c, target) in targets.iter_mut().take(N).enumerate() {
        let mut sum = *target;
        for (s, l) in sum.iter_mut().zip(&x) {
            *s = multiply_add::<FUSED>(-*l, a[c], *s);
        }
        for (s, l) in sum.iter_mut().zip(&y) {
            *s = multiply_add::<FUSED>(-*l, b[c], *s);
        }
        for (s, l) in sum.iter_mut().zip(&z) {
            *s = multiply_add::<FUSED>(-*l, d[c], *s);
        }
        *target = sum;
    }
}

/// `target -= left rightᵀ`: `target` is `m × n`, `left` `m × 3`, `right` `n × 3`, all columns first.
#[inline(always)]
pub(crate) fn subtract_product<const FUSED: bool>(
    target: &mut [f64],
    left: &[f64],
    m: usize,
    right: &[f64],
    n: usize,
) {
    match (m, n) {
        (6, 6) => subtract_fixed::<FUSED, 6, 6>(target, left, right),
        (9, 9) => subtract_fixed::<FUSED, 9, 9>(target, left, right),
        _ => {
            for (left, right) in left.chunks_exact(m).zip(right.chunks_exact(n)) {
                for (target, factor) in target.chunks_exact_mut(m).zip(right) {
                    add_scaled::<FUSED>(target, left, -*factor);
                }
            }
        }
    }
}

#[inline(always)]
fn multiply_inverse_fixed<const FUSED: bool, const N: usize>(
    target: &mut [f64],
    left: &[f64],
    inverse: &[[f64; POINT]; POINT],
) {
    let (targets, _) = target.as_chunks_mut::<N>();
    let (lefts, _) = left.as_chunks::<N>();
    let &[x, y, z] = lefts else {
        return;
    };
    for (target, factors) in targets.iter_mut().zip(inverse) {
        let left = x.iter().zip(&y).zip(&z);
        for (t, ((x, y), z)) in target.iter_mut().zip(left) {
            let sum = multiply_add::<FUSED>(*y, factors[1], x * factors[0]);
            *t = multiply_add::<FUSED>(*z, factors[2], sum);
        }
    }
}

/// `target = left inverse`: `target` and `left` are `n × 3`, columns first, `inverse` symmetric.
#[inline(always)]
pub(crate) fn multiply_inverse<const FUSED: bool>(
    target: &mut [f64],
    left: &[f64],
    n: usize,
    inverse: &[[f64; POINT]; POINT],
) {
    match n {
        6 => return multiply_inverse_fixed::<FUSED, 6>(target, left, inverse),
        9 => return multiply_inverse_fixed::<FUSED, 9>(target, left, inverse),
        _ => {}
    }
    for (target, factors) in target.chunks_exact_mut(n).zip(inverse) {
        for (r, t) in target.iter_mut().enumerate() {
            let sum = left[r] * factors[0];
            let sum = multiply_add::<FUSED>(left[n + r], factors[1], sum);
            *t = multiply_add::<FUSED>(left[2 * n + r], factors[2], sum);
        }
    }
}

#[inline(always)]
fn add_matrix_vector_fixed<const FUSED: bool, const M: usize>(
    target: &mut [f64],
    matrix: &[f64],
    vector: &[f64],
) {
    let (columns, _) = matrix.as_chunks::<M>();
    let Some((target, _)) = target.split_first_chunk_mut::<M>() else {
        return;
    };
    let mut sum = *target;
    for (column, factor) in columns.iter().zip(vector) {
        for (s, x) in sum.iter_mut().zip(column) {
            *s = multiply_add::<FUSED>(*x, *factor, *s);
        }
    }
    *target = sum;
}

/// `target += matrix vector`, the matrix columns first.
#[inline(always)]
pub(crate) fn add_matrix_vector<const FUSED: bool>(
    target: &mut [f64],
    matrix: &[f64],
    vector: &[f64],
) {
    match target.len() {
        6 => add_matrix_vector_fixed::<FUSED, 6>(target, matrix, vector),
        9 => add_matrix_vector_fixed::<FUSED, 9>(target, matrix, vector),
        _ => {
            for (column, factor) in matrix.chunks_exact(target.len().max(1)).zip(vector) {
                add_scaled::<FUSED>(target, column, *factor);
            }
        }
    }
}

/// Scalar product in four partial sums, which do not wait for one another.
#[inline(always)]
fn dot_fixed<const FUSED: bool, const N: usize>(a: &[f64; N], b: &[f64; N]) -> f64 {
    let mut sums = [0.0; 4];
    for (k, (x, y)) in a.iter().zip(b).enumerate() {
        sums[k % 4] = multiply_add::<FUSED>(*x, *y, sums[k % 4]);
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3])
}

#[inline(always)]
fn add_transposed_vector_fixed<const FUSED: bool, const M: usize>(
    target: &mut [f64],
    matrix: &[f64],
    vector: &[f64],
) {
    let (columns, _) = matrix.as_chunks::<M>();
    let Some(vector) = vector.first_chunk::<M>() else {
        return;
    };
    for (t, column) in target.iter_mut().zip(columns) {
        *t += dot_fixed::<FUSED, M>(column, vector);
    }
}

/// `target += matrixᵀ vector`, the matrix columns first.
#[inline(always)]
pub(crate) fn add_transposed_vector<const FUSED: bool>(
    target: &mut [f64],
    matrix: &[f64],
    vector: &[f64],
) {
    match vector.len() {
        6 => add_transposed_vector_fixed::<FUSED, 6>(target, matrix, vector),
        9 => add_transposed_vector_fixed::<FUSED, 9>(target, matrix, vector),
        _ => {
            for (t, column) in target
                .iter_mut()
                .zip(matrix.chunks_exact(vector.len().max(1)))
            {
                *t += dot::<FUSED>(column, vector);
            }
        }
    }
}

/// `target += a aᵀ` of rows of a panel, columns first: `target` is `m × n`, from the diagonal down; `a` are the `m` rows from
/// `from` on of columns of `height` each.
#[inline(always)]
pub(crate) fn add_lower_product<const FUSED: bool>(
    target: &mut [f64],
    panel: &[f64],
    height: usize,
    from: usize,
    m: usize,
    n: usize,
) {
    let columns = |k: usize| &panel[k * height + from..k * height + from + m];
    let width = panel.len() / height.max(1);
    let mut k = 0;
    while k + 4 <= width {
        let [x, y, z, w] = [columns(k), columns(k + 1), columns(k + 2), columns(k + 3)];
        for (c, target) in target.chunks_exact_mut(m.max(1)).take(n).enumerate() {
            let [a, b, d, e] = [x[c], y[c], z[c], w[c]];
            let rows = x[c..].iter().zip(&y[c..]).zip(&z[c..]).zip(&w[c..]);
            for (t, (((x, y), z), w)) in target[c..].iter_mut().zip(rows) {
                let sum = multiply_add::<FUSED>(*x, a, *t);
                let sum = multiply_add::<FUSED>(*y, b, sum);
                let sum = multiply_add::<FUSED>(*z, d, sum);
                *t = multiply_add::<FUSED>(*w, e, sum);
            }
        }
        k += 4;
    }
    for k in k..width {
        let x = columns(k);
        for (c, target) in target.chunks_exact_mut(m.max(1)).take(n).enumerate() {
            add_scaled::<FUSED>(&mut target[c..], &x[c..], x[c]);
        }
    }
}
