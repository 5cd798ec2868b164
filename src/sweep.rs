//! Sweeps: methods, variants and seeds as a list of jobs, which any number of workers share.

mod arrays;
mod plan;
mod worker;

pub use arrays::{ArrayJob, KubernetesOptions};
pub use plan::{SweepJob, SweepPlan};
pub use worker::{SweepWorkerOutcome, SweepWorkerSettings, run_sweep_worker};
