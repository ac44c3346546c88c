use std::net::Ipv4Addr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};

use super::*;
use crate::lidar_vendors::velodyne::settings::{Destination, FieldOfView, PhaseLock, Switch};
use crate::lidar_vendors::velodyne::wire::{PpsStatus, Returns};
use crate::transport::http::HttpListener;

/// A sensor's web server on a port of its own.
struct Server {
    sensor: Arc<Mutex<SensorWeb>>,
    address: SocketAddr,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    fn start() -> Self {
        let listener = HttpListener::bind((Ipv4Addr::LOCALHOST, 0).into()).unwrap();
        let address = listener.address();
        let info = SensorInfo {
            model: "VLP-32C".to_owned(),
            serial: "11001170750012".to_owned(),
        };
        let status = SensorStatus {
            pps: PpsStatus::Locked,
            motor: Switch::On,
            motor_rpm: 600,
            laser: Switch::On,
        };
        let sensor = Arc::new(Mutex::new(SensorWeb::new(info, status)));
        let stop = Arc::new(AtomicBool::new(false));
        let (served, stopped) = (Arc::clone(&sensor), Arc::clone(&stop));
        let serve = move || {
            while !stopped.load(Ordering::Relaxed) {
                let answer = |request: &HttpRequest| served.lock().unwrap().handle(request);
                listener.serve(Duration::from_millis(20), answer).unwrap();
            }
        };
        let thread = thread::Builder::new()
            .name("mock-velodyne-page".to_owned())
            .spawn(serve)
            .unwrap();
        Self {
            sensor,
            address,
            stop,
            thread: Some(thread),
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn changes() -> [Setting; 5] {
    [
        Setting::Rpm(1200),
        Setting::Returns(Returns::Dual),
        Setting::FieldOfView(FieldOfView {
            start_deg: 270,
            end_deg: 90,
        }),
        Setting::PhaseLock(PhaseLock {
            lock: Switch::On,
            offset_centideg: 18_000,
        }),
        Setting::Destination(Destination {
            address: Ipv4Addr::new(192, 168, 1, 100),
            data_port: 2369,
            position_port: 8309,
        }),
    ]
}

#[test]
fn settings_are_written_and_read_back_one_by_one() {
    let server = Server::start();
    let page = SensorPage::at(server.address);
    assert_eq!(page.info().unwrap().serial, "11001170750012");
    assert_eq!(page.status().unwrap().pps, PpsStatus::Locked);
    assert_eq!(page.settings().unwrap(), Settings::default());
    let after = page.apply(&changes()).unwrap();
    for change in changes() {
        assert_eq!(change.of(&after), change);
    }
    assert_eq!(*server.sensor.lock().unwrap().settings(), after);
    assert_eq!(page.status().unwrap().motor_rpm, 1200);
    // Unsaved settings are gone after a restart, saved ones are not.
    page.reset().unwrap();
    assert_eq!(page.settings().unwrap(), Settings::default());
    page.apply(&changes()[..1]).unwrap();
    page.save().unwrap();
    page.apply(&changes()[1..2]).unwrap();
    page.reset().unwrap();
    let kept = page.settings().unwrap();
    assert_eq!((kept.rpm, kept.returns), (1200, Returns::Strongest));
}

#[test]
fn a_sensor_that_says_yes_and_does_nothing_is_found_out() {
    let server = Server::start();
    let page = SensorPage::at(server.address);
    let ignore = SettingsHandling::Ignores;
    server.sensor.lock().unwrap().set_handling(ignore);
    let error = page.apply(&changes()).unwrap_err().to_string();
    assert!(
        error.contains("was set to rpm=1200 but reads rpm=600"),
        "{error}"
    );
}

#[test]
fn what_the_sensor_does_not_have_is_not_sent() {
    let server = Server::start();
    let page = SensorPage::at(server.address);
    let error = page.apply(&[Setting::Rpm(610)]).unwrap_err().to_string();
    assert!(error.contains("rpm cannot be `610`"), "{error}");
    assert_eq!(
        *server.sensor.lock().unwrap().settings(),
        Settings::default()
    );
}

#[test]
fn a_refusal_names_the_request() {
    let server = Server::start();
    let page = SensorPage::at(server.address);
    let error = page.post("/cgi/setting", "rpm=7").unwrap_err().to_string();
    assert!(
        error.contains("rejected /cgi/setting rpm=7 with status 400"),
        "{error}"
    );
}
