//! The LiDAR: where it sends, what it must be, how it is set.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use lsfb_drivers::any_lidar::{Model, Settings};
use lsfb_drivers::lidar::{BeamAngles, Returns, ScanSettings};
use lsfb_drivers::velodyne::VelodyneConfig;
use lsfb_drivers::velodyne::settings::{Destination, FieldOfView, PhaseLock, Setting, Switch};
use lsfb_geometry::MAIN_LIDAR;
use lsfb_types::Bounds;
use serde::{Deserialize, Serialize};

use crate::Error;

/// Whatever the packets say.
const ANY: &str = "any";

/// A LiDAR on the network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LidarNetConfig {
    /// Its name in the recording and in the rig.
    pub name: String,
    /// Address for data packets; port 0 takes a free one.
    pub data: SocketAddr,
    /// Address for position packets; port 0 takes a free one.
    pub position: SocketAddr,
    /// The sensor it must be, by its name ([`Model::key`]); `any` takes what the packets say.
    pub model: String,
    /// The packets are of `model` with these returns, whatever they say themselves: old firmware of Velodyne sensors lies.
    pub force_returns: Option<Returns>,
    /// File of the beam angles of this very unit, for Hesai sensors; relative to the file that names it.
    pub angles: Option<PathBuf>,
    /// A scan ends where the rotor passes this angle, degrees. With a field-of-view window, choose one outside it.
    pub cut_azimuth_deg: f64,
    /// Take packets from this address only; several sensors share the factory ports.
    pub sensor: Option<IpAddr>,
    /// Wanted kernel receive buffer, bytes.
    pub receive_buffer_bytes: usize,
    /// What to set on the sensor's web page before anything is recorded. Without it the sensor stays as it is.
    pub settings: Option<LidarSettingsConfig>,
}

/// Settings of a Velodyne sensor. Each is written to its web page and read back; the first that was not taken is an error. What
/// is not named stays. They last until the sensor loses power.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LidarSettingsConfig {
    /// The sensor's web page, for instance `192.168.1.201:80`.
    pub page: SocketAddr,
    /// Speed of the motor, revolutions per minute: 300 to 1200 in steps of 60.
    #[serde(default)]
    pub rpm: Option<u16>,
    /// Which echoes it sends.
    #[serde(default)]
    pub returns: Option<Returns>,
    /// First and last degree of the sector in which it fires, clockwise, 0 to 359.
    #[serde(default)]
    pub field_of_view_deg: Option<[u16; 2]>,
    /// Where the rotor points at each pulse per second, hundredths of a degree; needs the pulse.
    #[serde(default)]
    pub phase_lock_centideg: Option<u16>,
    /// This host's address, to which it sends; the ports are those of the list of devices.
    #[serde(default)]
    pub destination: Option<Ipv4Addr>,
}

lsfb_types::bounds! {
    LidarNetConfig {
        name: any,
        data: any,
        position: any,
        model: any,
        force_returns: any,
        angles: any,
        cut_azimuth_deg: number(Bounds::Within(-360.0, 360.0)),
        sensor: any,
        receive_buffer_bytes: number(Bounds::AT_LEAST_ONE),
        settings: sections,
    }
}

lsfb_types::bounds! {
    LidarSettingsConfig {
        page: any,
        rpm: optional(Bounds::Within(300.0, 1200.0)),
        returns: any,
        field_of_view_deg: any,
        phase_lock_centideg: optional(Bounds::Within(0.0, 35_999.0)),
        destination: any,
    }
}

impl LidarSettingsConfig {
    /// The changes, one by one.
    pub(crate) fn changes(&self, data_port: u16, position_port: u16) -> Vec<Setting> {
        let returns = self.returns.map(Setting::Returns);
        let field_of_view = self
            .field_of_view_deg
            .map(|[start_deg, end_deg]| Setting::FieldOfView(FieldOfView { start_deg, end_deg }));
        let phase_lock = self.phase_lock_centideg.map(|offset_centideg| {
            Setting::PhaseLock(PhaseLock {
                lock: Switch::On,
                offset_centideg,
            })
        });
        let destination = self.destination.map(|address| {
            Setting::Destination(Destination {
                address,
                data_port,
                position_port,
            })
        });
        let rpm = self.rpm.map(Setting::Rpm);
        [rpm, returns, field_of_view, phase_lock, destination]
            .into_iter()
            .flatten()
            .collect()
    }
}

impl Default for LidarNetConfig {
    /// The factory ports on every interface, any sensor.
    fn default() -> Self {
        let wire = VelodyneConfig::default();
        Self {
            name: MAIN_LIDAR.to_owned(),
            data: wire.data_bind,
            position: wire.position_bind,
            model: ANY.to_owned(),
            force_returns: None,
            angles: None,
            cut_azimuth_deg: 0.0,
            sensor: wire.sensor,
            receive_buffer_bytes: wire.receive_buffer_bytes,
            settings: None,
        }
    }
}

impl LidarNetConfig {
    /// Whether both listen on a port of the same address.
    pub(crate) fn shares_port_with(&self, other: &Self) -> bool {
        let ports = [self.data, self.position];
        let theirs = [other.data, other.position];
        theirs
            .iter()
            .any(|port| port.port() != 0 && ports.contains(port))
    }

    /// Refuses what the sensor would: before anything is opened, and before any of its settings is changed.
    pub(super) fn check_settings(&self) -> Result<(), Error> {
        let (data, position) = (self.data.port(), self.position.port());
        let changes = self.settings.iter().flat_map(|s| s.changes(data, position));
        for change in changes {
            change.emit().map_err(|problem| Error::LidarSettings {
                lidar: self.name.clone(),
                problem: problem.to_string(),
            })?;
        }
        Ok(())
    }

    /// How its packets are read; the file of beam angles is.
    pub(crate) fn decoder(&self) -> Result<Settings, Error> {
        let refused = |problem: String| Error::LidarSettings {
            lidar: self.name.clone(),
            problem,
        };
        let model = match self.model.as_str() {
            ANY => None,
            name => Some(Model::from_key(name).ok_or_else(|| {
                let known = Model::keys();
                refused(format!(
                    "model = {name:?} is unknown: expected {ANY}, {known}"
                ))
            })?),
        };
        if self.force_returns.is_some() && model.is_none() {
            let problem = "force_returns needs the model of the LiDAR";
            return Err(refused(problem.to_owned()));
        }
        let angles = match &self.angles {
            Some(path) => {
                let text = std::fs::read_to_string(path).map_err(|cause| Error::Io {
                    path: path.clone(),
                    cause,
                })?;
                let named = |error| refused(format!("{}: {error}", path.display()));
                Some(BeamAngles::parse_csv(&text).map_err(named)?)
            }
            None => None,
        };
        Ok(Settings {
            model,
            scans: ScanSettings {
                force_returns: self.force_returns,
                // A float cast saturates, and a whole turn is none.
                cut_azimuth_centideg: (self.cut_azimuth_deg.rem_euclid(360.0) * 100.0) as u16
                    % 36_000,
                angles,
            },
        })
    }
}
