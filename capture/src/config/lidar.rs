//! The LiDAR: where it sends, what it must be, how it is set.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;

use lsfb_drivers::any_lidar::{DEFAULT_PORTS, Model, Settings, page_of};
use lsfb_drivers::lidar::{
    BeamAngles, Destination, Page, RECEIVE_BUFFER_BYTES, Returns, ScanSettings, SensorSettings,
};
use lsfb_geometry::MAIN_LIDAR;
use lsfb_types::{Bounds, OutOfBounds};
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
    /// File of the beam angles of this very unit, for sensors that come with one; relative to the file that names it.
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

/// Settings of a sensor with a web page that is known, as Velodyne's. Each is written to the page and read back; the first that was not
/// taken is an error. What is not named stays. They last until the sensor loses power.
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
        rpm: optional(Bounds::MultipleOf(60.0, 300.0, 1200.0)),
        returns: any,
        field_of_view_deg: any,
        phase_lock_centideg: optional(Bounds::Within(0.0, 35_999.0)),
        destination: any,
    }
    also is_in_a_turn
}

/// Degrees of a turn, the last of which is the one before the first.
const DEGREES: Bounds = Bounds::Within(0.0, 359.0);

impl LidarSettingsConfig {
    /// A sector ends at degrees that there are.
    fn is_in_a_turn(&self, section: &str) -> Result<(), OutOfBounds> {
        let mut ends = self.field_of_view_deg.iter().flatten();
        match ends.find(|degree| !DEGREES.hold(f64::from(**degree))) {
            Some(degree) => Err(OutOfBounds::new(
                section,
                "field_of_view_deg",
                degree,
                &DEGREES,
            )),
            None => Ok(()),
        }
    }
}

impl Default for LidarNetConfig {
    /// The factory ports on every interface, any sensor.
    fn default() -> Self {
        let any = IpAddr::V4(Ipv4Addr::UNSPECIFIED);
        let [data, position] = DEFAULT_PORTS.map(|port| SocketAddr::new(any, port));
        Self {
            name: MAIN_LIDAR.to_owned(),
            data,
            position,
            model: ANY.to_owned(),
            force_returns: None,
            angles: None,
            cut_azimuth_deg: 0.0,
            sensor: None,
            receive_buffer_bytes: RECEIVE_BUFFER_BYTES,
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
        let Some(wanted) = &self.settings else {
            return Ok(());
        };
        let checked = (self.page()?.check)(&self.sensor_settings(wanted));
        checked.map_err(|problem| self.refused(problem.to_string()))
    }

    /// Sets the sensor where that is asked for.
    pub(crate) fn set(&self) -> Result<(), Error> {
        let Some(wanted) = &self.settings else {
            return Ok(());
        };
        (self.page()?.apply)(wanted.page, &self.sensor_settings(wanted))?;
        Ok(())
    }

    /// The page that sets its settings.
    fn page(&self) -> Result<Page, Error> {
        page_of(self.model()?).ok_or_else(|| {
            let model = &self.model;
            self.refused(format!(
                "settings of model {model} cannot be changed from here: remove them from the list of devices"
            ))
        })
    }

    /// What is wanted of a sensor whose packets are to arrive at its ports.
    fn sensor_settings(&self, wanted: &LidarSettingsConfig) -> SensorSettings {
        SensorSettings {
            rpm: wanted.rpm,
            returns: wanted.returns,
            field_of_view_deg: wanted.field_of_view_deg,
            phase_lock_centideg: wanted.phase_lock_centideg,
            destination: wanted.destination.map(|address| Destination {
                address,
                data_port: self.data.port(),
                position_port: self.position.port(),
            }),
        }
    }

    fn refused(&self, problem: String) -> Error {
        Error::LidarSettings {
            lidar: self.name.clone(),
            problem,
        }
    }

    /// The sensor that it must be; `None` takes what the packets say.
    fn model(&self) -> Result<Option<Model>, Error> {
        if self.model == ANY {
            return Ok(None);
        }
        Model::from_key(&self.model).map(Some).ok_or_else(|| {
            let known = Model::keys();
            self.refused(format!(
                "model = {:?} is unknown: expected {ANY}, {known}",
                self.model
            ))
        })
    }

    /// How its packets are read; the file of beam angles is.
    pub(crate) fn decoder(&self) -> Result<Settings, Error> {
        let model = self.model()?;
        if self.force_returns.is_some() && model.is_none() {
            let problem = "force_returns needs the model of the LiDAR";
            return Err(self.refused(problem.to_owned()));
        }
        let angles = match &self.angles {
            Some(path) => {
                let text = std::fs::read_to_string(path).map_err(|cause| Error::Io {
                    path: path.clone(),
                    cause,
                })?;
                let named = |error| self.refused(format!("{}: {error}", path.display()));
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
