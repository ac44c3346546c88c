//! `lsfb sim`: simulated devices to record from.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context as _;
use lsfb_capture::{DevicesConfig, LidarNetConfig, Overflow};
use lsfb_sim::{
    ClocksConfig, DatumConfig, Device, Look, Pace, PaperMotion, Place, SimConfig, SimSession,
    Simulation, preview,
};
use serde::Serialize;

use crate::context::Context;
use crate::existing::expect_free;
use crate::outcome::Outcome;
use crate::simulated::{self, Endpoints, Equipment, Layout};

/// How long the glasses look for their recorder.
const PATIENCE: Duration = Duration::from_secs(3600);

/// Simulate a building, a backpack and glasses; play the devices live, or record them directly.
///
/// Writes the rigs, the settings, and the ground truth (in a separate folder, for `lsfb eval`). Without
/// --record, the devices wait for `lsfb scan` in another terminal: first the backpack, then the
/// glasses.
///
/// Examples:
///   lsfb sim --out sim --seed 7 --record
///   lsfb sim --out sim --speed 1       # then, in another terminal:
///   lsfb scan --devices sim/backpack-devices.toml --out scan.mcap
///   lsfb scan --devices sim/glasses-devices.toml --out walk.mcap
///   lsfb sim --out c3 --motion C3 --device android --record
///   lsfb sim --out q --place stairs --clocks quartz --record && lsfb clock q/scan.mcap
///   lsfb sim --out puck --place stairs --lidar-model vlp-16 --returns dual --record
///   lsfb sim preview --out pictures --place atrium
///   lsfb sim --out mine --scene hall.glb --record
#[derive(clap::Args)]
#[command(
    verbatim_doc_comment,
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true
)]
pub struct Arguments {
    #[command(subcommand)]
    action: Option<Action>,
    /// Folder for all results.
    #[arg(long, value_name = "FOLDER", required = true)]
    out: Option<PathBuf>,
    /// The environment: demo, calibration, office-park, house-park, medium-office, large-office, exhibition-hall, atrium,
    /// wide-corridor, narrow-corridor or stairs.
    #[arg(long, value_name = "NAME", value_parser = place, conflicts_with_all = ["config", "motion"])]
    place: Option<Place>,
    /// Your own textured scene, a binary glTF file in metres, instead of --place.
    #[arg(long, value_name = "GLB", conflicts_with_all = ["config", "motion", "place"])]
    scene: Option<PathBuf>,
    /// A sequence of the paper's Table VII, O0 to S2, in its environment.
    #[arg(long, value_name = "NAME", value_parser = motion, conflicts_with = "config")]
    motion: Option<&'static PaperMotion>,
    /// The device of the second walk: glasses, android or iphone.
    #[arg(long, value_name = "NAME", value_parser = device, default_value = "glasses", conflicts_with = "config")]
    device: Device,
    /// Age of the environment in months; furniture and objects move once a month.
    #[arg(long, value_name = "N", default_value_t = 0, conflicts_with = "config")]
    months_later: u32,
    /// Simulate the night: few lamps are lit, windows and screens are dark.
    #[arg(long, conflicts_with = "config")]
    night: bool,
    /// Path-trace the light of lamps, sky and sun. Computed once and kept in the folder. Always used for a
    /// --scene (its own lamps, KHR_lights_punctual, and emissive surfaces), unless --simple-light.
    #[arg(long, conflicts_with = "config")]
    baked_light: bool,
    /// Show a --scene as bright as its textures are, without any light.
    #[arg(long, conflicts_with_all = ["config", "baked_light"])]
    simple_light: bool,
    /// Seed of the building, the walks and the noise; by default that of --config, otherwise 1.
    #[arg(long, value_name = "N", value_parser = super::seed, allow_hyphen_values = true)]
    seed: Option<u64>,
    /// Settings of the simulation instead of the defaults; --seed overrides its seed.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
    /// Record scan.mcap and walk.mcap in this process.
    #[arg(long)]
    record: bool,
    /// Clocks of the devices: ideal (all keep UTC) or quartz (each drifts; links delay and stall). With
    /// --record, arrival times are simulated too, so that `lsfb clock` has something to estimate; the truth
    /// is in truth/truth_*_clocks.csv.
    #[arg(long, value_parser = clocks, value_name = "KIND")]
    clocks: Option<Clocks>,
    /// Position on Earth: latitude and longitude in degrees, height above the ellipsoid in metres, e.g.
    /// 48.15,11.58,565. x points east, y north. Determines satellites, NMEA sentences and the Earth's
    /// magnetic field.
    #[arg(long, value_parser = datum, value_name = "LAT,LON,H", allow_hyphen_values = true)]
    datum: Option<DatumConfig>,
    /// Maximum playback speed, in simulated seconds per second; 0 is as fast as possible.
    #[arg(
        long,
        value_name = "FACTOR",
        default_value_t = 1.0,
        conflicts_with = "record"
    )]
    speed: f64,
    #[command(flatten)]
    equipment: Equipment,
    #[command(flatten)]
    endpoints: Endpoints,
}

