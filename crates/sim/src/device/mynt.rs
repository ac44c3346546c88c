//! A Mynt stereo unit: frames with their trailer, and extension unit answers, through the camera socket.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use nalgebra::Vector3;

use lsfb_drivers::mynt_s::model::{
    EXPOSURE_STEP_NS, STANDARD_GRAVITY_M_S2, USB_PRODUCT, USB_VENDOR,
};
use lsfb_drivers::mynt_s::wire::{
    DeviceInfo, ImuProtocol, ImuSegment, ImuValues, TimeSource, Trailer, UnitFile, Version,
    XuDevice, emit_frame,
};
use lsfb_drivers::transport::camera_socket::{CameraListener, CameraUnit, UnitRequest};
use lsfb_drivers::transport::uvc::FrameFormat;

use lsfb_types::OutOfBounds;

use super::clock::{Readiness, SimClock};
use super::feed::{Next, Shot, ShotFeed, Which};
use crate::noise::{Dice, next_gaussian, stream};
use crate::timing::{Clocked, Discipline};
use crate::{Error, GRAVITY_M_S2, ImuConfig, RigSim, Simulation};

/// How long the unit listens for a request before it looks whether a frame is due.
pub(super) const LISTEN: Duration = Duration::from_millis(1);
/// Time between two samples of the unit's accelerometer; the gyroscope's lie in the middle.
const IMU_PERIOD_NS: i64 = 5_000_000;

/// One of the two units, and its socket.
pub(crate) struct MyntDevice {
    unit: usize,
    listener: CameraListener,
    info: DeviceInfo,
    /// What a recorded unit answered when it was asked for its files.
    files: BTreeMap<UnitFile, Vec<u8>>,
}

impl MyntDevice {
    /// Makes the socket. Unit 0 holds `cam0` and `cam1`, unit 1 `cam2` and `cam3`.
    pub(crate) fn bind(unit: usize, path: &Path) -> Result<Self, Error> {
        let serial = format!("07C41A19000907{:02}", 31 + unit);
        Ok(Self {
            unit,
            listener: CameraListener::bind(path)?,
            info: DeviceInfo {
                usb_vendor: USB_VENDOR,
                usb_product: USB_PRODUCT,
                name: "MYNT-EYE-S200B".to_owned(),
                serial,
                spec: Version { major: 1, minor: 3 },
                lens: [0, 1],
                imu: [0, 1],
                baseline_mm: 80,
                auxiliary_chip: Version { major: 1, minor: 4 },
                image_processor: Version { major: 2, minor: 1 },
                firmware: Version { major: 2, minor: 1 },
                hardware: Version { major: 1, minor: 0 },
                hardware_flags: 0,
            },
            files: BTreeMap::new(),
        })
    }

    /// Makes the socket of a unit that keeps the files of a recorded one.
    pub(super) fn bind_recorded(
        unit: usize,
        path: &Path,
        files: &BTreeMap<UnitFile, Vec<u8>>,
    ) -> Result<Self, Error> {
        let mut device = Self::bind(unit, path)?;
        let answer = files.get(&UnitFile::DeviceInfo);
        if let Some(info) = answer.and_then(|answer| DeviceInfo::parse(answer).ok()) {
            device.info = info;
        }
        device.files = files.clone();
        Ok(device)
    }

    /// How it speaks of its IMU.
    pub(super) fn imu_protocol(&self) -> ImuProtocol {
        ImuProtocol::of_spec(self.info.spec)
    }

    /// The extension unit of a unit that has just powered up.
    pub(super) fn extension_unit(&self) -> XuDevice {
        let mut xu = XuDevice::new(self.info.clone(), self.imu_protocol());
        for (file, answer) in &self.files {
            xu.set_file_answer(*file, answer);
        }
        xu
    }

