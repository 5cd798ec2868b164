//! Processes that compute one run together: `mpirun -n R covers train ...`.

use rl::ProcessRanks;

use crate::CoversError;

/// Calls `work` with the ranks (processes) that `mpirun` or `srun` started, or with this process as
/// the only rank; an error on one of several ranks ends them all. If `work` fails, prints the error
/// and ends all processes, since the others would wait for this one.
///
/// # Errors
/// Errors of `work` in a process that is alone.
#[cfg(feature = "mpi")]
pub(crate) fn on_ranks<T>(
    work: impl FnOnce(ProcessRanks) -> Result<T, CoversError>,
) -> Result<T, CoversError> {
    world::on_ranks(work)
}

/// Variables with the number of processes, which are set by Open MPI's `mpirun`, and by MPICH's and
/// `srun` with PMI. `srun` with PMIx sets none.
#[cfg(not(feature = "mpi"))]
const SIZES: [&str; 2] = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE"];

/// Calls `work` with this process as the only rank: the program was built without the feature
/// `mpi`.
///
/// # Errors
/// [`CoversError::NoMpi`] if `mpirun` or `srun` started several processes, each of which would train
/// a run of its own; errors of `work`.
#[cfg(not(feature = "mpi"))]
pub(crate) fn on_ranks<T>(
    work: impl FnOnce(ProcessRanks) -> Result<T, CoversError>,
) -> Result<T, CoversError> {
    let sizes = SIZES.map(|name| std::env::var(name).ok());
    match sizes.into_iter().flatten().filter_map(|size| size.parse().ok()).max() {
        Some(processes) if processes > 1 => Err(CoversError::NoMpi { processes }),
        _ => work(ProcessRanks::default()),
    }
}

#[cfg(feature = "mpi")]
mod world {
    use std::env;
    use std::io::{Write, stderr};
    use std::sync::Arc;

    use experiments::printable::printable_message;
    use mpi::Threading;
    use mpi::datatype::PartitionMut;
    use mpi::topology::SimpleCommunicator;
    use mpi::traits::{Communicator as _, CommunicatorCollectives};
    use rl::{ProcessCommunicator, ProcessRanks};

    use crate::CoversError;

    /// Variables of which one is set in a process that was started by Open MPI's `mpirun`, by `srun`
    /// or another program with PMIx, or by MPICH's `mpirun`.
    const LAUNCHED: [&str; 3] = ["OMPI_COMM_WORLD_SIZE", "PMIX_RANK", "PMI_RANK"];

    /// All processes that were started together. The handle of MPI is asked for in every call, since
    /// it may not be sent to another thread.
    struct World;

    impl ProcessCommunicator for World {
        fn rank(&self) -> usize {
            SimpleCommunicator::world().rank().cast_unsigned() as usize
        }

        fn size(&self) -> usize {
            SimpleCommunicator::world().size().cast_unsigned() as usize
        }

        fn all_gather(&self, own: &[u8]) -> Vec<u8> {
            let world = SimpleCommunicator::world();
            let (mut lengths, mut starts) = (vec![0_i32; self.size()], Vec::new());
            world.all_gather_into(&(own.len() as i32), &mut lengths[..]);
            let mut total = 0_usize;
            for &length in &lengths {
                starts.push(total as i32);
                total += length.cast_unsigned() as usize;
            }
            assert!(i32::try_from(total).is_ok(), "got {total} bytes, expected less than 2 GiB");
            let mut all = vec![0; total];
            let mut parts = PartitionMut::new(&mut all[..], lengths, starts);
            world.all_gather_varcount_into(own, &mut parts);
            all
        }
    }

    pub fn on_ranks<T>(
        work: impl FnOnce(ProcessRanks) -> Result<T, CoversError>,
    ) -> Result<T, CoversError> {
        let launched = LAUNCHED.iter().any(|name| env::var_os(name).is_some());
        // collective calls come from whichever thread runs the learner, one at a time
        let universe =
            if launched { mpi::initialize_with_threading(Threading::Serialized) } else { None };
        let Some((universe, _)) = universe else {
            return work(ProcessRanks::default());
        };
        let world = universe.world();
        work(ProcessRanks::new(Arc::new(World))).inspect_err(|error| {
            let _ = writeln!(stderr(), "rank {}: {}", world.rank(), printable_message(error));
            world.abort(1)
        })
    }
}