#[derive(clap::Subcommand)]
enum Action {
    /// Draw contact sheets of both walks and a view from above, as PNG.
    ///
    /// Examples:
    ///   lsfb sim preview --out pictures --place atrium
    ///   lsfb sim preview --out pictures --motion C3 --device android
    ///   lsfb sim preview --out pictures --detailed-look --baked-light
    #[command(verbatim_doc_comment)]
    Preview {
        /// Folder for the pictures.
        #[arg(long, value_name = "FOLDER")]
        out: PathBuf,
        /// An environment of `lsfb sim --place`; may be repeated. Without --place and --motion: all nine of the
        /// paper.
        #[arg(long, value_name = "NAME", value_parser = place)]
        place: Vec<Place>,
        /// A sequence of the paper's Table VII, O0 to S2; may be repeated.
        #[arg(long, value_name = "NAME", value_parser = motion)]
        motion: Vec<&'static PaperMotion>,
        /// Settings of the simulation, as `lsfb sim --config`; --seed overrides its seed.
        #[arg(long, value_name = "TOML", conflicts_with_all = ["place", "motion"])]
        config: Option<PathBuf>,
        /// The device of the second walk: glasses, android or iphone.
        #[arg(long, value_name = "NAME", value_parser = device, default_value = "glasses", conflicts_with = "config")]
        device: Device,
        /// Seed of the buildings, the walks and the noise; by default that of --config, otherwise 1.
        #[arg(long, value_name = "N", value_parser = super::seed, allow_hyphen_values = true)]
        seed: Option<u64>,
        /// Age of the environment in months; furniture and objects move once a month.
        #[arg(long, value_name = "N", default_value_t = 0, conflicts_with = "config")]
        months_later: u32,
        /// Your own textured scene, a binary glTF file in metres, instead of environments.
        #[arg(long, value_name = "GLB", conflicts_with_all = ["config", "place", "motion"])]
        scene: Option<PathBuf>,
        /// Use path-traced light, as `lsfb sim --baked-light` and for --scene; it is kept in the folder.
        #[arg(long, conflicts_with = "config")]
        baked_light: bool,
        /// Show a --scene as bright as its textures are, without any light.
        #[arg(long, conflicts_with_all = ["config", "baked_light"])]
        simple_light: bool,
        /// Paint each material and object individually, as `lsfb bench twin` does. With --baked-light: what a
        /// trial's cameras see.
        #[arg(long, conflicts_with_all = ["config", "scene"])]
        detailed_look: bool,
        /// Draw the night: few lamps are lit, windows and screens are dark.
        #[arg(long, conflicts_with = "config")]
        night: bool,
        /// Close a door that is otherwise open; the second walk stays on one side of it.
        #[arg(long, conflicts_with = "config")]
        fire_door: bool,
    },
}

fn place(name: &str) -> Result<Place, String> {
    Place::named(name).ok_or_else(|| "no such environment; see lsfb sim --help".to_owned())
}

fn motion(name: &str) -> Result<&'static PaperMotion, String> {
    PaperMotion::named(name).ok_or_else(|| "expected a sequence of Table VII, O0 to S2".to_owned())
}

/// How the devices tell the time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Clocks {
    Ideal,
    Quartz,
}

fn clocks(name: &str) -> Result<Clocks, String> {
    match name {
        "ideal" => Ok(Clocks::Ideal),
        "quartz" => Ok(Clocks::Quartz),
        _ => Err("expected ideal or quartz".to_owned()),
    }
}

fn datum(text: &str) -> Result<DatumConfig, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|n| n.trim().parse()).collect();
    match numbers.as_deref() {
        Ok(&[latitude_deg, longitude_deg, altitude_m]) => Ok(DatumConfig {
            latitude_deg,
            longitude_deg,
            altitude_m,
        }),
        _ => Err("expected three numbers, e.g. 48.15,11.58,565".to_owned()),
    }
}

/// A device by its name on the command line.
pub fn device(name: &str) -> Result<Device, String> {
    let found = Device::ALL.into_iter().find(|d| d.name() == name);
    found.ok_or_else(|| "expected glasses, android or iphone".to_owned())
}

