//! Weights made by a formula, for tests that need no published ones; `benches/networks/reference.py` makes the same.

use crate::weights::Weights;

/// Tensors of these names and shapes.
pub(crate) fn generated(tensors: &[(String, Vec<usize>)]) -> Weights {
    Weights::from_tensors(tensors.iter().map(|(name, shape)| {
        let mut state = name
            .bytes()
            .fold(1u32, |s, b| s.wrapping_mul(31).wrapping_add(u32::from(b)));
        let count: usize = shape.iter().product();
        let inputs = (count / shape[0].max(1)).max(1);
        let (middle, spread) = match name.rsplit('.').next() {
            Some("running_var") => (1.0, 0.5),
            Some("running_mean" | "bias") => (0.0, 0.1),
            _ if shape.len() == 1 => (1.0, 0.2),
            _ => (0.0, (3.0 / inputs as f32).sqrt()),
        };
        let values = (0..count).map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            middle + spread * ((state >> 8) as f32 / 8_388_608.0 - 1.0)
        });
        (name.clone(), shape.clone(), values.collect())
    }))
}
