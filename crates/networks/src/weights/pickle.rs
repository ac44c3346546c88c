//! The tensors of a PyTorch file: an archive with a pickled list (`data.pkl`) and a file of values for each storage.
//!
//! Of the pickle language only what such lists are made of is understood, and nothing is ever executed: names of functions are
//! compared with those that put tensors and ordered dictionaries together, all others give a value of no meaning.

use std::collections::HashMap;

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
    let mut storages: HashMap<&str, Vec<f32>> = HashMap::new();
    let mut tensors = Vec::new();
    for (name, tensor) in &machine.named {
        if !storages.contains_key(tensor.storage.as_str()) {
            let wanted = format!("{folder}data/{}", tensor.storage);
            let file = files.iter().find(|f| f.name == wanted);
            let bytes = file.ok_or(Damage::CutOff { what: "a tensor" })?.content()?;
            let (values, _) = bytes.as_chunks::<4>();
            let values = values.iter().map(|c| f32::from_le_bytes(*c)).collect();
            storages.insert(&tensor.storage, values);
        }
        let count = tensor
            .shape
            .iter()
            .try_fold(1usize, |p, n| p.checked_mul(*n));
        let end = count.and_then(|count| tensor.offset.checked_add(count));
        let values = end.and_then(|end| storages[tensor.storage.as_str()].get(tensor.offset..end));
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
    steps: usize,
}

impl<'a> Machine<'a> {
    fn new(bytes: &'a [u8]) -> Self {
        Self {
            rest: bytes,
            stack: Vec::new(),
            memo: HashMap::new(),
            named: Vec::new(),
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
            b'X' => {
                let length = self.number(4)?;
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
                self.stack.push(storage_of(&storage));
            }
            b'R' => {
                let (arguments, function) = (self.stack.pop()?, self.stack.pop()?);
                self.stack.push(called(&function, &arguments));
            }
            b'b' => drop(self.stack.pop()?),
            b'a' => drop(self.stack.pop()?),
            b'e' => drop(self.above_mark()?),
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

    /// An entry of a dictionary.
    fn name(&mut self, pair: &[Item]) {
        if let [Item::Text(name), Item::Tensor(tensor)] = pair {
            self.named.push((name.clone(), tensor.clone()));
        }
    }
}

/// What `("storage", type, key, device, count)` stands for.
fn storage_of(item: &Item) -> Item {
    if let Item::Tuple(parts) = item
        && let [_, Item::Function(kind), Item::Text(key), ..] = &parts[..]
        && kind == "torch.FloatStorage"
    {
        return Item::FloatStorage(key.clone());
    }
    Item::Other
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
