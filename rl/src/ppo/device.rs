//! Updates on a GPU.

use equivariant::gpu::{Batch, GpuError, Passes, Program};
use rand_chacha::ChaCha8Rng;

use crate::adam::bias_correction;
use crate::env::Observations;
use crate::error::{RlError, check_finite};
use crate::loss::LossSums;
use crate::minibatch::normalised_advantages;
use crate::network::ActorCritic;
use crate::ppo::graph::{Graph, ROW, Size};
use crate::ppo::task::{Task, shuffle};
use crate::ppo_stats::Totals;

/// A GPU with the kernels of an update.
pub(super) struct Device {
    device: equivariant::gpu::Device,
    /// Compiled at the first update, and again for a longer one.
    compiled: Option<Compiled>,
}

struct Compiled {
    size: Size,
    graph: Graph,
    program: Program,
}

/// The minibatches of all passes, in their order.
#[derive(Default)]
struct Schedule {
    /// Decision and advantage of each draw, as words.
    draws: Vec<u32>,
    /// Where each minibatch starts among the draws, and its length.
    minibatches: Vec<(usize, usize)>,
    /// The generator after the shuffle of each pass.
    generators: Vec<ChaCha8Rng>,
}

impl Device {
    pub fn new(device: &equivariant::gpu::Device) -> Self {
        Self {
            device: device.clone(),
            compiled: None,
        }
    }

    /// Draws all minibatches, runs them without waiting for one another, and reads what came of
    /// them. The device takes no step after one that the divergence forbids; the generator is left
    /// as after the last pass that was begun.
    pub fn run(&mut self, task: Task) -> Result<Totals, RlError> {
        let schedule = Schedule::draw(&task);
        let compiled = self.compiled(&task, &schedule)?;
        compiled.write(&task, &schedule);
        compiled.submit(&task, &schedule);
        compiled.read(task, &schedule)
    }

    fn compiled(&mut self, task: &Task, schedule: &Schedule) -> Result<&Compiled, GpuError> {
        let needed = Size {
            rollout: task.buffer.samples(),
            draws: schedule.draws.len() / 2,
            minibatches: schedule.minibatches.len(),
        };
        let known = self
            .compiled
            .take()
            .filter(|known| known.size.holds(needed));
        let compiled = match known {
            Some(known) => known,
            None => Compiled::new(&self.device, task, needed)?,
        };
        Ok(self.compiled.insert(compiled))
    }
}

impl Size {
    fn holds(self, needed: Size) -> bool {
        self.rollout >= needed.rollout
            && self.draws >= needed.draws
            && self.minibatches >= needed.minibatches
    }
}

impl Schedule {
    /// Draws the minibatches of every pass, as the processor does pass by pass.
    fn draw(task: &Task) -> Self {
        let mut schedule = Self::default();
        let mut order: Vec<usize> = (0..task.buffer.samples()).collect();
        let mut rng = task.rng.clone();
        let mut normalised = Vec::new();
        for _ in 0..task.settings.epochs {
            shuffle(&mut order, &mut rng);
            schedule.generators.push(rng.clone());
            for indices in order.chunks(task.settings.minibatch) {
                let start = schedule.draws.len() / 2;
                schedule.minibatches.push((start, indices.len()));
                normalised_advantages(&task.rollout.advantages, indices, &mut normalised);
                let draws = indices.iter().zip(&normalised);
                let words = draws.flat_map(|(&i, &a)| [i as u32, (a as f32).to_bits()]);
                schedule.draws.extend(words);
            }
        }
        schedule
    }
}

impl Compiled {
    fn new(device: &equivariant::gpu::Device, task: &Task, size: Size) -> Result<Self, GpuError> {
        let graph = Graph::new(task.policy.network(), task.settings, size)?;
        let program = Program::new(
            device,
            &graph.plan,
            task.settings.minibatch.min(size.rollout),
        )?;
        Ok(Self {
            size,
            graph,
            program,
        })
    }

