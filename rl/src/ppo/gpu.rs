//! PPO updates on a GPU: a plan of kernels for the network, the loss and the optimiser.

use equivariant::gpu::{
    BatchUniforms, BufferSlot, CompiledPlan, ComputePlan, GpuError, KernelDispatch, PassesToRun,
    WorkgroupCount,
};
use rand_chacha::ChaCha8Rng;

use crate::adam::{Adam, bias_correction};
use crate::device::{NetworkOutputs, ObservationBuffers, SAMPLE_STRUCT_WGSL, add_network};
use crate::env::Observations;
use crate::error::{RlError, check_finite};
use crate::network::ActorCritic;
use crate::ppo::minibatch::{Backend, MAX_LOG_RATIO, Minibatch, Update};
use crate::ppo::settings::PpoSettings;
use crate::ppo::stats::{LossSums, PpoTotals};

/// Number of values in a row of the statistics that the GPU logs: the first row is the state of the
/// update, the others belong to one minibatch each.
const LOG_ROW_LEN: usize = 8;
/// Number of partial sums of the gradient's squared components, equal to the number of threads that
/// add them up.
const NUM_PARTIAL_SQUARES: usize = 64;

/// A GPU as a [`Backend`] of PPO updates. It queues all minibatches without waiting for results;
/// once the KL divergence stops the update, the remaining minibatches have no effect.
pub(super) struct GpuBackend {
    device: equivariant::gpu::GpuDevice,
    queue: QueuedMinibatches,
    /// Kernels of the update, compiled at the first update and again for larger sizes.
    compiled: Option<CompiledUpdate>,
}

struct CompiledUpdate {
    size: UpdateSize,
    update_plan: UpdatePlan,
    program: CompiledPlan,
}

/// Minibatches of all epochs of an update, in order.
#[derive(Default)]
struct QueuedMinibatches {
    /// Index in the rollout and normalised advantage of each decision of each minibatch, as two
    /// 32-bit words.
    samples: Vec<u32>,
    /// Position of the first decision among all `samples`, and number of decisions, of each
    /// minibatch.
    minibatches: Vec<(usize, usize)>,
    /// State of the random generator after the shuffle of each minibatch's epoch.
    generators: Vec<ChaCha8Rng>,
}

impl Backend for GpuBackend {
    fn losses(
        &mut self,
        update: &Update,
        minibatch: &Minibatch,
    ) -> Result<Option<(LossSums, &mut [f32])>, RlError> {
        self.queue.push(minibatch, update.rng);
        Ok(None)
    }

    fn finish(&mut self, update: &mut Update) -> Result<Option<PpoTotals>, RlError> {
        let queue = std::mem::take(&mut self.queue);
        let compiled = self.compiled(update, &queue)?;
        compiled.write(update, &queue);
        compiled.submit(update, &queue);
        compiled.read(update, &queue).map(Some)
    }
}

impl GpuBackend {
    pub fn new(device: &equivariant::gpu::GpuDevice) -> Self {
        Self { device: device.clone(), queue: QueuedMinibatches::default(), compiled: None }
    }

    fn compiled(
        &mut self,
        update: &Update,
        queue: &QueuedMinibatches,
    ) -> Result<&CompiledUpdate, GpuError> {
        let needed = UpdateSize {
            rollout: update.buffer.num_samples(),
            samples: queue.samples.len() / 2,
            minibatches: queue.minibatches.len(),
        };
        // compiled buffers also serve smaller updates
        let known = self.compiled.take().filter(|known| known.size.holds(needed));
        let compiled = match known {
            Some(known) => known,
            None => CompiledUpdate::new(&self.device, update, needed)?,
        };
        Ok(self.compiled.insert(compiled))
    }
}

impl UpdateSize {
    fn holds(self, needed: UpdateSize) -> bool {
        self.rollout >= needed.rollout
            && self.samples >= needed.samples
            && self.minibatches >= needed.minibatches
    }
}

impl QueuedMinibatches {
    fn push(&mut self, minibatch: &Minibatch, rng: &ChaCha8Rng) {
        let Minibatch { indices, advantages, .. } = minibatch;
        self.minibatches.push((self.samples.len() / 2, indices.len()));
        self.generators.push(rng.clone());
        let samples = indices.iter().zip(*advantages);
        let words = samples.flat_map(|(&i, &a)| [i as u32, (a as f32).to_bits()]);
        self.samples.extend(words);
    }
}

impl CompiledUpdate {
    fn new(
        device: &equivariant::gpu::GpuDevice,
        update: &Update,
        size: UpdateSize,
    ) -> Result<Self, GpuError> {
        let update_plan = UpdatePlan::new(update.policy.network(), update.settings, size)?;
        let program = CompiledPlan::new(
            device,
            &update_plan.plan,
            update.settings.minibatch.min(size.rollout),
        )?;
        Ok(Self { size, update_plan, program })
    }

