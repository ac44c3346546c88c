//! `lsfb calib target`: a board on paper.

use std::path::PathBuf;

use lsfb_calib::board::PageSize;

use super::calib_board::{BoardArguments, two_lengths};
use crate::bad_argument::BadArgument;
use crate::context::Context;
use crate::outcome::Outcome;

/// Print a calibration board: a PDF at true scale, and its Kalibr file.
///
/// Examples:
///   lsfb calib target --checkerboard 9,6,0.025 --page-m 0.297,0.21 --out board.pdf
///   lsfb calib target --april-grid 6,6,0.088,0.3 --page-m 0.841,0.841 --out grid.pdf
///   lsfb calib target --charuco 11,8,0.025,0.019,5x5 --page-m 0.297,0.21 --out charuco.pdf
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(flatten)]
    board: BoardArguments,
    /// Size of the paper: width and height.
    #[arg(long, value_name = "W,H", default_value = "0.297,0.21", value_parser = two_lengths)]
    page_m: [f64; 2],
    /// The PDF to write; the Kalibr file is written beside it.
    #[arg(long, value_name = "PDF")]
    out: PathBuf,
}

/// Writes the board.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let target = arguments.board.target()?;
    let [width_m, height_m] = arguments.page_m;
    let page = PageSize { width_m, height_m };
    let yaml = arguments.out.with_extension("yaml");
    let pdf = target.to_pdf(page);
    let pdf = pdf.map_err(|error| BadArgument::new(format!("--page-m: {error}")))?;
    context.claim(&arguments.out, &[])?;
    context.claim(&yaml, &[])?;
    context.check_stop()?;
    super::write(&arguments.out, pdf)?;
    super::write(&yaml, target.to_kalibr())?;
    context.print(&target, || {
        format!(
            "{}: print without scaling, then check that the line measures 100 mm; {} is the target file for --target",
            arguments.out.display(),
            yaml.display()
        )
    })?;
    Ok(Outcome::Done)
}
