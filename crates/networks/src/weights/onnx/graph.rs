//! The convolutions of an ONNX graph, each with what it follows.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use super::protobuf::{Value, fields, numbers};
use crate::error::Damage;

/// More operators than any network that is known has.
const MAX_OPERATORS: usize = 4096;
/// More convolutions than any network that is known has.
const MAX_CONVOLUTIONS: usize = 64;

const CUT_OFF: Damage = Damage::CutOff {
    what: "the graph of an ONNX file",
};

/// A convolution of a graph.
#[derive(Clone, Debug, PartialEq)]
pub struct GraphConvolution {
    /// Outputs, inputs, rows, columns.
    pub shape: Vec<usize>,
    pub values: Vec<f32>,
    pub bias: Option<Vec<f32>>,
    /// Evaluated at every so-manieth cell; `None` of one that is not square, not padded by half its side, dilated or in groups.
    pub stride: Option<u64>,
    /// Convolutions that it follows, by their order.
    pub after: BTreeSet<usize>,
    /// Operators between those and this one that change values.
    pub between: BTreeSet<String>,
}

/// A graph, as far as it says which network it is.
#[derive(Clone, Debug, PartialEq)]
pub struct Graph {
    pub convolutions: Vec<GraphConvolution>,
    /// How many operators of each kind it has.
    pub operators: BTreeMap<String, usize>,
}

/// What a value of the graph comes from.
#[derive(Clone, Debug, Default)]
struct Origin {
    after: BTreeSet<usize>,
    between: BTreeSet<String>,
}

/// Operators that move values, scale or add them, and say nothing of which network it is.
const SILENT: [&str; 22] = [
    "Add",
    "Cast",
    "Clip",
    "Concat",
    "Constant",
    "DepthToSpace",
    "Div",
    "Expand",
    "Gather",
    "Identity",
    "Mul",
    "Pow",
    "ReduceMean",
    "Reshape",
    "Resize",
    "Shape",
    "Slice",
    "Sqrt",
    "Squeeze",
    "Sub",
    "Transpose",
    "Unsqueeze",
];

impl Graph {
    /// Of the bytes of an ONNX file.
    pub fn parse(bytes: &[u8]) -> Result<Self, Damage> {
        const GRAPH: u64 = 7;
        const NODE: u64 = 1;
        const INITIALIZER: u64 = 5;
        let model = fields(bytes).ok_or(CUT_OFF)?;
        let graph = messages(&model, GRAPH).next().ok_or(CUT_OFF)?;
        let graph = fields(graph).ok_or(CUT_OFF)?;
        let mut tensors = HashMap::new();
        for bytes in messages(&graph, INITIALIZER) {
            if let Some((name, tensor)) = tensor(bytes)? {
                tensors.insert(name, tensor);
            }
        }
        let mut found = Self {
            convolutions: Vec::new(),
            operators: BTreeMap::new(),
        };
        let mut origins: HashMap<String, Origin> = HashMap::new();
        for bytes in messages(&graph, NODE).take(MAX_OPERATORS) {
            let node = Node::parse(bytes).ok_or(CUT_OFF)?;
            *found.operators.entry(node.kind.clone()).or_default() += 1;
            let mut origin = Origin::default();
            for input in &node.inputs {
                if let Some(from) = origins.get(input) {
                    origin.after.extend(&from.after);
                    origin.between.extend(from.between.iter().cloned());
                }
            }
            let is_silent = SILENT.contains(&node.kind.as_str());
            if node.kind == "Conv" && found.convolutions.len() < MAX_CONVOLUTIONS {
                let after = BTreeSet::from([found.convolutions.len()]);
                found
                    .convolutions
                    .extend(node.convolution(origin, &tensors));
                origin = Origin {
                    after,
                    between: BTreeSet::new(),
                };
            } else if !is_silent {
                origin.between.insert(node.kind.clone());
            }
            for output in node.outputs {
                origins.insert(output, origin.clone());
            }
        }
        Ok(found)
    }

    /// What it consists of, in words.
    pub fn summary(&self) -> String {
        let kinds = self
            .operators
            .iter()
            .filter(|(kind, _)| *kind != "Constant");
        let kinds: Vec<String> = kinds
            .map(|(kind, count)| format!("{count} {kind}"))
            .collect();
        kinds.join(", ")
    }
}

/// The messages of this number among fields.
fn messages<'a>(fields: &[(u64, Value<'a>)], wanted: u64) -> impl Iterator<Item = &'a [u8]> {
    fields
        .iter()
        .filter_map(move |(number, value)| match value {
            Value::Bytes(bytes) if *number == wanted => Some(*bytes),
            _ => None,
        })
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[derive(Clone, Debug)]
struct Tensor {
    shape: Vec<usize>,
    values: Vec<f32>,
}