impl Arguments {
    /// Devices that wait for `lsfb scan`.
    pub fn playing(
        out: &Path,
        seed: u64,
        speed: f64,
        equipment: Equipment,
        endpoints: Endpoints,
    ) -> Self {
        Self {
            action: None,
            out: Some(out.to_owned()),
            place: None,
            scene: None,
            motion: None,
            device: Device::Glasses,
            months_later: 0,
            night: false,
            baked_light: false,
            simple_light: false,
            seed: Some(seed),
            config: None,
            record: false,
            clocks: None,
            datum: None,
            speed,
            equipment,
            endpoints,
        }
    }
}

#[derive(Serialize)]
struct Made {
    folder: PathBuf,
    seed: u64,
    recordings: Vec<lsfb_capture::CaptureReport>,
}

/// Builds the world, plays or records.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    if let Some(action) = &arguments.action {
        return draw(action, context);
    }
    let out = arguments.out.as_deref().context("--out is missing")?;
    let mut config = match (arguments.place, arguments.motion) {
        (_, Some(motion)) => SimConfig::for_motion(motion, arguments.device),
        (Some(place), None) => SimConfig::for_place(place, arguments.device),
        (None, None) => super::config_or_default(arguments.config.as_deref())?,
    };
    if let Some(scene) = &arguments.scene {
        config = of_scene(scene, arguments.device, arguments.simple_light);
    }
    if arguments.config.is_none() {
        config.months_later = arguments.months_later;
        config.night = arguments.night;
        config.light.baked |= arguments.baked_light;
        config.device = arguments.device;
    }
    config.seed = arguments.seed.unwrap_or(config.seed);
    anyhow::ensure!(
        !config.fire_door,
        "fire_door: the scanner would walk through the closed door; `lsfb bench twin --condition \
         fire-door` scans with the door open, and `lsfb sim preview --fire-door` shows the walk"
    );
    match arguments.clocks {
        Some(Clocks::Ideal) => config.clocks = ClocksConfig::default(),
        Some(Clocks::Quartz) => config.clocks = ClocksConfig::quartz(),
        None => {}
    }
    config.datum = arguments.datum.unwrap_or(config.datum);
    // Clocks that drift are told from arrivals: those of sockets that are read as fast as they go tell nothing.
    let with_arrivals = arguments.clocks.is_some() || !config.clocks.is_ideal();
    arguments.equipment.apply(&mut config);
    expect_no_other(out, &config, arguments.record, context)?;
    let layout = Layout::create(out)?;
    let simulation = simulated::prepare(&layout, &config, [None, None], None, context)?;
    let mut recordings = Vec::new();
    if arguments.record && with_arrivals {
        recordings = simulated::record_with_simulated_arrivals(&layout, &simulation, context)?;
    } else if arguments.record {
        recordings.push(simulated::record_backpack(&layout, &simulation, context)?);
        recordings.push(simulated::record_glasses(&layout, &simulation, context)?);
    } else {
        let pace = if arguments.speed > 0.0 {
            Pace::RealTimes(arguments.speed)
        } else {
            Pace::Unlimited
        };
        let lidar = LidarNetConfig {
            data: arguments.endpoints.lidar_data,
            position: arguments.endpoints.lidar_position,
            ..LidarNetConfig::default()
        };
        let glasses = arguments.endpoints.sidecar;
        let backpack_file = layout.file("backpack-devices.toml");
        let glasses_file = layout.file("glasses-devices.toml");
        let write = |path: &PathBuf, devices: DevicesConfig| {
            std::fs::write(path, devices.to_toml()).with_context(|| path.display().to_string())
        };
        // The list of devices lies beside what it names.
        let absolute = Layout::create(&std::path::absolute(out)?)?;
        write(
            &backpack_file,
            simulated::backpack_devices(&absolute, &config, lidar.clone(), Overflow::Drop),
        )?;
        write(
            &glasses_file,
            simulated::glasses_devices(&absolute, glasses, Overflow::Drop),
        )?;

        let devices = simulated::start_backpack(&layout, &simulation, lidar, pace, None)?;
        context.note(&format!(
            "waiting for: lsfb scan --devices {} --out scan.mcap",
            backpack_file.display()
        ));
        play(devices, context)?;
        context.note(&format!(
            "waiting for: lsfb scan --devices {} --out walk.mcap",
            glasses_file.display()
        ));
        let rig = simulated::invite_glasses(&absolute, &simulation, glasses)?;
        let devices = SimSession::start_glasses(&simulation, &rig, pace, PATIENCE)?;
        play(devices, context)?;
    }
    let lost = recordings.iter().any(|r| r.lost > 0);
    let made = Made {
        folder: out.to_owned(),
        seed: config.seed,
        recordings,
    };
    context.print_ended(&made, || {
        let mut text = format!(
            "{}: rigs, truth and settings of seed {}",
            made.folder.display(),
            made.seed
        );
        for report in &made.recordings {
            let _ = write!(text, "\n{}", super::scan::text(report));
        }
        text
    })?;
    Ok(if lost {
        Outcome::DataLost
    } else {
        Outcome::Done
    })
}

