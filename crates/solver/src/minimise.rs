use std::ops::ControlFlow;

use crate::bounds::{clamp, hold_at_bounds};
use crate::diagnosis::diagnose;
use crate::divide::on_pool;
use crate::dogleg::Dogleg;
use crate::evaluation::{Evaluation, TotalCost, not_finite, squared_norm};
use crate::layout::{Layout, Part};
use crate::linear_system::LinearSystem;
use crate::normal::{NormalEquations, Step};
use crate::problem::{Problem, Role};
use crate::{Diagnosis, Error, Iteration, Kernel, Method, Report, SolveConfig, Termination};

/// Dampings beyond which a step no longer moves anything.
const LARGEST_DAMPING: f64 = 1e20;
const SMALLEST_DAMPING: f64 = 1e-14;

/// Share of the foreseen decrease that a step must bring.
const LEAST_QUALITY: f64 = 1e-3;

/// Minimises `½ Σ ρ(‖r‖²)` over the free blocks; the problem holds the result.
///
/// The same problem gives the same bits on any number of threads. After an error the values are those of the start.
pub fn solve(problem: &mut Problem, config: &SolveConfig) -> Result<Report, Error> {
    solve_controlled(problem, config, &mut |_| ControlFlow::Continue(()))
}

/// [`solve`], asking `control` after each step, taken or refused, whether to go on: for progress, cancelling and time
/// limits. The problem holds the best values found.
pub fn solve_controlled(
    problem: &mut Problem,
    config: &SolveConfig,
    control: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
) -> Result<Report, Error> {
    config.check_bounds("")?;
    check_values(problem)?;
    let mut layout = Layout::new(problem)?;
    let mut values = problem.values.clone();
    clamp(problem, &mut values);
    let mut evaluation = Evaluation::new(problem, &layout);
    let start = evaluation.start(problem, &layout, &values);
    if let Some(position) = start.not_finite {
        return Err(not_finite(problem, &layout, position));
    }
    let mut system = LinearSystem::new(&mut layout, config)?;
    let mut report = Report {
        initial_cost: start.cost,
        final_cost: start.cost,
        iterations: 0,
        graduation_steps: 0,
        refused_steps: 0,
        termination: Termination::MaxIterations,
        gradient_max_norm: 0.0,
        step_norm: 0.0,
        residuals: problem.residual_count(),
        undefined_at_start: evaluation.active.iter().filter(|a| !**a).count(),
        undefined_at_end: 0,
        untouched_blocks: untouched(problem, &layout),
        reduced_dimension: layout.dimension(),
        eliminated_points: layout.points.len(),
        linear_solver: system.kind(),
        condition: None,
        undetermined: Vec::new(),
    };
    if layout.reduced.is_empty() && layout.points.is_empty() {
        report.termination = Termination::NothingFree;
        return Ok(report);
    }
    let mut state = Workspace {
        normal: NormalEquations::new(&layout),
        step: Step::new(&layout),
        trial_values: values.clone(),
        trial_costs: evaluation.costs.clone(),
        values,
        evaluation,
        layout: &layout,
        problem,
    };
    state.minimise(&mut system, config, &mut report, control)?;
    let Workspace { values, normal, .. } = state;
    if config.diagnosis == Diagnosis::Full {
        diagnose(problem, &layout, &normal, &mut system, &mut report);
    }
    problem.values = values;
    Ok(report)
}

/// Refuses values that are not finite.
pub(crate) fn check_values(problem: &Problem) -> Result<(), Error> {
    for (block, entry) in problem.blocks.iter().enumerate() {
        let stored = &problem.values[entry.stored()];
        if !stored.iter().all(|x| x.is_finite()) {
            return Err(Error::BlockNotFinite { block });
        }
    }
    Ok(())
}

fn untouched(problem: &Problem, layout: &Layout) -> usize {
    let free = |role| matches!(role, Role::Free | Role::Eliminated);
    problem
        .blocks
        .iter()
        .zip(&layout.parts)
        .filter(|(block, part)| free(block.role) && **part == Part::Constant)
        .count()
}

/// Everything that iterations fill in; taken once.
struct Workspace<'a> {
    problem: &'a Problem,
    layout: &'a Layout,
    evaluation: Evaluation,
    normal: NormalEquations,
    step: Step,
    values: Vec<f64>,
    trial_values: Vec<f64>,
    trial_costs: Vec<f64>,
}

/// How long steps may be.
enum Region {
    /// Damping, and the factor by which it grows once a step is refused: Nielsen's rule, by which damping falls
    /// smoothly with the quality of the step, and grows ever faster while steps fail.
    Damping {
        damping: f64,
        growth: f64,
    },
    Radius(Dogleg),
}

