//! What the second walk is recorded with.

use serde::{Deserialize, Serialize};

/// What the second walk is recorded with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Device {
    /// An Android phone: one camera, rolling shutter.
    Android,
    /// An iPhone: one camera, rolling shutter.
    Iphone,
    /// AR glasses: two cameras, global shutter.
    #[default]
    Glasses,
}

impl Device {
    /// All of them, in the order of the tables.
    pub const ALL: [Self; 3] = [Self::Android, Self::Iphone, Self::Glasses];

    /// Its name in topics and files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Android => "android",
            Self::Iphone => "iphone",
            Self::Glasses => "glasses",
        }
    }
}
