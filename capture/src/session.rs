//! One recording session: opens devices, runs their threads, waits for the end.

use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;

use lsfb_drivers::mynt_s::MyntCamera;
use lsfb_drivers::transport::udp::{UdpConfig, UdpSource};
use lsfb_geometry::Rig;
use lsfb_types::ProgressFn;

use crate::config::{DevicesConfig, LidarNetConfig};
use crate::control::{Control, Counts};
use crate::health::{HealthFeed, Monitor};
use crate::poses::{PoseQueue, Poses, poses};
use crate::recorder::{self, Recorder};
use crate::remark::{RemarkQueue, Remarks, remarks};
use crate::report::StreamReport;
use crate::sidecar::{PairingFolder, PhonesListener, RecordingFolders, SidecarServer};
use crate::tap::{Tap, TapSender, tap};
use crate::threads::{Device, Ends, Threads};
use crate::{CaptureReport, Error, camera, imu, lidar, sidecar};

/// Listening for the devices that send by themselves; not yet recording.
pub struct Session {
    config: DevicesConfig,
    rig: Option<Rig>,
    lidars: Vec<lidar::Listening>,
    sidecar: Option<SidecarServer>,
    counts: Counts,
    tap: Option<TapSender>,
    remarks: Option<RemarkQueue>,
    poses: Option<PoseQueue>,
    health: HealthFeed,
}

impl Session {
    /// Reads the rig, sets the LiDAR where that is asked for, and begins to listen for it and for sidecars.
    pub fn open(config: &DevicesConfig) -> Result<Self, Error> {
        Self::open_with(config, None)
    }

    /// The same, where phones connect at an address that is open already.
    pub fn open_with(
        config: &DevicesConfig,
        phones: Option<&PhonesListener>,
    ) -> Result<Self, Error> {
        if config.lidars.is_empty()
            && config.cameras.is_empty()
            && config.imus.is_empty()
            && config.sidecar.is_none()
        {
            return Err(Error::NoDevice);
        }
        config.check()?;
        let rig = config.rig.as_deref().map(Rig::read).transpose()?;
        let lidars = listen(&config.lidars)?;
        let sidecar = config
            .sidecar
            .as_ref()
            .map(|s| {
                let folder = PairingFolder::open(&s.folder)?;
                let pseudonyms = s.hash_identifiers.then(|| folder.pseudonyms());
                let phones = match phones {
                    Some(phones) => phones.clone(),
                    None => PhonesListener::start(s.listen, &folder)?,
                };
                SidecarServer::open(phones, s.push_listen, folder, pseudonyms.transpose()?)
            })
            .transpose()?;
        Ok(Self {
            config: config.clone(),
            rig,
            lidars,
            sidecar,
            counts: Counts::default(),
            tap: None,
            remarks: None,
            poses: None,
            health: HealthFeed::default(),
        })
    }

    /// Where data packets and position packets of each LiDAR are expected, in this order; empty without a LiDAR.
    pub fn lidar_addresses(&self) -> Vec<SocketAddr> {
        let of = |net: &LidarNetConfig| {
            let of_port = |listening: &lidar::Listening| {
                let lidar = listening.lidars.iter().find(|l| l.name == net.name)?;
                let addresses = listening.source.local_addresses();
                let address = |port: usize| addresses.get(port).copied();
                Some(
                    lidar
                        .ports
                        .into_iter()
                        .filter_map(address)
                        .collect::<Vec<_>>(),
                )
            };
            self.lidars.iter().find_map(of_port).unwrap_or_default()
        };
        self.config.lidars.iter().flat_map(of).collect()
    }

    /// Where sidecars connect.
    pub fn sidecar_address(&self) -> Option<SocketAddr> {
        self.sidecar.as_ref().map(SidecarServer::address)
    }

    /// Where apps push by plain HTTP.
    pub fn push_address(&self) -> Option<SocketAddr> {
        self.sidecar.as_ref().and_then(SidecarServer::push_address)
    }

    /// Live counts; they go on counting while [`Session::run`] runs.
    pub fn counts(&self) -> Counts {
        self.counts.clone()
    }

    /// A lossy look at what is going to be recorded. There is one: of several the last gets everything.
    pub fn tap(&mut self) -> Tap {
        let (sender, tap) = tap();
        self.tap = Some(sender);
        tap
    }

    /// Where the operator's words go while this session records. There is one: of several the last is heard.
    pub fn remarks(&mut self) -> Remarks {
        let (sender, queue) = remarks();
        self.remarks = Some(queue);
        sender
    }

    /// Where the rig's poses go while this session records, on `/tf`. There is one: of several the last is heard.
    pub fn poses(&mut self) -> Poses {
        let (sender, queue) = poses();
        self.poses = Some(queue);
        sender
    }

    /// What the rig is doing, twice a second while [`Session::run`] runs.
    pub fn health(&self) -> HealthFeed {
        self.health.clone()
    }

