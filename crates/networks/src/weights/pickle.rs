//! The tensors of a PyTorch file: an archive with a pickled list (`data.pkl`) and a file of values for each storage. Before PyTorch 1.6 one file
//! after the other: pickled a number, the version, the machine's types, the list, and the keys of the storages; then the values of each.
//!
//! Of the pickle language only what such lists are made of is understood, and nothing is ever executed: names of functions are
//! compared with those that put tensors and ordered dictionaries together, all others give a value of no meaning.

use std::collections::{BTreeMap, HashMap};

use super::Weights;
use super::archive::ArchivedFile;
use crate::error::Damage;

/// Values on the stack at most, and values a list may have in all.
const MAX_VALUES: usize = 1 << 20;

/// Whether this is the name of the list in an archive.
pub fn is_list(name: &str) -> bool {
    name == "data.pkl" || name.ends_with("/data.pkl")
}

/// The tensors of 32-bit floats in the files of an archive.
pub fn parse(files: &[ArchivedFile]) -> Result<Weights, Damage> {
    let list = files.iter().find(|f| is_list(f.name));
    let list = list.ok_or(Damage::NoWeights)?;
    let folder = list.name.trim_end_matches("data.pkl");
    let content = list.content()?;
    let mut machine = Machine::new(&content);
    machine.run().ok_or(Damage::List)?;
    let mut storages: HashMap<String, Vec<f32>> = HashMap::new();
    for (_, tensor) in &machine.named {
        if !storages.contains_key(&tensor.storage) {
            let wanted = format!("{folder}data/{}", tensor.storage);
            let file = files.iter().find(|f| f.name == wanted);
            let bytes = file.ok_or(Damage::CutOff { what: "a tensor" })?.content()?;
            storages.insert(tensor.storage.clone(), floats(&bytes));
        }
    }
    weights(&machine.named, &storages)
}

/// The tensors of 32-bit floats in a file of PyTorch before 1.6, from behind the number that says so.
pub fn parse_old(bytes: &[u8]) -> Result<Weights, Damage> {
    let mut rest = bytes;
    let mut pickled = || -> Result<Machine<'_>, Damage> {
        let mut machine = Machine::new(rest);
        machine.run().ok_or(Damage::List)?;
        rest = machine.rest;
        Ok(machine)
    };
    // The version and the machine's types.
    for _ in 0..2 {
        pickled()?;
    }
    let (list, keys) = (pickled()?, pickled()?);
    let mut storages: HashMap<String, Vec<f32>> = HashMap::new();
    for key in keys.listed {
        let cut_off = Damage::CutOff { what: "a tensor" };
        let kind = list.storages.get(&key).ok_or(Damage::List)?;
        let value_bytes = value_bytes(kind).ok_or(Damage::List)?;
        let (count, values) = rest.split_first_chunk::<8>().ok_or(cut_off.clone())?;
        let length = usize::try_from(u64::from_le_bytes(*count)).ok();
        let length = length.and_then(|count| count.checked_mul(value_bytes));
        let split = length.and_then(|length| values.split_at_checked(length));
        let (values, after) = split.ok_or(cut_off)?;
        if kind == FLOATS {
            storages.insert(key, floats(values));
        }
        rest = after;
    }
    weights(&list.named, &storages)
}

/// What storages of 32-bit floats are called.
const FLOATS: &str = "torch.FloatStorage";

/// Bytes of a value in a storage of this kind; `None` of one that is not known.
fn value_bytes(kind: &str) -> Option<usize> {
    Some(
        match kind.strip_prefix("torch.")?.strip_suffix("Storage")? {
            "Byte" | "Char" | "Bool" => 1,
            "Half" | "BFloat16" | "Short" => 2,
            "Float" | "Int" => 4,
            "Double" | "Long" => 8,
            _ => return None,
        },
    )
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    let (values, _) = bytes.as_chunks::<4>();
    values.iter().map(|c| f32::from_le_bytes(*c)).collect()
}

