//! ONNX files of networks that are known, as exported by PyTorch: the values of their convolutions, under the names that the authors
//! give them. Which is which is told by what follows what, not by names, as exporters give new ones to what they fold together.

mod graph;
mod layouts;
mod protobuf;
#[cfg(test)]
mod tests;

use super::Weights;
use crate::error::Damage;
use graph::{Graph, GraphConvolution};
use layouts::{LAYOUTS, Layer};

/// The first field of such a file is the version of the format, a number.
const FIRST_BYTE: u8 = 0x08;

/// Whether these may be the bytes of an ONNX file.
pub fn is_onnx(bytes: &[u8]) -> bool {
    bytes.first() == Some(&FIRST_BYTE)
}

/// The tensors of a network that is known.
pub fn parse(bytes: &[u8]) -> Result<Weights, Damage> {
    let graph = Graph::parse(bytes)?;
    let layout = LAYOUTS.iter().find(|layout| fits(layout, &graph));
    let layout = layout.ok_or_else(|| Damage::UnknownGraph {
        found: graph.summary(),
    })?;
    let mut tensors = Vec::new();
    for ((name, bias_name, ..), convolution) in layout.iter().zip(graph.convolutions) {
        let outputs = convolution.shape.first().copied().unwrap_or(0);
        tensors.push((
            format!("{name}.weight"),
            convolution.shape,
            convolution.values,
        ));
        if let Some(bias) = convolution.bias {
            tensors.push((format!("{bias_name}.bias"), vec![outputs], bias));
        }
    }
    Ok(Weights::from_tensors(tensors))
}

/// Whether all convolutions are there, and each follows those that it should.
fn fits(layout: &[Layer], graph: &Graph) -> bool {
    let is_same = |(layer, found): (&Layer, &GraphConvolution)| {
        let (_, bias, stride, after, between) = layer;
        found.stride == Some(*stride)
            && found.bias.is_some() != bias.is_empty()
            && found.after.iter().eq(after.iter())
            && found.between.iter().eq(between.iter())
    };
    layout.len() == graph.convolutions.len() && layout.iter().zip(&graph.convolutions).all(is_same)
}
