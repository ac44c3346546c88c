//! What the values at the front of a record are, as the head of the file says, and reading them.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::{Bytes, Tags};

#[derive(Deserialize)]
struct Described {
    data_layout: Vec<Piece>,
}

#[derive(Deserialize)]
struct Piece {
    name: String,
    #[serde(rename = "type")]
    of: String,
    offset: Option<usize>,
    index: Option<usize>,
    size: Option<usize>,
}

/// What the values at the front of a record are.
pub(in crate::import) struct Layout {
    pieces: BTreeMap<String, Piece>,
    /// Bytes of the values of fixed size, and how many of others lie behind them.
    fixed: usize,
    parts: usize,
    /// What follows the values: `image/jpg`.
    pub(in crate::import) behind: String,
}

/// The values of a record.
pub(in crate::import) struct Values<'a> {
    layout: &'a Layout,
    record: &'a [u8],
    /// Bytes of all values.
    pub(in crate::import) size: usize,
}

impl Layout {
    /// That of a stream's data in a version; why there is none, in words.
    pub(in crate::import) fn of(tags: &Tags, version: u32) -> Result<Self, String> {
        let tag = |name: String| tags.get(&name).ok_or(format!("the file has no tag {name}"));
        let format = tag(format!("RF:Data:{version}"))?;
        let (first, behind) = format.split_once('+').unwrap_or((format, ""));
        if first.split('/').next() != Some("data_layout") {
            return Err(format!("records of the form {format} are not supported"));
        }
        let layout = tag(format!("DL:Data:{version}:0"))?;
        let layout: Described = serde_json::from_str(layout).map_err(|e| e.to_string())?;
        let (mut fixed, mut parts) = (0, 0);
        for piece in &layout.data_layout {
            match (piece.offset, piece.index) {
                (Some(offset), _) => {
                    let end = piece.bytes()?.checked_add(offset);
                    fixed = fixed.max(end.ok_or("a value far outside its record")?);
                }
                (None, Some(index)) => parts = parts.max(index.saturating_add(1)),
                (None, None) => return Err(format!("the position of {} is unknown", piece.name)),
            }
        }
        let pieces = layout.data_layout.into_iter();
        Ok(Self {
            pieces: pieces.map(|p| (p.name.clone(), p)).collect(),
            fixed,
            parts,
            behind: behind.to_owned(),
        })
    }

    /// The values at the front of a record.
    pub(in crate::import) fn values<'a>(&'a self, record: &'a [u8]) -> Result<Values<'a>, String> {
        let mut values = Values {
            layout: self,
            record,
            size: 0,
        };
        let mut size = self.fixed.saturating_add(self.parts.saturating_mul(8));
        for part in 0..self.parts.min(record.len()) {
            size = size.max(values.part(part)?.1);
        }
        if record.len() < size {
            return Err(format!("{} bytes instead of {size}", record.len()));
        }
        values.size = size;
        Ok(values)
    }
}

impl Piece {
    /// Its bytes, where it has a fixed size.
    fn bytes(&self) -> Result<usize, String> {
        let element = self
            .of
            .split_once('<')
            .map_or("", |(_, e)| e.trim_end_matches('>'));
        let size = match element {
            "Bool" | "int8_t" | "uint8_t" | "char" => 1,
            "int16_t" | "uint16_t" => 2,
            "int32_t" | "uint32_t" | "float" => 4,
            "int64_t" | "uint64_t" | "double" | "Point2Df" => 8,
            "Point3Df" => 12,
            "Point2Dd" | "Point4Df" => 16,
            "Point3Dd" => 24,
            "Point4Dd" => 32,
            other => {
                return Err(format!(
                    "{} is of the type {other}, which is not supported",
                    self.name
                ));
            }
        };
        Ok(self.size.unwrap_or(1).saturating_mul(size))
    }
}

impl<'a> Values<'a> {
    /// Where a value of its own length begins and ends in the record.
    fn part(&self, index: usize) -> Result<(usize, usize), String> {
        let entry = self
            .record
            .get(self.layout.fixed + 8 * index..)
            .unwrap_or_default();
        let mut entry = Bytes(entry);
        let found = entry.u32().zip(entry.u32());
        let (offset, length) = found.ok_or("a truncated record")?;
        let begin = self.layout.fixed + 8 * self.layout.parts + offset as usize;
        Ok((begin, begin + length as usize))
    }

    fn fixed(&self, name: &str, of: &str) -> Result<&'a [u8], String> {
        let piece = self.layout.pieces.get(name);
        let piece = piece.filter(|p| p.of == of);
        let piece = piece.ok_or_else(|| format!("it has no {name} of {of}"))?;
        let begin = piece.offset.unwrap_or(usize::MAX);
        let end = begin.saturating_add(piece.bytes()?);
        self.record
            .get(begin..end)
            .ok_or_else(|| format!("truncated before {name}"))
    }

    /// A whole number of 64 bits.
    pub(in crate::import) fn int(&self, name: &str) -> Result<i64, String> {
        let bytes = self.fixed(name, "DataPieceValue<int64_t>")?;
        Ok(i64::from_le_bytes(bytes.try_into().unwrap_or_default()))
    }

    /// A whole number of 64 bits without a sign.
    pub(in crate::import) fn unsigned(&self, name: &str) -> Result<u64, String> {
        let bytes = self.fixed(name, "DataPieceValue<uint64_t>")?;
        Ok(u64::from_le_bytes(bytes.try_into().unwrap_or_default()))
    }

    /// A number of either precision, finite.
    pub(in crate::import) fn number(&self, name: &str) -> Result<f64, String> {
        let double = self.fixed(name, "DataPieceValue<double>");
        let value = match double {
            Ok(bytes) => f64::from_le_bytes(bytes.try_into().unwrap_or_default()),
            Err(_) => {
                let bytes = self.fixed(name, "DataPieceValue<float>")?;
                f64::from(f32::from_le_bytes(bytes.try_into().unwrap_or_default()))
            }
        };
        match value.is_finite() {
            true => Ok(value),
            false => Err(format!("{name} is not finite")),
        }
    }

    /// Three finite numbers, which another value calls valid.
    pub(in crate::import) fn axes(&self, name: &str) -> Result<[f64; 3], String> {
        if self.fixed(&format!("{name}_valid"), "DataPieceValue<Bool>")? == [0] {
            return Err(format!("its {name} is marked as not valid"));
        }
        let mut bytes = Bytes(self.fixed(name, "DataPieceArray<float>")?);
        let axes = [(); 3].map(|()| {
            bytes
                .array()
                .map_or(f64::NAN, |b| f64::from(f32::from_le_bytes(b)))
        });
        match axes.iter().all(|v| v.is_finite()) {
            true => Ok(axes),
            false => Err(format!("{name} has not three finite numbers")),
        }
    }

    /// A text.
    pub(in crate::import) fn text(&self, name: &str) -> Result<String, String> {
        let piece = self.layout.pieces.get(name);
        let index = piece.filter(|p| p.of == "DataPieceString");
        let index = index.and_then(|p| p.index);
        let (begin, end) = self.part(index.ok_or_else(|| format!("it has no {name}"))?)?;
        let text = self.record.get(begin..end);
        let text = text.ok_or_else(|| format!("truncated within {name}"))?;
        Ok(String::from_utf8_lossy(text).into_owned())
    }

    /// What is behind the values.
    pub(in crate::import) fn behind(&self) -> &'a [u8] {
        self.record.get(self.size..).unwrap_or_default()
    }
}