    /// Copies parameters, Adam's moments, the rollout and its minibatches to the GPU.
    fn write(&self, update: &Update, queue: &QueuedMinibatches) {
        let UpdatePlan { plan, buffers, moments } = &self.update_plan;
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
        buffers.observation_buffers.upload(&self.program, network, images, vectors);
        self.program.write_floats(buffers.decisions, &decisions(network, update));
        self.program.write_words(buffers.observation_buffers.samples, &queue.samples);
        // zeros: the state RUNNING, and no row written yet
        self.program.write_floats(buffers.log, &vec![0.0; log_len(queue)]);
    }

    /// Queues the kernels of every minibatch on the GPU.
    fn submit(&self, update: &Update, queue: &QueuedMinibatches) {
        let [encoder, heads] = update.param_groups().map(|group| group.learning_rate);
        for (index, &(start, samples)) in queue.minibatches.iter().enumerate() {
            let steps = update.optimiser.steps + index as u64 + 1;
            // Adam's bias corrections, computed here in f64, which kernels do not have
            let [first, second] = update.optimiser.betas.map(|beta| bias_correction(beta, steps));
            let batch = BatchUniforms {
                samples,
                start,
                index,
                extra_numbers: [encoder / first, heads / first, second.sqrt(), 0.0],
            };
            self.program.submit_passes(PassesToRun::All, batch);
        }
    }

    /// Waits for the queued minibatches and copies their results to the policy, optimiser and
    /// random generator.
    fn read(&self, update: &mut Update, queue: &QueuedMinibatches) -> Result<PpoTotals, RlError> {
        let UpdatePlan { plan, buffers, moments: [first, second] } = &self.update_plan;
        let [params, first, second] =
            [plan.params_buffer(), *first, *second].map(|slot| (slot, plan.num_device_params()));
        let log = (buffers.log, log_len(queue));
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
        let begun = totals.steps.min(queue.generators.len() - 1);
        update.rng.clone_from(&queue.generators[begun]);
        outcome.map(|()| totals)
    }
}

