//! `lsfb groundtruth`: a walk and an HD map → trajectory.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use lsfb_eval::radio::read_table;
use lsfb_geometry::Trajectory;
use lsfb_pipeline::ground_truth::{
    GroundTruth, GroundTruthConfig, GroundTruthReport, ground_truth_in_stages,
    ground_truth_together,
};
use lsfb_pipeline::hd_map::HdMap;
use lsfb_recording::{Provenance, Recording, read_tum, write_tum};
use lsfb_types::{Finding, Judgement, Verdict};
use serde::{Deserialize, Serialize};

use super::covariance_file;
use super::groundtruth_page::WalkPage;
use super::models::ModelFolder;
use super::motion_file;
use super::surroundings::Surroundings;
use crate::context::Context;
use crate::files;
use crate::judged::{Judged, problem_lines};
use crate::outcome::Outcome;
use crate::standing;

/// Compute the ground-truth trajectory of a walk in an HD map.
///
/// Beside the trajectory WALK.tum, WALK_covariance.txt has its poses with their covariance, as `lsfb eval` reads it: 44 columns. Most of an
/// attitude's is how far the cameras may be turned against the rig file: what its calibration found (lsfb calib writes it into the rig file,
/// cameras.NAME.sigmas), or extrinsics_sigma_rad, 2 mrad, where it does not say.
///
/// WALK_states.csv has poses, velocities, biases and turn rates at the IMU's rate, in EuRoC's columns, and gravity. WALK_states.mcap, a ROS 2
/// bag, has the same, and the poses of the images with their covariance: /pose, /imu_rate/pose, velocity, turn_rate and biases, /gravity.
///
/// What is not certain, or lies elsewhere when parts of the map are withheld, is left out: then the exit code is 3, and the findings say
/// why. WALK_cross_check.txt has, for each pose, how far half of the map's points move it.
///
/// Points of the map that the walk must see are looked for: where many are not there, the place is another or has changed, and its poses are
/// left out. Far beside the scanner's path few points are certain to be in view; the finding place-not-checked then says for how long the
/// place could not be told from another that is built alike. Its poses are given: trust them only where there is no such place.
///
/// Some images are looked for where they are not said to be, too: a walk that fits the map nearly as well somewhere else (the other end of a
/// corridor, the next bay) is refused below min_place_margin, and warned of below twice (looks-alike), unless what the map has there is not
/// seen. Where that holds of the place at which most images were found, and not of the other, the walk is solved at the other.
///
/// The IMU measures lengths and the vertical: a map of another scale, or one that leans, is told by it (map-scale, map-level), as far as the
/// accelerometer is calibrated; beyond 5 % the exit code is 4. So it is where images and IMU would only agree if the IMU were more than 12
/// standard deviations from calibrated ones (imu-errors), or a camera more than 10 from its rig file (camera-off): images are late or another
/// camera's, or axes are wrong, and the walk is bent.
///
/// Observations are chosen and everything is solved in turns until neither changes the other, six times at most; where they still do, not-at-rest
/// says how many observations, and how far the last turn moved poses.
///
/// A walk that was recorded without an IMU is placed by its images alone, and the finding without-imu says so: lengths and the vertical are the
/// map's then, nothing checks them, and there are poses only where enough of the map is in view.
///
/// The pressure that a phone's barometer measured must change with the height (finding barometer; beyond 1.8 m the exit code is 4: a stretch is on
/// another floor than it seems). Whoever walked there before with a trajectory that is right can make a table of what is heard where
/// (`lsfb dataset radio`): with --radio a walk that did not hear the same is refused, as one on another floor that looks alike.
///
/// Walks that went by the same places can be solved together (--with): what two of them see, points of the map and others, is one point then, so
/// that devices lie to each other as they did better than by the map alone (finding together). Each is solved and judged by itself first, and one
/// that is refused then, or is not to be used (exit code 4), is refused here, also where it would be found elsewhere by itself. Settings, and the weights of a map of learned features, are
/// the same for all; of the others nothing is kept for a command that is stopped.
///
/// An existing trajectory, made by this program from the same walk and map with the same settings, is not computed again. Stopped, the same
/// command goes on behind the images that it had localized: what is known of them is kept in WALK.tum.unfinished until then.
///
/// Examples:
///   lsfb groundtruth walk.mcap --map map --out walk.tum
///   lsfb groundtruth walk.mcap --map map --out walk.tum --out-report walk.html
///   lsfb groundtruth phone.mcap --with glasses.mcap --map map --out phone.tum
///   lsfb groundtruth walk2.mcap --map map --radio radio.csv --out walk2.tum
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The recording of a walk with a phone or glasses.
    #[arg(value_name = "MCAP")]
    recording: PathBuf,
    /// The map, a folder.
    #[arg(long, value_name = "FOLDER")]
    map: PathBuf,
    /// The trajectory to write, in the map's world frame.
    #[arg(long, value_name = "TUM")]
    out: PathBuf,
    /// Also write a page: the trajectory in the map, its standard deviations over time, what was left out and why. Of a walk that is refused
    /// there is none.
    #[arg(long, value_name = "HTML")]
    out_report: Option<PathBuf>,
    /// Another walk through the map, of another device say, that is solved together with this one; may be given several times. Results are this
    /// walk's.
    #[arg(long, value_name = "MCAP")]
    with: Vec<PathBuf>,
    /// Settings instead of the defaults.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
    /// Readings of Wi-Fi and Bluetooth of other walks at their places in this map, a table of `lsfb dataset radio`: the walk must have heard the
    /// same where it was.
    #[arg(long, value_name = "CSV")]
    radio: Option<PathBuf>,
    #[command(flatten)]
    models: ModelFolder,
}