fn weights(
    named: &[(String, StoredTensor)],
    storages: &HashMap<String, Vec<f32>>,
) -> Result<Weights, Damage> {
    let mut tensors = Vec::new();
    for (name, tensor) in named {
        let count = tensor
            .shape
            .iter()
            .try_fold(1usize, |p, n| p.checked_mul(*n));
        let end = count.and_then(|count| tensor.offset.checked_add(count));
        let storage = storages.get(&tensor.storage);
        let values = end.and_then(|end| storage?.get(tensor.offset..end));
        let values = values.ok_or(Damage::CutOff { what: "a tensor" })?;
        tensors.push((name.clone(), tensor.shape.clone(), values.to_vec()));
    }
    Ok(Weights::from_tensors(tensors))
}

/// A tensor that lies in a storage row by row.
#[derive(Clone, Debug, PartialEq)]
struct StoredTensor {
    storage: String,
    offset: usize,
    shape: Vec<usize>,
}

#[derive(Clone, Debug, PartialEq)]
enum Item {
    Mark,
    Number(usize),
    Text(String),
    Function(String),
    Tuple(Vec<Item>),
    FloatStorage(String),
    Tensor(StoredTensor),
    Other,
}

/// The stack machine of the pickle language.
struct Machine<'a> {
    rest: &'a [u8],
    stack: Vec<Item>,
    memo: HashMap<usize, Item>,
    named: Vec<(String, StoredTensor)>,
    /// Kinds of the storages by their keys.
    storages: BTreeMap<String, String>,
    /// Texts in lists.
    listed: Vec<String>,
    steps: usize,
}

