use crate::model::Model;
use crate::network::Network;
use crate::pattern::pattern;

/// Places that are compared in each image.
const PROBES: usize = 12;
/// Scores and channels may differ by this much: other programs add in another order, and fold layers otherwise.
const TOLERANCE: f32 = 1e-3;

/// Width and height of two images, pixels, as a network may be right at the size it was tried with and nowhere else; for each place the
/// score and the channel.
type Expected = [([u32; 2], [[f32; 2]; PROBES]); 2];

// For each place the highest score of its column (of XFeat times reliability) and one channel of the descriptor, by onnxruntime
// 1.32 of the authors' weights exported as ONNX; `benches/networks/reference.py` prints them.
const XFEAT: Expected = [
    (
        [320, 256],
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
    ),
    (
        [192, 224],
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
    ),
];
const ALIKE_T: Expected = [
    (
        [320, 256],
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
    ),
    (
        [192, 224],
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
    ),
];

// ALIKED: onnxruntime's operators one by one on the authors' weights, which agree with its exported maps to 4e-5; the second size is
// no multiple of what its maps need.
const ALIKED_T16: Expected = [
    (
        [320, 256],
        [
            [0.828949, -0.00465919],
            [0.684242, -0.0346207],
            [0.678649, -0.332654],
            [0.888764, 0.0243852],
            [0.825621, -0.0841998],
            [0.587044, -0.171159],
            [0.660721, 0.190867],
            [0.872369, -0.0458601],
            [0.629079, 0.0149828],
            [0.85205, -0.0286795],
            [0.96656, -0.0434292],
            [0.850602, 0.00226239],
        ],
    ),
    (
        [200, 150],
        [
            [0.817452, 0.0488238],
            [0.544097, -0.0147036],
            [0.60929, -0.275649],
            [0.715438, 0.018804],
            [0.119689, -0.162133],
            [0.370767, -0.160742],
            [0.822861, 0.30529],
            [0.832894, 0.124567],
            [0.880332, -0.0677222],
            [0.771349, -0.0495423],
            [0.426819, 0.0419774],
            [0.961208, 0.167231],
        ],
    ),
];
const ALIKED_N16ROT: Expected = [
    (
        [320, 256],
        [
            [0.924966, 0.0638812],
            [0.689576, -0.0884769],
            [0.703496, 0.139473],
            [0.643365, 0.124658],
            [0.699337, 0.00307409],
            [0.725611, 0.0848773],
            [0.696173, -0.0956175],
            [0.424041, 0.0977317],
            [0.410295, -0.000148237],
            [0.70007, -0.00657392],
            [0.773407, -0.0856353],
            [0.743625, 0.0368685],
        ],
    ),
    (
        [200, 150],
        [
            [0.172615, 0.0575223],
            [0.359816, -0.0693407],
            [0.170915, 0.153089],
            [0.0249667, 0.152423],
            [0.022994, 0.0183282],
            [0.00566315, 0.0492627],
            [0.117379, -0.0619296],
            [0.0476794, 0.0336207],
            [0.274153, 0.115419],
            [0.345886, -0.0457787],
            [0.0262566, -0.0921022],
            [0.191648, 0.00507225],
        ],
    ),
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

/// Runs a network with published weights on an image of each size and compares it with the numbers of another program. Nothing where there
/// are none: of SuperPoint, whose weights nobody may pass on, or could not be had.
pub fn agreement(network: &Network) -> Vec<Agreement> {
    let expected: &[_] = match network.model() {
        Model::SuperPoint | Model::SuperPointOpen => &[],
        Model::XFeat => &XFEAT,
        Model::AlikeT => &ALIKE_T,
        Model::AlikedT16 => &ALIKED_T16,
        Model::AlikedN16Rot => &ALIKED_N16ROT,
    };
    let sizes = expected.iter();
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
