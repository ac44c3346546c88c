//! The sensor's settings as its web page has them: form fields to write, documents to read. Both directions, no I/O.

use std::fmt;
use std::net::Ipv4Addr;

use serde_json::{Value, json};

use super::wire::{PpsStatus, Returns};
use crate::lidar::SensorSettings;
pub use crate::lidar::{Destination, SettingsError};

/// Slowest and fastest motor, revolutions per minute (VLP-32C 63-9325 p. 41), and the step between.
const RPM: std::ops::RangeInclusive<u16> = 300..=1200;
const RPM_STEP: u16 = 60;
const LAST_DEGREE: u16 = 359;

/// Everything that can be set and read back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Whether the lasers fire.
    pub laser: Switch,
    /// Which echoes are sent.
    pub returns: Returns,
    /// Motor, revolutions per minute.
    pub rpm: u16,
    /// Sector in which the sensor fires.
    pub field_of_view: FieldOfView,
    /// Whether, and where, the rotor points at each pulse per second.
    pub phase_lock: PhaseLock,
    /// Where packets go.
    pub destination: Destination,
}

/// On or off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Switch {
    /// On.
    On,
    /// Off.
    Off,
}

/// The sector in which the sensor fires, whole degrees clockwise; where `end` is smaller, it goes through 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FieldOfView {
    /// First degree, 0 to 359.
    pub start_deg: u16,
    /// Last degree, 0 to 359.
    pub end_deg: u16,
}

/// Whether, and where, the rotor points at each pulse per second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PhaseLock {
    /// Whether it is locked; needs a pulse per second.
    pub lock: Switch,
    /// Angle at the pulse, 0.01°, below 36 000.
    pub offset_centideg: u16,
}

impl Default for Settings {
    /// The factory's.
    fn default() -> Self {
        Self {
            laser: Switch::On,
            returns: Returns::Strongest,
            rpm: 600,
            field_of_view: FieldOfView {
                start_deg: 0,
                end_deg: LAST_DEGREE,
            },
            phase_lock: PhaseLock {
                lock: Switch::Off,
                offset_centideg: 0,
            },
            destination: Destination {
                address: Ipv4Addr::BROADCAST,
                data_port: 2368,
                position_port: 8308,
            },
        }
    }
}

/// One change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Setting {
    /// Switch the lasers.
    Laser(Switch),
    /// Choose the echoes.
    Returns(Returns),
    /// Set the motor, revolutions per minute: 300 to 1200 in steps of 60.
    Rpm(u16),
    /// Set the sector.
    FieldOfView(FieldOfView),
    /// Lock the rotor's phase.
    PhaseLock(PhaseLock),
    /// Choose where packets go.
    Destination(Destination),
}

/// A form to be posted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Form {
    /// Path on the sensor.
    pub path: &'static str,
    /// Fields.
    pub body: String,
}

const SETTING: &str = "/cgi/setting";
const FIELD_OF_VIEW: &str = "/cgi/setting/fov";
const PHASE_LOCK: &str = "/cgi/setting/phaselock";
const DESTINATION: &str = "/cgi/setting/host";

impl Setting {
    /// The changes that are asked for, one by one.
    pub fn of_all(wanted: &SensorSettings) -> Vec<Self> {
        let field_of_view = wanted
            .field_of_view_deg
            .map(|[start_deg, end_deg]| Self::FieldOfView(FieldOfView { start_deg, end_deg }));
        let phase_lock = wanted.phase_lock_centideg.map(|offset_centideg| {
            Self::PhaseLock(PhaseLock {
                lock: Switch::On,
                offset_centideg,
            })
        });
        let changes = [
            wanted.rpm.map(Self::Rpm),
            wanted.returns.map(Self::Returns),
            field_of_view,
            phase_lock,
            wanted.destination.map(Self::Destination),
        ];
        changes.into_iter().flatten().collect()
    }

    /// The form that asks for it; an error names a value that the sensor does not have.
    pub fn emit(&self) -> Result<Form, SettingsError> {
        let refused = |field, got: u16| {
            Err(SettingsError {
                field,
                got: got.to_string(),
            })
        };
        let (path, body) = match self {
            Self::Laser(switch) => (SETTING, format!("laser={}", switch.form_value())),
            Self::Returns(mode) => (SETTING, format!("returns={}", returns_name(*mode))),
            Self::Rpm(rpm) if !RPM.contains(rpm) || !rpm.is_multiple_of(RPM_STEP) => {
                return refused("rpm", *rpm);
            }
            Self::Rpm(rpm) => (SETTING, format!("rpm={rpm}")),
            Self::FieldOfView(sector) => {
                for degree in [sector.start_deg, sector.end_deg] {
                    if degree > LAST_DEGREE {
                        return refused("field of view", degree);
                    }
                }
                let FieldOfView { start_deg, end_deg } = sector;
                (FIELD_OF_VIEW, format!("start={start_deg}&end={end_deg}"))
            }
            Self::PhaseLock(lock) if lock.offset_centideg >= super::wire::TURN_CENTIDEG => {
                return refused("phase lock offset", lock.offset_centideg);
            }
            Self::PhaseLock(PhaseLock {
                lock,
                offset_centideg,
            }) => {
                let enabled = lock.form_value();
                (
                    PHASE_LOCK,
                    format!("enabled={enabled}&offset={offset_centideg}"),
                )
            }
            Self::Destination(to) => (
                DESTINATION,
                format!(
                    "addr={}&dport={}&tport={}",
                    to.address, to.data_port, to.position_port
                ),
            ),
        };
        Ok(Form { path, body })
    }

