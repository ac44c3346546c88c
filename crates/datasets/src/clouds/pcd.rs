//! PCD files, format 0.7: text, binary and compressed.

use lsfb_recording::cloud::{ByteOrder, MAX_POINTS, NumberKind, PackedField};

use super::text::Lines;
use super::{Packed, lzf};

const MAX_HEADER_BYTES: usize = 4096;

#[derive(Clone, Copy, PartialEq, Eq)]
enum Writing {
    Text,
    Binary,
    /// Field after field, packed by LZF.
    Compressed,
}

/// A field, how many of its numbers each point has, and which word of a line is the first of them.
struct Column {
    field: PackedField,
    count: usize,
    word: usize,
}

struct Header {
    columns: Vec<Column>,
    point_bytes: usize,
    points: usize,
    writing: Writing,
    data_at: usize,
}

pub(super) fn parse(bytes: &[u8]) -> Result<Packed, String> {
    let header = header(bytes)?;
    let data = bytes.get(header.data_at..).unwrap_or_default();
    if header.writing == Writing::Text {
        let is_point = |line: &&[u8]| !line.trim_ascii().is_empty();
        let found = data.split(|b| *b == b'\n').filter(is_point).count();
        if found > header.points {
            return Err(format!(
                "{found} points, but the header says {}",
                header.points
            ));
        }
        let columns: Vec<usize> = header.columns.iter().map(|c| c.word).collect();
        let before = bytes.get(..header.data_at).unwrap_or_default();
        let lines = Lines {
            header: before.iter().filter(|b| **b == b'\n').count(),
            points: header.points,
            words: header.columns.iter().map(|c| c.count).sum(),
            columns: &columns,
        };
        let data = lines.doubles(data)?;
        let names = header.columns.iter().map(|c| c.field.name.as_str());
        return Ok(Packed::of_doubles(names, data));
    }
    let needed = header.points * header.point_bytes;
    let data = match header.writing {
        Writing::Compressed => by_points(&header, &decompressed(data, needed)?),
        Writing::Text | Writing::Binary => {
            data.get(..needed).map(<[u8]>::to_vec).ok_or_else(|| {
                format!(
                    "{} bytes of points, but the header says {needed}: truncated",
                    data.len()
                )
            })?
        }
    };
    Ok(Packed {
        fields: header.columns.into_iter().map(|c| c.field).collect(),
        order: ByteOrder::Little,
        point_bytes: header.point_bytes,
        points: header.points,
        data,
    })
}

/// The bytes behind two lengths: packed, and unpacked.
fn decompressed(data: &[u8], needed: usize) -> Result<Vec<u8>, String> {
    let truncated = || "compressed points: truncated".to_owned();
    let length = |at: usize| {
        let bytes = data.get(at..).and_then(|rest| rest.first_chunk());
        bytes.map(|b| u32::from_le_bytes(*b) as usize)
    };
    let packed = length(0).ok_or_else(truncated)?;
    let unpacked = length(4).ok_or_else(truncated)?;
    if unpacked != needed {
        return Err(format!(
            "{unpacked} bytes of compressed points, but the header says {needed}"
        ));
    }
    let packed = data.get(8..).and_then(|rest| rest.get(..packed));
    lzf::unpack(packed.ok_or_else(truncated)?, needed)
}

/// From all points of a field after all of the field before to all fields of a point after all of the point before.
fn by_points(header: &Header, by_fields: &[u8]) -> Vec<u8> {
    let mut data = vec![0; by_fields.len()];
    let mut rest = by_fields;
    for column in &header.columns {
        let width = column.field.kind.bytes() * column.count;
        let (of_field, behind) = rest.split_at((width * header.points).min(rest.len()));
        rest = behind;
        let points = data.chunks_exact_mut(header.point_bytes);
        for (point, value) in points.zip(of_field.chunks_exact(width)) {
            if let Some(room) = point.get_mut(column.field.offset..column.field.offset + width) {
                room.copy_from_slice(value);
            }
        }
    }
    data
}

