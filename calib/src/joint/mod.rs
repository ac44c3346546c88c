//! The joint pose graph of all sensors, Eq. 3.
//!
//! Over the poses `I_T_Ci` of all cameras and `I_T_L` of the LiDAR, in the IMU:
//!
//! `Σᵢ ‖log(I_T_Ci ∘ I_T̂_Ci⁻¹)‖²_ΣC + Σᵢ ‖log(I_T_Ci⁻¹ ∘ I_T_L ∘ Ci_T̂_L⁻¹)‖²_ΣL`
//!
//! Both are one residual, `log(I_T_A⁻¹ ∘ I_T_B ∘ A_T̂_B⁻¹)`, with A the IMU itself in the first sum; so transforms between two
//! cameras can join. Where an edge carries a measured covariance, that takes the place of ΣC or ΣL.

mod consistency;
mod edge_residual;
mod page;
mod swapped;

use std::collections::BTreeMap;

use lsfb_geometry::{CameraSigmas, Matrix6, Rig, Se3};
use lsfb_solver::{
    Block, BlockId, Kernel, Problem, SolveConfig, covariance, solve_until_converged,
};
use lsfb_types::{Bounds, Finding, Verdict};
use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

pub use crate::transform::{IMU, LIDAR};
use crate::{Error, JoinProblem, TransformEdge};
use edge_residual::GraphEdge;

/// Where covariances come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Weights {
    /// Those that edges carry; ΣC and ΣL for others.
    #[default]
    Measured,
    /// ΣC and ΣL for all, as in the paper.
    Paper,
}

/// Settings of [`join_transforms`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct JointConfig {
    /// Where covariances come from.
    pub weights: Weights,
    /// Diagonal of ΣC: rotation (rad²), translation (m²), in the target's axes. For edges without the LiDAR.
    pub camera_variance: [f64; 6],
    /// Diagonal of ΣL: rotation (rad²), translation (m²), in the camera's axes. For edges to the LiDAR.
    pub lidar_variance: [f64; 6],
}

impl Default for JointConfig {
    fn default() -> Self {
        Self {
            weights: Weights::Measured,
            camera_variance: [0.01, 0.01, 0.01, 0.03, 0.03, 0.03],
            lidar_variance: [0.01, 0.01, 0.01, 0.03, 0.03, 0.15],
        }
    }
}

lsfb_types::bounds! {
    JointConfig {
        weights: any,
        camera_variance: each(Bounds::POSITIVE),
        lidar_variance: each(Bounds::POSITIVE),
    }
}

/// A sensor's pose in the IMU.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SensorPose {
    /// Name of the sensor.
    pub name: String,
    /// The pose.
    #[serde(skip)]
    pub imu_from_sensor: Se3,
    /// Covariance of its tangent, perturbed on the right: in the sensor's axes.
    #[serde(skip)]
    pub covariance: Matrix6<f64>,
    /// Standard deviations, rotation (rad) then translation (m), in the sensor's axes.
    pub sigma: [f64; 6],
}

/// How one edge agrees with all others.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EdgeConsistency {
    /// Sensor that the edge takes points to.
    pub target: String,
    /// Sensor that it takes points from.
    pub source: String,
    /// Whether its covariance was measured.
    pub measured: bool,
    /// Angle between the edge and the path through all others, radians; `None` where there is no other path.
    pub loop_rotation_rad: Option<f64>,
    /// Distance between the same, metres.
    pub loop_translation_m: Option<f64>,
    /// Squared disagreement over its expected variance; mean six where all is as expected.
    pub chi_square: Option<f64>,
    /// Whether this is more than accident explains.
    pub outlier: bool,
    /// How it came out, as the finding about it says.
    #[serde(skip)]
    pub verdict: Verdict,
}

/// All sensors in one frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JointCalibration {
    /// By name.
    pub sensors: Vec<SensorPose>,
    /// By names of their ends.
    pub edges: Vec<EdgeConsistency>,
    /// Half the weighted squares of all edges.
    pub cost: f64,
    /// Numbers measured beyond those needed.
    pub redundancy: usize,
    /// Squares over redundancy: 1 where covariances are right. Covariances of the poses are multiplied by it where weights
    /// are relative (any edge without a measured covariance) or where it speaks of more noise than was said; and, since it is
    /// itself known from few numbers only, by what makes their 95 % regions hold 95 % (Fisher's F over chi-square).
    pub variance_factor: f64,
    /// What was looked at, and how it came out.
    #[serde(skip)]
    pub findings: Vec<Finding>,
}

