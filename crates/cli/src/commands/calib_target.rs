//! `lsfb calib target`: a board on paper.

use std::path::PathBuf;

use lsfb_calib::board::PageSize;

use super::calib_board::BoardArguments;
use crate::context::Context;
use crate::outcome::Outcome;

/// Print a calibration board: a PDF true to scale, and its Kalibr file.
///
/// Examples:
///   lsfb calib target --checkerboard 9,6,0.025 --page 297,210 --out board.pdf
///   lsfb calib target --april-grid 6,6,0.088,0.3 --page 841,841 --out grid.pdf
///   lsfb calib target --charuco 11,8,0.025,0.019,5x5 --page 297,210 --out charuco.pdf
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(flatten)]
    board: BoardArguments,
    /// Paper, width and height in millimetres.
    #[arg(long, value_name = "W,H", default_value = "297,210", value_parser = page)]
    page: PageSize,
    /// The PDF; the Kalibr file is written beside it.
    #[arg(long, value_name = "PDF")]
    out: PathBuf,
}

fn page(text: &str) -> Result<PageSize, String> {
    let millimetres = |word: &str| {
        let value: f64 = word
            .trim()
            .parse()
            .map_err(|_| format!("{word} is not a number"))?;
        Ok::<f64, String>(value * 1e-3)
    };
    let (width, height) = text.split_once(',').ok_or("expected W,H in millimetres")?;
    Ok(PageSize {
        width_m: millimetres(width)?,
        height_m: millimetres(height)?,
    })
}

/// Writes the board.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let target = arguments.board.target()?;
    let yaml = arguments.out.with_extension("yaml");
    super::write(&arguments.out, target.to_pdf(arguments.page)?)?;
    super::write(&yaml, target.to_kalibr())?;
    context.print(&target, || {
        format!(
            "{}: print without scaling, then measure the line of 100 mm; {} describes it to the tools",
            arguments.out.display(),
            yaml.display()
        )
    })?;
    Ok(Outcome::Done)
}
