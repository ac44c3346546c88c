//! Rounds of an update: linearize what is new or no longer true, solve, see what that moved.

use crate::problem::{Problem, ResidualId};
use crate::{Error, IncrementalConfig, UpdateReport};

use super::factor::Factor;
use super::marks::Marks;
use super::models::{Models, Trust};
use super::steps::{Part, Steps};
use super::system::System;

/// A round went wrong if it raises the cost of the residuals that it linearizes anew to more than this many times what it was
/// and one more.
const MOST_RAISE: f64 = 2.0;

/// Groups before the first that an update reached that are moved with it from the first: others wait until it is solved by
/// itself. Before that, forces between what is new do not cancel yet, and would bend everything that hangs together with it.
const MARGIN: usize = 8;

/// While what is new is solved by itself, models may be off by this many times the final limits: what remains is found with
/// everything else. Ten times and more saves more, but forces that do not cancel yet then bend long open chains.
const NEAR_LOOSER: f64 = 5.0;

/// Blocks in more groups than so many before the last are far: where something new reaches them, a loop closes.
const FAR: usize = 100;

/// So many groups at least are moved to the end of the order then: what comes next reaches those beside them.
const MOVED_TOGETHER: usize = 50;

/// One of so many points of a block is looked at before the others, where it has at least twice as many.
const SAMPLED: usize = 16;

/// Residuals that are undefined are tried again in so many rounds of each update.
const ROUNDS_FOR_UNDEFINED: usize = 2;

/// Everything that is kept from update to update.
#[derive(Default)]
pub(super) struct Kept {
    pub steps: Steps,
    pub models: Models,
    pub system: System,
    factor: Factor,
    /// Steps of blocks when all their residuals, and those without points, were linearized last for their turning, when
    /// they were looked at last, and when they were so near what is new or anywhere.
    turned_from: Vec<f64>,
    bare_turned_from: Vec<f64>,
    looked_from: Vec<f64>,
    near_looked_from: Vec<f64>,
    /// Scratch of a round.
    stale: Marks,
    points: Marks,
    blocks: Marks,
    /// Blocks whose points were eliminated anew.
    reached: Marks,
    moved: Marks,
    looked_at: Marks,
    sampled: Vec<usize>,
    /// Blocks that are moved to the end of the order of elimination.
    moving: Marks,
    /// Points that were looked at, and whose models are true.
    true_points: Marks,
    updates: usize,
    /// First group that this update reached, and that its first round did.
    first: usize,
    near_first: usize,
}

impl Kept {
    pub fn new(config: &IncrementalConfig) -> Self {
        Self {
            system: System::new(config.damping),
            ..Self::default()
        }
    }

    /// Writes where a block is.
    pub fn estimate_of(&self, problem: &Problem, block: usize, stored: &mut [f64]) {
        if self.steps.part(block) == Part::Point {
            let step = self.system.point_step(&self.steps, block);
            self.steps.moved_to(problem, block, step.as_slice(), stored);
            return;
        }
        let entry = &problem.blocks[block];
        stored.copy_from_slice(&problem.values[entry.stored()]);
    }

