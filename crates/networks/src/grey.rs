use lsfb_types::Image;

use crate::tensor::Tensor;

/// A grey image with values from 0 to 1, as networks take it.
#[derive(Clone, Debug)]
pub(crate) struct Grey {
    pub width: usize,
    pub height: usize,
    pub values: Vec<f32>,
}

impl Grey {
    /// `None` where the pixels do not fill the image, or it is too small for any keypoint.
    pub fn new(image: &Image) -> Option<Self> {
        const MIN_SIDE_PX: usize = 16;
        let (width, height) = (image.width as usize, image.height as usize);
        let whole = width.checked_mul(height) == Some(image.pixels.len());
        (whole && width.min(height) >= MIN_SIDE_PX).then(|| Self {
            width,
            height,
            values: image.pixels.iter().map(|v| f32::from(*v) / 255.0).collect(),
        })
    }

    /// As a map whose sides are multiples of `grain`: the last row and column repeated.
    pub fn padded(&self, grain: usize) -> Tensor {
        self.padded_from(grain, [0, 0])
    }

    /// As a map whose sides are multiples of `grain`, the rim repeated on all sides, and where in it the image begins: column, row.
    pub fn padded_around(&self, grain: usize) -> (Tensor, [usize; 2]) {
        let begin = [self.width, self.height].map(|side| (side.next_multiple_of(grain) - side) / 2);
        (self.padded_from(grain, begin), begin)
    }

    fn padded_from(&self, grain: usize, [left, top]: [usize; 2]) -> Tensor {
        let (height, width) = (
            self.height.next_multiple_of(grain),
            self.width.next_multiple_of(grain),
        );
        let mut padded = Tensor::zeros(height, width, 1);
        for (row, target) in padded.values.chunks_exact_mut(width).enumerate() {
            let from = row.saturating_sub(top).min(self.height - 1) * self.width;
            let source = &self.values[from..from + self.width];
            target[..left].fill(source[0]);
            target[left..left + self.width].copy_from_slice(source);
            target[left + self.width..].fill(source[self.width - 1]);
        }
        padded
    }
}
