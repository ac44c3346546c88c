//! Control points in a walk's images, their places, and what they add to Eq. (4).

use std::collections::BTreeMap;
use std::sync::Arc;

use lsfb_geometry::{Rig, Se3, StampedPose, Trajectory, UnitQuaternion, Vector2, Vector3};
use lsfb_solver::{Block, Kernel, Problem};
use nalgebra::DMatrix;

use super::report::{ControlMark, ControlReport, USUAL_FACTOR};
use super::snooping::{Off, Surveyed, scale_of_survey, snoop};
use super::{Control, ControlConfig, FEWEST, SHARE_OF_FEW, TELLING};
use crate::Error;
use crate::bending::Between;
use crate::features::triangulation::{TriangulatedPoint, View};
use crate::hd_map::{
    Click, FAR_CLICK_SIGMAS, SAME_MOMENT_NS, SiteFrame, UnplacedMark, meet_of_clicks,
};
use crate::residuals::{BetweenReprojection, ObservingCamera, Reprojection, SurveyedPoint};

/// The vertical of a walk is known to a fraction of a degree: a site's frame that leans more against it has no z upwards.
const MAX_TILT_DEG: f64 = 3.0;
/// Survey errors beyond so many standard deviations pull no harder.
const SURVEY_SCALE: f64 = 3.0;
/// As for other reprojections.
const CLICK_SCALE: f64 = 2.0;

/// Where the image of a click was taken.
#[derive(Clone, Copy, Debug)]
enum Taken {
    /// At a keyframe.
    At(usize),
    /// Between two of them.
    Between(Between),
}

/// A click whose image has a pose.
#[derive(Clone, Debug)]
struct Sight<'a> {
    camera: &'a str,
    pixel: Vector2<f64>,
    taken: Taken,
}

impl Sight<'_> {
    fn pose(&self, keyframes: &[StampedPose]) -> Option<Se3> {
        match &self.taken {
            Taken::At(k) => keyframes.get(*k).map(|k| k.world_from_rig),
            Taken::Between(between) => between.pose(keyframes),
        }
    }
}

/// Control points and the clicks on them, in the images of a walk.
pub(in crate::mapping) struct Marks<'a> {
    control: &'a Control,
    /// Of each control point.
    sights: Vec<Vec<Sight<'a>>>,
    clicks_without_pose: u64,
    /// Their middle: large coordinates and their turns do not go together.
    centre_m: Vector3<f64>,
}

/// The marks where the clicks have them.
pub(in crate::mapping) struct Placed {
    /// Of each control point, or why it has no place.
    found: Vec<Result<TriangulatedPoint, String>>,
    /// How well was clicked.
    sigma_px: f64,
}

/// The control points that hold a map, and how it lies in their site.
#[derive(Clone, Debug)]
pub(in crate::mapping) struct Hold {
    /// The site's frame with its origin in the middle of the control points.
    pub centred_from_world: Se3,
    /// Their numbers.
    pub marks: Vec<usize>,
    /// By how much the map is worse known than it says: they weigh so much more.
    pub map_factor: f64,
}

/// What control points add to Eq. (4).
pub(in crate::mapping) struct ControlTerms<'a> {
    marks: Vec<MarkTerms<'a>>,
    /// Where the map lies in the site; `None` where the marks are placed alone.
    centred_from_world: Option<Se3>,
    sigma_px: f64,
    /// By how much all standard deviations of control points are less, and their kernels farther: all else is so much worse known.
    map_factor: f64,
}

struct MarkTerms<'a> {
    number: usize,
    place: Vector3<f64>,
    sights: Vec<Sight<'a>>,
    surveyed: SurveyedPoint,
}

/// Unknowns that control points bring.
pub(in crate::mapping) struct ControlBlocks {
    pub site: Option<Block<Se3>>,
    /// In the order of the terms.
    pub marks: Vec<Block<Vector3<f64>>>,
}

/// Where Eq. (4) has the marks.
pub(in crate::mapping) struct SolvedControl {
    pub centred_from_world: Se3,
    /// By number.
    pub places: BTreeMap<usize, Vector3<f64>>,
}

