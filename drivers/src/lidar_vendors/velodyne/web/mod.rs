//! The sensor's web page: reading it, and changing settings so that it is known whether they were taken.

use std::net::SocketAddr;
use std::time::Duration;

use super::settings::{SensorInfo, SensorStatus, Setting, Settings, SettingsError};
use crate::Error;
use crate::lidar::Page;
use crate::transport::http::{HttpRequest, HttpResponse, Method, exchange};

const INFO: &str = "/cgi/info.json";
const SETTINGS: &str = "/cgi/settings.json";
const STATUS: &str = "/cgi/status.json";
const SAVE: &str = "/cgi/save";
const RESET: &str = "/cgi/reset";
/// A sensor on its own network answers within milliseconds, but not while its rotor starts.
const TIMEOUT: Duration = Duration::from_secs(5);

/// How these sensors are set.
pub const PAGE: Option<Page> = Some(Page {
    check: |wanted| {
        let changes = Setting::of_all(wanted).into_iter();
        changes
            .map(|change| change.emit())
            .try_for_each(|form| form.map(|_| ()))
    },
    apply: |address, wanted| {
        let page = SensorPage::at(address);
        page.apply(&Setting::of_all(wanted)).map(|_| ())
    },
});

/// The web page of one sensor (VLP-32C 63-9325, appendix on the interface; factory address 192.168.1.201, port 80).
#[derive(Clone, Copy, Debug)]
pub struct SensorPage {
    address: SocketAddr,
}

impl SensorPage {
    /// The page at `address`. Nothing is sent yet.
    pub fn at(address: SocketAddr) -> Self {
        Self { address }
    }

    /// What the sensor is.
    pub fn info(&self) -> Result<SensorInfo, Error> {
        self.document(INFO, SensorInfo::parse)
    }

    /// How it is doing.
    pub fn status(&self) -> Result<SensorStatus, Error> {
        self.document(STATUS, SensorStatus::parse)
    }

    /// Its settings.
    pub fn settings(&self) -> Result<Settings, Error> {
        self.document(SETTINGS, Settings::parse)
    }

    /// Changes settings one by one, and reads all of them back after each: units have been seen that answer a wrong
    /// request with 200. The first that was not taken is the error. They last until the sensor loses power; see
    /// [`SensorPage::save`].
    pub fn apply(&self, changes: &[Setting]) -> Result<Settings, Error> {
        let mut settings = self.settings()?;
        for change in changes {
            let form = change.emit().map_err(|e| self.protocol(e.to_string()))?;
            self.post(form.path, &form.body)?;
            settings = self.settings()?;
            let got = change.of(&settings);
            if got != *change {
                return Err(self.protocol(format!("was set to {change} but reads {got}")));
            }
        }
        Ok(settings)
    }

    /// Makes the settings last beyond the loss of power.
    pub fn save(&self) -> Result<(), Error> {
        self.post(SAVE, "submit")
    }

    /// Restarts the sensor.
    pub fn reset(&self) -> Result<(), Error> {
        self.post(RESET, "reset_system")
    }

    fn document<T>(
        &self,
        path: &str,
        parse: impl FnOnce(&[u8]) -> Result<T, SettingsError>,
    ) -> Result<T, Error> {
        let request = HttpRequest {
            method: Method::Get,
            path: path.to_owned(),
            body: Vec::new(),
        };
        let response = self.ask(&request)?;
        parse(&response.body).map_err(|e| self.protocol(format!("{path}: {e}")))
    }

    fn post(&self, path: &str, body: &str) -> Result<(), Error> {
        let request = HttpRequest {
            method: Method::Post,
            path: path.to_owned(),
            body: body.as_bytes().to_vec(),
        };
        self.ask(&request).map(|_| ())
    }

    fn ask(&self, request: &HttpRequest) -> Result<HttpResponse, Error> {
        let response = exchange(self.address, request, TIMEOUT)?;
        if !(200..300).contains(&response.status) {
            let form = String::from_utf8_lossy(&request.body);
            return Err(self.protocol(format!(
                "the sensor rejected {} {form} with status {}",
                request.path, response.status
            )));
        }
        Ok(response)
    }

    fn protocol(&self, problem: String) -> Error {
        Error::Protocol {
            device: format!("velodyne page {}", self.address),
            problem,
        }
    }
}

/// What a sensor does with settings that are sent to it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SettingsHandling {
    /// It takes them, as the manual says.
    #[default]
    Applies,
    /// It answers that all is well and changes nothing.
    Ignores,
}

/// The sensor's side of the page: a mock holds one and gives it every request.
#[derive(Clone, Debug)]
pub struct SensorWeb {
    info: SensorInfo,
    settings: Settings,
    saved: Settings,
    status: SensorStatus,
    handling: SettingsHandling,
}

impl SensorWeb {
    /// A sensor with the factory's settings.
    pub fn new(info: SensorInfo, status: SensorStatus) -> Self {
        Self {
            info,
            settings: Settings::default(),
            saved: Settings::default(),
            status,
            handling: SettingsHandling::default(),
        }
    }

    /// Changes what it does with settings that are sent to it.
    pub fn set_handling(&mut self, handling: SettingsHandling) {
        self.handling = handling;
    }

    /// Its settings now.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Answers a request.
    pub fn handle(&mut self, request: &HttpRequest) -> HttpResponse {
        let document = |body: String| HttpResponse {
            status: 200,
            body: body.into_bytes(),
        };
        let empty = |status| HttpResponse {
            status,
            body: Vec::new(),
        };
        match (request.method, request.path.as_str()) {
            (Method::Get, INFO) => document(self.info.emit()),
            (Method::Get, SETTINGS) => document(self.settings.emit()),
            (Method::Get, STATUS) => document(self.status.emit()),
            (Method::Get, _) => empty(404),
            (Method::Post, _) if self.handling == SettingsHandling::Ignores => empty(200),
            (Method::Post, SAVE) => {
                self.saved = self.settings;
                empty(204)
            }
            (Method::Post, RESET) => {
                self.settings = self.saved;
                empty(204)
            }
            (Method::Post, path) => {
                let body = String::from_utf8_lossy(&request.body);
                match self.settings.apply(path, &body) {
                    Ok(()) => {
                        self.status.laser = self.settings.laser;
                        self.status.motor_rpm = self.settings.rpm;
                        empty(204)
                    }
                    Err(_) => empty(400),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
