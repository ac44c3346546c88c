//! Evaluation from outside: what other programs make of the same trajectories.

mod evo;
mod made_up;
mod paper_tables;
mod tumvi;