impl<'a> Marks<'a> {
    /// `keyframes` are those of the trajectory, as the start has both.
    pub fn find(
        control: &'a Control,
        rig: &Rig,
        trajectory: &Trajectory,
        keyframes: &[StampedPose],
    ) -> Self {
        let mut clicks_without_pose = 0;
        let sights = control.points.iter().map(|point| {
            let own: Vec<&Click> = control
                .clicks
                .iter()
                .filter(|c| c.mark == point.mark)
                .collect();
            let found = own
                .iter()
                .filter_map(|c| sight(c, rig, trajectory, keyframes));
            let found: Vec<Sight> = found.collect();
            clicks_without_pose += (own.len() - found.len()) as u64;
            found
        });
        let sights = sights.collect();
        let sum = control
            .points
            .iter()
            .map(|p| p.place_m)
            .sum::<Vector3<f64>>();
        Self {
            control,
            sights,
            clicks_without_pose,
            centre_m: sum / control.points.len().max(1) as f64,
        }
    }

    /// Places them with the keyframes where they are.
    pub fn place(&self, rig: &Rig, keyframes: &[StampedPose], config: &ControlConfig) -> Placed {
        let far_px = FAR_CLICK_SIGMAS * config.click_sigma_px;
        let found = self.sights.iter().map(|sights| {
            let views = sights.iter().filter_map(|sight| {
                let mounted = rig.cameras.get(sight.camera)?;
                Some(View {
                    camera: &mounted.camera,
                    world_from_camera: sight.pose(keyframes)? * mounted.rig_from_camera,
                    pixel: sight.pixel,
                })
            });
            meet_of_clicks(&views.collect::<Vec<_>>(), far_px)
        });
        let found: Vec<_> = found.collect();
        // Two numbers a click, three are spent on the place of a mark.
        let sums = found
            .iter()
            .flatten()
            .fold((0.0, 0), |(squares, spare), point| {
                let clicks = point.inliers.len();
                let own = point.reprojection_rms_px.powi(2) * clicks as f64;
                (squares + own, spare + 2 * clicks - 3)
            });
        let scatter_px = (sums.0 / f64::max(sums.1 as f64, 1.0)).sqrt();
        Placed {
            found,
            sigma_px: scatter_px.max(config.click_sigma_px),
        }
    }