impl PpoTotals {
    /// Adds the sums that the GPU logged for each minibatch, up to the one that ended the update.
    fn add_log(&mut self, log: &[f32], epochs: usize) -> Result<(), RlError> {
        let rows = log.chunks_exact(LOG_ROW_LEN).skip(1);
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
            self.losses.add_sums(&LossSums {
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

fn log_len(queue: &QueuedMinibatches) -> usize {
    LOG_ROW_LEN * (queue.minibatches.len() + 1)
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
struct UpdateSize {
    /// Number of decisions of the rollout.
    rollout: usize,
    /// Number of decisions in all minibatches of all epochs.
    samples: usize,
    /// Number of minibatches of all epochs.
    minibatches: usize,
}

/// Kernels of a PPO update in a [`ComputePlan`] for a GPU, and the buffers that they share with the
/// CPU.
struct UpdatePlan {
    plan: ComputePlan,
    buffers: UpdateBuffers,
    /// GPU buffers of Adam's first and second moment.
    moments: [BufferSlot; 2],
}

/// GPU buffers of a PPO update that the CPU writes and reads, besides parameters and moments.
#[derive(Clone, Copy)]
struct UpdateBuffers {
    /// Buffers of the rollout's observations, and of the minibatches' decisions, which refer to
    /// them by index.
    observation_buffers: ObservationBuffers,
    /// Buffer of action (irrep-major), log-probability and return of each decision of the rollout.
    decisions: BufferSlot,
    /// Buffer of statistics: the state of the update, then one row for each minibatch.
    log: BufferSlot,
}

impl UpdatePlan {
    fn new(
        network: &ActorCritic<f32>,
        settings: &PpoSettings,
        size: UpdateSize,
    ) -> Result<Self, GpuError> {
        let mut plan = ComputePlan::new();
        let buffers = UpdateBuffers::new(&mut plan, network, size);
        let outputs = add_network(&mut plan, network, buffers.observation_buffers)?;
        let loss = loss(&plan, network, settings, buffers, &outputs)?;
        plan.add_kernels(vec![loss], Vec::new());
        let params = plan.num_device_params();
        let moments = [(); 2].map(|()| plan.add_buffer(params, 0));
        let squares = plan.add_buffer(NUM_PARTIAL_SQUARES, 0);
        let [sums, norm] = norms(&plan, settings, buffers, squares);
        let adam = optimiser(&plan, settings, buffers.log, moments, &outputs);
        for part in [sums, norm, adam] {
            plan.add_final_kernel(part);
        }
        Ok(Self { plan, buffers, moments })
    }
}

impl UpdateBuffers {
    fn new(plan: &mut ComputePlan, network: &ActorCritic<f32>, size: UpdateSize) -> Self {
        let spec = network.spec();
        Self {
            observation_buffers: ObservationBuffers::new(plan, network, size.rollout, size.samples),
            decisions: plan.add_buffer(size.rollout * (spec.action_irreps.len() + 2), 0),
            log: plan.add_buffer(LOG_ROW_LEN * (size.minibatches + 1), 0),
        }
    }
}

fn loss(
    plan: &ComputePlan,
    network: &ActorCritic<f32>,
    settings: &PpoSettings,
    buffers: UpdateBuffers,
    outputs: &NetworkOutputs,
) -> Result<KernelDispatch, GpuError> {
    let [Some(d_mean), Some(d_value)] = [outputs.mean, outputs.value].map(|y| y.gradient) else {
        unreachable!("outputs of layers have gradients")
    };
    let order = &network.action_order;
    let components: Vec<String> = order.iter().map(|i| format!("{i}u")).collect();
    let (count, components) = (order.len(), components.join(", "));
    let list = format!("array<u32, {count}>");
    let kernel = KernelDispatch::new("loss", 1, WorkgroupCount::for_fixed_workgroups(1))
        .add_u32_constants([("ACTION", count), ("LOG_STD", outputs.log_std_start)])
        .add_f32_constant("CLIP", settings.clip.into())
        .add_f32_constant("VALUE", settings.value_weight.into())
        .add_f32_constant("ENTROPY", settings.entropy_weight.into())
        .add_f32_constant("KL_STOP", settings.kl_stop_threshold())
        .add_f32_constant("MAX_LOG_RATIO", MAX_LOG_RATIO)
        .add_wgsl(&format!("var<private> component: {list} = {list}({components});"))
        .add_wgsl(SAMPLE_STRUCT_WGSL)
        .add_wgsl(include_str!("wgsl/log.wgsl"))
        .add_input_buffer("samples", "Sample", buffers.observation_buffers.samples)
        .add_input_buffer("decisions", "f32", buffers.decisions)
        .add_input_buffer("params", "f32", plan.params_buffer())
        .add_input_buffer("mean", "f32", outputs.mean.values)
        .add_input_buffer("value", "f32", outputs.value.values)
        .add_output_buffer("d_mean", "f32", d_mean)
        .add_output_buffer("d_value", "f32", d_value)
        .add_output_buffer("gradient", "f32", plan.params_gradient_buffer())
        .add_output_buffer("log", "f32", buffers.log)
        .add_workgroup_sum()
        .add_wgsl(include_str!("wgsl/loss.wgsl"));
    Ok(kernel)
}

/// Creates the two GPU kernels for the norm of the gradient: partial sums of squares, and their
/// total.
fn norms(
    plan: &ComputePlan,
    settings: &PpoSettings,
    buffers: UpdateBuffers,
    squares: BufferSlot,
) -> [KernelDispatch; 2] {
    let sums = KernelDispatch::new(
        "squares",
        1,
        WorkgroupCount::for_fixed_workgroups(NUM_PARTIAL_SQUARES),
    )
    .add_u32_constants([("PARAMS", plan.num_device_params()), ("GROUPS", NUM_PARTIAL_SQUARES)])
    .add_input_buffer("gradient", "f32", plan.params_gradient_buffer())
    .add_output_buffer("squares", "f32", squares)
    .add_workgroup_sum()
    .add_wgsl(include_str!("wgsl/squares.wgsl"));
    let norm = KernelDispatch::new("norm", 1, WorkgroupCount::for_fixed_workgroups(1))
        .add_f32_constant("MAX_NORM", settings.max_grad_norm.into())
        .add_wgsl(include_str!("wgsl/log.wgsl"))
        .add_input_buffer("squares", "f32", squares)
        .add_output_buffer("log", "f32", buffers.log)
        .add_workgroup_sum()
        .add_wgsl(include_str!("wgsl/norm.wgsl"));
    [sums, norm]
}

/// Creates the GPU kernel for a step of Adam.
fn optimiser(
    plan: &ComputePlan,
    settings: &PpoSettings,
    log: BufferSlot,
    moments: [BufferSlot; 2],
    outputs: &NetworkOutputs,
) -> KernelDispatch {
    let action = outputs.mean.shape.len();
    // only for the decays: the CPU's Adam is the single source of these constants
    let Adam { betas, epsilon, .. } = Adam::new(0, settings.adam_epsilon);
    KernelDispatch::new("adam", 1, WorkgroupCount::for_fixed_threads(plan.num_device_params()))
        .add_u32_constants([
            ("PARAMS", plan.num_device_params()),
            ("HEADS", outputs.head_params_start),
            ("LOG_STD", outputs.log_std_start),
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
            choices: vec![],
        };
        let network = ActorCritic::new(&NetworkSettings::default(), &spec).unwrap();
        let size = UpdateSize { rollout: 500, samples: 6000, minibatches: 96 };
        let update_plan = UpdatePlan::new(&network, &PpoSettings::default(), size).unwrap();
        assert_eq!(update_plan.plan.num_kernels_per_pass(), [19, 32]);
    }
}