/// Computes, writes, prints.
pub fn run(arguments: &Arguments, context: &Context) -> anyhow::Result<Outcome> {
    let config: GroundTruthConfig = super::config_or_default(arguments.config.as_deref())?;
    let job = WalkJob {
        recording: &arguments.recording,
        others: &arguments.with,
        map: &arguments.map,
        out: &arguments.out,
        out_report: arguments.out_report.as_deref(),
        config: &config,
        radio: arguments.radio.as_deref(),
        models: &arguments.models,
    };
    let mut read: Vec<&Path> = vec![&arguments.recording];
    for other in &arguments.with {
        if read.iter().any(|path| files::is_same(path, other)) {
            anyhow::bail!(
                "{}: --with takes other walks, each once: one with itself says nothing new",
                other.display()
            );
        }
        read.push(other);
    }
    let found = job.compute(context, |result| context.claim(result, &read))?;
    let r = &found.said.report;
    let judgement = Judgement::new(found.said.findings());
    context.print(
        &Judged::new(&judgement, "the trajectory", &found.said),
        || {
            let mut text = format!(
                "{}: {} poses, {} of {} frames that were looked up localized, {} bridged, reprojection {:.3} px rms\n",
                arguments.out.display(),
                found.trajectory.len(),
                r.localized,
                r.looked_up,
                r.bridged,
                r.map_errors.rms_px
            );
            for camera in judgement.findings().iter().filter(|f| f.code == "camera") {
                text += &format!("  {}\n", camera.sentence());
            }
            text + &problem_lines(&judgement)
        },
    )?;
    Ok(match (judgement.verdict(), r.is_whole()) {
        (Verdict::Fail, _) => Outcome::JudgementFailed,
        (_, false) => Outcome::DataLost,
        _ => Outcome::Done,
    })
}

/// A trajectory that was written, and where it comes from.
pub struct WrittenTrajectory {
    pub trajectory: Trajectory,
    pub said: Said,
    pub provenance: Provenance,
}

/// What is said of a trajectory, and kept beside it.
#[derive(Serialize, Deserialize)]
pub struct Said {
    #[serde(flatten)]
    pub report: GroundTruthReport,
    /// What the walk's barometer and radio say of it.
    pub surroundings: Surroundings,
}

impl Said {
    /// All that is to be judged.
    pub fn findings(&self) -> Vec<Finding> {
        let own = self.report.findings().into_iter();
        own.chain(self.surroundings.findings()).collect()
    }

    /// Codes of what is not as it should be; of what forbids to use the trajectory with the verdict.
    pub fn doubts(&self) -> Vec<String> {
        let doubt = |finding: Finding| match finding.verdict {
            Verdict::Warn => Some(finding.code.into_owned()),
            Verdict::Fail => Some(format!("{} {}", finding.code, finding.verdict)),
            Verdict::Unknown | Verdict::Pass => None,
        };
        self.findings().into_iter().filter_map(doubt).collect()
    }

    /// Why the trajectory must not be used, a sentence each; empty where nothing forbids it.
    fn failures(&self) -> Vec<String> {
        let failed = |f: &Finding| f.verdict == Verdict::Fail;
        let failed = self.findings().into_iter().filter(failed);
        failed.map(|finding| finding.sentence()).collect()
    }

    /// Whether the trajectory must not be used.
    pub fn is_failed(&self) -> bool {
        Judgement::new(self.findings()).verdict() == Verdict::Fail
    }
}

/// A trajectory to be computed of a walk.
pub struct WalkJob<'a> {
    pub recording: &'a Path,
    /// Walks that are solved together with it.
    pub others: &'a [PathBuf],
    pub map: &'a Path,
    pub out: &'a Path,
    /// A page about it.
    pub out_report: Option<&'a Path>,
    pub config: &'a GroundTruthConfig,
    /// Readings of others at their places.
    pub radio: Option<&'a Path>,
    /// Weights for maps of learned features.
    pub models: &'a ModelFolder,
}

