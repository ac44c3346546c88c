use super::*;
use crate::generated::generated;
use crate::pattern::pattern;

fn network(author: Author) -> SuperPoint {
    let heads = DETECTOR.into_iter().chain(DESCRIPTOR);
    let shapes = BACKBONE
        .map(|(outputs, _)| (outputs, 3))
        .into_iter()
        .chain(heads);
    let inputs = [1, 64, 64, 64, 64, 128, 128, 128, 128, 256, 128, 256];
    let per_layer = author.tensors().len() / inputs.len();
    let shapes: Vec<_> = shapes.zip(inputs).collect();
    let tensors: Vec<(String, Vec<usize>)> = author
        .tensors()
        .into_iter()
        .enumerate()
        .map(|(index, name)| {
            let ((outputs, side), inputs) = shapes[index / per_layer];
            let is_kernel = index % per_layer == 0;
            let kernel = vec![outputs, inputs, side, side];
            (name, if is_kernel { kernel } else { vec![outputs] })
        })
        .collect();
    SuperPoint::read(&generated(&tensors), author).expect("whole")
}

/// Expected: onnxruntime 1.32, one operator at a time, of the same weights.
#[test]
fn computes_what_another_program_computes() {
    let expected = [
        (
            Author::MagicLeap,
            [64, 48],
            [
                [0.0172929, -0.0420881],
                [0.0171461, 0.0436166],
                [0.016755, -0.0995971],
                [0.0169596, -0.032221],
            ],
        ),
        (
            Author::MagicLeap,
            [75, 50],
            [
                [0.0173857, -0.0420881],
                [0.0169103, 0.0416934],
                [0.0171114, -0.0926837],
                [0.0179643, -0.0657466],
            ],
        ),
        (
            Author::Open,
            [64, 48],
            [
                [0.0290295, 0.103452],
                [0.0221877, 0.0164814],
                [0.0192276, 0.0793129],
                [0.017967, 0.000841797],
            ],
        ),
        (
            Author::Open,
            [75, 50],
            [
                [0.0291571, 0.103452],
                [0.0217289, 0.00783291],
                [0.017354, 0.0839872],
                [0.0233235, 0.00472037],
            ],
        ),
    ];
    for (author, [width, height], expected) in expected {
        let image = Grey::new(&pattern(width as u32, height as u32)).expect("an image");
        let maps = network(author).run(&image);
        for (i, [score, value]) in expected.into_iter().enumerate() {
            let (column, row) = ((37 * i + 11) % width, (23 * i + 7) % height);
            let found = [
                maps.highest_score(column),
                maps.channel(column, row, 41 * i % 256),
            ];
            assert!(
                (found[0] - score).abs() < 2e-6 && (found[1] - value).abs() < 1e-5,
                "{author:?}, {width} × {height}, {i}: {found:?} for {score} and {value}"
            );
        }
        let middle = maps.descriptor([11.5, 3.5]);
        let cell = maps.descriptors.cell(0, 1);
        assert!(middle.iter().zip(cell).all(|(a, b)| (a - b).abs() < 1e-6));
    }
}