    /// What `settings` says about the same thing.
    pub fn of(&self, settings: &Settings) -> Self {
        match self {
            Self::Laser(_) => Self::Laser(settings.laser),
            Self::Returns(_) => Self::Returns(settings.returns),
            Self::Rpm(_) => Self::Rpm(settings.rpm),
            Self::FieldOfView(_) => Self::FieldOfView(settings.field_of_view),
            Self::PhaseLock(_) => Self::PhaseLock(settings.phase_lock),
            Self::Destination(_) => Self::Destination(settings.destination),
        }
    }
}

impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.emit() {
            Ok(form) => f.write_str(&form.body),
            Err(error) => write!(f, "{error}"),
        }
    }
}

impl Settings {
    /// Takes the fields of a form, as the sensor does: all or, where one is wrong, none.
    pub fn apply(&mut self, path: &str, body: &str) -> Result<(), SettingsError> {
        let mut changed = *self;
        for pair in body.split('&') {
            let (name, value) = pair.split_once('=').unwrap_or((pair, ""));
            let number = |field| value.parse::<u16>().map_err(|_| error(field, value));
            match (path, name) {
                (SETTING, "laser") => changed.laser = switch("laser", value)?,
                (SETTING, "returns") => changed.returns = returns_mode(value)?,
                (SETTING, "rpm") => changed.rpm = number("rpm")?,
                (FIELD_OF_VIEW, "start") => changed.field_of_view.start_deg = number("start")?,
                (FIELD_OF_VIEW, "end") => changed.field_of_view.end_deg = number("end")?,
                (PHASE_LOCK, "enabled") => changed.phase_lock.lock = switch("enabled", value)?,
                (PHASE_LOCK, "offset") => changed.phase_lock.offset_centideg = number("offset")?,
                (DESTINATION, "addr") => {
                    let address = value.parse().map_err(|_| error("addr", value))?;
                    changed.destination.address = address;
                }
                (DESTINATION, "dport") => changed.destination.data_port = number("dport")?,
                (DESTINATION, "tport") => changed.destination.position_port = number("tport")?,
                _ => return Err(error("form field", name)),
            }
        }
        for setting in [
            Setting::Rpm(changed.rpm),
            Setting::FieldOfView(changed.field_of_view),
            Setting::PhaseLock(changed.phase_lock),
        ] {
            setting.emit()?;
        }
        *self = changed;
        Ok(())
    }

    /// Reads `settings.json`.
    pub fn parse(document: &[u8]) -> Result<Self, SettingsError> {
        let document = parse_json(document)?;
        let returns = text(&document, "returns", "/returns")?;
        let address = text(&document, "host address", "/host/addr")?;
        Ok(Self {
            laser: switch("laser", text(&document, "laser", "/laser")?)?,
            returns: returns_mode(returns)?,
            rpm: number(&document, "rpm", "/rpm")?,
            field_of_view: FieldOfView {
                start_deg: number(&document, "field of view", "/fov/start")?,
                end_deg: number(&document, "field of view", "/fov/end")?,
            },
            phase_lock: PhaseLock {
                lock: switch(
                    "phase lock",
                    text(&document, "phase lock", "/phaselock/enabled")?,
                )?,
                offset_centideg: number(&document, "phase lock offset", "/phaselock/offset")?,
            },
            destination: Destination {
                address: address
                    .parse()
                    .map_err(|_| error("host address", address))?,
                data_port: number(&document, "data port", "/host/dport")?,
                position_port: number(&document, "position port", "/host/tport")?,
            },
        })
    }

    /// `settings.json` of a sensor that has them.
    pub fn emit(&self) -> String {
        json!({
            "laser": self.laser.name(),
            "returns": returns_name(self.returns),
            "rpm": self.rpm,
            "fov": { "start": self.field_of_view.start_deg, "end": self.field_of_view.end_deg },
            "phaselock": {
                "enabled": self.phase_lock.lock.name(),
                "offset": self.phase_lock.offset_centideg,
            },
            "host": {
                "addr": self.destination.address.to_string(),
                "dport": self.destination.data_port,
                "tport": self.destination.position_port,
            },
            "net": {
                "addr": "192.168.1.201",
                "mask": "255.255.255.0",
                "gateway": "192.168.1.1",
                "dhcp": "off",
            },
        })
        .to_string()
    }
}

