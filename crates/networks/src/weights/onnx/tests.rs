//! Graphs put together byte by byte.

use super::*;

/// A field of bytes.
fn bytes(number: u8, content: &[u8]) -> Vec<u8> {
    let mut field = vec![number << 3 | 2];
    let mut length = content.len();
    while length >= 0x80 {
        field.push(length as u8 | 0x80);
        length >>= 7;
    }
    field.push(length as u8);
    field.extend(content);
    field
}

fn tensor(name: &str, shape: &[usize], seed: f32) -> Vec<u8> {
    let count: usize = shape.iter().product();
    let values: Vec<u8> = (0..count)
        .flat_map(|i| (seed + i as f32).to_le_bytes())
        .collect();
    let dimensions: Vec<u8> = shape.iter().flat_map(|n| [0x08, *n as u8]).collect();
    [
        dimensions,
        vec![0x10, 1],
        bytes(8, name.as_bytes()),
        bytes(9, &values),
    ]
    .concat()
}

fn node(kind: &str, inputs: &[&str], output: &str, numbers: &[(&str, &[u8])]) -> Vec<u8> {
    let mut node: Vec<u8> = inputs.iter().flat_map(|i| bytes(1, i.as_bytes())).collect();
    node.extend(bytes(2, output.as_bytes()));
    node.extend(bytes(4, kind.as_bytes()));
    for (name, values) in numbers {
        let values: Vec<u8> = values.iter().flat_map(|v| [0x40, *v]).collect();
        node.extend(bytes(5, &[bytes(1, name.as_bytes()), values].concat()));
    }
    node
}

fn file(nodes: &[Vec<u8>], tensors: &[Vec<u8>]) -> Vec<u8> {
    let nodes = nodes.iter().flat_map(|n| bytes(1, n));
    let graph: Vec<u8> = nodes
        .chain(tensors.iter().flat_map(|t| bytes(5, t)))
        .collect();
    [vec![FIRST_BYTE, 8], bytes(2, b"pytorch"), bytes(7, &graph)].concat()
}

/// A graph as a layout says, each convolution with as many outputs as its number in it.
fn exported(layout: &[Layer]) -> (Vec<Vec<u8>>, Vec<Vec<u8>>) {
    let (mut nodes, mut tensors) = (Vec::new(), Vec::new());
    for (index, (_, bias, stride, after, between)) in layout.iter().enumerate() {
        let mut seen = match &after[..] {
            [] => "image".to_owned(),
            [only] => format!("c{only}"),
            several => {
                let inputs: Vec<String> = several.iter().map(|i| format!("c{i}")).collect();
                let inputs: Vec<&str> = inputs.iter().map(String::as_str).collect();
                nodes.push(node("Concat", &inputs, &format!("s{index}"), &[]));
                format!("s{index}")
            }
        };
        for kind in *between {
            let next = format!("{seen}{kind}{index}");
            nodes.push(node(kind, &[&seen], &next, &[]));
            seen = next;
        }
        let (weight, bias_name) = (format!("w{index}"), format!("b{index}"));
        tensors.push(tensor(&weight, &[index + 1, 2, 1, 1], index as f32));
        let mut inputs = vec![seen.as_str(), &weight];
        if !bias.is_empty() {
            tensors.push(tensor(&bias_name, &[index + 1], 0.5));
            inputs.push(&bias_name);
        }
        let strides: &[u8] = &[*stride as u8; 2];
        let numbers: &[(&str, &[u8])] = &[("strides", strides), ("pads", &[0; 4])];
        nodes.push(node("Conv", &inputs, &format!("c{index}"), numbers));
    }
    (nodes, tensors)
}

#[test]
fn convolutions_are_named_by_what_they_follow() {
    for layout in LAYOUTS {
        let (nodes, tensors) = exported(layout);
        let weights = parse(&file(&nodes, &tensors)).expect("known");
        for (index, (name, bias, ..)) in layout.iter().enumerate() {
            let values = weights.tensor(&format!("{name}.weight"), &[index + 1, 2, 1, 1]);
            assert_eq!(values.expect("there")[0], index as f32);
            assert_eq!(weights.has(&format!("{bias}.bias")), !bias.is_empty());
        }
    }
}

/// Each convolution has the weights that it should by number and shape, and the network is another: it is refused, by what was found.
#[test]
fn graphs_that_are_put_together_otherwise_are_refused() {
    let layout = LAYOUTS[0];
    let (nodes, tensors) = exported(layout);
    let refused = |nodes: &[Vec<u8>]| {
        let refused = parse(&file(nodes, &tensors)).expect_err("another network");
        let said = refused.to_string();
        assert!(said.contains("found") && said.contains("Conv"), "{said}");
    };
    // Another gate in one place.
    let relu = nodes
        .iter()
        .rposition(|n| *n != nodes[0] && n.windows(4).any(|w| w == b"Relu"));
    let mut others = nodes.clone();
    let at = relu.expect("a rectification");
    let kind = others[at]
        .windows(4)
        .rposition(|w| w == b"Relu")
        .expect("there");
    others[at][kind..kind + 4].copy_from_slice(b"Tanh");
    refused(&others);
    // One layer less, and one more.
    refused(&nodes[..nodes.len() - 1]);
    let last = node("Conv", &["c1", "w1", "b1"], "more", &[("pads", &[0; 4])]);
    refused(&[&nodes[..], &[last]].concat());
    // A layer that looks at another than it should.
    let mut others = nodes.clone();
    let last = others.len() - 1;
    let number = layout.len() - 1;
    let (weight, bias) = (format!("w{number}"), format!("b{number}"));
    others[last] = node("Conv", &["c3", &weight, &bias], "c", &[("pads", &[0; 4])]);
    refused(&others);
}

#[test]
fn damaged_graphs_are_errors() {
    let (nodes, tensors) = exported(LAYOUTS[1]);
    let whole = file(&nodes, &tensors);
    for end in 0..whole.len() {
        assert!(parse(&whole[..end]).is_err(), "{end}");
    }
    for at in 0..whole.len() {
        for bit in [0x01, 0x80, 0xff] {
            let mut torn = whole.clone();
            torn[at] ^= bit;
            // Whatever it says then, it ends.
            let _ = parse(&torn);
        }
    }
    let elsewhere = [tensor("w", &[1], 0.0), vec![0x70, 1]].concat();
    assert_eq!(parse(&file(&[], &[elsewhere])), Err(Damage::ExternalValues));
}