impl<'a> Machine<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self {
            rest: bytes,
            stack: Vec::new(),
            memo: HashMap::new(),
            named: Vec::new(),
            storages: BTreeMap::new(),
            listed: Vec::new(),
            steps: 0,
        }
    }

    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.rest.split_at_checked(count)?;
        self.rest = rest;
        Some(taken)
    }

    fn number(&mut self, bytes: usize) -> Option<usize> {
        let taken = self.take(bytes)?;
        Some(
            taken
                .iter()
                .rev()
                .fold(0, |n, byte| n << 8 | usize::from(*byte)),
        )
    }

    fn line(&mut self) -> Option<&'a str> {
        let length = self.rest.iter().position(|b| *b == b'\n')?;
        let line = self.take(length + 1)?;
        std::str::from_utf8(&line[..length]).ok()
    }

    /// Everything above the last mark.
    fn above_mark(&mut self) -> Option<Vec<Item>> {
        let mark = self.stack.iter().rposition(|item| *item == Item::Mark)?;
        let above = self.stack.split_off(mark + 1);
        self.stack.pop();
        Some(above)
    }

    /// `None` where the bytes are no list that is understood.
    fn run(&mut self) -> Option<()> {
        loop {
            self.steps += 1;
            if self.steps > MAX_VALUES {
                return None;
            }
            let operation = self.take(1)?[0];
            if operation == b'.' {
                return Some(());
            }
            self.step(operation)?;
        }
    }

    fn step(&mut self, operation: u8) -> Option<()> {
        match operation {
            0x80 => {
                self.take(1)?;
            }
            b'(' => self.stack.push(Item::Mark),
            b'}' | b']' | b'N' | 0x88 | 0x89 => self.stack.push(Item::Other),
            b')' => self.stack.push(Item::Tuple(Vec::new())),
            b'K' => self.push_number(1)?,
            b'M' => self.push_number(2)?,
            b'J' => self.push_number(4)?,
            0x8a => {
                let length = self.number(1)?;
                self.push_number(length.min(8))?;
            }
            b'G' => {
                self.take(8)?;
                self.stack.push(Item::Other);
            }
            b'X' | b'U' => {
                // Python 2 writes short texts with a length of one byte.
                let length = self.number(if operation == b'X' { 4 } else { 1 })?;
                let text = std::str::from_utf8(self.take(length)?).ok()?;
                self.stack.push(Item::Text(text.to_owned()));
            }
            b'c' => {
                let name = format!("{}.{}", self.line()?, self.line()?);
                self.stack.push(Item::Function(name));
            }
            b'q' => self.remember(1)?,
            b'r' => self.remember(4)?,
            b'h' => self.recall(1)?,
            b'j' => self.recall(4)?,
            b't' => {
                let items = self.above_mark()?;
                self.stack.push(Item::Tuple(items));
            }
            0x85..=0x87 => {
                let count = usize::from(operation - 0x84);
                let items = self.stack.split_off(self.stack.len().checked_sub(count)?);
                self.stack.push(Item::Tuple(items));
            }
            b'Q' => {
                let storage = self.stack.pop()?;
                let storage = self.storage_of(&storage);
                self.stack.push(storage);
            }
            b'R' => {
                let (arguments, function) = (self.stack.pop()?, self.stack.pop()?);
                self.stack.push(called(&function, &arguments));
            }
            b'b' => drop(self.stack.pop()?),
            b'a' => {
                let item = self.stack.pop()?;
                self.list(item);
            }
            b'e' => {
                let items = self.above_mark()?;
                // Python 2 writes an entry of an ordered dictionary so.
                self.name(&items);
                items.into_iter().for_each(|item| self.list(item));
            }
            b's' => {
                let (value, key) = (self.stack.pop()?, self.stack.pop()?);
                self.name(&[key, value]);
            }
            b'u' => {
                let items = self.above_mark()?;
                items.chunks(2).for_each(|pair| self.name(pair));
            }
            _ => return None,
        }
        Some(())
    }

    fn push_number(&mut self, bytes: usize) -> Option<()> {
        let number = self.number(bytes)?;
        self.stack.push(Item::Number(number));
        Some(())
    }

    fn remember(&mut self, bytes: usize) -> Option<()> {
        let place = self.number(bytes)?;
        self.memo.insert(place, self.stack.last()?.clone());
        Some(())
    }

    fn recall(&mut self, bytes: usize) -> Option<()> {
        let place = self.number(bytes)?;
        self.stack.push(self.memo.get(&place)?.clone());
        Some(())
    }

    /// An item of a list.
    fn list(&mut self, item: Item) {
        if let Item::Text(text) = item {
            self.listed.push(text);
        }
    }

    /// What `("storage", type, key, device, count)` stands for.
    fn storage_of(&mut self, item: &Item) -> Item {
        let Item::Tuple(parts) = item else {
            return Item::Other;
        };
        let [_, Item::Function(kind), Item::Text(key), ..] = &parts[..] else {
            return Item::Other;
        };
        self.storages.insert(key.clone(), kind.clone());
        match kind == FLOATS {
            true => Item::FloatStorage(key.clone()),
            false => Item::Other,
        }
    }

    /// An entry of a dictionary.
    fn name(&mut self, pair: &[Item]) {
        if let [Item::Text(name), Item::Tensor(tensor)] = pair {
            self.named.push((name.clone(), tensor.clone()));
        }
    }
}

/// What a call gives: a tensor of `(storage, offset, shape, strides, …)`, where it lies row by row.
fn called(function: &Item, arguments: &Item) -> Item {
    let Item::Function(name) = function else {
        return Item::Other;
    };
    let Item::Tuple(parts) = arguments else {
        return Item::Other;
    };
    if name != "torch._utils._rebuild_tensor_v2" {
        return Item::Other;
    }
    let [
        Item::FloatStorage(storage),
        Item::Number(offset),
        Item::Tuple(shape),
        Item::Tuple(strides),
        ..,
    ] = &parts[..]
    else {
        return Item::Other;
    };
    let numbers = |items: &[Item]| -> Option<Vec<usize>> {
        let number = |item: &Item| match item {
            Item::Number(n) => Some(*n),
            _ => None,
        };
        items.iter().map(number).collect()
    };
    let (Some(shape), Some(strides)) = (numbers(shape), numbers(strides)) else {
        return Item::Other;
    };
    let mut step = 1usize;
    for (length, stride) in shape.iter().zip(&strides).rev() {
        if *length != 1 && *stride != step {
            return Item::Other;
        }
        step = step.saturating_mul(*length);
    }
    Item::Tensor(StoredTensor {
        storage: storage.clone(),
        offset: *offset,
        shape,
    })
}
