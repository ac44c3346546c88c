//! What a device is and how often it should send, as metadata of the recording: written as soon as it is known, so that it outlives a
//! recorder that is killed, and read by whoever judges the file.

use std::collections::BTreeMap;

use lsfb_recording::Recording;

/// Metadata records of devices are called so, with the device's name behind it.
const PREFIX: &str = "lsfb.device.";
const RATE: &str = "rate_hz";

/// What is known of a device.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct DeviceNote {
    device: String,
    /// Model, address, returns, `rate_hz`.
    entries: BTreeMap<String, String>,
}

impl DeviceNote {
    pub(crate) fn new(device: &str) -> Self {
        Self {
            device: device.to_owned(),
            entries: BTreeMap::new(),
        }
    }

    pub(crate) fn with(mut self, what: &str, value: impl ToString) -> Self {
        self.entries.insert(what.to_owned(), value.to_string());
        self
    }

    /// How many scans or samples a second it should send.
    pub(crate) fn with_rate_hz(self, rate_hz: f64) -> Self {
        self.with(RATE, format!("{rate_hz:.3}"))
    }

    /// Name of the metadata record.
    pub(crate) fn record(&self) -> String {
        format!("{PREFIX}{}", self.device)
    }

    pub(crate) fn entries(&self) -> &BTreeMap<String, String> {
        &self.entries
    }

    /// What a recording says of a device; `None` where it says nothing.
    pub(crate) fn read(recording: &Recording, device: &str) -> Option<Self> {
        let mut note = Self::new(device);
        note.entries = recording.metadata(&note.record()).ok()?;
        (!note.entries.is_empty()).then_some(note)
    }

    pub(crate) fn rate_hz(&self) -> Option<f64> {
        let rate_hz: f64 = self.entries.get(RATE)?.parse().ok()?;
        (rate_hz > 0.0 && rate_hz.is_finite()).then_some(rate_hz)
    }

    /// What it is, as its driver calls it.
    pub(crate) fn model(&self) -> Option<String> {
        self.entries.get("model").cloned()
    }

    /// The rest in words: `model VLP-32C, returns strongest`.
    pub(crate) fn words(&self) -> String {
        let entries = self.entries.iter().filter(|(what, _)| *what != RATE);
        let words: Vec<String> = entries
            .map(|(what, value)| format!("{what} {value}"))
            .collect();
        words.join(", ")
    }
}