/// Finds the poses that agree best with all edges. The order of edges does not matter.
pub fn join_transforms(
    edges: &[TransformEdge],
    config: &JointConfig,
) -> Result<JointCalibration, Error> {
    config.check_bounds("joint")?;
    let mut graph: Vec<GraphEdge> = edges
        .iter()
        .map(|edge| GraphEdge::new(edge, config))
        .collect::<Result<_, _>>()?;
    graph.sort_by(|a, b| a.ends().cmp(&b.ends()).then(a.order(b)));
    given_once(&graph)?;
    let Adjusted {
        problem,
        blocks,
        cost,
    } = adjust(&graph)?;
    let names: Vec<&str> = blocks
        .keys()
        .map(String::as_str)
        .filter(|n| *n != IMU)
        .collect();
    let ids: Vec<BlockId> = names.iter().map(|n| blocks[*n].id()).collect();
    let joint: DMatrix<f64> = covariance(&problem, &ids)?.joint().clone();

    let redundancy = 6 * (graph.len() - names.len());
    let chi_square = 2.0 * cost;
    let factor = if redundancy > 0 {
        chi_square / redundancy as f64
    } else {
        1.0
    };
    let relative = graph.iter().any(|e| !e.measured);
    // More noise than was said counts; less by accident does not make the result better.
    let applied = if relative {
        factor * consistency::widening(redundancy)
    } else {
        consistency::significant_factor(factor, redundancy)
    };
    let poses: BTreeMap<&str, Se3> = blocks
        .iter()
        .map(|(n, b)| (n.as_str(), problem.value(*b)))
        .collect();
    let mut table = consistency::table(&graph, &names, &poses, &joint);
    let mut findings = consistency::judge(&mut table, &graph, chi_square, redundancy, relative);
    if table.iter().any(|e| e.outlier) {
        findings.splice(0..0, swapped::swapped(&graph, &names, cost)?);
    }
    let sensors = names
        .iter()
        .enumerate()
        .map(|(k, name)| {
            let covariance: Matrix6<f64> =
                joint.fixed_view::<6, 6>(6 * k, 6 * k).into_owned() * applied;
            SensorPose {
                name: (*name).to_owned(),
                imu_from_sensor: poses[name],
                covariance,
                sigma: std::array::from_fn(|i| covariance[(i, i)].max(0.0).sqrt()),
            }
        })
        .collect();
    Ok(JointCalibration {
        sensors,
        edges: table,
        cost,
        redundancy,
        variance_factor: factor,
        findings,
    })
}

/// A file that is given twice, or copied, would close a loop with itself and be twice as sure.
fn given_once(graph: &[GraphEdge]) -> Result<(), Error> {
    const SAME: f64 = 1e-12;
    let is_same = |a: &GraphEdge, b: &GraphEdge| {
        a.ends() == b.ends()
            && (a.target_from_source.inverse() * b.target_from_source)
                .log()
                .norm()
                < SAME
    };
    let repeated = graph
        .iter()
        .enumerate()
        .find(|(k, edge)| graph[..*k].iter().any(|e| is_same(e, edge)));
    match repeated {
        None => Ok(()),
        Some((_, edge)) => Err(Error::NotJoined {
            first: edge.target.clone(),
            second: edge.source.clone(),
            cause: JoinProblem::GivenTwice,
        }),
    }
}

/// A graph at the least cost.
struct Adjusted {
    problem: Problem,
    blocks: BTreeMap<String, Block<Se3>>,
    cost: f64,
}

fn adjust(graph: &[GraphEdge]) -> Result<Adjusted, Error> {
    let mut problem = Problem::new();
    let mut blocks: BTreeMap<String, Block<Se3>> = BTreeMap::new();
    for (name, pose) in start(graph)? {
        let block = problem.add_block(pose);
        problem.set_name(block.id(), format!("pose of {name}"));
        problem.set_component_names(block.id(), &["roll", "pitch", "yaw", "x", "y", "z"]);
        if name == IMU {
            problem.set_constant(block);
        }
        blocks.insert(name, block);
    }
    for edge in graph {
        let ends = [
            blocks[edge.target.as_str()].id(),
            blocks[edge.source.as_str()].id(),
        ];
        problem.add_residual(edge.residual(), &ends, Kernel::Squared)?;
    }
    let config = SolveConfig {
        max_iterations: 100,
        cost_tolerance: 1e-14,
        ..SolveConfig::default()
    };
    let report = solve_until_converged(&mut problem, &config)?;
    let cost = report.final_cost;
    Ok(Adjusted {
        problem,
        blocks,
        cost,
    })
}

/// Poses along the shortest paths from the IMU.
fn start(graph: &[GraphEdge]) -> Result<BTreeMap<String, Se3>, Error> {
    let mut poses = BTreeMap::from([(IMU.to_owned(), Se3::identity())]);
    loop {
        let mut found = Vec::new();
        for edge in graph {
            match (poses.get(&edge.target), poses.get(&edge.source)) {
                (Some(target), None) => {
                    found.push((edge.source.clone(), *target * edge.target_from_source));
                }
                (None, Some(source)) => {
                    let pose = *source * edge.target_from_source.inverse();
                    found.push((edge.target.clone(), pose));
                }
                _ => {}
            }
        }
        if found.is_empty() {
            break;
        }
        for (name, pose) in found {
            poses.entry(name).or_insert(pose);
        }
    }
    let apart = graph
        .iter()
        .flat_map(|e| [&e.target, &e.source])
        .find(|name| !poses.contains_key(*name));
    match apart {
        Some(name) => Err(Error::NotJoined {
            first: IMU.to_owned(),
            second: name.clone(),
            cause: JoinProblem::NoChain,
        }),
        None if poses.len() < 2 => Err(Error::NotJoined {
            first: IMU.to_owned(),
            second: "any sensor".to_owned(),
            cause: JoinProblem::NoTransform,
        }),
        None => Ok(poses),
    }
}

impl JointCalibration {
    /// Pose of a sensor; `None` where the graph does not have it.
    pub fn sensor(&self, name: &str) -> Option<&SensorPose> {
        self.sensors.iter().find(|s| s.name == name)
    }

    /// The poses put into a rig; lenses, noise and sensors that the graph does not have stay.
    pub fn put_into(&self, rig: &mut Rig) {
        for sensor in &self.sensors {
            if let Some(camera) = rig.cameras.get_mut(&sensor.name) {
                camera.rig_from_camera = sensor.imu_from_sensor;
                let of_pose = CameraSigmas::of_pose(&sensor.covariance);
                camera.sigmas.rotation_rad = of_pose.rotation_rad;
                camera.sigmas.translation_m = of_pose.translation_m;
            } else if sensor.name == LIDAR
                && let Some(lidar) = rig.lidar_mut()
            {
                lidar.rig_from_lidar = sensor.imu_from_sensor;
            }
        }
    }
}
