//! Files of tensors: learners and networks.

use std::ops::Range;
use std::path::Path;

use covers::{Covers, CoversSettings, Extent, GroupingSettings, Labels, LearnerSettings};
use equivariant::{Layer, Linear, Relu, Sequential, Shape, Signature};
use rl::{BoxError, Critic, Encoder, EnvSpec, NetworkSettings, Observations, Outcome, PpoSettings};
use rl::{Transition, VectorEnv};
use symmetry::{Group, Irrep};

use super::{Reading, Target, accepted, in_file, measured, small_network};

/// The constant holds the learner that a valid file becomes.
pub const CHECKPOINT: Target = Target::new(
    "checkpoint",
    |input| in_file("checkpoint", &mended(input), read_checkpoint),
    checkpoints,
)
.holding(64, 1 << 16)
.tried(5_000);

pub const NETWORK: Target = Target::new(
    "network",
    |input| in_file("network", input, read_network),
    networks,
)
.holding(64, 1 << 12)
.tried(5_000);

/// The smallest learner that has everything: two frames kept of each of two episodes.
fn learner() -> LearnerSettings {
    LearnerSettings::Covers(CoversSettings {
        network: NetworkSettings {
            encoder: Encoder::Strided { fields: vec![1] },
            critic: Critic::Pooled { width: 1 },
            ..small_network()
        },
        ppo: PpoSettings {
            epochs: 1,
            ..PpoSettings::default()
        },
        grouping: GroupingSettings::Single,
        first_frames: 2,
        rollout_steps: 8,
        buffer_episodes: Some(2),
        ..CoversSettings::default()
    })
}

/// Environments whose episodes last two steps and show nothing.
struct Blank(EnvSpec);

fn blank() -> Blank {
    Blank(EnvSpec {
        num_envs: 2,
        image: [2, 2, 1],
        vector: vec![Irrep::X],
        action: vec![Irrep::X],
    })
}

impl VectorEnv for Blank {
    fn spec(&self) -> &EnvSpec {
        &self.0
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxError> {
        *out = Observations::new(&self.0);
        Ok(())
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxError> {
        let ended = out.outcomes[0].ended();
        *out = Transition::new(&self.0);
        out.rewards.copy_from_slice(actions);
        let outcome = [Outcome::Truncated, Outcome::Running][usize::from(ended)];
        out.outcomes.fill(outcome);
        Ok(())
    }
}

/// The file with the checksum that its bytes should have, so that a change gets past it; the file as
/// it is where it has no place for one.
fn mended(input: &[u8]) -> Vec<u8> {
    let mut file = input.to_vec();
    if let Some(place) = checksum_place(input) {
        file[place.clone()].fill(0);
        let checksum = crc32fast::hash(&file);
        file[place].copy_from_slice(&checksum.to_le_bytes());
    }
    file
}

fn checksum_place(file: &[u8]) -> Option<Range<usize>> {
    let length = u64::from_le_bytes(*file.first_chunk()?);
    let length = usize::try_from(length).ok()?.checked_add(8)?;
    let header: serde_json::Value = serde_json::from_slice(file.get(8..length)?).ok()?;
    let start = header["checksum"]["data_offsets"][0].as_u64()?;
    let start = usize::try_from(start).ok()?.checked_add(length)?;
    let place = start..start.checked_add(4)?;
    file.get(place.clone()).map(|_| place)
}

fn read_checkpoint(path: &Path) -> Option<Reading> {
    let (spec, labels) = (blank().0, Labels::default());
    measured(|| {
        accepted(learner().load(path, &spec, &labels))
            | accepted(learner().resume(path, &spec, &labels))
            | accepted(Covers::load(path, &spec))
    })
}

/// A learner before its first turn and after it, and one that was packed.
fn checkpoints() -> Vec<Vec<u8>> {
    let mut env = blank();
    let mut files = Vec::new();
    let Ok(mut learner) = learner().start(&env.0, &Labels::default()) else {
        return files;
    };
    let mut save = |learner: &dyn covers::Learner, extent| {
        in_file("seed", &[], |path| {
            let saved = learner.save(path, extent, "{}");
            files.extend(saved.ok().and_then(|()| std::fs::read(path).ok()));
        });
    };
    save(&*learner, Extent::Everything);
    if learner.learn(&mut env).is_ok() {
        save(&*learner, Extent::Everything);
        save(&*learner, Extent::Policies { episodes: 1 });
    }
    files
}

fn network() -> Option<Sequential<f32>> {
    let (from, to) = (Group::D2.trivial(2), Group::D2.regular(1));
    let layers: [Box<dyn Layer<f32>>; 3] = [
        Box::new(Linear::new(from, to).ok()?),
        Box::new(Relu::new(Shape::vector(to)).ok()?),
        Box::new(Linear::new(to, from).ok()?),
    ];
    Sequential::new(layers.into()).ok()
}

fn read_network(path: &Path) -> Option<Reading> {
    let network = network()?;
    measured(|| {
        let params = equivariant::load(path, &network);
        if let Ok(params) = &params {
            assert_eq!(params.len(), network.num_params());
        }
        accepted(params)
    })
}

fn networks() -> Vec<Vec<u8>> {
    let saved = network().and_then(|network| {
        let params = vec![0.5; network.num_params()];
        in_file("network-seed", &[], |path| {
            equivariant::save(path, &network, &params).ok()?;
            std::fs::read(path).ok()
        })
    });
    saved.into_iter().collect()
}
