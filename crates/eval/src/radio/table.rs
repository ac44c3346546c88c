//! Readings at their places as a table, for any program.

use std::fmt::Write as _;
use std::path::Path;

use lsfb_geometry::Vector3;
use lsfb_types::Timestamp;

use super::placing::{PlacedReading, RadioKind};
use crate::Error;

const HEADER: &str =
    "kind,time_ns,scan,source,rssi_dbm,field_x_t,field_y_t,field_z_t,x_m,y_m,z_m,sigma_m";
/// Larger files are none of these.
const MOST_BYTES: u64 = 1 << 30;

/// The table, a reading on each line. What would break it in a sender's name is replaced by `_`.
pub fn table(readings: &[PlacedReading]) -> String {
    let mut text = format!("{HEADER}\n");
    for r in readings {
        let kind = match r.kind {
            RadioKind::Wifi => "wifi",
            RadioKind::Ble => "ble",
            RadioKind::Magnetic => "magnetic",
        };
        let breaks = |c: char| c == ',' || c == '"' || c.is_control();
        let source = r.source.replace(breaks, "_");
        let ([fx, fy, fz], p) = (r.field_t, r.position_m);
        // Writing into a string cannot fail.
        let _ = writeln!(
            text,
            "{kind},{},{},{source},{},{fx},{fy},{fz},{:.4},{:.4},{:.4},{:.4}",
            r.time.nanos(),
            r.scan,
            r.rssi_dbm,
            p.x,
            p.y,
            p.z,
            r.sigma_m
        );
    }
    text
}

/// Reads such a table.
pub fn read_table(path: &Path) -> Result<Vec<PlacedReading>, Error> {
    let io = |source| Error::Io {
        path: path.to_owned(),
        source,
    };
    let wrong = |what: String| Error::NotATrajectory {
        path: path.to_owned(),
        what,
    };
    if std::fs::metadata(path).map_err(io)?.len() > MOST_BYTES {
        return Err(wrong("larger than 1 GiB".to_owned()));
    }
    let text = std::fs::read_to_string(path).map_err(io)?;
    let mut lines = text.lines();
    if lines.next() != Some(HEADER) {
        return Err(wrong(format!(
            "not a table of placed readings: its first line is not '{HEADER}'; make one with `lsfb dataset radio`"
        )));
    }
    lines
        .enumerate()
        .filter(|(_, line)| !line.is_empty())
        .map(|(i, line)| {
            parse(line).map_err(|what| Error::BadLine {
                path: path.to_owned(),
                line: i + 2,
                what,
            })
        })
        .collect()
}

fn parse(line: &str) -> Result<PlacedReading, String> {
    let cells: Vec<&str> = line.split(',').collect();
    let [kind, time, scan, source, rssi, numbers @ ..] = &cells[..] else {
        return Err(format!("{} columns; expected 12", cells.len()));
    };
    let no_number = |cell: &str| format!("'{cell}' is not a valid number for this column");
    let numbers: Result<Vec<f64>, String> = numbers
        .iter()
        .map(|cell| {
            let number: Option<f64> = cell.parse().ok();
            number
                .filter(|n| n.is_finite())
                .ok_or_else(|| no_number(cell))
        })
        .collect();
    let &[fx, fy, fz, x, y, z, sigma_m] = &numbers?[..] else {
        return Err(format!("{} columns; expected 12", cells.len()));
    };
    if sigma_m < 0.0 {
        return Err(format!("'{sigma_m}' is not a standard deviation"));
    }
    Ok(PlacedReading {
        kind: match *kind {
            "wifi" => RadioKind::Wifi,
            "ble" => RadioKind::Ble,
            "magnetic" => RadioKind::Magnetic,
            other => return Err(format!("'{other}' is not a kind of reading")),
        },
        time: Timestamp::from_nanos(time.parse().map_err(|_| no_number(time))?),
        scan: scan.parse().map_err(|_| no_number(scan))?,
        source: (*source).to_owned(),
        rssi_dbm: rssi.parse().map_err(|_| no_number(rssi))?,
        field_t: [fx, fy, fz],
        position_m: Vector3::new(x, y, z),
        sigma_m,
    })
}
