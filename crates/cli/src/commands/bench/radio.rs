//! `lsfb bench radio`: places by Wi-Fi, from the nearest neighbours.

use std::path::PathBuf;

use lsfb_eval::radio::{NeighbourConfig, judge_neighbours, read_table};
use lsfb_types::Judgement;

use crate::bad_argument::BadArgument;
use crate::context::Context;
use crate::judged::{Judged, problem_lines};
use crate::outcome::Outcome;

/// Localize every Wi-Fi scan by the scans of all other walks: the baseline for radio localization.
///
/// Reads the tables of `lsfb dataset radio`, one per walk. A scan is compared with all scans of other
/// walks by the cosine of their signal powers; the places of the nearest are averaged. Errors are
/// horizontal, and also given for the scans that have another walk nearby: elsewhere no method could
/// know the place.
///
/// Examples:
///   lsfb bench radio walk1.csv walk2.csv walk3.csv
///   lsfb --json bench radio walk1.csv walk2.csv --neighbours 5
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// One table per walk.
    #[arg(value_name = "CSV", required = true, num_args = 2..)]
    walks: Vec<PathBuf>,
    /// Number of nearest scans whose places are averaged.
    #[arg(long, value_name = "N", default_value_t = NeighbourConfig::default().neighbours)]
    neighbours: usize,
}

/// Reads, judges, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let config = NeighbourConfig {
        neighbours: arguments.neighbours,
        ..NeighbourConfig::default()
    };
    BadArgument::check(config.check_bounds(""), &[])?;
    let mut walks = Vec::new();
    for (i, path) in arguments.walks.iter().enumerate() {
        let same = arguments.walks[..i]
            .iter()
            .find(|other| crate::files::is_same(other, path));
        anyhow::ensure!(
            same.is_none(),
            BadArgument::new(format!(
                "{}: given twice: comparing a walk with itself finds every place exactly",
                path.display()
            ))
        );
        context.check_stop()?;
        walks.push(read_table(path)?);
    }
    let figures = judge_neighbours(&walks, &config)?;
    let judgement = Judgement::new(figures.findings.clone());
    let what = format!("{} walks", figures.walks);
    let judged = Judged::new(&judgement, &what, &figures);
    context.print(&judged, || {
        let of = |e: &lsfb_eval::Statistics| {
            format!(
                "{} scans: mean {:.2} m, median {:.2} m, largest {:.2} m",
                e.count, e.mean, e.median, e.max
            )
        };
        let mut text = format!(
            "{} walks, {} scans of known place (σ {:.2} m)\nall: {}",
            figures.walks,
            figures.scans,
            figures.place_sigma_m,
            of(&figures.errors_m)
        );
        for reach in &figures.reaches {
            if let Some(errors_m) = &reach.errors_m {
                text += &format!(
                    "\nanother walk within {} m: {}",
                    reach.within_m,
                    of(errors_m)
                );
            }
        }
        if figures.unheard > 0 {
            text += &format!(
                "\n{} scans share no transmitter with another walk",
                figures.unheard
            );
        }
        format!("{text}\n{}", problem_lines(&judgement))
            .trim_end()
            .to_owned()
    })?;
    Ok(Outcome::of(judgement.verdict()))
}
