//! Tables of words and numbers.

use lsfb_report::scroll;
use maud::{Markup, html};

/// A table with a heading; the first cell of a row names it.
#[derive(Clone, Debug)]
pub struct Table {
    /// Heading.
    pub title: String,
    /// Over the columns.
    pub head: Vec<String>,
    /// One cell for each column.
    pub rows: Vec<Vec<String>>,
}

/// Nothing where there are no rows.
pub(super) fn section(table: &Table) -> Markup {
    let drawn = html! {
        table.numbers {
            thead { tr { @for cell in &table.head { th { (cell) } } } }
            tbody { @for row in &table.rows { tr { @for cell in row { td { (cell) } } } } }
        }
    };
    html! {
        @if !table.rows.is_empty() { section { h2 { (table.title) } (scroll(&drawn)) } }
    }
}