/// A scene of the user's, in the light of its own lamps unless that is simple.
fn of_scene(scene: &Path, device: Device, simple_light: bool) -> SimConfig {
    let mut config = SimConfig::for_place(Place::Imported, device);
    config.scene = scene.to_owned();
    config.light.baked = !simple_light;
    config
}

/// Fails where recordings, or the truth of other settings, would be replaced. The same settings give the same truth.
fn expect_no_other(
    out: &Path,
    config: &SimConfig,
    record: bool,
    context: &Context,
) -> anyhow::Result<()> {
    let settings = out.join(simulated::SETTINGS);
    let same = std::fs::read_to_string(&settings).is_ok_and(|s| Ok(s) == toml::to_string(config));
    if !same {
        expect_free(&settings, &[], context.force())?;
    }
    for recording in ["scan.mcap", "walk.mcap"] {
        let path = out.join(recording);
        context.will_write(&path);
        if record {
            expect_free(&path, &[], context.force())?;
        }
    }
    Ok(())
}

#[derive(Serialize)]
struct Drawn {
    pictures: Vec<PathBuf>,
}

/// `lsfb sim preview`.
fn draw(action: &Action, context: &Context) -> anyhow::Result<Outcome> {
    let Action::Preview {
        out,
        place,
        motion,
        config: settings,
        device,
        seed,
        months_later,
        scene,
        baked_light,
        simple_light,
        detailed_look,
        night,
        fire_door,
    } = action;
    let mut wanted: Vec<(String, SimConfig)> = Vec::new();
    if settings.is_some() {
        let config = super::config_or_default::<SimConfig>(settings.as_deref())?;
        wanted.push((config.place.name().to_owned(), config));
    }
    for motion in motion {
        wanted.push((
            motion.name.to_owned(),
            SimConfig::for_motion(motion, *device),
        ));
    }
    if let Some(scene) = scene {
        let config = of_scene(scene, *device, *simple_light);
        wanted.push((Place::Imported.name().to_owned(), config));
    }
    let places = if place.is_empty() && wanted.is_empty() {
        &Place::ENVIRONMENTS[..]
    } else {
        place
    };
    for place in places {
        wanted.push((
            place.name().to_owned(),
            SimConfig::for_place(*place, *device),
        ));
    }
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    let mut pictures = Vec::new();
    for (name, mut config) in wanted {
        config.seed = seed.unwrap_or(config.seed);
        if settings.is_none() {
            config.months_later = *months_later;
            (config.night, config.fire_door) = (*night, *fire_door);
            config.light.baked |= *baked_light;
            if *detailed_look {
                config.look = Look::Detailed;
            }
        }
        config.light.cache = out.join("light");
        for kind in ["scan", "walk", "top"] {
            context.claim(&out.join(format!("{name}-{kind}.png")), &[])?;
        }
        let show = |p: lsfb_types::Progress| context.show(p);
        let simulation = Simulation::new(&config, &show)?;
        for (kind, rig) in [("scan", simulation.scan()), ("walk", simulation.glasses())] {
            let path = out.join(format!("{name}-{kind}.png"));
            preview::contact_sheet(&simulation, rig, &show)?.write_png(&path)?;
            pictures.push(path);
            context.check_stop()?;
        }
        let path = out.join(format!("{name}-top.png"));
        preview::top_view(&simulation).write_png(&path)?;
        pictures.push(path);
    }
    let drawn = Drawn { pictures };
    context.print(&drawn, || {
        let lines: Vec<String> = drawn
            .pictures
            .iter()
            .map(|p| p.display().to_string())
            .collect();
        lines.join("\n")
    })?;
    Ok(Outcome::Done)
}

/// Plays to the end, or until Ctrl-C.
fn play(devices: SimSession, context: &Context) -> anyhow::Result<()> {
    devices.join(&|p| context.show(p))?;
    Ok(context.check_stop()?)
}
