//! PLY files, text and binary of both byte orders: the element `vertex`.

use lsfb_recording::cloud::{ByteOrder, MAX_POINTS, NumberKind, PackedField};

use super::Packed;
use super::text::Lines;

/// Lines of a header at most.
const MAX_HEADER_LINES: usize = 1_000;

#[derive(Clone, Copy, PartialEq, Eq)]
enum Writing {
    Text,
    Binary(ByteOrder),
}

pub(super) fn parse(bytes: &[u8]) -> Result<Packed, String> {
    let mut rest = bytes;
    let mut writing = None;
    let mut points = None;
    let mut in_vertex = false;
    let (mut fields, mut point_bytes) = (Vec::new(), 0);
    for number in 0.. {
        let end = rest.iter().position(|b| *b == b'\n');
        let end = end.filter(|_| number < MAX_HEADER_LINES);
        let end = end.ok_or("not a PLY header: the line end_header is missing")?;
        let (line, behind) = rest.split_at(end);
        rest = behind.get(1..).unwrap_or_default();
        let line = String::from_utf8_lossy(line);
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["ply"] if number == 0 => {}
            _ if number == 0 => {
                return Err("not a PLY file: it does not begin with `ply`".to_owned());
            }
            ["format", "ascii", _] => writing = Some(Writing::Text),
            ["format", "binary_little_endian", _] => {
                writing = Some(Writing::Binary(ByteOrder::Little));
            }
            ["format", "binary_big_endian", _] => writing = Some(Writing::Binary(ByteOrder::Big)),
            ["format", ..] => return Err(format!("unknown: {line:?}")),
            ["element", "vertex", count] => {
                points = Some(count.parse::<usize>().map_err(|_| format!("{line:?}"))?);
                in_vertex = true;
            }
            ["element", name, ..] => {
                if points.is_none() {
                    return Err(format!(
                        "elements {name} before the vertices are not supported"
                    ));
                }
                in_vertex = false;
            }
            ["property", "list", ..] if in_vertex => {
                return Err("vertices with lists are not supported".to_owned());
            }
            ["property", kind, name] if in_vertex => {
                let kind = kind_of(kind).ok_or_else(|| format!("unknown: {line:?}"))?;
                fields.push(PackedField {
                    name: (*name).to_owned(),
                    kind,
                    offset: point_bytes,
                });
                point_bytes += kind.bytes();
            }
            ["end_header"] => break,
            _ => {}
        }
    }
    let points = points.ok_or("the element vertex is missing")?;
    if points > MAX_POINTS {
        return Err(format!("{points} points; a scan has at most {MAX_POINTS}"));
    }
    match writing.ok_or("the line format is missing")? {
        Writing::Text => {
            let columns: Vec<usize> = (0..fields.len()).collect();
            let before = bytes.get(..bytes.len() - rest.len()).unwrap_or_default();
            let lines = Lines {
                header: before.iter().filter(|b| **b == b'\n').count(),
                points,
                words: columns.len(),
                columns: &columns,
            };
            let data = lines.doubles(rest)?;
            Ok(Packed::of_doubles(
                fields.iter().map(|f| f.name.as_str()),
                data,
            ))
        }
        Writing::Binary(order) => {
            let needed = points * point_bytes;
            let data = rest.get(..needed).ok_or_else(|| {
                format!(
                    "{} bytes of points, but the header says {needed}: truncated",
                    rest.len()
                )
            })?;
            Ok(Packed {
                fields,
                order,
                point_bytes,
                points,
                data: data.to_vec(),
            })
        }
    }
}

fn kind_of(name: &str) -> Option<NumberKind> {
    Some(match name {
        "char" | "int8" => NumberKind::I8,
        "uchar" | "uint8" => NumberKind::U8,
        "short" | "int16" => NumberKind::I16,
        "ushort" | "uint16" => NumberKind::U16,
        "int" | "int32" => NumberKind::I32,
        "uint" | "uint32" => NumberKind::U32,
        "float" | "float32" => NumberKind::F32,
        "double" | "float64" => NumberKind::F64,
        _ => return None,
    })
}