/// What came of one step.
struct Attempt {
    trial: TotalCost,
    predicted: f64,
    length: f64,
}

impl Workspace<'_> {
    fn minimise(
        &mut self,
        system: &mut LinearSystem,
        config: &SolveConfig,
        report: &mut Report,
        control: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
    ) -> Result<(), Error> {
        let mut region = match config.method {
            Method::LevenbergMarquardt => Region::Damping {
                damping: config.initial_damping,
                growth: 2.0,
            },
            Method::Dogleg => {
                Region::Radius(Dogleg::new(self.layout, 1.0 / config.initial_damping))
            }
        };
        if config.graduation > 0.0 {
            self.evaluation.relaxation = self.first_relaxation();
            report.final_cost = self.cost_again();
        }
        while report.iterations < config.max_iterations + report.graduation_steps {
            system.factored = None;
            self.linearize()?;
            report.iterations += 1;
            report.undefined_at_end = *self.evaluation.undefined.get_mut();
            report.gradient_max_norm = self.normal.gradient_max_norm();
            if let Region::Radius(dogleg) = &mut region {
                dogleg.begin();
            }
            let graduated = self.evaluation.relaxation > 1.0;
            if report.gradient_max_norm <= config.gradient_tolerance && !graduated {
                report.termination = Termination::GradientTolerance;
                return Ok(());
            }
            let ended = self.descend(system, config, &mut region, report, control)?;
            if graduated && ended.is_none_or(|t| t != Termination::Stopped) {
                // The step served a kernel that is now too wide, however good it was.
                let narrower = self.evaluation.relaxation / config.graduation;
                self.evaluation.relaxation = narrower.max(1.0);
                report.graduation_steps += 1;
                report.final_cost = self.cost_again();
                if let Region::Damping { damping, growth } = &mut region {
                    *damping = damping.min(config.initial_damping);
                    *growth = 2.0;
                }
            } else if let Some(termination) = ended {
                report.termination = termination;
                return Ok(());
            }
        }
        Ok(())
    }

    /// Tries steps until one lowers the cost enough; a termination where that was the last.
    fn descend(
        &mut self,
        system: &mut LinearSystem,
        config: &SolveConfig,
        region: &mut Region,
        report: &mut Report,
        control: &mut dyn FnMut(&Iteration) -> ControlFlow<()>,
    ) -> Result<Option<Termination>, Error> {
        loop {
            if region.is_closed() {
                return Ok(Some(Termination::NoDecrease));
            }
            let attempt = on_pool(|| self.attempt(system, region));
            let mut ended = None;
            let mut taken = false;
            if let Some(attempt) = attempt {
                let least = config.step_tolerance * (norm(&self.values) + config.step_tolerance);
                if attempt.length <= least {
                    // Short from the start of this iteration, or only after longer steps were refused?
                    return Ok(Some(if region.was_refused() {
                        Termination::NoDecrease
                    } else {
                        report.step_norm = attempt.length;
                        Termination::StepTolerance
                    }));
                }
                let decrease = report.final_cost - attempt.trial.cost;
                let quality = decrease / attempt.predicted;
                taken = decrease > 0.0 && quality > LEAST_QUALITY;
                if taken {
                    if decrease <= config.cost_tolerance * report.final_cost {
                        ended = Some(Termination::CostTolerance);
                    }
                    std::mem::swap(&mut self.values, &mut self.trial_values);
                    std::mem::swap(&mut self.evaluation.costs, &mut self.trial_costs);
                    report.final_cost = attempt.trial.cost;
                    report.step_norm = attempt.length;
                    region.taken(quality);
                } else {
                    region.refused();
                }
            } else {
                region.refused();
            }
            report.refused_steps += usize::from(!taken);
            let told = control(&Iteration {
                number: report.iterations,
                of: config.max_iterations + report.graduation_steps,
                cost: report.final_cost,
                damping: region.damping(),
                gradient_max_norm: report.gradient_max_norm,
                step_norm: report.step_norm,
            });
            if told.is_break() {
                return Ok(Some(Termination::Stopped));
            }
            if taken {
                return Ok(ended);
            }
        }
    }

    fn linearize(&mut self) -> Result<(), Error> {
        let Self {
            problem,
            layout,
            evaluation,
            normal,
            values,
            ..
        } = self;
        on_pool(|| normal.linearize(problem, layout, evaluation, values));
        evaluation.outcome(problem, layout)?;
        hold_at_bounds(problem, layout, values, normal);
        Ok(())
    }

    /// Finds a step and the cost at its end; `None` where there is no step.
    fn attempt(&mut self, system: &mut LinearSystem, region: &mut Region) -> Option<Attempt> {
        let predicted = match region {
            Region::Damping { damping, .. } => {
                if !system.solve(&self.normal, self.layout, *damping, &mut self.step) {
                    return None;
                }
                if system.is_exact() {
                    self.normal.predicted_decrease(&self.step, *damping)
                } else {
                    let model = self.normal.quadratic(self.layout, &self.step);
                    -model.slope - 0.5 * model.square
                }
            }
            Region::Radius(dogleg) => {
                dogleg.step(&self.normal, self.layout, system, &mut self.step)?
            }
        };
        self.step.apply(
            self.problem,
            self.layout,
            &self.values,
            &mut self.trial_values,
        );
        clamp(self.problem, &mut self.trial_values);
        let trial = self.evaluation.total(
            self.problem,
            self.layout,
            &self.trial_values,
            &mut self.trial_costs,
        );
        Some(Attempt {
            trial,
            predicted,
            length: self.step.length(),
        })
    }

    /// The factor at which the worst residual of a graduated kernel is still on its convex part.
    fn first_relaxation(&self) -> f64 {
        let mut factor: f64 = 1.0;
        for (position, cost) in self.evaluation.costs.iter().enumerate() {
            let entry = &self.problem.residuals[self.layout.order[position] as usize];
            if let Kernel::GemanMcClure { scale } = entry.kernel {
                // ρ = s c² / (s + c²), solved for s; nearly c² means far out.
                let rho = (2.0 * cost).min(scale * scale * (1.0 - 1e-12));
                let squared = rho * scale * scale / (scale * scale - rho);
                factor = factor.max(2.0 * squared / (scale * scale));
            }
        }
        factor
    }

    /// The cost at the present values with the present width of the kernels.
    fn cost_again(&mut self) -> f64 {
        let total = on_pool(|| {
            self.evaluation.total(
                self.problem,
                self.layout,
                &self.values,
                &mut self.trial_costs,
            )
        });
        std::mem::swap(&mut self.evaluation.costs, &mut self.trial_costs);
        total.cost
    }
}

