use super::*;
use crate::generated::generated;
use crate::pattern::pattern;

/// The shape of a tensor of the smallest form.
fn shape(name: &str) -> Vec<usize> {
    let channels = Size::Tiny.channels();
    let values = channels[3];
    let block = name
        .bytes()
        .find(u8::is_ascii_digit)
        .map_or(0, |digit| usize::from(digit.saturating_sub(b'1')).min(3));
    let outputs = channels[block];
    let before = if block == 0 { 3 } else { channels[block - 1] };
    let inputs = if name.contains(".conv2") {
        outputs
    } else {
        before
    };
    match name {
        "desc_head.agg_weights" => vec![16, values, values],
        "desc_head.sf_conv.weight" => vec![values, values, 1, 1],
        "desc_head.offset_conv.0.weight" => vec![32, values, 3, 3],
        "desc_head.offset_conv.2.weight" => vec![32, 32, 1, 1],
        "score_head.0.weight" => vec![8, values, 1, 1],
        "score_head.2.weight" => vec![4, 8, 3, 3],
        "score_head.4.weight" => vec![4, 4, 3, 3],
        "score_head.6.weight" => vec![1, 4, 3, 3],
        _ if name.starts_with("desc_head") => vec![32],
        _ if name.contains("offset_conv.weight") => vec![18, inputs, 3, 3],
        _ if name.contains("offset_conv.bias") => vec![18],
        _ if name.starts_with("conv") => vec![values / 4, outputs, 1, 1],
        _ if name.contains("downsample.weight") => vec![outputs, before, 1, 1],
        _ if name.contains(".conv") => vec![outputs, inputs, 3, 3],
        _ => vec![outputs],
    }
}

fn network() -> Aliked {
    let tensors: Vec<_> = tensors()
        .into_iter()
        .map(|n| (n.clone(), shape(&n)))
        .collect();
    Aliked::read(&generated(&tensors), Size::Tiny).expect("whole")
}

fn grey(width: u32, height: u32) -> Grey {
    Grey::new(&pattern(width, height)).expect("an image")
}

/// Expected: onnxruntime 1.32, one operator at a time, of the same weights.
#[test]
fn computes_what_another_program_computes() {
    let network = network();
    let expected = [
        (
            [96, 64],
            [
                [0.573749, 0.0673148],
                [0.723687, 0.110664],
                [0.768353, -0.11504],
                [0.653765, -0.316573],
                [0.766369, -0.0374403],
                [0.588445, -0.102683],
            ],
        ),
        (
            [75, 50],
            [
                [0.633146, 0.070583],
                [0.714421, 0.106553],
                [0.622536, -0.115878],
                [0.743902, -0.262598],
                [0.595349, -0.0632641],
                [0.71835, -0.131169],
            ],
        ),
    ];
    for ([width, height], expected) in expected {
        let image = grey(width as u32, height as u32);
        let maps = network.run(&image);
        for (i, [score, value]) in expected.into_iter().enumerate() {
            let (column, row) = ((37 * i + 11) % width, (23 * i + 7) % height);
            let descriptor = maps.descriptors(&[[column as f32, row as f32]]);
            let found = [maps.highest_score(column), descriptor[7 * i % 64]];
            assert!(
                (found[0] - score).abs() < 1e-4 && (found[1] - value).abs() < 1e-4,
                "{width} × {height}, {i}: {found:?} for {score} and {value}"
            );
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same() {
    let network = network();
    let image = grey(333, 217);
    let found = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        pool.expect("a pool").install(|| {
            let maps = network.run(&image);
            let keypoints = maps.keypoints();
            let pixels: Vec<[f32; 2]> = keypoints.iter().map(|k| k.pixel).collect();
            (keypoints, maps.descriptors(&pixels))
        })
    };
    let one = found(1);
    assert!(one.0.len() > 100, "{}", one.0.len());
    assert_eq!(one, found(2));
    assert_eq!(one, found(5));
}

#[test]
fn descriptors_at_the_rim_and_of_no_keypoint() {
    let network = network();
    let image = grey(40, 33);
    let maps = network.run(&image);
    assert!(maps.descriptors(&[]).is_empty());
    let corners = maps.descriptors(&[[0.0, 0.0], [39.0, 32.0], [-5.0, 1e9], [f32::NAN, 3.0]]);
    assert_eq!(corners.len(), 4 * 64);
    for corner in corners.chunks_exact(64).take(2) {
        let norm: f32 = corner.iter().map(|v| v * v).sum();
        assert!((norm - 1.0).abs() < 1e-5, "{norm}");
    }
}
