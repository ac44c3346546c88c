//! The LiDAR's pose to cameras from any recording, without a target: mutual information first, edges as a check.

use lsfb_geometry::{Matrix6, Rig, RigCamera, Se3, Vector6};
use lsfb_recording::Recording;
use lsfb_types::ProgressFn;
use serde::Serialize;

use super::against_lidar::{overlay, views};
use super::alignment::{Score, View, misalignment, usable};
use super::gyro::{Gyro, gyro};
use super::mutual_information::mutual_information;
use super::pose_search::{Found, Steps, following, maximum, profiles, turned_best};
use super::scans::{ScanInRig, scans};
use super::seen::{Seen, present};
use super::{Overlay, VerifyConfig};
use crate::{Error, TransformEdge};

/// How well a translation is known that is left as it was, metres: as a tape measure has it.
const BY_HAND_M: f64 = 0.02;
/// Smallest standard deviations that are claimed: a tenth of a step of most LiDARs in azimuth, and of the noise of one range.
const LEAST_SIGMA: [f64; 2] = [4e-4, 0.003];
/// Standard deviations beyond which the scene does not determine a rotation (rad), or a translation (m).
const LARGEST_SIGMA: [f64; 2] = [0.006, 0.01];
/// Standard deviations by which both scores may differ, and the most that edges are trusted to, radians.
const MOST_DIFFERENCE: f64 = 4.0;
const EDGES_SIGMA_RAD: f64 = 0.012;
/// Half the width of the profiles: radians and metres.
const PROFILE: [f64; 2] = [0.02, 0.06];
/// Names of the six numbers.
const NAMES: [&str; 6] = ["rotation x", "rotation y", "rotation z", "x", "y", "z"];

/// One number of the camera's pose, about or along its own axes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Component {
    /// `rotation x` … `z`.
    pub name: &'static str,
    /// What was added to what the rig says, radians or metres; `None` where the recording does not determine it: it is as it
    /// was.
    pub change: Option<f64>,
    /// Standard deviation, radians or metres; of what is not determined, what it would be. `None`: nothing is known.
    pub sigma: Option<f64>,
    /// The score around the result: pairs of the number, with the result at zero, and the mutual information (nats).
    #[serde(skip)]
    pub profile: Vec<[f64; 2]>,
}

/// What is said of one camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Refinement {
    /// The camera.
    pub camera: String,
    /// Its six numbers; none where nothing can be said.
    pub components: Vec<Component>,
    /// Mutual information with the rig's pose and with the one found, nats.
    pub score: [f64; 2],
    /// By what edges would turn the camera further, radians, and its standard deviation; `None` where they say nothing.
    pub edges_turn_rad: Option<[f64; 2]>,
    /// Pose of the LiDAR in the camera with its covariance. `None` where the recording does not determine it.
    #[serde(skip)]
    pub edge: Option<TransformEdge>,
    /// Returns over an image, with the rig's pose and with the one found.
    #[serde(skip)]
    pub overlays: Option<[Overlay; 2]>,
    /// In words.
    pub sentence: String,
}

/// All cameras.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RefinementReport {
    /// By name.
    pub cameras: Vec<Refinement>,
}

/// Poses between the LiDAR and all cameras of a rig that is nearly right: within 2.5° and 5 cm.
pub fn refine(
    recording: &Recording,
    rig: &Rig,
    config: &VerifyConfig,
    progress: ProgressFn,
) -> Result<RefinementReport, Error> {
    let unknown = |problem: &str| Error::NotJoined {
        first: "cameras".to_owned(),
        second: "lidar".to_owned(),
        problem: problem.to_owned(),
    };
    let lidar = rig
        .lidar
        .as_ref()
        .ok_or_else(|| unknown("the rig has no LiDAR: give it a pose as measured by hand"))?;
    let gyro = gyro(recording)?;
    let scans = scans(recording, rig, gyro.as_ref(), config)?;
    if scans.is_empty() {
        return Err(unknown("the recording has no scans"));
    }
    let only_views = VerifyConfig {
        max_frames: 0,
        ..*config
    };
    let mut cameras = Vec::new();
    for (name, mounted) in present(recording, rig) {
        let seen = Seen::read(recording, (name, mounted), &scans, &only_views, progress)?;
        let one = One {
            name,
            mounted,
            rig_from_lidar: &lidar.rig_from_lidar,
            seen: &seen,
            scans: &scans,
            gyro: gyro.as_ref(),
        };
        cameras.push(one.refined()?);
    }
    if cameras.is_empty() {
        return Err(unknown("none of the rig's cameras is in the recording"));
    }
    Ok(RefinementReport { cameras })
}