/// Name and values of an initialiser of 32-bit floats; `None` of another type.
fn tensor(bytes: &[u8]) -> Result<Option<(String, Tensor)>, Damage> {
    const DIMS: u64 = 1;
    const DATA_TYPE: u64 = 2;
    const FLOAT_DATA: u64 = 4;
    const NAME: u64 = 8;
    const RAW_DATA: u64 = 9;
    const DATA_LOCATION: u64 = 14;
    const FLOAT: u64 = 1;
    const EXTERNAL: u64 = 1;
    let (mut name, mut shape, mut raw) = (String::new(), Vec::new(), Vec::new());
    let mut is_float = false;
    for (number, value) in fields(bytes).ok_or(CUT_OFF)? {
        match (number, value) {
            (DIMS, Value::Number(n)) => shape.push(n),
            (DIMS, Value::Bytes(packed)) => shape.extend(numbers(packed).ok_or(CUT_OFF)?),
            (DATA_TYPE, Value::Number(kind)) => is_float = kind == FLOAT,
            (FLOAT_DATA | RAW_DATA, Value::Bytes(values)) => raw.extend(values),
            (NAME, Value::Bytes(bytes)) => name = text(bytes),
            (DATA_LOCATION, Value::Number(EXTERNAL)) => return Err(Damage::ExternalValues),
            _ => {}
        }
    }
    let shape: Result<Vec<usize>, _> = shape.into_iter().map(usize::try_from).collect();
    let shape = shape.map_err(|_| Damage::List)?;
    let (values, left) = raw.as_chunks::<4>();
    let count = shape.iter().try_fold(1usize, |p, n| p.checked_mul(*n));
    if !is_float {
        return Ok(None);
    }
    if count != Some(values.len()) || !left.is_empty() {
        return Err(Damage::CutOff { what: "a tensor" });
    }
    let values = values.iter().map(|c| f32::from_le_bytes(*c)).collect();
    Ok(Some((name, Tensor { shape, values })))
}

/// An operator.
struct Node {
    kind: String,
    inputs: Vec<String>,
    outputs: Vec<String>,
    /// Attributes that are whole numbers, or lists of them.
    numbers: HashMap<String, Vec<u64>>,
}

impl Node {
    fn parse(bytes: &[u8]) -> Option<Self> {
        const INPUT: u64 = 1;
        const OUTPUT: u64 = 2;
        const OP_TYPE: u64 = 4;
        const ATTRIBUTE: u64 = 5;
        let node = fields(bytes)?;
        let mut attributes = HashMap::new();
        for bytes in messages(&node, ATTRIBUTE) {
            const NAME: u64 = 1;
            const I: u64 = 3;
            const INTS: u64 = 8;
            let attribute = fields(bytes)?;
            let mut values = Vec::new();
            for (number, value) in &attribute {
                match (*number, value) {
                    (I | INTS, Value::Number(n)) => values.push(*n),
                    (INTS, Value::Bytes(packed)) => values.extend(numbers(packed)?),
                    _ => {}
                }
            }
            attributes.insert(text(messages(&attribute, NAME).next()?), values);
        }
        Some(Self {
            kind: text(messages(&node, OP_TYPE).next()?),
            inputs: messages(&node, INPUT).map(text).collect(),
            outputs: messages(&node, OUTPUT).map(text).collect(),
            numbers: attributes,
        })
    }

    /// Of a convolution whose weights are in the file.
    fn convolution(
        &self,
        origin: Origin,
        tensors: &HashMap<String, Tensor>,
    ) -> Option<GraphConvolution> {
        let weights = tensors.get(self.inputs.get(1)?)?;
        let bias = match self.inputs.get(2).filter(|name| !name.is_empty()) {
            Some(name) => Some(tensors.get(name)?.values.clone()),
            None => None,
        };
        let [_, _, rows, columns] = weights.shape[..] else {
            return None;
        };
        let all = |name: &str, expected: u64| {
            let values = self.numbers.get(name).into_iter().flatten();
            values.into_iter().all(|v| *v == expected)
        };
        let strides = self.numbers.get("strides").cloned().unwrap_or(vec![1, 1]);
        let pads = self.numbers.get("pads").cloned().unwrap_or(vec![0; 4]);
        let rim = rows as u64 / 2;
        let is_plain = rows == columns
            && strides.len() == 2
            && strides[0] == strides[1]
            && pads.len() == 4
            && pads.iter().all(|pad| *pad == rim)
            && all("dilations", 1)
            && all("group", 1)
            && !self.numbers.contains_key("auto_pad");
        Some(GraphConvolution {
            shape: weights.shape.clone(),
            values: weights.values.clone(),
            bias,
            stride: is_plain.then_some(strides[0]),
            after: origin.after,
            between: origin.between,
        })
    }
}