/// What the sensor is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SensorInfo {
    /// Model, as the sensor names it.
    pub model: String,
    /// Serial number.
    pub serial: String,
}

impl SensorInfo {
    /// Reads `info.json`.
    pub fn parse(document: &[u8]) -> Result<Self, SettingsError> {
        let document = parse_json(document)?;
        Ok(Self {
            model: text(&document, "model", "/model")?.to_owned(),
            serial: text(&document, "serial", "/serial")?.to_owned(),
        })
    }

    /// `info.json` of such a sensor.
    pub fn emit(&self) -> String {
        json!({ "model": self.model, "serial": self.serial }).to_string()
    }
}

/// How the sensor is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SensorStatus {
    /// State of the pulse-per-second input.
    pub pps: PpsStatus,
    /// Whether the motor turns.
    pub motor: Switch,
    /// How fast, revolutions per minute.
    pub motor_rpm: u16,
    /// Whether the lasers fire.
    pub laser: Switch,
}

impl SensorStatus {
    /// Reads `status.json`.
    pub fn parse(document: &[u8]) -> Result<Self, SettingsError> {
        let document = parse_json(document)?;
        let pps = text(&document, "pps state", "/gps/pps_state")?;
        let pps = match pps.to_ascii_lowercase().as_str() {
            "absent" => PpsStatus::Absent,
            "synchronizing" => PpsStatus::Synchronizing,
            "locked" => PpsStatus::Locked,
            "error" => PpsStatus::Error,
            _ => return Err(error("pps state", pps)),
        };
        Ok(Self {
            pps,
            motor: switch("motor", text(&document, "motor", "/motor/state")?)?,
            motor_rpm: number(&document, "motor rpm", "/motor/rpm")?,
            laser: switch("laser", text(&document, "laser", "/laser/state")?)?,
        })
    }

    /// `status.json` of such a sensor.
    pub fn emit(&self) -> String {
        let pps = match self.pps {
            PpsStatus::Absent => "Absent",
            PpsStatus::Synchronizing => "Synchronizing",
            PpsStatus::Locked => "Locked",
            PpsStatus::Error | PpsStatus::Unknown(_) => "Error",
        };
        json!({
            "gps": { "pps_state": pps, "position": "" },
            "motor": { "state": self.motor.name(), "rpm": self.motor_rpm, "lock": "Off", "phase": 0 },
            "laser": { "state": self.laser.name() },
        })
        .to_string()
    }
}

impl Switch {
    fn name(self) -> &'static str {
        match self {
            Self::On => "On",
            Self::Off => "Off",
        }
    }

    fn form_value(self) -> &'static str {
        match self {
            Self::On => "on",
            Self::Off => "off",
        }
    }
}

fn switch(field: &'static str, value: &str) -> Result<Switch, SettingsError> {
    match value.to_ascii_lowercase().as_str() {
        "on" => Ok(Switch::On),
        "off" => Ok(Switch::Off),
        _ => Err(error(field, value)),
    }
}

fn returns_name(mode: Returns) -> &'static str {
    match mode {
        Returns::Strongest => "Strongest",
        Returns::Last => "Last",
        Returns::Dual => "Dual",
    }
}

fn returns_mode(value: &str) -> Result<Returns, SettingsError> {
    [Returns::Strongest, Returns::Last, Returns::Dual]
        .into_iter()
        .find(|mode| returns_name(*mode).eq_ignore_ascii_case(value))
        .ok_or_else(|| error("returns", value))
}

fn parse_json(document: &[u8]) -> Result<Value, SettingsError> {
    serde_json::from_slice(document).map_err(|e| error("document", &e.to_string()))
}

fn text<'a>(
    document: &'a Value,
    field: &'static str,
    pointer: &str,
) -> Result<&'a str, SettingsError> {
    let value = document.pointer(pointer);
    value
        .and_then(Value::as_str)
        .ok_or_else(|| error(field, &value.map_or("absent".to_owned(), Value::to_string)))
}

/// A number; firmware writes some of them as text.
fn number(document: &Value, field: &'static str, pointer: &str) -> Result<u16, SettingsError> {
    let value = document.pointer(pointer);
    let number = match value {
        Some(Value::String(text)) => text.trim().parse().ok(),
        Some(value) => value.as_u64().and_then(|number| number.try_into().ok()),
        None => None,
    };
    number.ok_or_else(|| error(field, &value.map_or("absent".to_owned(), Value::to_string)))
}

fn error(field: &'static str, got: &str) -> SettingsError {
    SettingsError {
        field,
        // What a server sends goes into a message: not all of it.
        got: got.chars().take(80).collect(),
    }
}

#[cfg(test)]
mod tests;
