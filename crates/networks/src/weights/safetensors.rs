//! `.safetensors`: the length of a JSON object, the object (name → type, shape, place), then the values, little-endian.

use serde_json::{Map, Value, json};

use super::Weights;
use crate::error::Damage;

/// Bytes of the length in front.
const LENGTH_BYTES: usize = 8;
/// The largest list of tensors, bytes.
const MAX_LIST_BYTES: usize = 16 << 20;

/// Whether it begins with the length of a list, and then the list.
pub fn is_list(bytes: &[u8]) -> bool {
    list_len(bytes).is_some()
}

/// Bytes of the list.
fn list_len(bytes: &[u8]) -> Option<usize> {
    let (length, rest) = bytes.split_first_chunk::<LENGTH_BYTES>()?;
    let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
    (length <= MAX_LIST_BYTES && rest.first() == Some(&b'{')).then_some(length)
}

/// The tensors of 32-bit floats; others (counters of training) are left out.
pub fn parse(bytes: &[u8]) -> Result<Weights, Damage> {
    let length = list_len(bytes).ok_or(Damage::UnknownKind)?;
    let (list, values) = bytes[LENGTH_BYTES..]
        .split_at_checked(length)
        .ok_or(Damage::CutOff {
            what: "the list of tensors",
        })?;
    let list: Map<String, Value> = serde_json::from_slice(list).map_err(|_| Damage::List)?;
    let mut tensors = Vec::new();
    for (name, entry) in list {
        if name == "__metadata__" || entry["dtype"] != "F32" {
            continue;
        }
        let shape = numbers(&entry["shape"]).ok_or(Damage::List)?;
        let [from, to] = numbers(&entry["data_offsets"])
            .and_then(|v| <[usize; 2]>::try_from(v).ok())
            .ok_or(Damage::List)?;
        let bytes = values
            .get(from..to)
            .ok_or(Damage::CutOff { what: "a tensor" })?;
        let (chunks, left) = bytes.as_chunks::<4>();
        let count = shape.iter().try_fold(1usize, |p, n| p.checked_mul(*n));
        if count != Some(chunks.len()) || !left.is_empty() {
            return Err(Damage::List);
        }
        let values = chunks.iter().map(|c| f32::from_le_bytes(*c)).collect();
        tensors.push((name, shape, values));
    }
    Ok(Weights::from_tensors(tensors))
}

fn numbers(value: &Value) -> Option<Vec<usize>> {
    let entries = value.as_array()?.iter();
    entries.map(|n| usize::try_from(n.as_u64()?).ok()).collect()
}

/// Tensors by name, values in the same order.
pub fn write(weights: &Weights) -> Vec<u8> {
    let mut list = Map::new();
    let mut end = 0;
    for (name, tensor) in &weights.tensors {
        let begin = end;
        end += 4 * tensor.values.len();
        list.insert(
            name.clone(),
            json!({"dtype": "F32", "shape": tensor.shape, "data_offsets": [begin, end]}),
        );
    }
    let mut list = Value::Object(list).to_string();
    // The values begin at a multiple of eight bytes.
    list.extend(std::iter::repeat_n(' ', (8 - list.len() % 8) % 8));
    let mut bytes = (list.len() as u64).to_le_bytes().to_vec();
    bytes.extend(list.as_bytes());
    for tensor in weights.tensors.values() {
        tensor
            .values
            .iter()
            .for_each(|v| bytes.extend(v.to_le_bytes()));
    }
    bytes
}