    /// Of those that hold, or to place all of them. `None` where too few have a place now.
    pub fn terms(&self, placed: &Placed, hold: Option<&Hold>) -> Option<ControlTerms<'a>> {
        let map_factor = hold.map_or(1.0, |hold| hold.map_factor);
        let is_wanted = |number: usize| hold.is_none_or(|hold| hold.marks.contains(&number));
        let found = placed.found.iter().enumerate();
        let marks = found.filter(|(number, _)| is_wanted(*number));
        let marks = marks.filter_map(|(number, found)| {
            let found = found.as_ref().ok()?;
            let own = &self.sights[number];
            Some(MarkTerms {
                number,
                place: found.point_in_world,
                sights: found.inliers.iter().map(|k| own[*k].clone()).collect(),
                surveyed: SurveyedPoint {
                    place_in_site: self.centred(number),
                    sigmas_m: self.control.points[number].sigmas_m / map_factor,
                },
            })
        });
        let marks: Vec<MarkTerms> = marks.collect();
        (marks.len() >= FEWEST).then(|| ControlTerms {
            marks,
            centred_from_world: hold.map(|hold| hold.centred_from_world),
            sigma_px: placed.sigma_px / map_factor,
            map_factor,
        })
    }

    fn centred(&self, number: usize) -> Vector3<f64> {
        self.control.points[number].place_m - self.centre_m
    }

    /// Which of the marks hold the map, from their places and the covariance of these (`None` where it is unknown), in the order of the terms; and what is to be
    /// said of it.
    pub fn decide(
        &self,
        placed: &Placed,
        covariance_m2: Option<&DMatrix<f64>>,
        config: &ControlConfig,
    ) -> (Option<Hold>, ControlReport) {
        let names = || self.control.points.iter().map(|p| &p.mark);
        let mut report = ControlReport {
            clicks_without_pose: self.clicks_without_pose,
            click_sigma_px: placed.sigma_px,
            unplaced: names()
                .zip(&placed.found)
                .filter_map(|(name, found)| {
                    Some(UnplacedMark {
                        name: name.clone(),
                        reason: found.as_ref().err()?.clone(),
                    })
                })
                .collect(),
            ..ControlReport::default()
        };
        let numbers: Vec<usize> = (0..placed.found.len())
            .filter(|k| placed.found[*k].is_ok())
            .collect();
        let points = placed.found.iter().flatten();
        let surveyed: Vec<Surveyed> = numbers
            .iter()
            .zip(points)
            .map(|(number, found)| Surveyed {
                in_world: found.point_in_world,
                in_site: self.centred(*number),
                sigmas_m: self.control.points[*number].sigmas_m,
            })
            .collect();
        if surveyed.len() < FEWEST {
            report.reason = format!(
                "{} of them could be placed in the map, but {FEWEST} are needed",
                surveyed.len()
            );
            return (None, report);
        }
        let Some(covariance_m2) = covariance_m2 else {
            report.reason =
                "images and scans do not determine the map, so that blunders would not be noticed"
                    .to_owned();
            return (None, report);
        };
        let Some(snooped) = snoop(&surveyed, covariance_m2, config.blunder_sigmas) else {
            report.reason = "those that could be placed in the map lie on one line, about which it could rotate".to_owned();
            return (None, report);
        };
        for (k, (number, mark)) in numbers.iter().zip(&surveyed).enumerate() {
            let point = &self.control.points[*number];
            let in_site = snooped.site_from_world * mark.in_world;
            let Off {
                metres,
                worst_sigma_m,
                sigmas,
            } = snooped.off[k].unwrap_or(Off {
                metres: Vector3::zeros(),
                worst_sigma_m: f64::INFINITY,
                sigmas: 0.0,
            });
            let agreeing = placed.found[*number]
                .as_ref()
                .map_or(0, |f| f.inliers.len());
            report.marks.push(ControlMark {
                name: point.mark.clone(),
                surveyed_m: point.place_m.into(),
                map_m: (in_site + self.centre_m).into(),
                clicks: agreeing as u64,
                clicks_left_out: (self.sights[*number].len() - agreeing) as u64,
                from_others_m: metres.into(),
                from_others_sigma_m: worst_sigma_m.is_finite().then_some(worst_sigma_m),
                from_others_sigmas: sigmas,
                holds: snooped.holding.contains(&k),
                before_m: (in_site - mark.in_site).norm(),
                after_m: (in_site - mark.in_site).norm(),
            });
        }
        report.map_factor = snooped.map_factor * snooped.sigma0.max(1.0);
        let share = if snooped.holding.len() < TELLING {
            SHARE_OF_FEW
        } else {
            1.0
        };
        let most = (share * config.max_map_factor).max(1.0);
        // Few marks always come nearer by another size.
        if report.map_factor > USUAL_FACTOR && surveyed.len() > FEWEST {
            report.scale = scale_of_survey(&surveyed);
        }
        report.tilt_deg = tilt_deg(&snooped.site_from_world.rotation);
        let held = snooped.holding.len();
        if report.tilt_deg > MAX_TILT_DEG {
            report.reason = format!(
                "their z axis leans by {:.1}° from the vertical: are two of their axes swapped, or is one of them reversed?",
                report.tilt_deg
            );
        } else if report.map_factor > most {
            report.reason = format!(
                "even the {held} that agree best differ from the map by {:.1} times their combined standard deviations ({most} at most): the problem is not a few bad marks; check units, axes and frame",
                report.map_factor
            );
        } else {
            report.holds = true;
        }
        let hold = report.holds.then(|| Hold {
            centred_from_world: snooped.site_from_world,
            marks: snooped.holding.iter().map(|k| numbers[*k]).collect(),
            map_factor: snooped.map_factor,
        });
        (hold, report)
    }

    /// Brings what is said of the marks up to where Eq. (4) has the map now.
    pub fn say_after(&self, report: &mut ControlReport, placed: &Placed, solved: &SolvedControl) {
        report.click_sigma_px = placed.sigma_px;
        for (number, point) in self.control.points.iter().enumerate() {
            let own = report.marks.iter_mut().find(|mark| mark.name == point.mark);
            let found = placed.found[number].as_ref().ok();
            let place = solved.places.get(&number).copied();
            let place = place.or(found.map(|found| found.point_in_world));
            let (Some(mark), Some(place)) = (own, place) else {
                continue;
            };
            if let Some(found) = found {
                mark.clicks = found.inliers.len() as u64;
                mark.clicks_left_out = (self.sights[number].len() - found.inliers.len()) as u64;
            }
            let in_site = solved.centred_from_world * place;
            mark.map_m = (in_site + self.centre_m).into();
            mark.after_m = (in_site - self.centred(number)).norm();
        }
        report.tilt_deg = tilt_deg(&solved.centred_from_world.rotation);
    }

    /// The site's frame, and where the map's world lies in it (in what is left of it when its origin is taken off).
    pub fn site(&self, hold: &Hold) -> (SiteFrame, Se3) {
        let origin_m = self.control.origin_m;
        let shift = Se3::new(UnitQuaternion::identity(), self.centre_m - origin_m);
        let names = hold
            .marks
            .iter()
            .map(|k| self.control.points[*k].mark.clone());
        let site = SiteFrame {
            origin_m: origin_m.into(),
            control_points: names.collect(),
        };
        (site, shift * hold.centred_from_world)
    }
}

