//! Errors of the program's commands.

use deploy::DeployError;
use experiments::RunError;
use learner::LearnerError;
use model_check::ModelSymmetryError;
use render::RenderError;
use report::ReportError;
use watch::WatchError;

/// Error of a `covers` command.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CoversError {
    /// Error of a run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Error of a report.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// Error of rendering.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// Error of watching a run.
    #[error(transparent)]
    Watch(#[from] WatchError),
    /// Error of a robot's deployment or calibration.
    #[error(transparent)]
    Deploy(#[from] DeployError),
    /// Error of checking a model.
    #[error(transparent)]
    ModelCheck(#[from] ModelSymmetryError),
    /// Failed jobs of a sweep.
    #[error(
        "these jobs failed: {}. The reason of each is printed above; the next sweep tries them \
         again", failed_jobs.join(", ")
    )]
    SweepJobsFailed {
        /// Names of the failed jobs.
        failed_jobs: Vec<String>,
    },
    /// Several processes of `mpirun` or `srun` in a program that cannot share a run among them.
    #[error(
        "`mpirun` or `srun` started {processes} processes, but this program was built without MPI, \
         so each would train a run of its own: build it with `--features mpi`, or start one process"
    )]
    NoMpi {
        /// Number of processes, of which this is one.
        processes: usize,
    },
    /// Request for a full-screen view without a terminal.
    #[error(
        "`--tui` needs a terminal, but standard output is not one: leave the option out, or follow \
         the run with `covers watch`"
    )]
    NoTerminal,
}

impl From<LearnerError> for CoversError {
    fn from(error: LearnerError) -> Self {
        Self::Run(error.into())
    }
}
