//! Many runs: methods and seeds as a list of jobs, which any number of workers claim one by one.

mod arrays;
mod plan;
mod worker;

pub use arrays::ArrayJob;
pub use plan::{Job, Plan};
pub use worker::{Ended, work};