fn header(bytes: &[u8]) -> Result<Header, String> {
    let mut names: Vec<String> = Vec::new();
    let (mut sizes, mut kinds, mut counts) = (Vec::new(), Vec::new(), Vec::new());
    let mut points = None;
    let mut at = 0;
    loop {
        let rest = bytes
            .get(at..MAX_HEADER_BYTES.min(bytes.len()))
            .unwrap_or_default();
        let Some(end) = rest.iter().position(|&b| b == b'\n') else {
            return Err("not a PCD header: the line DATA is missing".to_owned());
        };
        let line = String::from_utf8_lossy(rest.get(..end).unwrap_or_default()).into_owned();
        at += end + 1;
        let mut words = line.split_whitespace();
        let numbers = |words: std::str::SplitWhitespace<'_>| -> Result<Vec<usize>, String> {
            words
                .map(|w| {
                    w.parse()
                        .map_err(|_| format!("{w:?} is not a number in {line:?}"))
                })
                .collect()
        };
        match words.next() {
            Some("FIELDS") => names = words.map(str::to_owned).collect(),
            Some("SIZE") => sizes = numbers(words)?,
            Some("COUNT") => counts = numbers(words)?,
            Some("TYPE") => kinds = words.map(str::to_owned).collect(),
            Some("POINTS") => points = numbers(words)?.first().copied(),
            Some("DATA") => {
                let writing = match words.next() {
                    Some("ascii") => Writing::Text,
                    Some("binary") => Writing::Binary,
                    Some("binary_compressed") => Writing::Compressed,
                    other => {
                        return Err(format!(
                            "DATA {} is not supported: use ascii, binary or binary_compressed",
                            other.unwrap_or("")
                        ));
                    }
                };
                let points = points.ok_or("the line POINTS is missing")?;
                if points > MAX_POINTS {
                    return Err(format!("{points} points; a scan has at most {MAX_POINTS}"));
                }
                let (columns, point_bytes) = layout(&names, &sizes, &kinds, &counts)?;
                return Ok(Header {
                    columns,
                    point_bytes,
                    points,
                    writing,
                    data_at: at,
                });
            }
            _ => {}
        }
    }
}

fn layout(
    names: &[String],
    sizes: &[usize],
    kinds: &[String],
    counts: &[usize],
) -> Result<(Vec<Column>, usize), String> {
    if names.is_empty() || sizes.len() != names.len() || kinds.len() != names.len() {
        return Err("FIELDS, SIZE and TYPE do not name the same number of fields".to_owned());
    }
    let (mut offset, mut word) = (0, 0);
    let mut columns = Vec::new();
    for (i, ((name, size), kind)) in names.iter().zip(sizes).zip(kinds).enumerate() {
        let count = counts.get(i).copied().unwrap_or(1);
        let kind = kind_of(kind, *size).filter(|_| (1..=1024).contains(&count));
        let kind =
            kind.ok_or_else(|| format!("field {name}: type, size {size} or count {count}"))?;
        columns.push(Column {
            field: PackedField {
                name: name.clone(),
                kind,
                offset,
            },
            count,
            word,
        });
        offset += kind.bytes() * count;
        word += count;
    }
    Ok((columns, offset))
}

fn kind_of(letter: &str, bytes: usize) -> Option<NumberKind> {
    Some(match (letter, bytes) {
        ("I", 1) => NumberKind::I8,
        ("U", 1) => NumberKind::U8,
        ("I", 2) => NumberKind::I16,
        ("U", 2) => NumberKind::U16,
        ("I", 4) => NumberKind::I32,
        ("U", 4) => NumberKind::U32,
        ("I", 8) => NumberKind::I64,
        ("U", 8) => NumberKind::U64,
        ("F", 4) => NumberKind::F32,
        ("F", 8) => NumberKind::F64,
        _ => return None,
    })
}
