//! Convolutions against their definition.

use super::*;

/// By the definition, one value at a time.
fn plain(input: &Tensor, weights: &[f32], shape: Shape, stride: usize) -> Vec<f32> {
    let rim = shape.side / 2;
    let length = |cells: usize| (cells + 2 * rim - shape.side) / stride + 1;
    let mut values = Vec::new();
    for row in 0..length(input.height) {
        for column in 0..length(input.width) {
            for output in 0..shape.outputs {
                let mut sum = 0.0;
                for c in 0..shape.inputs {
                    for y in 0..shape.side {
                        for x in 0..shape.side {
                            let (v, u) = (row * stride + y, column * stride + x);
                            let inside = v >= rim
                                && u >= rim
                                && v - rim < input.height
                                && u - rim < input.width;
                            if inside {
                                let weight =
                                    ((output * shape.inputs + c) * shape.side + y) * shape.side + x;
                                sum += weights[weight] * input.cell(v - rim, u - rim)[c];
                            }
                        }
                    }
                }
                values.push(sum);
            }
        }
    }
    values
}

#[test]
fn agrees_with_the_definition() {
    let number = |i: usize| ((i * 7919 + 13) % 101) as f32 / 50.0 - 1.0;
    for (side, stride, height, width) in [(3, 1, 7, 5), (3, 2, 8, 9), (1, 1, 4, 6), (3, 2, 1, 1)] {
        let shape = Shape {
            outputs: 5,
            inputs: 3,
            side,
        };
        let input = Tensor {
            height,
            width,
            channels: 3,
            values: (0..height * width * 3).map(number).collect(),
        };
        let values: Vec<f32> = (0..5 * 3 * side * side).map(|i| number(i + 1000)).collect();
        let weights =
            Weights::from_tensors([("w".to_owned(), vec![5, 3, side, side], values.clone())]);
        let convolution = Convolution::read(&weights, "w", shape).expect("there");
        let found = convolution.strided(stride).apply(&input);
        let expected = plain(&input, &values, shape, stride);
        assert_eq!(found.values.len(), expected.len());
        for (a, b) in found.values.iter().zip(&expected) {
            assert!((a - b).abs() < 1e-4, "{side} {stride}: {a} {b}");
        }
    }
}

/// Where nothing is moved, it is a convolution like any other; where all is moved by whole cells, one of the map moved.
#[test]
fn deformable_convolutions_that_move_nothing_or_everything_alike() {
    let number = |i: usize| ((i * 7919 + 13) % 101) as f32 / 50.0 - 1.0;
    let (height, width) = (9, 12);
    let input = Tensor {
        height,
        width,
        channels: 2,
        values: (0..height * width * 2).map(number).collect(),
    };
    let tensor = |name: &str, shape: Vec<usize>, values: Vec<f32>| (name.to_owned(), shape, values);
    let kernel: Vec<f32> = (0..3 * 2 * 9).map(|i| number(i + 500)).collect();
    let found = |down: f32, right: f32| {
        let bias = [down, right].repeat(9);
        let weights = Weights::from_tensors([
            tensor(
                "d.offset_conv.weight",
                vec![18, 2, 3, 3],
                vec![0.0; 18 * 18],
            ),
            tensor("d.offset_conv.bias", vec![18], bias),
            tensor("d.regular_conv.weight", vec![3, 2, 3, 3], kernel.clone()),
            tensor("n.weight", vec![3], vec![1.0; 3]),
            tensor("n.bias", vec![3], vec![0.0; 3]),
            tensor("n.running_mean", vec![3], vec![0.0; 3]),
            tensor("n.running_var", vec![3], vec![1.0; 3]),
        ]);
        let read = DeformableConvolution::read(&weights, "d", [2, 3], "n", Gate::None);
        read.expect("whole").apply(&input)
    };
    let shape = Shape {
        outputs: 3,
        inputs: 2,
        side: 3,
    };
    let plain = plain(&input, &kernel, shape, 1);
    let still = found(0.0, 0.0);
    for (a, b) in still.values.iter().zip(&plain) {
        assert!((a - b).abs() < 1e-4, "{a} {b}");
    }
    let moved = found(1.0, -2.0);
    for row in 0..height - 2 {
        for column in 3..width - 1 {
            for (a, b) in moved
                .cell(row, column)
                .iter()
                .zip(still.cell(row + 1, column - 2))
            {
                assert!((a - b).abs() < 1e-4, "{row} {column}: {a} {b}");
            }
        }
    }
}
