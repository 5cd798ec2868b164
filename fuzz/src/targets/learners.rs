//! Smallest learners of every kind and grouping, and tiny environments for them.

use covers::{
    CoversSettings, GroupingSettings, Learner, LearnerSettings, NewPolicyInit, OffPolicySettings,
    ReassignedRolloutHandling,
};
use rl::{
    BoxedEnvError, CriticSettings, EncoderSettings, EnvSpec, NetworkSettings, Observations,
    PpoSettings, RecurrentContextSettings, SacSettings, StepOutcome, Transition, VectorEnv,
};
use symmetry::Irrep;

use super::small::small_network;

/// Returns learners of every kind and grouping. The first needs one rollout to have all of its
/// state, the others need two.
pub fn learners() -> Vec<LearnerSettings> {
    let on_policy = of_covers().map(LearnerSettings::Covers);
    let off_policy = with_replays().map(LearnerSettings::OffPolicy);
    on_policy.into_iter().chain(off_policy).collect()
}

const THRESHOLD: GroupingSettings = GroupingSettings::Threshold { threshold: 0.0 };

fn evidence() -> GroupingSettings {
    let text = r#"{"evidence": {"filters": 1, "memory": 4}}"#;
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{text}: {error}"))
}

fn of_covers() -> [CoversSettings; 4] {
    let grouped = |grouping| CoversSettings { grouping, ..covers() };
    [
        grouped(GroupingSettings::Oracle),
        grouped(GroupingSettings::Single),
        CoversSettings {
            handover: ReassignedRolloutHandling::Reuse,
            new_policy: NewPolicyInit::Copy,
            ..grouped(THRESHOLD)
        },
        grouped(evidence()),
    ]
}

fn with_replays() -> [OffPolicySettings; 3] {
    let grouped = |grouping| OffPolicySettings { grouping, ..off_policy() };
    [
        grouped(GroupingSettings::Single),
        OffPolicySettings {
            context: Some(RecurrentContextSettings { size: 4, length: 2 }),
            ..grouped(THRESHOLD)
        },
        OffPolicySettings { still_channels: 0, ..grouped(evidence()) },
    ]
}

fn network() -> NetworkSettings {
    NetworkSettings { encoder: EncoderSettings::Strided { fields: vec![1; 3] }, ..small_network() }
}

/// Returns settings by which a buffer keeps two frames of each of four episodes.
fn covers() -> CoversSettings {
    CoversSettings {
        network: NetworkSettings { critic: CriticSettings::Pooled { width: 1 }, ..network() },
        ppo: PpoSettings { epochs: 1, ..PpoSettings::default() },
        first_frames: 2,
        rollout_steps: 8,
        buffer_episodes: Some(4),
        ..CoversSettings::default()
    }
}

/// Returns settings by which the replay buffer has dropped steps after the second rollout.
fn off_policy() -> OffPolicySettings {
    OffPolicySettings {
        network: network(),
        sac: SacSettings {
            batch: 4,
            window: 2,
            burn_in: 4,
            updates_per_step: 0.25,
            ..SacSettings::paper()
        },
        capacity: 12,
        warm_up: 2,
        still_channels: 1,
        newest_steps: 4,
        first_frames: 2,
        rollout_steps: 8,
        buffer_episodes: Some(4),
        ..OffPolicySettings::default()
    }
}

/// Environments whose episodes last two steps. One pixel is the number of the step.
pub struct Clock {
    spec: EnvSpec,
    now: u8,
}

/// Creates two environments.
pub fn clock() -> Clock {
    let spec = EnvSpec {
        num_envs: 2,
        image_shape: [8, 8, 2],
        vector_irreps: vec![Irrep::X],
        action_irreps: vec![Irrep::X],
        choices: vec![],
    };
    Clock { spec, now: 0 }
}

impl Clock {
    fn observe(&self, out: &mut Observations) {
        *out = Observations::new(&self.spec);
        let pictures = out.images.chunks_mut(self.spec.image_len());
        pictures.for_each(|picture| picture[0] = self.now);
        out.vectors.fill(f32::from(self.now));
    }
}

impl VectorEnv for Clock {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError> {
        self.observe(out);
        Ok(())
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        *out = Transition::new(&self.spec);
        self.now += 1;
        self.observe(&mut out.observations);
        self.observe(&mut out.final_observations);
        out.rewards.copy_from_slice(actions);
        let ended = self.now.is_multiple_of(2);
        let outcome = [StepOutcome::Running, StepOutcome::Truncated][usize::from(ended)];
        out.outcomes.fill(outcome);
        Ok(())
    }
}

/// Trains a learner on one rollout, and on another if it needs no label for it.
pub fn taught(learner: &mut dyn Learner) -> Option<()> {
    let mut env = clock();
    learner.learn(&mut env).ok()?;
    // labels come from a run: an oracle has none for its second rollout
    let _ = learner.learn(&mut env);
    Some(())
}