impl Region {
    fn is_closed(&self) -> bool {
        self.damping() > LARGEST_DAMPING
    }

    fn was_refused(&self) -> bool {
        match self {
            Self::Damping { growth, .. } => *growth > 2.0,
            Self::Radius(dogleg) => dogleg.was_refused(),
        }
    }

    fn damping(&self) -> f64 {
        match self {
            Self::Damping { damping, .. } => *damping,
            Self::Radius(dogleg) => 1.0 / dogleg.radius(),
        }
    }

    fn taken(&mut self, quality: f64) {
        match self {
            Self::Damping { damping, growth } => {
                let factor = (1.0 - (2.0 * quality - 1.0).powi(3)).clamp(1.0 / 3.0, 2.0);
                *damping = (*damping * factor).max(SMALLEST_DAMPING);
                *growth = 2.0;
            }
            Self::Radius(dogleg) => dogleg.taken(quality),
        }
    }

    fn refused(&mut self) {
        match self {
            Self::Damping { damping, growth } => {
                *damping *= *growth;
                *growth *= 2.0;
            }
            Self::Radius(dogleg) => dogleg.refused(),
        }
    }
}

fn norm(values: &[f64]) -> f64 {
    squared_norm(values).sqrt()
}

impl Step {
    fn length(&self) -> f64 {
        let points: f64 = self.points.iter().map(|p| p.norm_squared()).sum();
        (squared_norm(&self.reduced) + points).sqrt()
    }

    /// Moves `values` by the step. What is not free stays as it is in `moved`.
    pub fn apply(&self, problem: &Problem, layout: &Layout, values: &[f64], moved: &mut [f64]) {
        for (i, block) in layout.reduced.iter().enumerate() {
            move_block(
                problem,
                *block,
                &self.reduced[layout.rows(i)],
                values,
                moved,
            );
        }
        for (block, delta) in layout.points.iter().zip(&self.points) {
            move_block(problem, *block, delta.as_slice(), values, moved);
        }
    }
}

/// Longest tangent of which components may be held.
const LONGEST_MASKED: usize = 64;

/// Moves one block by its searched components.
pub(crate) fn move_block(
    problem: &Problem,
    block: usize,
    delta: &[f64],
    values: &[f64],
    moved: &mut [f64],
) {
    let entry = &problem.blocks[block];
    let range = entry.stored();
    let (from, to) = (&values[range.clone()], &mut moved[range]);
    if entry.mask == crate::residual::ALL {
        (entry.plus)(from, delta, to);
        return;
    }
    let mut whole = [0.0; LONGEST_MASKED];
    for (k, d) in delta.iter().enumerate() {
        whole[entry.component(k)] = *d;
    }
    (entry.plus)(from, &whole[..entry.shape.tangent.min(LONGEST_MASKED)], to);
}
