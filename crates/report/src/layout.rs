//! Where the parts of a plot are.

/// The plotting library knows whole pixels only: everything is drawn this many times larger than the page shows it.
pub(crate) const FINE: u32 = 4;

/// Room left of the plot for labels, pixels of the page.
pub(crate) const LEFT: u32 = 60;
/// Room below the plot for labels.
pub(crate) const BELOW: u32 = 42;
/// Room above and at the right.
pub(crate) const MARGIN: u32 = 10;
/// Colours of data; further ones begin anew.
pub(crate) const SERIES: u8 = 4;
