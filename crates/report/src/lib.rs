//! Every page that `lsfb` writes: one frame, one way to draw a verdict, one way to draw a plot.
//!
//! A page is one file: nothing is fetched, so that it opens on a laptop in the field and years later. It follows the reader's
//! light or dark setting, reads on a phone and prints. Its script only adds to what is there: values under the pointer, a closer
//! look at a plot, a view that turns.
//!
//! ```
//! use lsfb_report::{Axis, Ink, Layer, Page, Plot};
//! use lsfb_types::{Finding, Judgement, Verdict};
//! use maud::html;
//!
//! let judgement = Judgement::new(vec![Finding::new("fit", Verdict::Pass, "cam0", "corners fit to 0.12 px")]);
//! let plot = Plot {
//!     name: "error over time".to_owned(),
//!     width_px: 560,
//!     height_px: 260,
//!     x: Axis::linear("time (s)", [0.0, 10.0]),
//!     y: Axis::linear("error (px)", [0.0, 1.0]),
//!     layers: vec![Layer::line(vec![[0.0, 0.2], [10.0, 0.7]], Ink::Series(0))],
//! };
//! let page = Page::new("Camera calibration")
//!     .judged(&judgement, "1 camera, 40 views")
//!     .body(html! { section { h2 { "Errors" } (plot.draw()) } })
//!     .to_html();
//! assert!(page.contains("PASS: 1 camera, 40 views; no problems found"));
//! ```

mod axis;
mod chart;
mod findings;
mod image;
mod layout;
mod number;
mod page;
mod plot;
mod scene;
mod statistics;
mod theme;

pub use axis::{Axis, tick_step};
pub use findings::badge;
pub use image::{arrows, coverage, png};
pub use number::{rounded, significant, with_unit};
pub use page::{Page, scroll};
pub use plot::{Ink, Layer, Plot, SHADES, ink_css, plot_height_px, plot_width_px};
pub use scene::{Path, Scene};
pub use statistics::{Normal, bars, histogram, scatter};
