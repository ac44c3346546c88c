use lsfb_types::Image;

use crate::model::Model;
use crate::network::Network;

/// Places that are compared in each image.
const PROBES: usize = 12;
/// Sizes of the images, pixels: two, as a network may be right at the size it was tried with and nowhere else.
const SIZES_PX: [[u32; 2]; 2] = [[320, 256], [192, 224]];
/// Scores and channels may differ by this much: other programs add in another order, and fold layers otherwise.
const TOLERANCE: f32 = 1e-3;

// For each place the highest score of its column (of XFeat times reliability) and one channel of the descriptor, by onnxruntime
// 1.32 of the authors' weights exported as ONNX; `benches/networks/reference.py` prints them.
const XFEAT: [[[f32; 2]; PROBES]; 2] = [
    [
        [0.0733347, 0.12328],
        [0.0104409, -0.0124926],
        [0.00146625, -0.111585],
        [0.00296042, 0.00836487],
        [0.00531207, -0.0426049],
        [0.0050714, -0.0218769],
        [0.00295525, 0.324654],
        [0.0030157, -0.0188148],
        [0.0043863, -0.0123916],
        [0.0312962, 0.058305],
        [0.00641973, -0.218201],
        [0.00337132, -0.187265],
    ],
    [
        [0.0730914, 0.123211],
        [0.0102626, -0.00796353],
        [0.00065339, -0.124184],
        [0.00167229, 0.0143127],
        [0.00109716, -0.0769682],
        [0.0261969, 0.0727524],
        [0.0255202, 0.199436],
        [0.001857, -0.0291159],
        [0.00278382, -0.0539445],
        [0.00316169, 0.090524],
        [0.00241941, -0.141505],
        [0.00643905, -0.0804419],
    ],
];
const ALIKE_T: [[[f32; 2]; PROBES]; 2] = [
    [
        [0.848482, -0.100201],
        [0.98039, 0.0780156],
        [0.998067, -0.110502],
        [0.995804, -0.181777],
        [0.994372, -0.0396686],
        [0.935596, 0.0868277],
        [0.993603, -0.0728967],
        [0.893659, -0.00230747],
        [0.980739, -0.00551173],
        [0.909425, 0.126322],
        [0.987315, 0.0355335],
        [0.979428, -0.00468326],
    ],
    [
        [0.854252, -0.0990649],
        [0.976192, 0.0781685],
        [0.998076, -0.103969],
        [0.99678, -0.175592],
        [0.993762, -0.00678957],
        [0.909651, -0.0152923],
        [0.992604, -0.0994709],
        [0.940921, -0.00924824],
        [0.910369, 0.151908],
        [0.949231, 0.0911258],
        [0.971558, 0.0818266],
        [0.849403, 0.0924642],
    ],
];

/// How a network agrees with another program on the same weights and images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agreement {
    /// Size of the image, pixels.
    pub size_px: [u32; 2],
    /// The largest difference of a score, 0–1.
    pub score: f32,
    /// The largest difference of a channel of a descriptor, which has unit length.
    pub descriptor: f32,
}

impl Agreement {
    /// Whether the differences are those of rounding.
    pub fn holds(&self) -> bool {
        self.score.max(self.descriptor) <= TOLERANCE
    }
}

/// Runs a network with published weights on an image of each size and compares it with the numbers of another program.
pub fn agreement(network: &Network) -> Vec<Agreement> {
    let expected = match network.model() {
        Model::XFeat => &XFEAT,
        Model::AlikeT => &ALIKE_T,
    };
    let sizes = SIZES_PX.iter().zip(expected);
    sizes
        .map(|(size_px, expected)| {
            let [width, height] = *size_px;
            let maps = network.run(&pattern(width, height));
            let (mut score, mut descriptor) = (0.0f32, 0.0f32);
            for (i, expected) in expected.iter().enumerate() {
                let column = (37 * i + 11) % width as usize;
                let row = (53 * i + 7) % height as usize;
                let [highest, channel] = maps.as_ref().map_or([f32::INFINITY; 2], |maps| {
                    [
                        maps.highest_score(column),
                        maps.channel(column, row, 7 * i % 64),
                    ]
                });
                score = score.max((highest - expected[0]).abs());
                descriptor = descriptor.max((channel - expected[1]).abs());
            }
            Agreement {
                size_px: *size_px,
                score,
                descriptor,
            }
        })
        .collect()
}

/// An image with corners, edges and texture.
fn pattern(width: u32, height: u32) -> Image {
    let value = |x: u32, y: u32| {
        let squares = x * x / 7 + 3 * x * y / 11 + y * y / 5;
        (squares + 90 * ((x / 16 + y / 16) % 2)) as u8
    };
    let rows = 0..height;
    Image {
        width,
        height,
        pixels: rows
            .flat_map(|y| (0..width).map(move |x| value(x, y)))
            .collect(),
        ..Image::default()
    }
}
