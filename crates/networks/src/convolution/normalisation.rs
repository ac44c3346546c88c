use crate::error::Damage;
use crate::tensor::Tensor;
use crate::weights::Weights;

/// A batch normalisation: for each channel a factor and what is added to the product.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Normalisation {
    pub scales: Vec<f32>,
    shifts: Vec<f32>,
}

/// Whether a batch normalisation has scales and shifts of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Affine {
    None,
    Learned,
}

impl Normalisation {
    /// From the tensors of this name; `epsilon` is added to variances before their roots are taken.
    pub fn read(
        weights: &Weights,
        name: &str,
        channels: usize,
        affine: Affine,
        epsilon: f32,
    ) -> Result<Self, Damage> {
        let column = |part: &str| weights.tensor(&format!("{name}.{part}"), &[channels]);
        let (mean, variance) = (column("running_mean")?, column("running_var")?);
        let (factors, offsets) = match affine {
            Affine::Learned => (column("weight")?.to_vec(), column("bias")?.to_vec()),
            Affine::None => (vec![1.0; channels], vec![0.0; channels]),
        };
        let deviations = variance.iter().map(|v| (v + epsilon).sqrt());
        let scales: Vec<f32> = factors.iter().zip(deviations).map(|(f, d)| f / d).collect();
        let moved = mean.iter().zip(&scales).map(|(mean, scale)| mean * scale);
        Ok(Self {
            shifts: offsets.iter().zip(moved).map(|(o, m)| o - m).collect(),
            scales,
        })
    }

    /// Normalises the channels of a cell.
    pub fn apply_to(&self, cell: &mut [f32]) {
        for ((value, scale), shift) in cell.iter_mut().zip(&self.scales).zip(&self.shifts) {
            *value = *value * scale + shift;
        }
    }

    /// Normalises a map.
    pub fn apply(&self, map: &mut Tensor) {
        let cells = map.values.chunks_exact_mut(self.scales.len().max(1));
        cells.for_each(|cell| self.apply_to(cell));
    }
}