/// Everything about one camera.
struct One<'a> {
    name: &'a str,
    mounted: &'a RigCamera,
    rig_from_lidar: &'a Se3,
    seen: &'a Seen,
    scans: &'a [ScanInRig],
    gyro: Option<&'a Gyro>,
}

impl One<'_> {
    fn refined(&self) -> Result<Refinement, Error> {
        let views = views(self.mounted, self.seen, self.scans, self.gyro);
        let start = self.mounted.rig_from_camera.inverse();
        let Some(usable) = usable(&views, Score::MutualInformation) else {
            return Ok(self.silent("too few scans and images of the same time"));
        };
        let Some((found, sigma)) = determined(&usable, &start) else {
            return Ok(self.silent("brightness in LiDAR and images has no maximum near the rig's pose: look at the overlay of `lsfb calib verify`, or record a place with surfaces of different brightness"));
        };
        let mut refinement = Refinement {
            camera: self.name.to_owned(),
            components: components(&usable, &start, &found, &sigma),
            score: [&start, &found.camera_from_rig].map(|p| mutual_information(&usable, p)),
            edges_turn_rad: None,
            edge: None,
            overlays: self.overlays(&start, &found.camera_from_rig)?,
            sentence: String::new(),
        };
        self.judge(&mut refinement, &views, &found, &sigma);
        Ok(refinement)
    }

    fn silent(&self, why: &str) -> Refinement {
        Refinement {
            camera: self.name.to_owned(),
            components: Vec::new(),
            score: [0.0; 2],
            edges_turn_rad: None,
            edge: None,
            overlays: None,
            sentence: why.to_owned(),
        }
    }

    fn overlays(&self, before: &Se3, after: &Se3) -> Result<Option<[Overlay; 2]>, Error> {
        let drawn = |pose: &Se3| {
            overlay(
                self.name,
                self.mounted,
                pose,
                self.seen,
                self.scans,
                self.gyro,
            )
        };
        Ok(drawn(before)?.zip(drawn(after)?).map(|(a, b)| [a, b]))
    }

    /// What is said of it, and whether it is given out.
    fn judge(
        &self,
        refinement: &mut Refinement,
        views: &[View],
        found: &Found,
        sigma: &Vector6<f64>,
    ) {
        let undetermined: Vec<String> = refinement
            .components
            .iter()
            .filter(|c| c.change.is_none())
            .map(Component::in_words)
            .collect();
        if (0..3).any(|k| !found.free.contains(&k)) {
            refinement.sentence = format!(
                "not determined: {}; record a place with surfaces of different brightness, all around",
                undetermined.join(", ")
            );
            return;
        }
        // Edges start from what was found: they should not want to go elsewhere.
        if let Some(edges) = misalignment(views, &found.camera_from_rig, Score::Edges) {
            let (apart, spread) = (edges.turn.norm(), edges.sigma_rad.norm());
            refinement.edges_turn_rad = Some([apart, spread]);
            let chance = (spread.powi(2) + sigma.fixed_rows::<3>(0).norm_squared()).sqrt();
            if spread < EDGES_SIGMA_RAD && apart > MOST_DIFFERENCE * chance {
                refinement.sentence = format!(
                    "brightness and edges differ by {:.2}°: look at the overlays",
                    apart.to_degrees()
                );
                return;
            }
        }
        let lost = if undetermined.is_empty() {
            String::new()
        } else {
            format!(
                "; as it was, since not determined: {}",
                undetermined.join(", ")
            )
        };
        refinement.sentence = format!("{}{lost}", refinement.change_in_words(sigma));
        refinement.edge = Some(self.edge(found, sigma));
    }

    /// The transform for the joint graph.
    fn edge(&self, found: &Found, sigma: &Vector6<f64>) -> TransformEdge {
        let camera_from_lidar = found.camera_from_rig * *self.rig_from_lidar;
        let mut covariance = found.covariance;
        for k in 0..6 {
            // Correlations stay as they are; what is added is each number's own. An angle that is not determined is not given.
            let least = if found.free.contains(&k) {
                sigma[k]
            } else {
                0.0
            };
            covariance[(k, k)] = covariance[(k, k)].max(least * least);
        }
        // The change is in the camera's axes; covariances of edges are in those of the LiDAR.
        let through = camera_from_lidar.inverse().adjoint();
        let covariance: Matrix6<f64> = through * covariance * through.transpose();
        TransformEdge {
            target: self.name.to_owned(),
            source: crate::joint::LIDAR.to_owned(),
            target_from_source: camera_from_lidar,
            covariance: Some(0.5 * (covariance + covariance.transpose())),
        }
    }
}