    /// Brings parameters, moments, the rollout and its minibatches to the device.
    fn write(&self, task: &Task, schedule: &Schedule) {
        let Graph {
            plan,
            slots,
            moments,
        } = &self.graph;
        let network = task.policy.network();
        let optimiser = &task.optimiser;
        let placed = [
            (plan.params(), task.policy.params()),
            (moments[0], &optimiser.first_moment),
            (moments[1], &optimiser.second_moment),
        ];
        for (slot, values) in placed {
            self.program.write(slot, &plan.placed(values));
        }
        let Observations { images, vectors } = task.buffer.observations();
        slots
            .observed
            .write(&self.program, network, images, vectors);
        self.program
            .write(slots.decisions, &decisions(network, task));
        self.program
            .write_words(slots.observed.draws, &schedule.draws);
        self.program.write(slots.log, &vec![0.0; log_len(schedule)]);
    }

    /// Starts every minibatch.
    fn submit(&self, task: &Task, schedule: &Schedule) {
        let [encoder, heads] = task.groups().map(|group| group.learning_rate);
        for (index, &(start, samples)) in schedule.minibatches.iter().enumerate() {
            let steps = task.optimiser.steps + index as u64 + 1;
            let [first, second] = task
                .optimiser
                .betas
                .map(|beta| bias_correction(beta, steps));
            let batch = Batch {
                samples,
                start,
                index,
                numbers: [encoder / first, heads / first, second.sqrt(), 0.0],
            };
            self.program.submit(Passes::All, batch);
        }
    }

    /// Waits for the minibatches and takes over what they left.
    fn read(&self, task: Task, schedule: &Schedule) -> Result<Totals, RlError> {
        let Graph {
            plan,
            slots,
            moments: [first, second],
        } = &self.graph;
        let [params, first, second] =
            [plan.params(), *first, *second].map(|slot| (slot, plan.device_params()));
        let log = (slots.log, log_len(schedule));
        let [params, first, second, log] = self.program.read([params, first, second, log])?;
        let mut totals = Totals::default();
        let outcome = totals.add_log(&log, task.settings.epochs);
        task.policy
            .params_mut()
            .copy_from_slice(&plan.unplaced(&params));
        task.optimiser.first_moment = plan.unplaced(&first);
        task.optimiser.second_moment = plan.unplaced(&second);
        task.optimiser.steps += totals.steps as u64;
        let begun = totals.epochs.min(schedule.generators.len() - 1);
        task.rng.clone_from(&schedule.generators[begun]);
        outcome.map(|()| totals)
    }
}

impl Totals {
    /// Adds the rows of a log up to where the update ended.
    fn add_log(&mut self, log: &[f32], epochs: usize) -> Result<(), RlError> {
        let rows = log.chunks_exact(ROW).skip(1);
        let of_pass = rows.len() / epochs;
        for row in rows {
            let [samples, policy, value, entropy, kl, clipped, norm, stepped] =
                std::array::from_fn(|i| f64::from(row[i]));
            if samples == 0.0 {
                break;
            }
            check_finite("the loss of a minibatch", policy + value + kl)?;
            self.losses.add(&LossSums {
                samples,
                policy,
                value,
                entropy,
                kl,
                clipped,
                symmetry: 0.0,
            });
            check_finite("the norm of the gradient", norm)?;
            if stepped == 0.0 {
                break;
            }
            self.grad_norms += norm;
            self.steps += 1;
            self.epochs = self.steps / of_pass;
        }
        Ok(())
    }
}

fn log_len(schedule: &Schedule) -> usize {
    ROW * (schedule.minibatches.len() + 1)
}

/// Action, irrep-major, log-probability and return of every decision.
fn decisions(network: &ActorCritic<f32>, task: &Task) -> Vec<f32> {
    let order = &network.action_order;
    let made = task.buffer.decisions();
    let actions = made.actions.chunks_exact(order.len());
    let others = made.log_probs.iter().zip(&task.rollout.returns);
    let rows = actions
        .zip(others)
        .flat_map(|(action, (&log_prob, &target))| {
            let action = order.iter().map(|&i| action[i]);
            action.chain([log_prob, target])
        });
    rows.collect()
}
