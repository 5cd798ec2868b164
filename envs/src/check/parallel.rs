//! Independent pieces of work on every processor.

use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::EnvError;

/// Applies `work` to every job, on as many threads as there are processors; results keep the order of the jobs.
///
/// # Errors
/// The first error in that order.
pub(crate) fn map<J: Sync, R: Send>(
    jobs: &[J],
    work: impl Fn(&J) -> Result<R, EnvError> + Sync,
) -> Result<Vec<R>, EnvError> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let next = AtomicUsize::new(0);
    let done = Mutex::new(Vec::with_capacity(jobs.len()));
    std::thread::scope(|scope| {
        for _ in 0..threads.min(jobs.len()) {
            scope.spawn(|| {
                while let Some((index, job)) = take(jobs, &next) {
                    let result = work(job);
                    let mut done = done.lock().unwrap_or_else(PoisonError::into_inner);
                    done.push((index, result));
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    done.sort_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, result)| result).collect()
}

fn take<'a, J>(jobs: &'a [J], next: &AtomicUsize) -> Option<(usize, &'a J)> {
    let index = next.fetch_add(1, Ordering::Relaxed);
    jobs.get(index).map(|job| (index, job))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_keep_the_order_of_the_jobs_and_errors_come_through() {
        let jobs: Vec<u64> = (0..100).collect();
        assert_eq!(map(&jobs, |&job| Ok(job * job)).unwrap()[9], 81);
        let error = map(&jobs, |&job| {
            if job == 50 {
                Err(EnvError::NotReset)
            } else {
                Ok(())
            }
        });
        assert!(matches!(error, Err(EnvError::NotReset)));
    }
}
