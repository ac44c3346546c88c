//! What was measured, in the layout of the paper's Tables III, VI and VII.

use super::description::Description;
use super::plan::{Device, Environment};
use super::sequence::SequenceFigures;

/// What stands where nothing is known.
const NOTHING: &str = "–";

/// Table III: the cameras of each device, as its first sequence has them.
pub fn cameras_table(measured: &[SequenceFigures]) -> String {
    let mut rows = vec![row(["", "Android phone", "iPhone", "AR glasses"])];
    let of = |device: Device| measured.iter().find(|m| m.planned.device == device);
    let line = |title: &str, text: &dyn Fn(&SequenceFigures) -> Option<String>| {
        let cells = Device::ALL.map(|device| of(device).and_then(text));
        let [a, i, g] = cells.map(|cell| cell.unwrap_or_else(|| NOTHING.to_owned()));
        vec![title.to_owned(), a, i, g]
    };
    rows.push(line("#Cam.", &|m| Some(m.images.cameras.len().to_string())));
    rows.push(line("Res.", &|m| {
        let [width, height] = m.images.cameras.first()?.size_px;
        Some(format!("{width}×{height}"))
    }));
    rows.push(line("FoV", &|m| {
        let [x, y] = m.images.cameras.first()?.view_deg?;
        Some(format!("{x:.0}°×{y:.0}°"))
    }));
    rows.push(line("Freq.", &|m| {
        Some(format!("{:.0} Hz", m.images.cameras.first()?.rate_hz))
    }));
    rows.push(line("GS / RS", &|m| {
        let is_rolling = m.images.cameras.first()?.is_rolling?;
        Some(if is_rolling { "RS" } else { "GS" }.to_owned())
    }));
    aligned(&rows)
}

/// Table VI: environments, their size, their motions.
pub fn environments_table(description: &Description) -> String {
    let mut rows = vec![row(["Environment", "Size (m×m)", "Seq.", "Description"])];
    for environment in &description.environments {
        let queries = description.queries.iter();
        let mut motions: Vec<&str> = queries
            .filter(|q| q.environment == environment.name)
            .map(|q| q.motion.as_str())
            .collect();
        motions.dedup();
        let [x, y] = environment.size_m;
        rows.push(vec![
            environment.title.clone(),
            format!("{x}×{y}"),
            motions.join(", "),
            described(environment),
        ]);
    }
    aligned(&rows)
}

fn described(environment: &Environment) -> String {
    match environment.radio {
        true => format!("{}; with radio", environment.description),
        false => environment.description.clone(),
    }
}

/// Table VII: images and length, by device.
pub fn motions_table(description: &Description, measured: &[SequenceFigures]) -> String {
    let mut rows = vec![row(["Seq.", "#Frames", "Length (m)", "Description"])];
    for motion in motions(description) {
        let of = |device: Device| {
            let mut own = measured.iter();
            own.find(|m| m.planned.motion == motion && m.planned.device == device)
        };
        let frames = Device::ALL.map(|device| {
            let camera = of(device).and_then(|m| m.images.cameras.first());
            camera.map_or(NOTHING.to_owned(), |c| c.frames.to_string())
        });
        let lengths = Device::ALL.map(|device| {
            let found = of(device).and_then(|m| m.motion.as_ref());
            found.map_or(NOTHING.to_owned(), |m| format!("{:.0}", m.length_m))
        });
        let said = description.queries.iter().find(|q| q.motion == motion);
        rows.push(vec![
            motion.to_owned(),
            frames.join(" / "),
            lengths.join(" / "),
            said.map_or(String::new(), |q| q.description.clone()),
        ]);
    }
    aligned(&rows) + "Android phone / iPhone / AR glasses\n"
}

/// How each sequence moved.
pub fn motion_classes_table(measured: &[SequenceFigures]) -> String {
    let head = [
        "Seq.",
        "gait",
        "gaze",
        "m/s",
        "top m/s",
        "°/s 95 %",
        "blur px 95 %",
        "parallax °",
        "height m",
        "gap s",
    ];
    let mut rows = vec![head.map(str::to_owned).to_vec()];
    for own in measured {
        let Some(motion) = &own.motion else { continue };
        let gap_s = own
            .images
            .cameras
            .iter()
            .map(|c| c.longest_gap_s)
            .fold(0.0, f64::max);
        rows.push(vec![
            own.planned.name.clone(),
            motion.gait.to_string(),
            motion.gaze.map_or(NOTHING.to_owned(), |g| g.to_string()),
            format!("{:.2}", motion.mean_speed_m_s),
            format!("{:.2}", motion.top_speed_m_s),
            format!("{:.0}", motion.turning_deg_s[1]),
            own.blur_px
                .map_or(NOTHING.to_owned(), |[_, most]| format!("{most:.1}")),
            format!("{:.1}", motion.parallax_deg),
            format!("{:.1}", motion.height_m),
            format!("{gap_s:.2}"),
        ]);
    }
    match rows.len() {
        1 => String::new(),
        _ => aligned(&rows),
    }
}

/// Names of motions, in their order, each once.
fn motions(description: &Description) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for query in &description.queries {
        if !names.contains(&query.motion.as_str()) {
            names.push(&query.motion);
        }
    }
    names
}

fn row(cells: [&str; 4]) -> Vec<String> {
    cells.map(str::to_owned).to_vec()
}

/// Columns as wide as what stands in them.
fn aligned(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column));
        cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let mut text = String::new();
    for row in rows {
        let cells = row.iter().zip(&widths);
        let line: Vec<String> = cells
            .map(|(cell, width)| format!("{cell:<width$}"))
            .collect();
        text += line.join("  ").trim_end();
        text.push('\n');
    }
    text
}