    /// Takes in new residuals and blocks that lost some, and solves. Whether it came to an end.
    pub fn update(
        &mut self,
        problem: &mut Problem,
        config: &IncrementalConfig,
        new: &Marks,
        touched: &Marks,
        report: &mut UpdateReport,
    ) -> Result<bool, Error> {
        self.take_in(problem, new, touched)?;
        let mut is_near = true;
        for round in 1..=config.max_rounds {
            report.rounds += 1;
            report.relinearized_residuals += self.stale.all().len();
            if !self.linearize(problem)? {
                return Ok(false);
            }
            if round == 1 {
                self.touch(touched);
            }
            self.reduce();
            let changed = self.blocks.all();
            let Some(first) = self.factor.update(&self.system, &self.steps, changed) else {
                return Ok(false);
            };
            self.blocks.clear();
            if round == 1 {
                self.near_first = first;
                self.first = first;
            }
            self.first = self.first.min(first);
            report.columns = self.factor.groups();
            report.factored_columns += report.columns - first;
            let trust = Trust {
                change: config.relinearize_above,
                kernel: config.kernel_error_above,
                tries_undefined: round <= ROUNDS_FOR_UNDEFINED,
            };
            if is_near {
                let looser = Trust {
                    change: NEAR_LOOSER * trust.change,
                    kernel: NEAR_LOOSER * trust.kernel,
                    ..trust
                };
                self.solve(problem, config, self.first.saturating_sub(MARGIN));
                self.look(problem, config, true, looser);
                is_near = !self.stale.is_empty();
            }
            if !is_near {
                self.solve(problem, config, 0);
                self.look(problem, config, false, trust);
            }
            if self.stale.is_empty() {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Solves for the steps back to group `last`, as far as anything moves.
    fn solve(&mut self, problem: &mut Problem, config: &IncrementalConfig, last: usize) {
        let groups = (last, self.first);
        let (steps, moved) = (&mut self.steps, &mut self.moved);
        self.factor.solve(
            problem,
            steps,
            &self.system,
            groups,
            config.propagate_above,
            moved,
        );
    }

    /// Makes room, registers what is new, and brings the order of elimination up to date.
    fn take_in(&mut self, problem: &Problem, new: &Marks, touched: &Marks) -> Result<(), Error> {
        let count = problem.blocks.len();
        self.updates += 1;
        self.steps.begin();
        self.steps.grow(problem);
        self.models.grow(problem);
        self.system.grow(count, &self.steps);
        self.factor.grow(count);
        self.turned_from.resize(self.steps.len(), 0.0);
        self.bare_turned_from.resize(self.steps.len(), 0.0);
        self.looked_from.resize(self.steps.len(), 0.0);
        self.near_looked_from.resize(self.steps.len(), 0.0);
        self.stale.clear();
        self.points.clear();
        self.blocks.clear();
        self.moved.clear();
        for k in new.all() {
            let is_there = problem.residuals[*k].residual.is_some();
            if is_there && !self.models.is_known(*k) {
                self.models.register(problem, &self.steps, *k)?;
                let blocks = problem.blocks_of(ResidualId(*k));
                self.system.add_residual(&self.steps, blocks, *k);
                self.stale.add(*k);
            }
        }
        let (steps, system, factor) = (&self.steps, &self.system, &mut self.factor);
        let gone = touched.all().iter().copied();
        let gone: Vec<usize> = gone
            .filter(|b| factor.has(*b) && !system.is_reduced(steps, *b))
            .collect();
        factor.remove(steps, &gone);
        self.move_reached(problem);
        let (steps, factor) = (&self.steps, &mut self.factor);
        let new = self.stale.all().iter();
        let blocks = new.flat_map(|k| problem.blocks_of(ResidualId(*k)));
        let mut blocks: Vec<usize> = blocks
            .map(|block| block.0)
            .filter(|b| steps.part(*b) == Part::Reduced && !factor.has(*b))
            .collect();
        blocks.sort_unstable();
        blocks.dedup();
        factor.append(steps, &blocks);
        Ok(())
    }

    /// Moves what is far and reached by something new to the end of the order of elimination, with what is beside it. Where a loop closes, all columns
    /// between would have rows of all that comes at its end, and be made anew in each round; so they are made once, and have rows of
    /// the few at whose side the loop was cut.
    fn move_reached(&mut self, problem: &Problem) {
        let Some(last) = self.factor.groups().checked_sub(FAR) else {
            return;
        };
        let (steps, system, factor) = (&self.steps, &self.system, &self.factor);
        let is_far = |block: usize| factor.has(block) && factor.group(block) < last;
        let (mut reached, moving) = (Vec::new(), &mut self.moving);
        for k in self.stale.all() {
            for block in problem.blocks_of(ResidualId(*k)) {
                match steps.part(block.0) {
                    Part::Held => {}
                    Part::Reduced => reached.push(block.0),
                    Part::Point => reached.extend(system.blocks_at(block.0)),
                }
            }
        }
        let mut groups = 0;
        let mut add = |block: usize, moving: &mut Marks| {
            if is_far(block) && !moving.has(block) {
                groups += 1;
                for beside in factor.beside(block) {
                    moving.add(beside);
                }
            }
            groups
        };
        for block in reached {
            add(block, moving);
        }
        let mut next = 0;
        while let Some(block) = moving.all().get(next).copied() {
            next += 1;
            for point in system.points_of(block) {
                for other in system.blocks_at(*point as usize) {
                    if add(other, moving) >= MOVED_TOGETHER {
                        next = usize::MAX;
                    }
                }
            }
        }
        // A coupling stands in the column of that which is eliminated first.
        for block in moving.all() {
            self.reached.add(*block);
            for point in system.points_of(*block) {
                for other in system.blocks_at(*point as usize) {
                    self.reached.add(other);
                }
            }
            for k in system.bare_of(*block) {
                for other in problem.blocks_of(ResidualId(*k as usize)) {
                    self.reached.add(other.0);
                }
            }
        }
        let mut moved = moving.all().to_vec();
        moving.clear();
        moved.sort_by_key(|block| factor.place()[*block]);
        self.factor.remove(&self.steps, &moved);
        self.factor.append(&self.steps, &moved);
    }

    /// Linearizes what is stale, and marks the points and blocks whose equations that changes. `false` where the cost rose.
    fn linearize(&mut self, problem: &mut Problem) -> Result<bool, Error> {
        // All residuals of a point are linearized together: from models made before and after everything turned, a point would
        // be torn in two.
        let mut next = 0;
        while let Some(k) = self.stale.all().get(next).copied() {
            next += 1;
            for slot in self.models.model(k).1 {
                let block = slot.block as usize;
                match self.steps.part(block) {
                    Part::Held => {}
                    Part::Reduced => {
                        self.blocks.add(block);
                    }
                    Part::Point => {
                        if self.points.add(block) {
                            let step = self.system.point_step(&self.steps, block);
                            self.steps.set(problem, block, step.as_slice());
                            for k in self.system.residuals_of(block) {
                                self.stale.add(*k as usize);
                            }
                        }
                    }
                }
            }
        }
        let (mut before, mut after) = (0.0, 0.0);
        for k in self.stale.all() {
            let old = self.models.cost(*k);
            self.models.linearize(problem, &self.steps, *k)?;
            if let Some(old) = old {
                before += old;
                after += self.models.cost(*k).unwrap_or(old);
            }
        }
        self.stale.clear();
        Ok(after <= MOST_RAISE * before + 1.0)
    }

    /// Marks blocks that lost residuals.
    fn touch(&mut self, touched: &Marks) {
        for block in touched.all() {
            match self.steps.part(*block) {
                Part::Held => {}
                Part::Reduced => {
                    self.blocks.add(*block);
                }
                Part::Point => {
                    self.points.add(*block);
                }
            }
        }
    }

    /// Brings points and reduced system up to date.
    fn reduce(&mut self) {
        for point in self.points.all() {
            self.system
                .eliminate(&self.models, &self.steps, *point, &mut self.reached);
        }
        for block in self.reached.all() {
            self.blocks.add(*block);
        }
        let (steps, system) = (&self.steps, &self.system);
        self.blocks.retain(|block| system.is_reduced(steps, block));
        for block in self.blocks.all() {
            let points_changed = self.reached.has(*block);
            let place = self.factor.place();
            self.system
                .reduce(&self.models, &self.steps, place, *block, points_changed);
        }
        self.reached.clear();
    }

    /// Finds the residuals whose models are no longer true where the blocks have moved: near what is new, or anywhere.
    fn look(
        &mut self,
        problem: &mut Problem,
        config: &IncrementalConfig,
        near: bool,
        trust: Trust,
    ) {
        self.looked_at.clear();
        let nearest = self.first.max(self.near_first.saturating_sub(MARGIN));
        for block in self.moved.all() {
            if near && self.factor.group(*block) < nearest {
                continue;
            }
            let range = self.steps.range(*block);
            let step = self.steps.of(*block);
            let looked_from = if near {
                &self.near_looked_from
            } else {
                &self.looked_from
            };
            let (looked_from, limit) = (&looked_from[range.clone()], config.look_above);
            if !self.system.differ(range.clone(), step, looked_from, limit) {
                continue;
            }
            self.near_looked_from[range.clone()].copy_from_slice(step);
            if !near {
                self.looked_from[range.clone()].copy_from_slice(step);
            }
            let turned_from = &self.turned_from[range.clone()];
            let turned = self.steps.turn_since(problem, *block, turned_from);
            if !near && turned > config.turn_above {
                self.turned_from[range.clone()].copy_from_slice(self.steps.of(*block));
                for k in self.system.residuals_of(*block) {
                    self.stale.add(*k as usize);
                }
            }
            let turned_from = &self.bare_turned_from[range.clone()];
            let turned = self.steps.turn_since(problem, *block, turned_from);
            let is_turned = !near && turned > config.turn_alone_above;
            if is_turned {
                self.bare_turned_from[range.clone()].copy_from_slice(self.steps.of(*block));
            }
            for k in self.system.bare_of(*block) {
                if is_turned && !self.models.is_linear(*k as usize) {
                    self.stale.add(*k as usize);
                } else {
                    self.looked_at.add(*k as usize);
                }
            }
            let points = self.system.points_of(*block);
            if near || points.len() < 2 * SAMPLED {
                for point in points {
                    self.points.add(*point as usize);
                }
            } else {
                self.sampled.push(*block);
            }
        }
        self.sample(problem, trust);
        for point in self.points.all() {
            let step = self.system.point_step(&self.steps, *point);
            self.steps.set(problem, *point, step.as_slice());
            for k in self.system.residuals_of(*point) {
                self.looked_at.add(*k as usize);
            }
        }
        self.points.clear();
        let residuals = self.looked_at.all();
        let (steps, stale) = (&self.steps, &mut self.stale);
        self.models
            .find_stale(problem, steps, residuals, trust, stale);
    }

    /// Of blocks with many points, looks at some first, others in each update: where none of them has changed by more than it
    /// may, the others are taken to be alike.
    fn sample(&mut self, problem: &mut Problem, trust: Trust) {
        self.true_points.clear();
        for block in std::mem::take(&mut self.sampled) {
            let points = self.system.points_of(block);
            let is_sampled = |point: &&u32| **point as usize % SAMPLED == self.updates % SAMPLED;
            let is_stale = points.iter().filter(is_sampled).any(|point| {
                let point = *point as usize;
                // Many blocks see the same point.
                if self.points.has(point) || self.true_points.has(point) {
                    return false;
                }
                let step = self.system.point_step(&self.steps, point);
                self.steps.set(problem, point, step.as_slice());
                let of_point = self.system.residuals_of(point);
                let is_stale = self.models.any_stale(problem, &self.steps, of_point, trust);
                if !is_stale {
                    self.true_points.add(point);
                }
                is_stale
            });
            if is_stale {
                for point in points {
                    self.points.add(*point as usize);
                }
            }
        }
    }
}
