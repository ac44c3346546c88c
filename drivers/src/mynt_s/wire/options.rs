//! Camera options: selector 1 of the extension unit, three bytes per transaction.

use crate::WireError;
use crate::transport::uvc::XuQuery;

/// An option of the unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum CameraOption {
    /// 0 automatic, 1 manual.
    ExposureMode,
    /// Largest gain of automatic exposure.
    MaxGain,
    /// Longest exposure of automatic exposure.
    MaxExposureTime,
    /// Mean grey value that automatic exposure aims at.
    DesiredBrightness,
    /// Samples of the IMU per second.
    ImuFrequency,
    /// Infra-red projector.
    IrControl,
    /// High dynamic range mode.
    HdrMode,
    /// Shortest exposure of automatic exposure.
    MinExposureTime,
    /// Full span of the accelerometer, g.
    AccelerometerSpan,
    /// Full span of the gyroscope, °/s.
    GyroscopeSpan,
    /// Low-pass filter of the accelerometer.
    AccelerometerLowPass,
    /// Low-pass filter of the gyroscope.
    GyroscopeLowPass,
    /// Address on the auxiliary bus.
    I2cAddress,
}

impl CameraOption {
    /// All of them, by id.
    pub const ALL: [Self; 13] = [
        Self::ExposureMode,
        Self::MaxGain,
        Self::MaxExposureTime,
        Self::DesiredBrightness,
        Self::ImuFrequency,
        Self::IrControl,
        Self::HdrMode,
        Self::MinExposureTime,
        Self::AccelerometerSpan,
        Self::GyroscopeSpan,
        Self::AccelerometerLowPass,
        Self::GyroscopeLowPass,
        Self::I2cAddress,
    ];

    /// Its number on the wire.
    pub fn id(self) -> u8 {
        match self {
            Self::ExposureMode => 0,
            Self::MaxGain => 1,
            Self::MaxExposureTime => 2,
            Self::DesiredBrightness => 3,
            Self::ImuFrequency => 4,
            Self::IrControl => 5,
            Self::HdrMode => 6,
            // 7 is the frame rate of the older S1 units.
            Self::MinExposureTime => 8,
            Self::AccelerometerSpan => 9,
            Self::GyroscopeSpan => 10,
            Self::AccelerometerLowPass => 11,
            Self::GyroscopeLowPass => 12,
            Self::I2cAddress => 13,
        }
    }

    /// The option with that number.
    pub fn from_id(id: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|option| option.id() == id)
    }
}

/// Bit of the first byte: this selects the option to be read.
const SELECT: u8 = 0x80;

/// What the host writes to the channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OptionCommand {
    /// The following read is about this option.
    Select(CameraOption),
    /// Sets an option.
    Set {
        /// Which.
        option: CameraOption,
        /// Its new value.
        value: u16,
    },
}

impl OptionCommand {
    /// Reads the three bytes.
    pub fn parse(bytes: &[u8]) -> Result<Self, WireError> {
        let &[first, high, low] = bytes else {
            return Err(WireError::Length {
                expected: 3,
                got: bytes.len(),
            });
        };
        let option = parse_option(first & !SELECT)?;
        Ok(if first & SELECT != 0 {
            Self::Select(option)
        } else {
            Self::Set {
                option,
                value: u16::from_be_bytes([high, low]),
            }
        })
    }

    /// The three bytes.
    pub fn emit(self) -> [u8; 3] {
        match self {
            Self::Select(option) => [option.id() | SELECT, 0, 0],
            Self::Set { option, value } => emit_value(option, value),
        }
    }

    /// Reads an answer: the value, if it is about `option`.
    pub fn parse_value(option: CameraOption, bytes: &[u8]) -> Result<u16, WireError> {
        match *bytes {
            [id, high, low] if id == option.id() => Ok(u16::from_be_bytes([high, low])),
            [id, _, _] => Err(WireError::Constant {
                offset: 0,
                expected: option.id().into(),
                got: id.into(),
            }),
            _ => Err(WireError::Length {
                expected: 3,
                got: bytes.len(),
            }),
        }
    }
}

fn parse_option(id: u8) -> Result<CameraOption, WireError> {
    CameraOption::from_id(id).ok_or(WireError::Value {
        field: "option",
        offset: 0,
        got: id.into(),
    })
}

fn emit_value(option: CameraOption, value: u16) -> [u8; 3] {
    let [high, low] = value.to_be_bytes();
    [option.id(), high, low]
}

/// Values an option may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OptionRange {
    /// Smallest.
    pub min: u16,
    /// Largest.
    pub max: u16,
    /// After power-up.
    pub default: u16,
}

/// The device's side of the channel: current values, and the answers to reads.
#[derive(Clone, Debug)]
pub struct OptionTable {
    current: [u16; CameraOption::ALL.len()],
    selected: CameraOption,
}

impl Default for OptionTable {
    fn default() -> Self {
        Self {
            current: CameraOption::ALL.map(|option| Self::range(option).default),
            selected: CameraOption::ExposureMode,
        }
    }
}

impl OptionTable {
    /// Range of an option on an S2 unit. Exposure, spans, filters and IMU rate are the vendor's; gain, brightness,
    /// infra-red and address are assumed.
    pub fn range(option: CameraOption) -> OptionRange {
        let (min, max, default) = match option {
            CameraOption::ExposureMode | CameraOption::HdrMode => (0, 1, 0),
            CameraOption::MaxGain => (0, 255, 8),
            CameraOption::MaxExposureTime => (0, 655, 333),
            CameraOption::DesiredBrightness => (1, 255, 122),
            CameraOption::ImuFrequency => (100, 500, 200),
            CameraOption::IrControl => (0, 160, 0),
            CameraOption::MinExposureTime => (0, 655, 0),
            CameraOption::AccelerometerSpan => (6, 48, 12),
            CameraOption::GyroscopeSpan => (250, 4000, 1000),
            CameraOption::AccelerometerLowPass => (0, 2, 2),
            CameraOption::GyroscopeLowPass => (23, 64, 64),
            CameraOption::I2cAddress => (0, 127, 0),
        };
        OptionRange { min, max, default }
    }

    /// Current value.
    pub fn value(&self, option: CameraOption) -> u16 {
        self.position(option)
            .and_then(|at| self.current.get(at).copied())
            .unwrap_or_default()
    }

    /// Carries out what the host wrote. A value out of range is refused and changes nothing.
    pub fn apply(&mut self, command: OptionCommand) -> Result<(), WireError> {
        match command {
            OptionCommand::Select(option) => self.selected = option,
            OptionCommand::Set { option, value } => {
                let range = Self::range(option);
                if !(range.min..=range.max).contains(&value) {
                    return Err(WireError::Value {
                        field: "option value",
                        offset: 1,
                        got: value.into(),
                    });
                }
                if let Some(at) = self.position(option) {
                    self.current[at] = value;
                }
            }
        }
        Ok(())
    }

    /// The three bytes of a read about the selected option; `None` where the query is not a read of a value.
    pub fn answer(&self, query: XuQuery) -> Option<[u8; 3]> {
        let range = Self::range(self.selected);
        let value = match query {
            XuQuery::GetCur => self.value(self.selected),
            XuQuery::GetMin => range.min,
            XuQuery::GetMax => range.max,
            XuQuery::GetDef => range.default,
            XuQuery::SetCur => return None,
        };
        Some(emit_value(self.selected, value))
    }

    fn position(&self, option: CameraOption) -> Option<usize> {
        CameraOption::ALL.iter().position(|known| *known == option)
    }
}
