//! How parts of a recording scatter against their standard deviations: `disjoint_parts FOLDER.. FROM-TO..` cuts what both cameras saw in
//! folders of TUM VI that follow each other (`tumvi_calib_imu1/mav0 tumvi_calib_imu1_next/mav0 0-240 240-480 480-720`) by the numbers
//! of its images, calibrates each part alone, and prints √(χ²/degrees of freedom) of each parameter, the worst first.

use std::error::Error;
use std::ops::Range;
use std::path::Path;

use lsfb_rigs::parts::{Said, TumVi};
use lsfb_types::Verdict;

fn range(word: &str) -> Option<Range<usize>> {
    let (from, to) = word.split_once('-')?;
    Some(from.parse().ok()?..to.parse().ok()?)
}

#[allow(clippy::print_stdout, reason = "an example prints its result")]
fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let ranges: Vec<Range<usize>> = arguments.iter().filter_map(|word| range(word)).collect();
    let folders = arguments.iter().filter(|word| range(word).is_none());
    let folders: Vec<&Path> = folders.map(Path::new).collect();
    if folders.is_empty() || ranges.len() < 2 {
        return Err("name folders and at least two parts".into());
    }
    let recorded = TumVi::read(folders);
    let mut said = Said::default();
    for part in ranges {
        let found = recorded.calibrate(part.clone(), &mut said);
        println!("{part:?}: {}", found.judgement().verdict());
        let remarks = found.findings.iter().filter(|f| f.verdict != Verdict::Pass);
        remarks.for_each(|f| println!("  {} of {}: {}", f.code, f.subject, f.what));
    }
    let mut scatter = said.scatter();
    scatter.sort_by(|a, b| b.1.total_cmp(&a.1));
    for (name, ratio) in scatter {
        let (_, values) = said.values().find(|v| v.0 == name).ok_or("no such name")?;
        let values: Vec<String> = values
            .iter()
            .map(|[value, sigma]| format!("{value:.3e} ± {sigma:.1e}"))
            .collect();
        println!("{ratio:5.2}  {name:26} {}", values.join(", "));
    }
    println!("root of the mean square of all: {:.2}", said.rms());
    Ok(())
}
