//! Point clouds in PCD files, format 0.7, ASCII and binary: fields x y z, and intensity, ring and the points' times where they are
//! there (`point_times.rs`).

use std::path::Path;

use lsfb_types::{Echo, LidarPoint, LidarScan};

use crate::Error;
use crate::point_times::{Numbers, PointTimes, is_time, point_times};

/// Points in one file; more is a map, not a scan.
const MAX_POINTS: usize = 20_000_000;
const MAX_HEADER_BYTES: usize = 4096;

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Float,
    Signed,
    Unsigned,
}

struct Field {
    name: String,
    kind: Kind,
    size: usize,
    offset: usize,
    column: usize,
}

struct Header {
    fields: Vec<Field>,
    point_bytes: usize,
    points: usize,
    binary: bool,
    data_at: usize,
}

/// A point cloud from a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Cloud {
    /// Its points.
    pub scan: LidarScan,
    /// Where their times come from.
    pub times: PointTimes,
}

/// Reads a point cloud from a PCD file, ASCII or binary. Points whose coordinates are not finite are left out.
pub fn read_pcd(path: &Path) -> Result<Cloud, Error> {
    let bytes = std::fs::read(path).map_err(|source| Error::Io {
        path: path.to_owned(),
        action: "read",
        source,
    })?;
    let fail = |message: String| Error::Cloud {
        path: path.to_owned(),
        message,
    };
    let header = header(&bytes).map_err(fail)?;
    let data = bytes.get(header.data_at..).unwrap_or_default();
    let mut rows: Vec<Vec<f64>> = if header.binary {
        let need = header.points * header.point_bytes;
        if data.len() < need {
            return Err(fail(format!(
                "{} bytes of points where the header announces {need}: truncated",
                data.len()
            )));
        }
        data.chunks_exact(header.point_bytes)
            .take(header.points)
            .map(|row| binary_row(&header, row))
            .collect()
    } else {
        let text = String::from_utf8_lossy(data);
        let lines = text.lines().filter(|line| !line.trim().is_empty());
        let rows: Vec<_> = lines
            .take(header.points)
            .map(|line| text_row(&header, line))
            .collect();
        if rows.len() < header.points {
            return Err(fail(format!(
                "{} points where the header announces {}",
                rows.len(),
                header.points
            )));
        }
        rows
    };
    let column = |name: &str| header.fields.iter().position(|f| f.name == name);
    let (Some(x), Some(y), Some(z)) = (column("x"), column("y"), column("z")) else {
        return Err(fail("no fields x, y and z".to_owned()));
    };
    let (intensity, ring) = (column("intensity"), column("ring"));
    rows.retain(|row| {
        [x, y, z]
            .iter()
            .all(|i| row.get(*i).is_some_and(|c| (*c as f32).is_finite()))
    });
    let time = header.fields.iter().position(|f| is_time(&f.name));
    let (offsets_ns, times) = match time.and_then(|at| Some((at, header.fields.get(at)?))) {
        None => (Vec::new(), PointTimes::Absent),
        Some((at, field)) => {
            let values: Vec<f64> = rows.iter().map(|r| value(r, Some(at))).collect();
            let numbers = match field.kind {
                Kind::Float => Numbers::Real,
                Kind::Signed | Kind::Unsigned => Numbers::Whole,
            };
            point_times(&field.name, numbers, &values)
        }
    };
    let points = rows.iter().enumerate().map(|(k, row)| LidarPoint {
        position_m: [x, y, z].map(|i| value(row, Some(i)) as f32),
        // Float casts saturate: what does not fit becomes the nearest that does.
        intensity: value(row, intensity) as u8,
        ring: value(row, ring) as u16,
        // Programs number the kinds of returns differently, and the file does not say which one wrote it.
        echo: Echo::Unknown,
        time_offset_ns: offsets_ns.get(k).copied().unwrap_or(0),
    });
    Ok(Cloud {
        scan: LidarScan {
            points: points.collect(),
        },
        times,
    })
}