impl WalkJob<'_> {
    /// Computes the trajectory and writes it with where it comes from, unless it stands. `claim` is asked before anything is
    /// replaced.
    pub fn compute(
        &self,
        context: &Context,
        claim: impl Fn(&Path) -> anyhow::Result<()>,
    ) -> anyhow::Result<WrittenTrajectory> {
        let (walk, hd_map) = (context.open(self.recording)?, super::open_map(self.map)?);
        let learned = self.models.learned(hd_map.feature())?;
        let config = GroundTruthConfig {
            learned: learned.or_else(|| self.config.learned.clone()),
            ..self.config.clone()
        };
        let mut provenance = Provenance::new(&config);
        provenance.add_input(self.recording)?;
        provenance.add_rig(&super::about(self.recording, walk.rig())?);
        let mut others = Vec::with_capacity(self.others.len());
        for path in self.others {
            let other = context.open(path)?;
            provenance.add_input(path)?;
            provenance.add_rig(&super::about(path, other.rig())?);
            others.push(other);
        }
        // The map's header has the hashes of its other files.
        provenance.add_input(&self.map.join(HdMap::HEADER))?;
        let covariances = files::beside(self.out, "covariance");
        let cross_check = files::beside(self.out, "cross_check");
        let states = files::beside(self.out, "states").with_extension("csv");
        let motion = states.with_extension("mcap");
        let heard = self.radio.map(read_table).transpose()?;
        if let Some(table) = self.radio {
            provenance.add_input(table)?;
        }
        let outputs: Vec<&Path> = [Some(self.out), self.out_report]
            .into_iter()
            .flatten()
            .collect();
        if let Some(said) = context.standing(&outputs, &provenance) {
            return Ok(WrittenTrajectory {
                trajectory: read_tum(self.out)?,
                said,
                provenance,
            });
        }
        outputs.iter().try_for_each(|result| claim(result))?;
        claim(&covariances)?;
        claim(&cross_check)?;
        claim(&states)?;
        claim(&motion)?;
        let stages = context.kept_stages(self.out, &provenance)?;
        let show = |p| context.show(p);
        let found = match &others[..] {
            [] => ground_truth_in_stages(&walk, &hd_map, &config, &stages, &show),
            others => {
                let others: Vec<&Recording> = others.iter().collect();
                ground_truth_together(&walk, &others, &hd_map, &config, &stages, &show)
            }
        };
        let found = super::about(self.recording, stages.kept_if_stopped(found))?;
        let surroundings =
            Surroundings::of(&walk, &found, heard.as_deref()).or_else(|refused| {
                stages.remove()?;
                Err(refused)
            })?;
        standing::forget(&outputs)?;
        write_tum(self.out, &found.trajectory)?;
        let poses = found.trajectory.poses().iter().zip(&found.covariances);
        files::write(&covariances, covariance_file::text(NOT_IN_IT, poses))?;
        files::write(&cross_check, disagreements(&found))?;
        files::write(&states, states_text(&found))?;
        motion_file::write(&found, &motion)?;
        let beside = [covariances, cross_check, states, motion];
        let said = Said {
            report: found.report.clone(),
            surroundings,
        };
        provenance.with_failures(said.failures()).write(self.out)?;
        if let Some(path) = self.out_report {
            let page = WalkPage {
                name: &self.recording.display().to_string(),
                map: &hd_map,
                found: &found,
                findings: said.findings(),
                provenance: &provenance,
            };
            super::write(path, page.to_html())?;
            provenance.write(path)?;
        }
        standing::finish(&outputs, &beside, &provenance, &said)?;
        stages.remove()?;
        Ok(WrittenTrajectory {
            trajectory: found.trajectory,
            said,
            provenance,
        })
    }
}

/// What the covariances leave out.
const NOT_IN_IT: &str = "In it are errors of images, of the IMU, of the cameras, of single points of the map and of those that lie together; what all of\n\
     the map around shares, its scale and its place, does not show in a walk and is not in it.";

/// EuRoC's columns of a state (position and velocity in the world, rotation, biases of the IMU), and the turn rate, at the IMU's rate.
fn states_text(found: &GroundTruth) -> String {
    let [x, y, z]: [f64; 3] = found.gravity_m_s2.into();
    let mut text = format!(
        "# gravity in the world of these states: {x:.6} {y:.6} {z:.6} m/s^2\n\
         #timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], \
         v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad s^-1], b_w_RS_S_y [rad s^-1], b_w_RS_S_z [rad s^-1], \
         b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2], b_a_RS_S_z [m s^-2], w_RS_S_x [rad s^-1], w_RS_S_y [rad s^-1], w_RS_S_z [rad s^-1]\n"
    );
    for state in &found.states {
        let pose = &state.nav.world_from_rig;
        let q = pose.rotation.quaternion();
        let vectors = [
            state.nav.velocity_m_s,
            state.bias.gyro_rad_s,
            state.bias.accel_m_s2,
            state.turn_rate_rad_s,
        ];
        let turned = [q.w, q.i, q.j, q.k];
        let cells = pose.translation.iter().chain(&turned);
        let _ = write!(text, "{}", state.time.nanos());
        for cell in cells.chain(vectors.iter().flatten()) {
            let _ = write!(text, ",{cell:.9}");
        }
        text.push('\n');
    }
    text
}

/// How far half of the map's points move each position.
fn disagreements(found: &GroundTruth) -> String {
    let mut text = String::from("# timestamp_s disagreement_m\n");
    for (pose, moved_m) in found.trajectory.poses().iter().zip(&found.disagreements_m) {
        // Writing into a string cannot fail.
        let _ = writeln!(text, "{} {moved_m:.6}", pose.time);
    }
    text
}
