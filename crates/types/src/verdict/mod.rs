//! What every command that judges says: a [`Verdict`] with the [`Finding`]s it rests on.
//!
//! One shape for a recording, a machine, a clock, a calibration: pages, terminal and JSON draw it and decide nothing. Sentences
//! are put together here alone.
//!
//! ```
//! use lsfb_types::{Finding, Judgement, Limit, Verdict};
//! let judgement = Judgement::new(vec![
//!     Finding::new("fit", Verdict::Pass, "cam0", "corners fit to 0.12 px"),
//!     Finding::new("coverage", Verdict::Warn, "cam0", "corners cover 30 % of the image")
//!         .value(0.3, "")
//!         .limit(Limit::AtLeast(0.5))
//!         .remedy("move the target into the upper left"),
//! ]);
//! assert_eq!(judgement.verdict(), Verdict::Warn);
//! assert_eq!(
//!     judgement.headline("1 camera, 40 views"),
//!     "WARN: 1 camera, 40 views; check cam0: corners cover 30 % of the image"
//! );
//! assert_eq!(Judgement::default().verdict(), Verdict::Unknown);
//! ```

mod finding;
mod judgement;

use std::fmt;

pub use finding::{Finding, Limit};
pub use judgement::Judgement;

/// How something that was judged came out, from the least to the most serious.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "lowercase"))]
pub enum Verdict {
    /// It could not be determined, or was not looked at.
    #[default]
    Unknown,
    /// As it should be.
    Pass,
    /// Usable; somebody should look at it.
    Warn,
    /// Data was lost, or the result must not be used.
    Fail,
}

impl Verdict {
    /// The most serious of some; [`Verdict::Unknown`] of none: nothing passes that was not looked at.
    pub fn worst(verdicts: impl IntoIterator<Item = Self>) -> Self {
        verdicts.into_iter().max().unwrap_or_default()
    }

    /// As people read it: `PASS`, `WARN`, `FAIL`, `UNKNOWN`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Unknown => "UNKNOWN",
            Self::Pass => "PASS",
            Self::Warn => "WARN",
            Self::Fail => "FAIL",
        }
    }

    /// [`Verdict::Pass`] where a condition holds, else this.
    pub fn unless(self, is_good: bool) -> Self {
        if is_good { Self::Pass } else { self }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}
