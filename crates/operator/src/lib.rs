//! What the operator sees while scanning: a page for the phone or tablet in hand, a few lines on the terminal, and the
//! recording's own messages for Foxglove.
//!
//! This crate is told everything and asks nothing: whoever records hands a [`ScreenState`] and a [`MapSnapshot`] to the
//! [`Screen`], and takes [`Request`]s from it. A browser that is slow, or gone, is not waited for.
//!
//! - [`Screen`] serves the page and its WebSocket, without any other program or the internet.
//! - [`Preview`] is a small picture of what a camera sees.
//! - [`LiveMap`] grows from registered scans: a floor plan, how well each place was seen, and where to go back.
//! - [`terminal`] writes the same state as lines of text.
//! - [`Foxglove`] offers live messages to the Foxglove app.
//!
//! ```no_run
//! use lsfb_operator::{Screen, ScreenConfig, ScreenState};
//! let (screen, requests) = Screen::open(&ScreenConfig::default())?;
//! println!("open {}", screen.links().join(" or "));
//! screen.publish(&ScreenState::default());
//! for request in requests {
//!     request.answer(Err("nothing is connected".to_owned()));
//! }
//! # Ok::<(), lsfb_operator::Error>(())
//! ```
//!
//! All of them are mounted at addresses of the one HTTP server, `lsfb-web`: on this machine the page needs no TLS, and from elsewhere
//! it is asked for by TLS alone, where a browser may keep the screen awake.

mod client;
mod coverage;
mod error;
mod foxglove;
mod map;
mod page;
mod preview;
mod screen;
mod shared;
mod socket;
mod state;
pub mod terminal;

pub use coverage::{CoverageConfig, GoBack, Reason, Viewer};
pub use error::Error;
pub use foxglove::{Foxglove, LiveMessage};
pub use map::{LiveMap, MapConfig, MapSnapshot};
pub use preview::Preview;
pub use screen::{Screen, ScreenConfig, SecureScreen};
pub use shared::{Command, Request};
pub use state::{
    BatteryState, ControlPoint, CoverageState, Level, LoopState, Phase, PoseState, ScreenState,
    StorageState, StreamState, SyncState, Tracking, UnseenKind, UnseenMotion,
};
