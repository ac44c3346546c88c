//! SLAM systems on sequences with ground truth: run, judged, and laid out as Tables VIII and IX of the paper.
//!
//! A plan is a TOML file: sequences (a recording, its truth, the longer side of the place) and systems (a command with placeholders and the
//! layout of the input it reads). Every run ends with a trajectory or with the cause why there is none.

mod cause;
mod command;
mod export;
mod format;
mod pages;
mod plan;
mod process;
mod results;
mod table;

pub use cause::Cause;
pub use export::{HiddenRegions, Layout, camera_name, export, export_without};
pub use pages::page_of;
pub use plan::{Plan, Scale, Sequence, System, read_plan};
pub use results::{Finished, RunConfig, RunResult, run_plan, table_of};
pub use table::{Cell, Column, ColumnCount, Figure, MarkedTable, Metric, SlamRow, SlamTable};