/// A number of a row; zero where the file has no such field.
fn value(row: &[f64], at: Option<usize>) -> f64 {
    at.and_then(|i| row.get(i)).copied().unwrap_or(0.0)
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
            return Err("no PCD header: the line DATA is missing".to_owned());
        };
        let line = String::from_utf8_lossy(rest.get(..end).unwrap_or_default()).into_owned();
        at += end + 1;
        let mut words = line.split_whitespace();
        let numbers = |words: std::str::SplitWhitespace<'_>| -> Result<Vec<usize>, String> {
            words
                .map(|w| {
                    w.parse()
                        .map_err(|_| format!("{w:?} is no number in {line:?}"))
                })
                .collect()
        };
        match words.next() {
            Some("FIELDS") => names = words.map(str::to_owned).collect(),
            Some("SIZE") => sizes = numbers(words)?,
            Some("COUNT") => counts = numbers(words)?,
            Some("TYPE") => {
                kinds = words
                    .map(|w| match w {
                        "F" => Ok(Kind::Float),
                        "I" => Ok(Kind::Signed),
                        "U" => Ok(Kind::Unsigned),
                        _ => Err(format!("unknown type {w:?}")),
                    })
                    .collect::<Result<_, _>>()?;
            }
            Some("POINTS") => points = numbers(words)?.first().copied(),
            Some("DATA") => {
                let binary = match words.next() {
                    Some("ascii") => false,
                    Some("binary") => true,
                    other => {
                        return Err(format!(
                            "DATA {} is not supported, ascii and binary are",
                            other.unwrap_or("")
                        ));
                    }
                };
                let points = points.ok_or("no line POINTS")?;
                if points > MAX_POINTS {
                    return Err(format!("{points} points; a scan has at most {MAX_POINTS}"));
                }
                let (fields, point_bytes) = layout(&names, &sizes, &kinds, &counts)?;
                return Ok(Header {
                    fields,
                    point_bytes,
                    points,
                    binary,
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
    kinds: &[Kind],
    counts: &[usize],
) -> Result<(Vec<Field>, usize), String> {
    if names.is_empty() || sizes.len() != names.len() || kinds.len() != names.len() {
        return Err("FIELDS, SIZE and TYPE do not name the same number of fields".to_owned());
    }
    let (mut offset, mut column) = (0, 0);
    let mut fields = Vec::new();
    for (i, ((name, &size), &kind)) in names.iter().zip(sizes).zip(kinds).enumerate() {
        let count = counts.get(i).copied().unwrap_or(1);
        if !matches!(size, 1 | 2 | 4 | 8) || !(1..=1024).contains(&count) {
            return Err(format!("field {name}: size {size}, count {count}"));
        }
        fields.push(Field {
            name: name.clone(),
            kind,
            size,
            offset,
            column,
        });
        offset += size * count;
        column += count;
    }
    Ok((fields, offset))
}

fn binary_row(header: &Header, row: &[u8]) -> Vec<f64> {
    let value = |field: &Field| {
        let mut wide = [0_u8; 8];
        let bytes = row
            .get(field.offset..field.offset + field.size)
            .unwrap_or_default();
        for (to, from) in wide.iter_mut().zip(bytes) {
            *to = *from;
        }
        let [a, b, c, d, ..] = wide;
        match (field.kind, field.size) {
            (Kind::Float, 4) => f64::from(f32::from_le_bytes([a, b, c, d])),
            (Kind::Float, 8) => f64::from_le_bytes(wide),
            (Kind::Float, _) => f64::NAN,
            (Kind::Unsigned, _) => u64::from_le_bytes(wide) as f64,
            (Kind::Signed, 1) => f64::from(i8::from_le_bytes([a])),
            (Kind::Signed, 2) => f64::from(i16::from_le_bytes([a, b])),
            (Kind::Signed, 4) => f64::from(i32::from_le_bytes([a, b, c, d])),
            (Kind::Signed, _) => i64::from_le_bytes(wide) as f64,
        }
    };
    header.fields.iter().map(value).collect()
}

fn text_row(header: &Header, line: &str) -> Vec<f64> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let value = |field: &Field| {
        words
            .get(field.column)
            .and_then(|w| w.parse().ok())
            .unwrap_or(f64::NAN)
    };
    header.fields.iter().map(value).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z intensity ring\nSIZE 4 4 4 4 2\nTYPE F F F F U\n\
                          COUNT 1 1 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\n";

    fn written(bytes: &[u8]) -> Result<Cloud, Error> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.pcd");
        std::fs::write(&path, bytes).unwrap();
        read_pcd(&path)
    }

    #[test]
    fn ascii_and_binary_say_the_same() {
        let ascii = format!("{HEADER}DATA ascii\n1 2 3 40 5\n-1 -2 0.5 300 6\n");
        let mut binary = format!("{HEADER}DATA binary\n").into_bytes();
        for (xyzi, ring) in [
            ([1.0_f32, 2.0, 3.0, 40.0], 5_u16),
            ([-1.0, -2.0, 0.5, 300.0], 6),
        ] {
            binary.extend(xyzi.iter().flat_map(|v| v.to_le_bytes()));
            binary.extend(ring.to_le_bytes());
        }
        let point = |position_m, intensity, ring| LidarPoint {
            echo: Echo::Unknown,
            position_m,
            intensity,
            ring,
            time_offset_ns: 0,
        };
        let expected = vec![
            point([1.0, 2.0, 3.0], 40, 5),
            point([-1.0, -2.0, 0.5], 255, 6),
        ];
        for bytes in [ascii.as_bytes(), &binary] {
            let cloud = written(bytes).unwrap();
            assert_eq!(cloud.scan.points, expected);
            assert_eq!(cloud.times, PointTimes::Absent);
        }
    }

    #[test]
    fn the_field_of_times_is_used_whatever_its_name() {
        let cloud = |name: &str, kind: &str, size: usize, times: [&str; 2]| {
            let text = format!(
                "VERSION 0.7\nFIELDS x y z {name}\nSIZE 4 4 4 {size}\nTYPE F F F {kind}\nPOINTS 3\n\
                 DATA ascii\n1 2 3 {}\nnan 2 3 7e18\n1 2 4 {}\n",
                times[0], times[1]
            );
            written(text.as_bytes()).unwrap()
        };
        for (name, kind, size, times) in [
            ("t", "U", 4, ["5000000", "85000000"]),
            ("time", "F", 4, ["-0.08", "0"]),
            ("timestamp", "F", 8, ["1700000000.25", "1700000000.33"]),
            ("offset_time", "U", 4, ["20", "80020"]),
        ] {
            let found = cloud(name, kind, size, times);
            assert!(matches!(&found.times, PointTimes::Field { name: n, .. } if n == name));
            let offsets: Vec<u32> = found.scan.points.iter().map(|p| p.time_offset_ns).collect();
            assert!(
                offsets[0] == 0 && offsets[1].abs_diff(80_000_000) < 200,
                "{name}: {offsets:?}"
            );
        }
    }

    #[test]
    fn damage_is_named_and_never_panics() {
        let whole = format!("{HEADER}DATA binary\n0123456789").into_bytes();
        for cut in 0..whole.len() {
            assert!(written(&whole[..cut]).is_err());
        }
        let message = written(&whole).unwrap_err().to_string();
        assert!(
            message.contains("a.pcd") && message.contains("truncated"),
            "{message}"
        );
        let nothing = HEADER.replace("COUNT 1 1 1 1 1", "COUNT 0 0 0 0 0");
        let message = written(format!("{nothing}DATA binary\n").as_bytes()).unwrap_err();
        assert!(message.to_string().contains("count 0"), "{message}");
        let compressed = format!("{HEADER}DATA binary_compressed\n");
        assert!(
            written(compressed.as_bytes())
                .unwrap_err()
                .to_string()
                .contains("binary_compressed")
        );
    }
}
