//! The solver as its users meet it.

mod bal;
mod edge_cases;
mod threads;