    /// Serves its host, and once it asks for the stream sends the whole walk. Returns the frames sent.
    pub(crate) fn run(
        self,
        simulation: &Arc<Simulation>,
        clock: &SimClock,
        device: usize,
    ) -> Result<u64, Error> {
        let rig = simulation.scan();
        let mut xu = self.extension_unit();
        let Some(Started { mut unit, format }) = self.wait_for_host(&mut xu, clock)? else {
            return Ok(0);
        };
        let camera = simulation.config().scan_cameras.clone();
        if [format.width, format.height] != [2 * camera.width, camera.height] {
            let got = format!("{}x{}", format.width, format.height);
            let bounds = "twice the width, and the height, of the simulated cameras";
            return Err(OutOfBounds::new("host", "frame_format", &got, &bounds).into());
        }
        let feed = ShotFeed::start(
            &format!("sim-mynt{}-render", self.unit),
            Arc::clone(simulation),
            Which::Scan,
            vec![2 * self.unit, 2 * self.unit + 1],
        )?;
        let mut segments = UnitImu::new(self.unit, simulation);
        let mut frames = 0;
        let mut waiting: Option<Shot> = None;
        let mut bytes = Vec::new();
        loop {
            // Requests are answered also while the frame, or its time, has not come yet.
            xu.serve(&mut unit, LISTEN)?;
            let shot = match waiting.take().map_or_else(|| feed.poll(), Next::Shot) {
                Next::Shot(shot) => shot,
                Next::NotYet if !clock.is_stopped() => continue,
                Next::NotYet | Next::Over => break,
            };
            match clock.poll(device, shot.offset_ns) {
                Readiness::Ready => {}
                Readiness::Early => {
                    waiting = Some(shot);
                    continue;
                }
                Readiness::Stopped => break,
            }
            segments.push_until(shot.offset_ns, rig, &mut xu);
            frame_bytes(rig, self.unit, format, &shot, &mut bytes)?;
            unit.send_frame(&bytes)?;
            frames += 1;
        }
        clock.finish(device);
        unit.finish()?;
        Ok(frames)
    }

    /// Serves one host after another until one starts the stream; `None`: the session was stopped before.
    pub(super) fn wait_for_host(
        &self,
        xu: &mut XuDevice,
        clock: &SimClock,
    ) -> Result<Option<Started>, Error> {
        while !clock.is_stopped() {
            let Some(mut unit) = self.listener.accept(50 * LISTEN)? else {
                continue;
            };
            while !clock.is_stopped() {
                match xu.serve(&mut unit, 50 * LISTEN) {
                    Ok(Some(UnitRequest::Start { format, .. })) => {
                        return Ok(Some(Started { unit, format }));
                    }
                    Ok(_) => {}
                    // It only looked what is here.
                    Err(lsfb_drivers::Error::Lost { .. }) => break,
                    Err(e) => return Err(e.into()),
                }
            }
        }
        Ok(None)
    }
}

pub(super) struct Started {
    pub(super) unit: CameraUnit,
    pub(super) format: FrameFormat,
}

/// Both images of a shot side by side, with the trailer.
pub(crate) fn frame_bytes(
    rig: &RigSim,
    unit: usize,
    format: FrameFormat,
    shot: &Shot,
    out: &mut Vec<u8>,
) -> Result<(), Error> {
    let [left, right] = shot.images.as_slice() else {
        let count = shot.images.len();
        return Err(OutOfBounds::new("", "cameras of a stereo unit", &count, &2).into());
    };
    let trailer = Trailer {
        time_source: time_source(rig, unit),
        frame_id: shot.frame as u16,
        timestamp_us: device_us(rig, unit, shot.offset_ns),
        exposure_steps: (left.exposure_ns / EXPOSURE_STEP_NS) as u16,
        checksum: 0,
    }
    .with_checksum();
    Ok(emit_frame(
        format,
        &[&left.pixels, &right.pixels],
        &trailer,
        out,
    )?)
}

/// A unit's clock, microseconds.
fn device_us(rig: &RigSim, unit: usize, offset_ns: i64) -> u64 {
    (rig.clocks().of(Clocked::Unit(unit)).device_ns(offset_ns) / 1000) as u64
}

