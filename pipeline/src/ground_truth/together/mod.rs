//! Several walks through one map, solved as one.
//!
//! Each is solved, and judged, by itself first. What two of them see is one point then, and eq. (5) of all walks one problem: points of the
//! map that two walks use are free, with what the map says of them known beforehand, so that what the map has wrong there moves both alike;
//! and local points of one walk are joined with those of another where images that were taken from nearly the same place show the same. How
//! the devices lie to each other is known better so than by the map alone. A pose is not called surer for it.

mod common_points;

use std::collections::{BTreeMap, BTreeSet};

use lsfb_geometry::{Matrix6, Trajectory, Vector3};
use lsfb_solver::{Block, Kernel, Problem};
use lsfb_types::{ProgressFn, Timestamp};

use super::optimization::{Part, SharedPoints, WalkBlocks, choose_observations};
use super::report::Together;
use super::settling::is_few;
use super::uncertainty::{Deviations, map_point_prior};
use super::walk::{FixedObservation, Walk};
use super::{GroundTruthConfig, Solved};
use crate::Error;
use crate::features::Features;
use crate::solve::solve_until_converged;
use common_points::{CommonPoint, common_points};

/// Rounds at most in which observations come and go.
const ROUNDS: usize = 4;

/// One of the walks.
pub(super) struct Member<'a> {
    pub walk: &'a mut Walk,
    /// Numbered `frame * cameras + camera`.
    pub features: &'a [Features],
    /// What it is by itself, and then with the others.
    pub solved: &'a mut Solved,
    /// What is given of it by itself.
    pub given: &'a Trajectory,
    /// Of the given poses.
    pub covariances: &'a [Matrix6<f64>],
}

impl Member<'_> {
    /// Points of the map that given frames use.
    fn map_points(&self) -> BTreeSet<u32> {
        self.given_sights().map(|(_, seen)| seen.point).collect()
    }

    /// Sights of the map in frames that are given, with the number of the frame: what is left out is right in no other walk.
    fn given_sights(&self) -> impl Iterator<Item = (usize, &FixedObservation)> {
        let frames = self.walk.frames.iter().enumerate();
        let given = frames.filter(|(_, frame)| self.is_given(frame.time));
        given.flat_map(|(k, frame)| frame.fixed.iter().map(move |seen| (k, seen)))
    }

    fn is_given(&self, time: Timestamp) -> bool {
        let given = self.given.poses();
        given.binary_search_by_key(&time, |p| p.time).is_ok()
    }
}

