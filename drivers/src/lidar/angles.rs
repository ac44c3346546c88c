//! Beam angles of one unit, from the file that comes with it.

/// Where each channel of a unit looks.
#[derive(Clone, Debug, PartialEq)]
pub struct BeamAngles {
    /// Angles above the horizontal by channel, degrees.
    pub elevation_deg: Vec<f64>,
    /// Added to the rotor's azimuth by channel, degrees, clockwise from above.
    pub azimuth_deg: Vec<f64>,
}

/// Why a file is not one of beam angles.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum AnglesError {
    /// A line is not `channel,elevation,azimuth`.
    #[error("line {line}: {text:?} is not `channel,elevation,azimuth` in degrees")]
    Line {
        /// Its number, from 1.
        line: usize,
        /// What it says.
        text: String,
    },
    /// Channels are not numbered 1, 2, 3 …
    #[error("line {line}: channel {got}, expected {expected}")]
    Order {
        /// Its number, from 1.
        line: usize,
        /// The next channel.
        expected: usize,
        /// What it says.
        got: usize,
    },
    /// No channel at all.
    #[error("no line with `channel,elevation,azimuth`")]
    Empty,
}

impl BeamAngles {
    /// Reads Hesai's angle correction file: a line of titles, then `channel,elevation,azimuth` in degrees, channels from 1.
    pub fn parse_csv(text: &str) -> Result<Self, AnglesError> {
        let mut angles = Self {
            elevation_deg: Vec::new(),
            azimuth_deg: Vec::new(),
        };
        let lines = text.lines().enumerate().skip(1);
        for (index, text) in lines.filter(|(_, text)| !text.trim().is_empty()) {
            let line = index + 1;
            let mut fields = text.split(',').map(str::trim);
            let mut angle = || {
                fields
                    .next()?
                    .parse::<f64>()
                    .ok()
                    .filter(|a| a.abs() <= 360.0)
            };
            let (Some(channel), Some(elevation), Some(azimuth)) = (angle(), angle(), angle())
            else {
                let text = text.to_owned();
                return Err(AnglesError::Line { line, text });
            };
            let expected = angles.elevation_deg.len() + 1;
            // A float cast saturates.
            let got = channel as usize;
            if got != expected {
                return Err(AnglesError::Order {
                    line,
                    expected,
                    got,
                });
            }
            angles.elevation_deg.push(elevation);
            angles.azimuth_deg.push(azimuth);
        }
        if angles.elevation_deg.is_empty() {
            return Err(AnglesError::Empty);
        }
        Ok(angles)
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.elevation_deg.len()
    }
}
