//! Worker threads of a run, whose panics become errors.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};

use rayon::ThreadPool;

use crate::error::RunError;

/// Starts the pool of `threads` threads that networks run on.
///
/// # Errors
/// [`RunError::Threads`].
pub fn thread_pool(threads: usize) -> Result<ThreadPool, RunError> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|source| RunError::Threads { threads, source })
}

/// Runs `work` on the threads of `pool`; a panic in any of them is returned as
/// [`RunError::Panicked`].
pub(crate) fn run_catching_panics<T: Send>(
    pool: &ThreadPool,
    work: impl FnOnce() -> Result<T, RunError> + Send,
) -> Result<T, RunError> {
    let result = catch_unwind(AssertUnwindSafe(|| pool.install(work)));
    result
        .unwrap_or_else(|panic| Err(RunError::Panicked { message: message_of(&*panic).to_owned() }))
}

fn message_of(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("without a message")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_of_any_worker_is_an_error_with_its_message() {
        use rayon::prelude::*;
        let pool = thread_pool(2).unwrap();
        let work = || {
            (0..8).into_par_iter().for_each(|i| assert!(i != 5, "item {i} fell over"));
            Ok(())
        };
        let message = run_catching_panics(&pool, work).unwrap_err().to_string();
        assert!(message.contains("item 5 fell over"), "{message}");
        assert!(run_catching_panics(&pool, || Ok(7)).is_ok_and(|seven| seven == 7));
    }
}
