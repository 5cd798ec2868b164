//! An update as a plan for a GPU: the network, its loss, and the optimiser.

use equivariant::gpu::{GpuError, Plan, Slot, Step, Work};

use crate::adam::Adam;
use crate::device::network::{DRAW, Observed, Outputs, add_network};
use crate::loss::LARGEST_LOG_RATIO;
use crate::network::ActorCritic;
use crate::ppo_settings::PpoSettings;

/// Numbers of a row of the log; the first row is the state.
pub(super) const ROW: usize = 8;
/// Partial sums of squares: as many as the threads that add them up.
const SQUARES: usize = 64;

/// How much an update may hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Size {
    /// Decisions of the rollout.
    pub rollout: usize,
    /// Decisions of all minibatches of all passes.
    pub draws: usize,
    /// Minibatches of all passes.
    pub minibatches: usize,
}

/// The plan and its buffers.
pub(super) struct Graph {
    pub plan: Plan,
    pub slots: Slots,
    /// First and second moment of Adam.
    pub moments: [Slot; 2],
}

/// What the processor writes and reads besides parameters.
#[derive(Clone, Copy)]
pub(super) struct Slots {
    /// The rollout's observations, and the draws from them.
    pub observed: Observed,
    /// Action, irrep-major, log-probability and return of each decision of the rollout.
    pub decisions: Slot,
    /// The state and a row for each minibatch.
    pub log: Slot,
}

impl Graph {
    pub fn new(
        network: &ActorCritic<f32>,
        settings: &PpoSettings,
        size: Size,
    ) -> Result<Self, GpuError> {
        let mut plan = Plan::new();
        let slots = Slots::new(&mut plan, network, size);
        let outputs = add_network(&mut plan, network, slots.observed)?;
        let loss = loss(&plan, network, settings, slots, &outputs)?;
        plan.push(vec![loss], Vec::new());
        let params = plan.device_params();
        let moments = [(); 2].map(|()| plan.buffer(params, 0));
        let squares = plan.buffer(SQUARES, 0);
        let [sums, norm] = norms(&plan, settings, slots, squares);
        let step = optimiser(&plan, settings, (slots, moments), &outputs);
        for step in [sums, norm, step] {
            plan.push_last(step);
        }
        Ok(Self {
            plan,
            slots,
            moments,
        })
    }
}

impl Slots {
    fn new(plan: &mut Plan, network: &ActorCritic<f32>, size: Size) -> Self {
        let spec = network.spec();
        Self {
            observed: Observed::new(plan, network, size.rollout, size.draws),
            decisions: plan.buffer(size.rollout * (spec.action.len() + 2), 0),
            log: plan.buffer(ROW * (size.minibatches + 1), 0),
        }
    }
}

/// The loss and its gradient in what the network puts out.
fn loss(
    plan: &Plan,
    network: &ActorCritic<f32>,
    settings: &PpoSettings,
    slots: Slots,
    outputs: &Outputs,
) -> Result<Step, GpuError> {
    let [Some(d_mean), Some(d_value)] = [outputs.mean, outputs.value].map(|y| y.gradient) else {
        unreachable!("outputs of layers have gradients")
    };
    let order = &network.action_order;
    let components: Vec<String> = order.iter().map(|i| format!("{i}u")).collect();
    let (count, components) = (order.len(), components.join(", "));
    let list = format!("array<u32, {count}>");
    let step = Step::new("loss", 1, Work::fixed_groups(1))
        .constants([("ACTION", count), ("LOG_STD", outputs.log_std)])
        .number("CLIP", settings.clip.into())
        .number("VALUE", settings.value_weight.into())
        .number("ENTROPY", settings.entropy_weight.into())
        .number("KL_STOP", settings.kl_stop())
        .number("LARGEST_LOG_RATIO", LARGEST_LOG_RATIO)
        .text(&format!(
            "var<private> component: {list} = {list}({components});"
        ))
        .text(DRAW)
        .text(include_str!("wgsl/log.wgsl"))
        .read("draws", "Draw", slots.observed.draws)
        .read("decisions", "f32", slots.decisions)
        .read("params", "f32", plan.params())
        .read("mean", "f32", outputs.mean.values)
        .read("value", "f32", outputs.value.values)
        .write("d_mean", "f32", d_mean)
        .write("d_value", "f32", d_value)
        .write("gradient", "f32", plan.gradient())
        .write("log", "f32", slots.log)
        .sums()
        .text(include_str!("wgsl/loss.wgsl"));
    Ok(step)
}

/// The norm of the gradient.
fn norms(plan: &Plan, settings: &PpoSettings, slots: Slots, squares: Slot) -> [Step; 2] {
    let sums = Step::new("squares", 1, Work::fixed_groups(SQUARES))
        .constants([("PARAMS", plan.device_params()), ("GROUPS", SQUARES)])
        .read("gradient", "f32", plan.gradient())
        .write("squares", "f32", squares)
        .sums()
        .text(include_str!("wgsl/squares.wgsl"));
    let norm = Step::new("norm", 1, Work::fixed_groups(1))
        .number("MAX_NORM", settings.max_grad_norm.into())
        .text(include_str!("wgsl/log.wgsl"))
        .read("squares", "f32", squares)
        .write("log", "f32", slots.log)
        .sums()
        .text(include_str!("wgsl/norm.wgsl"));
    [sums, norm]
}

/// A step of Adam.
fn optimiser(
    plan: &Plan,
    settings: &PpoSettings,
    (slots, moments): (Slots, [Slot; 2]),
    outputs: &Outputs,
) -> Step {
    let action = outputs.mean.shape.len();
    let Adam { betas, epsilon, .. } = Adam::new(0, settings.adam_epsilon);
    Step::new("adam", 1, Work::fixed_threads(plan.device_params()))
        .constants([
            ("PARAMS", plan.device_params()),
            ("HEADS", outputs.heads),
            ("LOG_STD", outputs.log_std),
            ("ACTION", action),
        ])
        .number("BETA_1", betas[0].into())
        .number("BETA_2", betas[1].into())
        .number("EPSILON", epsilon.into())
        .number("FLOOR", settings.min_log_std.into())
        .text(include_str!("wgsl/log.wgsl"))
        .read("gradient", "f32", plan.gradient())
        .read("log", "f32", slots.log)
        .write("first_moment", "f32", moments[0])
        .write("second_moment", "f32", moments[1])
        .write("params", "f32", plan.params())
        .text(include_str!("wgsl/adam.wgsl"))
}

#[cfg(test)]
mod tests {
    use symmetry::Irrep;

    use super::*;
    use crate::env::EnvSpec;
    use crate::network_settings::NetworkSettings;

    /// docs/performance.md says so.
    #[test]
    fn a_minibatch_of_the_default_network_takes_51_kernels() {
        let action = vec![Irrep::X, Irrep::Y, Irrep::Trivial, Irrep::Trivial];
        let spec = EnvSpec {
            num_envs: 1,
            image: [48, 48, 6],
            vector: action.clone(),
            action,
        };
        let network = ActorCritic::new(&NetworkSettings::default(), &spec).unwrap();
        let size = Size {
            rollout: 500,
            draws: 6000,
            minibatches: 96,
        };
        let graph = Graph::new(&network, &PpoSettings::default(), size).unwrap();
        assert_eq!(graph.plan.dispatches(), [19, 32]);
    }
}
