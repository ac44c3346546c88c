use lsfb_types::Timestamp;

/// A sample as a decoder knows it: with the device's own time, not yet on the recording's clock.
#[derive(Clone, Debug, PartialEq)]
pub struct Decoded<T> {
    /// Host receive time of the packet that completed the sample's first part.
    pub arrival: Timestamp,
    /// The device's counter at the sample; the decoder says the unit and where it wraps.
    pub device_ticks: u64,
    /// The measurement.
    pub sample: T,
}
