//! What the links to a camera speak: frames of a size, controls, and transactions with its extension unit (USB Video Class).
//! Channels and sizes are those of the Mynt Eye S2 family, whose links these are.

/// A size in which a unit streams: the images of its cameras side by side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameFormat {
    /// Width of the whole frame, pixels: that of all images together.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
}

impl FrameFormat {
    /// Two images of 640×400; 10, 20, 30 or 60 Hz.
    pub const S2_1280X400: Self = Self {
        width: 1280,
        height: 400,
    };
    /// Two images of 1280×800; 10, 20 or 30 Hz.
    pub const S2_2560X800: Self = Self {
        width: 2560,
        height: 800,
    };

    /// Bytes of a frame: two per pixel.
    pub const fn frame_bytes(self) -> usize {
        self.width as usize * self.height as usize * 2
    }

    /// Width of each of `cameras` images, pixels; `None` where they do not fill the frame.
    pub const fn image_width(self, cameras: u32) -> Option<u32> {
        match self.width.checked_rem(cameras) {
            Some(0) if self.width > 0 => Some(self.width / cameras),
            _ => None,
        }
    }
}

/// Number of the unit's UVC extension unit.
pub const EXTENSION_UNIT: u8 = 3;

/// Bytes of an IMU answer or a file answer.
pub const LARGE_TRANSFER_BYTES: usize = 2000;

/// A channel of the extension unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum XuSelector {
    /// Camera options.
    CamCtrl,
    /// Zero drift, erase, time synchronization.
    HalfDuplex,
    /// IMU request.
    ImuWrite,
    /// IMU answer.
    ImuRead,
    /// Device information and calibration.
    File,
}

impl XuSelector {
    /// Its number.
    pub fn id(self) -> u8 {
        match self {
            Self::CamCtrl => 1,
            Self::HalfDuplex => 2,
            Self::ImuWrite => 3,
            Self::ImuRead => 4,
            Self::File => 5,
        }
    }

    /// The channel with that number.
    pub fn from_id(id: u8) -> Option<Self> {
        [
            Self::CamCtrl,
            Self::HalfDuplex,
            Self::ImuWrite,
            Self::ImuRead,
            Self::File,
        ]
        .into_iter()
        .find(|selector| selector.id() == id)
    }

    /// Bytes of each of its transactions.
    pub fn len_bytes(self) -> usize {
        match self {
            Self::CamCtrl => 3,
            Self::HalfDuplex => 20,
            Self::ImuWrite => 5,
            Self::ImuRead | Self::File => LARGE_TRANSFER_BYTES,
        }
    }
}

/// Request codes of the USB Video Class, table A-8.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum XuQuery {
    /// Write.
    SetCur,
    /// Read the value.
    GetCur,
    /// Read the smallest value.
    GetMin,
    /// Read the largest value.
    GetMax,
    /// Read the value after power-up.
    GetDef,
}

impl XuQuery {
    /// Its code.
    pub fn code(self) -> u8 {
        match self {
            Self::SetCur => 0x01,
            Self::GetCur => 0x81,
            Self::GetMin => 0x82,
            Self::GetMax => 0x83,
            Self::GetDef => 0x87,
        }
    }

    /// The query with that code.
    pub fn from_code(code: u8) -> Option<Self> {
        [
            Self::SetCur,
            Self::GetCur,
            Self::GetMin,
            Self::GetMax,
            Self::GetDef,
        ]
        .into_iter()
        .find(|query| query.code() == code)
    }
}

/// The unit does not carry out a transaction: on USB, a stalled request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct XuRefusal;

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

/// What the link itself has met, as opposed to what the frames say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounters {
    /// Frames handed over.
    pub frames: u64,
    /// Frames that the kernel counted and never handed over: the host was too slow, or USB lost a part.
    pub missing: u64,
    /// Frames that the kernel marked as damaged; they are handed over as they are.
    pub damaged: u64,
}
