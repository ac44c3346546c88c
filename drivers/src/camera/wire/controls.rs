//! Controls of the image sensors that are not options of the extension unit but ordinary ones of the UVC processing unit.

/// A control of the image sensors. In manual exposure the vendor uses brightness for the exposure time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ImageControl {
    /// Exposure time in manual exposure; steps of the unit.
    Brightness,
    /// Black level.
    Contrast,
    /// Gain.
    Gain,
}

impl ImageControl {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Brightness, Self::Contrast, Self::Gain];

    /// Its selector in the processing unit (USB Video Class, table A-13).
    pub const fn id(self) -> u8 {
        match self {
            Self::Brightness => 2,
            Self::Contrast => 3,
            Self::Gain => 4,
        }
    }

    /// The control with that selector.
    pub fn from_id(id: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|control| control.id() == id)
    }

    /// Its number for V4L2 (`linux/v4l2-controls.h`).
    pub const fn v4l2_id(self) -> u32 {
        match self {
            Self::Brightness => 0x0098_0900,
            Self::Contrast => 0x0098_0901,
            Self::Gain => 0x0098_0913,
        }
    }
}
