//! PPO updates on a GPU: a plan of kernels for the network, the loss and the optimiser.

use equivariant::gpu::{
    Batch, BufferSlot, GpuError, KernelStep, Passes, Plan, Program, WorkgroupCount,
};
use rand_chacha::ChaCha8Rng;

use crate::adam::{Adam, bias_correction};
use crate::device::{DRAW_STRUCT_WGSL, DeviceObservations, NetworkOutputs, add_network};
use crate::env::Observations;
use crate::error::{RlError, check_finite};
use crate::network::ActorCritic;
use crate::ppo::minibatch::{Device, MAX_LOG_RATIO, Minibatch, Update};
use crate::ppo::settings::PpoSettings;
use crate::ppo::stats::{LossSums, PpoTotals};

/// Number of values in a row of the GPU's log: a first row for the state of the update, then one
/// for each minibatch.
const ROW: usize = 8;
/// Number of partial sums of the gradient's squared components, equal to the number of threads that
/// add them up.
const SQUARES: usize = 64;

/// A GPU as a [`Device`] of PPO updates. It queues all minibatches without waiting for results;
/// once the KL divergence stops the update, the remaining minibatches have no effect.
pub(super) struct Gpu {
    device: equivariant::gpu::Device,
    schedule: Schedule,
    /// Kernels of the update, compiled at the first update and again for larger sizes.
    compiled: Option<Compiled>,
}

struct Compiled {
    size: Size,
    graph: Graph,
    program: Program,
}

/// Minibatches of all epochs of an update, in order.
#[derive(Default)]
struct Schedule {
    /// Index in the rollout and normalised advantage of each decision of each minibatch, as two
    /// 32-bit words.
    draws: Vec<u32>,
    /// Position of the first decision among all `draws`, and number of decisions, of each
    /// minibatch.
    minibatches: Vec<(usize, usize)>,
    /// State of the random generator after the shuffle of each minibatch's epoch.
    generators: Vec<ChaCha8Rng>,
}

impl Device for Gpu {
    fn losses(
        &mut self,
        update: &Update,
        minibatch: &Minibatch,
    ) -> Result<Option<(LossSums, &mut [f32])>, RlError> {
        self.schedule.push(minibatch, update.rng);
        Ok(None)
    }

    fn finish(&mut self, update: &mut Update) -> Result<Option<PpoTotals>, RlError> {
        let schedule = std::mem::take(&mut self.schedule);
        let compiled = self.compiled(update, &schedule)?;
        compiled.write(update, &schedule);
        compiled.submit(update, &schedule);
        compiled.read(update, &schedule).map(Some)
    }
}

impl Gpu {
    pub fn new(device: &equivariant::gpu::Device) -> Self {
        Self { device: device.clone(), schedule: Schedule::default(), compiled: None }
    }