/// Solves all of them as one problem; returns what that did to each.
pub(super) fn solve_together(
    members: &mut [Member<'_>],
    config: &GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<Vec<Together>, Error> {
    let mut common = common_points(members, config, progress)?;
    let mut of_map = common_map_points(members);
    // What comes and goes in the first round is little; that points are common is new.
    for round in 1..=ROUNDS {
        if common.is_empty() && of_map.is_empty() {
            break;
        }
        solve_once(
            members,
            &of_map,
            &common,
            GroundTruthConfig::roughly,
            progress,
        )?;
        let changed = members.iter_mut().map(|m| {
            let last = &mut m.solved.last;
            let changed = choose_observations(m.walk, &last.estimate, &mut last.points, config);
            is_few(changed, last)
        });
        // All of them are looked at.
        let is_settled = changed.fold(true, |all, few| all & few);
        common.retain(|point| point.is_seen_by_two(members));
        of_map = common_map_points(members);
        if is_settled || round == ROUNDS {
            solve_once(
                members,
                &of_map,
                &common,
                GroundTruthConfig::clone,
                progress,
            )?;
            break;
        }
    }
    let numbers = 0..members.len();
    let said = numbers.map(|k| said_of(k, members, &of_map, &common));
    Ok(said.collect())
}

fn solve_once(
    members: &mut [Member<'_>],
    of_map: &BTreeSet<u32>,
    common: &[CommonPoint],
    settings: impl Fn(&GroundTruthConfig) -> GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<(), Error> {
    let mut problem = Problem::new();
    let of_map = map_points(members, of_map, &mut problem)?;
    let of_member = |member: &Member<'_>| SharedPoints {
        frames: member
            .walk
            .frames
            .iter()
            .map(|frame| member.is_given(frame.time))
            .collect(),
        of_map: of_map.clone(),
        local: BTreeMap::new(),
    };
    let mut shared: Vec<SharedPoints> = members.iter().map(of_member).collect();
    for point in common {
        let block = problem.add_eliminated_point(point.position(members));
        for (member, own) in &point.own {
            shared[*member].local.insert(*own, block);
        }
    }
    let mut all_blocks: Vec<WalkBlocks> = Vec::with_capacity(members.len());
    let mut solve = None;
    for (member, shared) in members.iter().zip(&shared) {
        let used = settings(&member.solved.config);
        let last = &member.solved.last;
        let part = Part {
            walk: member.walk,
            before: &last.estimate,
            points: &last.points,
            anchor: None,
            config: &used,
            shared,
        };
        all_blocks.push(part.add(&mut problem)?);
        solve.get_or_insert(used.solve);
    }
    let config = solve.unwrap_or_default();
    let report = solve_until_converged("walks together", &mut problem, &config, progress)?;
    for (member, blocks) in members.iter_mut().zip(all_blocks) {
        let last = &mut member.solved.last;
        *last = blocks.read(&problem, member.walk, &last.points, report.clone());
    }
    Ok(())
}

/// Points of the map that several walks use.
fn common_map_points(members: &[Member<'_>]) -> BTreeSet<u32> {
    let mut walks: BTreeMap<u32, usize> = BTreeMap::new();
    for number in members.iter().flat_map(Member::map_points) {
        *walks.entry(number).or_default() += 1;
    }
    let common = walks.into_iter().filter(|(_, count)| *count >= 2);
    common.map(|(number, _)| number).collect()
}

/// These points, free, with what the map says of them known beforehand, and that walk which shows best where each is.
fn map_points(
    members: &[Member<'_>],
    of_map: &BTreeSet<u32>,
    problem: &mut Problem,
) -> Result<BTreeMap<u32, Block<Vector3<f64>>>, Error> {
    let mut best: BTreeMap<u32, (f64, &Walk, &FixedObservation)> = BTreeMap::new();
    for member in members {
        let last = &member.solved.last;
        let shown = Deviations::of(member.walk, &last.estimate, &last.points);
        for (k, seen) in member.given_sights() {
            if !of_map.contains(&seen.point) {
                continue;
            }
            let shown_m = shown.of_map_point_m(&last.estimate, k, seen);
            let known = best
                .entry(seen.point)
                .or_insert((shown_m, member.walk, seen));
            if shown_m < known.0 {
                *known = (shown_m, member.walk, seen);
            }
        }
    }
    let mut blocks = BTreeMap::new();
    for (number, (shown_m, walk, seen)) in best {
        let block = problem.add_eliminated_point(seen.point_in_world);
        let prior = map_point_prior(walk, seen, shown_m);
        problem.add_residual(prior, &[block.id()], Kernel::Squared)?;
        blocks.insert(number, block);
    }
    Ok(blocks)
}

/// How far others moved a walk.
fn said_of(
    number: usize,
    members: &[Member<'_>],
    of_map: &BTreeSet<u32>,
    common: &[CommonPoint],
) -> Together {
    let member = &members[number];
    let estimate = &member.solved.last.estimate;
    let mut said = Together {
        others: members.len() as u64 - 1,
        map_points: member
            .map_points()
            .iter()
            .filter(|p| of_map.contains(p))
            .count() as u64,
        common_points: common
            .iter()
            .filter(|c| c.own.contains_key(&number))
            .count() as u64,
        ..Together::default()
    };
    let given = member.given.poses().iter();
    for (pose, covariance) in given.zip(member.covariances) {
        let frames = &member.walk.frames;
        let Ok(k) = frames.binary_search_by_key(&pose.time, |f| f.time) else {
            continue;
        };
        let moved = pose.world_from_rig.local(estimate.pose(k));
        said.moved_m = said.moved_m.max(moved.fixed_rows::<3>(3).norm());
        let squared = covariance.cholesky().map(|c| moved.dot(&c.solve(&moved)));
        let sigmas = squared.map_or(f64::INFINITY, |s| (s / CHI_SQUARED_95).sqrt());
        said.moved_sigmas = said.moved_sigmas.max(sigmas);
    }
    said
}

/// 95 % of squared norms of six standard normal numbers are below this.
const CHI_SQUARED_95: f64 = 12.591_587;