fn tilt_deg(turn: &UnitQuaternion<f64>) -> f64 {
    (turn * Vector3::z()).angle(&Vector3::z()).to_degrees()
}

fn sight<'a>(
    click: &'a Click,
    rig: &Rig,
    trajectory: &Trajectory,
    keyframes: &[StampedPose],
) -> Option<Sight<'a>> {
    let mounted = rig.cameras.get(&click.camera)?;
    let time = click.time + (mounted.timing.rig_from_camera_s * 1e9).round() as i64;
    let after = keyframes.partition_point(|k| k.time < time);
    let around = [after.checked_sub(1), Some(after)].into_iter().flatten();
    let same = |k: &usize| {
        let keyframe = keyframes.get(*k);
        keyframe.is_some_and(|k| (k.time - time).abs() < SAME_MOMENT_NS)
    };
    let taken = match around.clone().find(same) {
        Some(k) => Taken::At(k),
        None => {
            let pose = StampedPose {
                time,
                world_from_rig: trajectory.at(time)?,
            };
            Taken::Between(Between::of(&pose, keyframes)?)
        }
    };
    Some(Sight {
        camera: &click.camera,
        pixel: click.pixel,
        taken,
    })
}

/// Adds the marks, what was clicked and, where they hold the map, what was surveyed.
pub(in crate::mapping) fn add_control(
    problem: &mut Problem,
    observing: &BTreeMap<&str, Arc<ObservingCamera>>,
    poses: &[Block<Se3>],
    terms: &ControlTerms,
) -> Result<ControlBlocks, Error> {
    let kernel = |scale: f64| Kernel::Huber {
        scale: scale * terms.map_factor,
    };
    let (of_clicks, of_survey) = (kernel(CLICK_SCALE), kernel(SURVEY_SCALE));
    let site = terms.centred_from_world.map(|site| problem.add_block(site));
    let mut marks = Vec::new();
    for mark in &terms.marks {
        let block = problem.add_block(mark.place);
        for sight in &mark.sights {
            let Some(camera) = observing.get(sight.camera) else {
                continue;
            };
            match sight.taken {
                Taken::At(k) => {
                    let residual = Reprojection {
                        camera: camera.clone(),
                        pixel: sight.pixel,
                        sigma_px: terms.sigma_px,
                    };
                    problem.add_residual(residual, &[poses[k].id(), block.id()], of_clicks)?;
                }
                Taken::Between(between) => {
                    let residual = BetweenReprojection {
                        camera: camera.clone(),
                        image_in_keyframes: between.in_ends,
                        fraction: between.fraction,
                        pixel: sight.pixel,
                        sigma_px: terms.sigma_px,
                    };
                    let [a, b] = between.ends.map(|k| poses[k].id());
                    problem.add_residual(residual, &[a, b, block.id()], of_clicks)?;
                }
            }
        }
        if let Some(site) = site {
            problem.add_residual(mark.surveyed, &[site.id(), block.id()], of_survey)?;
        }
        marks.push(block);
    }
    Ok(ControlBlocks { site, marks })
}

impl ControlBlocks {
    /// Where the marks are, and how the map lies in the site; `None` where they only were placed.
    pub fn solved(&self, problem: &Problem, terms: &ControlTerms) -> Option<SolvedControl> {
        let numbers = terms.marks.iter().map(|mark| mark.number);
        let places = self.marks.iter().map(|block| problem.value(*block));
        Some(SolvedControl {
            centred_from_world: problem.value(self.site?),
            places: numbers.zip(places).collect(),
        })
    }
}