    fn compiled(&mut self, update: &Update, schedule: &Schedule) -> Result<&Compiled, GpuError> {
        let needed = Size {
            rollout: update.buffer.num_samples(),
            draws: schedule.draws.len() / 2,
            minibatches: schedule.minibatches.len(),
        };
        // compiled buffers also serve smaller updates
        let known = self.compiled.take().filter(|known| known.size.holds(needed));
        let compiled = match known {
            Some(known) => known,
            None => Compiled::new(&self.device, update, needed)?,
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
    fn push(&mut self, minibatch: &Minibatch, rng: &ChaCha8Rng) {
        let Minibatch { indices, advantages, .. } = minibatch;
        self.minibatches.push((self.draws.len() / 2, indices.len()));
        self.generators.push(rng.clone());
        let draws = indices.iter().zip(*advantages);
        let words = draws.flat_map(|(&i, &a)| [i as u32, (a as f32).to_bits()]);
        self.draws.extend(words);
    }
}

impl Compiled {
    fn new(
        device: &equivariant::gpu::Device,
        update: &Update,
        size: Size,
    ) -> Result<Self, GpuError> {
        let graph = Graph::new(update.policy.network(), update.settings, size)?;
        let program =
            Program::new(device, &graph.plan, update.settings.minibatch.min(size.rollout))?;
        Ok(Self { size, graph, program })
    }

    /// Copies parameters, Adam's moments, the rollout and its minibatches to the GPU.
    fn write(&self, update: &Update, schedule: &Schedule) {
        let Graph { plan, slots, moments } = &self.graph;
        let network = update.policy.network();
        let optimiser = &update.optimiser;
        let placed = [
            (plan.params_buffer(), update.policy.params()),
            (moments[0], &optimiser.first_moment),
            (moments[1], &optimiser.second_moment),
        ];
        for (slot, values) in placed {
            self.program.write_floats(slot, &plan.params_to_device_order(values));
        }
        let Observations { images, vectors } = update.buffer.observations();
        slots.observed.write(&self.program, network, images, vectors);
        self.program.write_floats(slots.decisions, &decisions(network, update));
        self.program.write_words(slots.observed.draws, &schedule.draws);
        // zeros: the state RUNNING, and no row written yet
        self.program.write_floats(slots.log, &vec![0.0; log_len(schedule)]);
    }

    /// Queues the kernels of every minibatch on the GPU.
    fn submit(&self, update: &Update, schedule: &Schedule) {
        let [encoder, heads] = update.groups().map(|group| group.learning_rate);
        for (index, &(start, samples)) in schedule.minibatches.iter().enumerate() {
            let steps = update.optimiser.steps + index as u64 + 1;
            // Adam's bias corrections, computed here in f64, which kernels do not have
            let [first, second] = update.optimiser.betas.map(|beta| bias_correction(beta, steps));
            let batch = Batch {
                samples,
                start,
                index,
                extra_numbers: [encoder / first, heads / first, second.sqrt(), 0.0],
            };
            self.program.submit(Passes::All, batch);
        }
    }

    /// Waits for the queued minibatches and copies their results to the policy, optimiser and
    /// random generator.
    fn read(&self, update: &mut Update, schedule: &Schedule) -> Result<PpoTotals, RlError> {
        let Graph { plan, slots, moments: [first, second] } = &self.graph;
        let [params, first, second] =
            [plan.params_buffer(), *first, *second].map(|slot| (slot, plan.num_device_params()));
        let log = (slots.log, log_len(schedule));
        let [params, first, second, log] =
            self.program.read_floats([params, first, second, log])?;
        let mut totals = PpoTotals::default();
        let outcome = totals.add_log(&log, update.settings.epochs);
        update.policy.params_mut().copy_from_slice(&plan.params_from_device_order(&params));
        update.optimiser.first_moment = plan.params_from_device_order(&first);
        update.optimiser.second_moment = plan.params_from_device_order(&second);
        update.optimiser.steps += totals.steps as u64;
        // the minibatch that ended the update follows the last step taken: the generator continues
        // from its epoch's shuffle, as on the CPU, which would not have drawn later ones
        let begun = totals.steps.min(schedule.generators.len() - 1);
        update.rng.clone_from(&schedule.generators[begun]);
        outcome.map(|()| totals)
    }
}

impl PpoTotals {
    /// Adds the sums that the GPU logged for each minibatch, up to the one that ended the update.
    fn add_log(&mut self, log: &[f32], epochs: usize) -> Result<(), RlError> {
        let rows = log.chunks_exact(ROW).skip(1);
        let per_epoch = rows.len() / epochs;
        for row in rows {
            let [
                samples,
                policy_loss,
                value_loss,
                entropy,
                approx_kl,
                clip_fraction,
                norm,
                stepped,
            ] = std::array::from_fn(|i| f64::from(row[i]));
            // a row that no minibatch wrote: the update had stopped
            if samples == 0.0 {
                break;
            }
            check_finite("the loss of a minibatch", policy_loss + value_loss + approx_kl)?;
            self.losses.add(&LossSums {
                samples,
                policy_loss,
                value_loss,
                entropy,
                approx_kl,
                clip_fraction,
                symmetry_loss: 0.0,
            });
            check_finite("the norm of the gradient", norm)?;
            if stepped == 0.0 {
                break;
            }
            self.grad_norm_sum += norm;
            self.steps += 1;
            // complete epochs only, as on the CPU
            self.epochs = self.steps / per_epoch;
        }
        Ok(())
    }
}

fn log_len(schedule: &Schedule) -> usize {
    ROW * (schedule.minibatches.len() + 1)
}

/// Returns a row for every decision of the rollout: action (irrep-major), log-probability and
/// return.
fn decisions(network: &ActorCritic<f32>, update: &Update) -> Vec<f32> {
    let order = &network.action_order;
    let made = update.buffer.decisions();
    let actions = made.actions.chunks_exact(order.len());
    let others = made.log_probs.iter().zip(&update.batch.returns);
    let rows = actions.zip(others).flat_map(|(action, (&log_prob, &target))| {
        let action = order.iter().map(|&i| action[i]);
        action.chain([log_prob, target])
    });
    rows.collect()
}

/// Sizes of a PPO update, for which GPU buffers are allocated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Size {
    /// Number of decisions of the rollout.
    rollout: usize,
    /// Number of decisions in all minibatches of all epochs.
    draws: usize,
    /// Number of minibatches of all epochs.
    minibatches: usize,
}

/// Kernels of a PPO update in a [`Plan`] for a GPU, and the buffers that they share with the CPU.
struct Graph {
    plan: Plan,
    slots: Slots,
    /// GPU buffers of Adam's first and second moment.
    moments: [BufferSlot; 2],
}

/// GPU buffers of a PPO update that the CPU writes and reads, besides parameters and moments.
#[derive(Clone, Copy)]
struct Slots {
    /// Buffers of the rollout's observations, and of the minibatches' decisions, which refer to
    /// them by index.
    observed: DeviceObservations,
    /// Buffer of action (irrep-major), log-probability and return of each decision of the rollout.
    decisions: BufferSlot,
    /// Buffer of statistics: the state of the update, then one row for each minibatch.
    log: BufferSlot,
}

impl Graph {
    fn new(
        network: &ActorCritic<f32>,
        settings: &PpoSettings,
        size: Size,
    ) -> Result<Self, GpuError> {
        let mut plan = Plan::new();
        let slots = Slots::new(&mut plan, network, size);
        let outputs = add_network(&mut plan, network, slots.observed)?;
        let loss = loss(&plan, network, settings, slots, &outputs)?;
        plan.add_kernels(vec![loss], Vec::new());
        let params = plan.num_device_params();
        let moments = [(); 2].map(|()| plan.add_buffer(params, 0));
        let squares = plan.add_buffer(SQUARES, 0);
        let [sums, norm] = norms(&plan, settings, slots, squares);
        let step = optimiser(&plan, settings, slots.log, moments, &outputs);
        for part in [sums, norm, step] {
            plan.add_final_kernel(part);
        }
        Ok(Self { plan, slots, moments })
    }
}

impl Slots {
    fn new(plan: &mut Plan, network: &ActorCritic<f32>, size: Size) -> Self {
        let spec = network.spec();
        Self {
            observed: DeviceObservations::new(plan, network, size.rollout, size.draws),
            decisions: plan.add_buffer(size.rollout * (spec.action_irreps.len() + 2), 0),
            log: plan.add_buffer(ROW * (size.minibatches + 1), 0),
        }
    }
}

/// Creates the GPU kernel for the PPO loss and its gradient with respect to the network's outputs.
fn loss(
    plan: &Plan,
    network: &ActorCritic<f32>,
    settings: &PpoSettings,
    slots: Slots,
    outputs: &NetworkOutputs,
) -> Result<KernelStep, GpuError> {
    let [Some(d_mean), Some(d_value)] = [outputs.mean, outputs.value].map(|y| y.gradient) else {
        unreachable!("outputs of layers have gradients")
    };
    let order = &network.action_order;
    let components: Vec<String> = order.iter().map(|i| format!("{i}u")).collect();
    let (count, components) = (order.len(), components.join(", "));
    let list = format!("array<u32, {count}>");
    let step = KernelStep::new("loss", 1, WorkgroupCount::fixed_workgroups(1))
        .add_u32_constants([("ACTION", count), ("LOG_STD", outputs.log_std)])
        .add_f32_constant("CLIP", settings.clip.into())
        .add_f32_constant("VALUE", settings.value_weight.into())
        .add_f32_constant("ENTROPY", settings.entropy_weight.into())
        .add_f32_constant("KL_STOP", settings.kl_stop_threshold())
        .add_f32_constant("MAX_LOG_RATIO", MAX_LOG_RATIO)
        .add_wgsl(&format!("var<private> component: {list} = {list}({components});"))
        .add_wgsl(DRAW_STRUCT_WGSL)
        .add_wgsl(include_str!("wgsl/log.wgsl"))
        .add_input_buffer("draws", "Draw", slots.observed.draws)
        .add_input_buffer("decisions", "f32", slots.decisions)
        .add_input_buffer("params", "f32", plan.params_buffer())
        .add_input_buffer("mean", "f32", outputs.mean.values)
        .add_input_buffer("value", "f32", outputs.value.values)
        .add_output_buffer("d_mean", "f32", d_mean)
        .add_output_buffer("d_value", "f32", d_value)
        .add_output_buffer("gradient", "f32", plan.params_gradient_buffer())
        .add_output_buffer("log", "f32", slots.log)
        .add_workgroup_sum()
        .add_wgsl(include_str!("wgsl/loss.wgsl"));
    Ok(step)
}

/// Creates the two GPU kernels for the norm of the gradient: partial sums of squares, and their
/// total.
fn norms(
    plan: &Plan,
    settings: &PpoSettings,
    slots: Slots,
    squares: BufferSlot,
) -> [KernelStep; 2] {
    let sums = KernelStep::new("squares", 1, WorkgroupCount::fixed_workgroups(SQUARES))
        .add_u32_constants([("PARAMS", plan.num_device_params()), ("GROUPS", SQUARES)])
        .add_input_buffer("gradient", "f32", plan.params_gradient_buffer())
        .add_output_buffer("squares", "f32", squares)
        .add_workgroup_sum()
        .add_wgsl(include_str!("wgsl/squares.wgsl"));
    let norm = KernelStep::new("norm", 1, WorkgroupCount::fixed_workgroups(1))
        .add_f32_constant("MAX_NORM", settings.max_grad_norm.into())
        .add_wgsl(include_str!("wgsl/log.wgsl"))
        .add_input_buffer("squares", "f32", squares)
        .add_output_buffer("log", "f32", slots.log)
        .add_workgroup_sum()
        .add_wgsl(include_str!("wgsl/norm.wgsl"));
    [sums, norm]
}

/// Creates the GPU kernel for a step of Adam.
fn optimiser(
    plan: &Plan,
    settings: &PpoSettings,
    log: BufferSlot,
    moments: [BufferSlot; 2],
    outputs: &NetworkOutputs,
) -> KernelStep {
    let action = outputs.mean.shape.len();
    // only for the decays: the CPU's Adam is the single source of these constants
    let Adam { betas, epsilon, .. } = Adam::new(0, settings.adam_epsilon);
    KernelStep::new("adam", 1, WorkgroupCount::fixed_threads(plan.num_device_params()))
        .add_u32_constants([
            ("PARAMS", plan.num_device_params()),
            ("HEADS", outputs.heads),
            ("LOG_STD", outputs.log_std),
            ("ACTION", action),
        ])
        .add_f32_constant("BETA_1", betas[0].into())
        .add_f32_constant("BETA_2", betas[1].into())
        .add_f32_constant("EPSILON", epsilon.into())
        .add_f32_constant("FLOOR", settings.min_log_std.into())
        .add_wgsl(include_str!("wgsl/log.wgsl"))
        .add_input_buffer("gradient", "f32", plan.params_gradient_buffer())
        .add_input_buffer("log", "f32", log)
        .add_output_buffer("first_moment", "f32", moments[0])
        .add_output_buffer("second_moment", "f32", moments[1])
        .add_output_buffer("params", "f32", plan.params_buffer())
        .add_wgsl(include_str!("wgsl/adam.wgsl"))
}

#[cfg(test)]
mod tests {
    use symmetry::Irrep;

    use super::*;
    use crate::env::EnvSpec;
    use crate::network_settings::NetworkSettings;

    /// The number stated in docs/performance.md.
    #[test]
    fn a_minibatch_of_the_default_network_takes_51_kernels() {
        let action = vec![Irrep::X, Irrep::Y, Irrep::Trivial, Irrep::Trivial];
        let spec = EnvSpec {
            num_envs: 1,
            image_shape: [48, 48, 6],
            vector_irreps: action.clone(),
            action_irreps: action,
        };
        let network = ActorCritic::new(&NetworkSettings::default(), &spec).unwrap();
        let size = Size { rollout: 500, draws: 6000, minibatches: 96 };
        let graph = Graph::new(&network, &PpoSettings::default(), size).unwrap();
        assert_eq!(graph.plan.num_kernels(), [19, 32]);
    }
}