/// The pose in what the views determine, and standard deviations of all six numbers: of those that are not determined, what
/// they would be had they been found.
fn determined(views: &[&View], start: &Se3) -> Option<(Found, Vector6<f64>)> {
    let steps = Steps::of(views, start)?;
    let turned = turned_best(views, start);
    let all = maximum(views, &turned, &steps, &[0, 1, 2, 3, 4, 5])?;
    let own = |found: &Found, k: usize| found.covariance[(k, k)].sqrt().max(LEAST_SIGMA[k / 3]);
    let sigma = Vector6::from_fn(|k, _| own(&all, k));
    let good = |k: usize| sigma[k] <= LARGEST_SIGMA[k / 3];
    if (0..6).all(good) {
        return Some((all, sigma));
    }
    // Translations first: without them rotations are known better.
    let mut free: Vec<usize> = (0..6).filter(|k| *k < 3 || good(*k)).collect();
    let mut found = maximum(views, &turned, &steps, &free)?;
    let bad = |found: &Found, free: &[usize]| -> Vec<usize> {
        let far = |k: &usize| own(found, *k) > LARGEST_SIGMA[*k / 3];
        free.iter().copied().filter(far).collect()
    };
    let worse = bad(&found, &free);
    if !worse.is_empty() {
        free.retain(|k| !worse.contains(k));
        if free.is_empty() {
            return None;
        }
        found = maximum(views, &turned, &steps, &free)?;
    }
    // What was held is wrong by as much as hands measure, and what was found follows it.
    let mut held = Matrix6::zeros();
    for k in (3..6).filter(|k| !found.free.contains(k)) {
        held[(k, k)] = BY_HAND_M * BY_HAND_M;
    }
    let follow = following(views, &found, &steps)? + Matrix6::identity();
    found.covariance += follow * held * follow.transpose();
    let sigma = Vector6::from_fn(|k, _| {
        if found.free.contains(&k) {
            own(&found, k)
        } else {
            sigma[k].max(found.covariance[(k, k)].sqrt())
        }
    });
    Some((found, sigma))
}

fn components(views: &[&View], start: &Se3, found: &Found, sigma: &Vector6<f64>) -> Vec<Component> {
    let change = (found.camera_from_rig * start.inverse()).log();
    let reach = std::array::from_fn(|k| PROFILE[k / 3]);
    profiles(views, &found.camera_from_rig, &reach)
        .into_iter()
        .enumerate()
        .map(|(k, profile)| Component {
            name: NAMES[k],
            change: found.free.contains(&k).then(|| change[k]),
            sigma: Some(sigma[k]).filter(|s| s.is_finite()),
            profile,
        })
        .collect()
}

impl Component {
    /// Whether it is an angle.
    pub fn is_angle(&self) -> bool {
        self.name.starts_with("rotation")
    }

    /// A value of it in degrees or millimetres.
    pub(super) fn shown(&self, value: f64) -> f64 {
        if self.is_angle() {
            value.to_degrees()
        } else {
            value * 1e3
        }
    }

    pub(super) fn unit(&self) -> &'static str {
        if self.is_angle() { "°" } else { "mm" }
    }

    fn in_words(&self) -> String {
        match self.sigma {
            Some(sigma) => format!("{} (σ {:.1} {})", self.name, self.shown(sigma), self.unit()),
            None => format!("{} (σ unknown)", self.name),
        }
    }
}

impl Refinement {
    fn change_in_words(&self, sigma: &Vector6<f64>) -> String {
        let size = |angles: bool| {
            let own = self.components.iter().filter(|c| c.is_angle() == angles);
            own.filter_map(|c| Some(c.change?.powi(2)))
                .sum::<f64>()
                .sqrt()
        };
        let spread = |from: usize| {
            let own = (from..from + 3).filter(|k| self.components[*k].change.is_some());
            own.map(|k| sigma[k].powi(2)).sum::<f64>().sqrt()
        };
        let turned = format!(
            "turned by {:.2}° ± {:.2}°",
            size(true).to_degrees(),
            spread(0).to_degrees()
        );
        if self.components[3..].iter().all(|c| c.change.is_none()) {
            return turned;
        }
        format!(
            "{turned} and moved by {:.0} ± {:.0} mm",
            size(false) * 1e3,
            spread(3) * 1e3
        )
    }
}