    /// Opens and configures cameras and IMU (the first that refuses is the error), records into `out` until every device
    /// has ended or `progress` asks for an end, and closes the file properly: to be told to stop is how a recording of
    /// devices that never end is finished, and no error.
    pub fn run(self, out: &Path, progress: ProgressFn<'_>) -> Result<CaptureReport, Error> {
        recorder::make_folder(out)?;
        self.check_space(out)?;
        let (cameras, imus) = open_devices(&self.config)?;
        let units = self.config.cameras.iter();
        let names: Vec<Vec<String>> = units.map(|unit| unit.names.clone()).collect();
        let settings = &self.config.recorder;
        let recorder = Recorder::start(out, self.rig, &names, settings, self.config.overflow)?;
        if self.poses.is_some() {
            recorder.expect_odometry();
        }
        camera::introduce(&cameras, &recorder.sender());
        imu::introduce(&self.config.imus, &recorder.sender());
        let finite = cameras.len() + imus.len() + usize::from(self.sidecar.is_some());
        let mut threads = Threads::new(
            Control::of(finite, self.counts.clone()),
            self.config.overflow,
            recorder.sender().tapped(self.tap),
            self.remarks,
            self.poses,
        );
        for listening in self.lidars {
            let names: Vec<String> = listening.lidars.iter().map(|l| l.name.clone()).collect();
            let devices = names.iter().map(|name| (name.clone(), lidar::expected()));
            threads.start_group(&names.join("+"), devices, |on| {
                lidar::record(listening, on.to_recorder, on.control, on.meters)
            })?;
        }
        for (index, unit) in cameras.into_iter().enumerate() {
            let device = Device {
                thread: &format!("camera{index}"),
                name: &unit.config.names.join("+"),
                ends: Ends::ByItself,
                expected: camera::expected(&unit.config),
            };
            threads.start(device, move |on| {
                camera::record(unit, on.to_recorder, on.control, on.meter)
            })?;
        }
        for line in imus {
            let name = line.config.name.clone();
            let device = Device {
                thread: &name,
                name: &name,
                ends: Ends::ByItself,
                expected: imu::expected(&line.config),
            };
            threads.start(device, |on| {
                imu::record(line, on.to_recorder, on.control, on.meter)
            })?;
        }
        if let (Some(server), Some(sidecar)) = (self.sidecar, &self.config.sidecar) {
            let place = RecordingFolders {
                recording: std::path::absolute(out).unwrap_or_else(|_| out.to_owned()),
                second_folder: settings.second_folder.clone(),
            };
            let come_back = Duration::from_secs(sidecar.come_back_secs.into());
            let device = Device {
                thread: "sidecar",
                name: "sidecar",
                ends: Ends::ByItself,
                // Phones send what they like, when they like.
                expected: Vec::new(),
            };
            threads.start(device, move |on| {
                let to_recorder = on.to_recorder.waiting();
                sidecar::record(server, place, come_back, &to_recorder, on.control, on.meter)
            })?;
        }
        let monitor = Monitor::new(
            &recorder,
            threads.meters(),
            self.health.clone(),
            out,
            &self.config,
        );
        let streams = threads.wait(&recorder, monitor, progress);
        self.health.close();
        let mut streams = streams?;
        streams.iter_mut().for_each(StreamReport::name_silence);
        let written = recorder.finish(&streams)?;
        Ok(written.report(out, streams))
    }

    /// Refuses to begin what will not fit.
    fn check_space(&self, out: &Path) -> Result<(), Error> {
        let settings = &self.config.recorder;
        if settings.least_space_secs <= 0.0 {
            return Ok(());
        }
        let folder = out.parent().unwrap_or(Path::new("")).to_owned();
        let mut folders = vec![folder];
        if let Some(second) = &settings.second_folder {
            recorder::make_folder(&second.join("x"))?;
            folders.push(second.clone());
        }
        recorder::check_space(
            &folders,
            self.config.expected_bytes_per_sec(),
            settings.least_space_secs,
        )
    }
}

/// Sets the LiDARs where that is asked for, and binds their ports; those that share one, with an address each, share a source.
fn listen(nets: &[LidarNetConfig]) -> Result<Vec<lidar::Listening>, Error> {
    let mut groups: Vec<Vec<&LidarNetConfig>> = Vec::new();
    for net in nets {
        let shares = |group: &Vec<&LidarNetConfig>| group.iter().any(|l| l.shares_port_with(net));
        match groups.iter_mut().find(|group| shares(group)) {
            Some(group) => group.push(net),
            None => groups.push(vec![net]),
        }
    }
    groups.iter().map(|group| listen_together(group)).collect()
}

fn listen_together(nets: &[&LidarNetConfig]) -> Result<lidar::Listening, Error> {
    let mut binds: Vec<SocketAddr> = Vec::new();
    let mut lidars = Vec::new();
    for net in nets {
        // What it says that cannot be used is said before anything is set.
        let settings = net.decoder()?;
        net.set()?;
        let ports = [net.data, net.position].map(|address| {
            let is_known = |bind: &SocketAddr| *bind == address && address.port() != 0;
            binds.iter().position(is_known).unwrap_or_else(|| {
                binds.push(address);
                binds.len() - 1
            })
        });
        lidars.push(lidar::Listened {
            name: net.name.clone(),
            settings,
            set_rpm: net.settings.as_ref().and_then(|wanted| wanted.rpm),
            sensor: net.sensor,
            ports,
        });
    }
    let buffers = nets.iter().map(|net| net.receive_buffer_bytes);
    let source = UdpSource::bind(&UdpConfig {
        binds,
        // Others are counted by address.
        sender: None,
        receive_buffer_bytes: buffers.max().unwrap_or_default(),
    })?;
    Ok(lidar::Listening { source, lidars })
}

/// The devices that are asked rather than listened to.
fn open_devices(config: &DevicesConfig) -> Result<(Vec<camera::Unit>, Vec<imu::Line>), Error> {
    let mut cameras = Vec::new();
    for unit in &config.cameras {
        cameras.push(camera::Unit {
            camera: MyntCamera::open(&unit.open())?,
            config: unit.clone(),
        });
    }
    let mut imus = Vec::new();
    for line in &config.imus {
        imus.push(imu::Line {
            unit: imu::ImuUnit::open(line)?,
            config: line.clone(),
        });
    }
    Ok((cameras, imus))
}
