//! Fuzz target of learners in checkpoint files.

use std::path::Path;
use std::sync::LazyLock;

use covers::{
    CheckpointExtent, CoversLearner, Learner, LearnerSettings, OffPolicyLearner, TaskLabel,
};
use rl::{EnvSpec, VectorEnv};
use serde_json::Value;

use super::learners::{clock, learners, taught};
use super::small::is_small_learner;
use super::tensors::{parts, sealed};
use super::{Reading, Target, accepted, in_file, measured};

/// Target of checkpoints. Its constant is the memory of the learner that a valid file becomes.
pub const CHECKPOINT: Target =
    Target::new("checkpoint", read, checkpoints).holding(64, 1 << 18).tried(5_000);

static LEARNERS: LazyLock<Vec<LearnerSettings>> = LazyLock::new(learners);

/// Reads a byte that chooses the learner, then the parts of the file, separated by zeros.
fn read(input: &[u8]) -> Option<Reading> {
    let (&kind, rest) = input.split_first()?;
    let mut parts = rest.splitn(3, |&byte| byte == 0);
    let envelope = str::from_utf8(parts.next()?).ok()?;
    let arrays = str::from_utf8(parts.next()?).ok()?;
    let file = sealed(envelope, arrays, parts.next()?)?;
    let settings = &LEARNERS[usize::from(kind) % LEARNERS.len()];
    let others = small_settings(settings, envelope);
    let (spec, labels) = (clock().spec().clone(), TaskLabel::default());
    in_file("checkpoint", &file, |path| {
        measured(|| {
            accepted(settings.load_for_acting(path, &spec, &labels))
                | accepted(settings.load_for_training(path, &spec, &labels))
                | others.is_some_and(|small| by_its_own_settings(&small, path, &spec))
        })
    })
}

/// Returns the settings in the file itself, if such a learner is built quickly.
fn small_settings(like: &LearnerSettings, envelope: &str) -> Option<LearnerSettings> {
    let mut envelope: Value = serde_json::from_str(envelope).ok()?;
    let settings = envelope.pointer_mut("/header/settings")?.take();
    let settings = match like {
        LearnerSettings::Covers(_) => {
            LearnerSettings::Covers(serde_json::from_value(settings).ok()?)
        }
        LearnerSettings::OffPolicy(_) => {
            LearnerSettings::OffPolicy(serde_json::from_value(settings).ok()?)
        }
    };
    is_small_learner(&settings).then_some(settings)
}

fn by_its_own_settings(settings: &LearnerSettings, path: &Path, spec: &EnvSpec) -> bool {
    match settings {
        LearnerSettings::Covers(_) => accepted(CoversLearner::load(path, spec)),
        LearnerSettings::OffPolicy(_) => accepted(OffPolicyLearner::load(path, spec)),
    }
}

fn checkpoints() -> Vec<Vec<u8>> {
    let seeds = LEARNERS.iter().enumerate().filter_map(seeds_of);
    seeds.flatten().collect()
}

/// Returns files of a learner before its first rollout, after two, and packed.
fn seeds_of((kind, settings): (usize, &LearnerSettings)) -> Option<Vec<Vec<u8>>> {
    let mut learner = settings.new_learner(clock().spec(), &TaskLabel::default()).ok()?;
    let save = |any: &dyn Learner, extent| {
        let bytes = any.to_checkpoint_bytes(Path::new("seed"), extent, "{}").ok()?;
        seed(kind, &bytes)
    };
    let before = save(&*learner, CheckpointExtent::Everything)?;
    taught(&mut *learner)?;
    let after = save(&*learner, CheckpointExtent::Everything)?;
    let packed = save(&*learner, CheckpointExtent::Policies { episodes_per_policy: 4 })?;
    Some(vec![before, after, packed])
}

fn seed(kind: usize, file: &[u8]) -> Option<Vec<u8>> {
    let (envelope, arrays, data) = parts(file)?;
    let kind = [u8::try_from(kind).ok()?];
    Some([&kind, envelope.as_bytes(), &[0], arrays.as_bytes(), &[0], &data].concat())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every kind of learner has three files, and all of them can be read.
    #[test]
    fn every_seed_is_a_learner() {
        let seeds = checkpoints();
        assert_eq!(seeds.len(), 3 * LEARNERS.len());
        for (index, seed) in seeds.iter().enumerate() {
            let reading = CHECKPOINT.run(seed);
            assert!(reading.is_some_and(|reading| reading.accepted), "{index}");
        }
    }
}