fn time_source(rig: &RigSim, unit: usize) -> TimeSource {
    match rig.clocks().of(Clocked::Unit(unit)).discipline() {
        Discipline::Utc => TimeSource::External,
        Discipline::Free => TimeSource::Device,
    }
}

/// The IMU inside a unit, in the axes of its left camera.
struct UnitImu {
    unit: usize,
    config: ImuConfig,
    dice: Dice,
    next_ns: i64,
    serial: u32,
}

impl UnitImu {
    fn new(unit: usize, simulation: &Simulation) -> Self {
        let config = simulation.config();
        Self {
            unit,
            config: config.glasses_imu.clone(),
            dice: stream(config.seed, "mynt imu", unit as u64),
            next_ns: 0,
            serial: 0,
        }
    }

    /// Queues the segments measured up to a time.
    fn push_until(&mut self, end_ns: i64, rig: &RigSim, xu: &mut XuDevice) {
        while self.next_ns <= end_ns {
            let force = self.specific_force(rig, self.next_ns);
            let g = force / STANDARD_GRAVITY_M_S2;
            let values = ImuValues::AccelerometerG(g.map(|v| v as f32).into());
            self.push(rig, self.next_ns, values, xu);
            let middle_ns = self.next_ns + IMU_PERIOD_NS / 2;
            let rate = self.angular_velocity(rig, middle_ns).map(f64::to_degrees);
            let values = ImuValues::GyroscopeDegS(rate.map(|v| v as f32).into());
            self.push(rig, middle_ns, values, xu);
            self.next_ns += IMU_PERIOD_NS;
        }
    }

    fn push(&mut self, rig: &RigSim, offset_ns: i64, values: ImuValues, xu: &mut XuDevice) {
        self.serial += 1;
        xu.push_imu(ImuSegment {
            serial: self.serial,
            timestamp_us: device_us(rig, self.unit, offset_ns),
            time_source: time_source(rig, self.unit),
            temperature: 36.5,
            values,
        });
    }

    fn noise(&self, density: f64) -> Vector3<f64> {
        let sigma = density * (1e9 / IMU_PERIOD_NS as f64).sqrt();
        Vector3::from_fn(|_, _| sigma * next_gaussian(&self.dice))
    }

    fn angular_velocity(&self, rig: &RigSim, offset_ns: i64) -> Vector3<f64> {
        let motion = rig.walk().at(offset_ns as f64 * 1e-9);
        let exact = match self.rig_from_unit(rig) {
            Some(pose) => pose.rotation.inverse() * motion.angular_velocity_rad_s,
            None => motion.angular_velocity_rad_s,
        };
        exact + self.noise(self.config.gyro_noise_density)
    }

    fn specific_force(&self, rig: &RigSim, offset_ns: i64) -> Vector3<f64> {
        let time_s = offset_ns as f64 * 1e-9;
        let step_s = 1e-3;
        let motion = rig.walk().at(time_s);
        let turn = motion.angular_velocity_rad_s;
        let gained = rig.walk().at(time_s + step_s).angular_velocity_rad_s
            - rig.walk().at(time_s - step_s).angular_velocity_rad_s;
        let gravity = Vector3::new(0.0, 0.0, -GRAVITY_M_S2);
        let at_rig =
            motion.world_from_rig.rotation.inverse() * (motion.acceleration_m_s2 - gravity);
        let exact = match self.rig_from_unit(rig) {
            // Off the rig's origin: Euler's and the centripetal acceleration.
            Some(pose) => {
                let arm = pose.translation;
                let euler = (gained / (2.0 * step_s)).cross(&arm);
                pose.rotation.inverse() * (at_rig + euler + turn.cross(&turn.cross(&arm)))
            }
            None => at_rig,
        };
        exact + self.noise(self.config.accel_noise_density)
    }

    fn rig_from_unit(&self, rig: &RigSim) -> Option<lsfb_geometry::Se3> {
        let left = rig.rig().cameras.values().nth(2 * self.unit)?;
        Some(left.rig_from_camera)
    }
}
