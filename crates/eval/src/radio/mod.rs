//! What a phone heard and felt, and where: every reading of Wi-Fi, Bluetooth and the magnetic field gets the place at which the phone was at
//! the reading's own time, with its standard deviation; and how well a place is found from Wi-Fi alone, by the nearest neighbours among
//! the walks of others.
//!
//! A scan takes seconds and its readings arrive together: at walking speed a place for each scan is metres off for some of its readings.

mod agreement;
mod neighbours;
mod placing;
mod table;

pub use agreement::{RadioAgreement, RadioAgreementConfig, RadioStretch, radio_agreement};
pub use neighbours::{NeighbourConfig, NeighbourFigures, Reach, judge_neighbours};
pub use placing::{KnownPlace, Placed, PlacedReading, PlacingConfig, RadioKind, place, waypoints};
pub use table::{read_table, table};

#[cfg(test)]
mod agreement_tests;
#[cfg(test)]
mod tests;
