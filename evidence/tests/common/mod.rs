//! Episodes of worlds, acted by experts.

#![allow(dead_code, clippy::unwrap_used)]

use evidence::{
    EpisodeSummariser, EpisodeSummary, ImageFeatureCache, Recogniser, RecogniserSettings,
    RolloutDecision, RolloutDecisionContext, Trajectory,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{Observations, Transition, VectorEnv};
use symmetry::Irrep;
use worlds::{GroupVisit, TaskStream, World, WorldKind};

pub const HORIZON: usize = 12;
const AXES: [Irrep; 2] = [Irrep::X, Irrep::Y];

/// Shows groups of a world for some rounds each.
pub fn stream(kind: WorldKind, seed: u64, visits: &[(usize, usize)], envs: usize) -> TaskStream {
    let visits = visits.iter().map(|&(group, rounds)| GroupVisit::new(group, rounds));
    let world = World::random(kind, seed);
    let stream = TaskStream::new(world, visits.collect(), envs).unwrap();
    stream.with_horizon(HORIZON)
}

/// The trajectories of `rounds` rounds, acted for the group `as_group`; without one, for the group
/// that runs.
pub fn trajectories(
    mut stream: TaskStream,
    rounds: usize,
    as_group: Option<usize>,
) -> Vec<Trajectory> {
    let spec = stream.spec().clone();
    let mut now = Observations::new(&spec);
    stream.reset(&mut now).unwrap();
    let mut transition = Transition::new(&spec);
    let mut all = Vec::new();
    for round in 0..rounds {
        let began = round * HORIZON * spec.num_envs;
        let images = now.images.chunks(spec.image_len()).map(<[u8]>::to_vec);
        let begin = |image| Trajectory { began, image, is_whole: true, ..Trajectory::default() };
        let mut trajectories: Vec<Trajectory> = images.map(begin).collect();
        for _ in 0..HORIZON {
            let group = as_group.unwrap_or(stream.group_in_round(stream.num_rounds_ended()));
            let actions = (0..spec.num_envs).flat_map(|env| stream.expert_action(env, group));
            let actions: Vec<f32> = actions.collect();
            stream.step(&actions, &mut transition).unwrap();
            for (env, trajectory) in trajectories.iter_mut().enumerate() {
                trajectory.vectors.extend(&now.vectors[2 * env..2 * env + 2]);
                trajectory.actions.extend(&actions[2 * env..2 * env + 2]);
                trajectory.rewards.push(transition.rewards[env]);
            }
            now.clone_from(&transition.observations);
        }
        all.extend(trajectories);
    }
    all
}

pub fn summaries(
    stream: TaskStream,
    rounds: usize,
    as_group: Option<usize>,
) -> Vec<EpisodeSummary> {
    summaries_of(&trajectories(stream, rounds, as_group))
}

pub fn summaries_of(trajectories: &[Trajectory]) -> Vec<EpisodeSummary> {
    let filters = RecogniserSettings::default().filters;
    let summariser = EpisodeSummariser::new([48, 48, 6], &AXES, &AXES, filters).unwrap();
    summariser.summarise(trajectories, &mut ImageFeatureCache::default()).unwrap()
}

pub fn set_returns(summaries: &mut [EpisodeSummary], change: impl Fn(f32) -> f32) {
    let returns = summaries.iter_mut().filter_map(|summary| summary.episode_return.as_mut());
    returns.for_each(|value| *value = change(*value));
}

pub fn rng() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(0)
}

/// A recogniser with default settings that knows nothing.
pub fn fresh() -> Recogniser {
    Recogniser::new(RecogniserSettings::default()).unwrap()
}

/// Decision of a recogniser on a rollout that it may leave undecided. It does not remember the
/// rollout.
pub fn assign(
    recogniser: &Recogniser,
    seen: &[EpisodeSummary],
    collector: usize,
) -> RolloutDecision {
    recogniser
        .clone()
        .assign_rollout(seen, RolloutDecisionContext::for_collector(collector), &mut rng())
        .unwrap()
}

/// Context of a rollout that must be decided.
pub fn must_decide(collector: usize) -> RolloutDecisionContext<'static> {
    RolloutDecisionContext {
        allow_undecided: false,
        ..RolloutDecisionContext::for_collector(collector)
    }
}

/// Decision of a recogniser on a rollout that it must decide. It does not remember the rollout.
pub fn settle(
    recogniser: &Recogniser,
    seen: &[EpisodeSummary],
    collector: usize,
) -> RolloutDecision {
    recogniser.clone().assign_rollout(seen, must_decide(collector), &mut rng()).unwrap()
}

/// Review of a rollout by a recogniser, which does not remember the rollout.
pub fn review(
    recogniser: &Recogniser,
    seen: &[EpisodeSummary],
    context: RolloutDecisionContext,
) -> RolloutDecision {
    recogniser.clone().review_proposed_policy(seen, context, &mut rng()).unwrap()
}

/// A recogniser of the groups 0, 1, ... of a world, each known from two rollouts of its own policy;
/// the first of them had returns of 0.
pub fn knowing(kind: WorldKind, seed: u64, groups: usize) -> Recogniser {
    let mut recogniser = fresh();
    for group in 0..groups {
        train(&mut recogniser, group, summaries(stream(kind, seed, &[(group, 8)], 5), 8, None));
    }
    recogniser
}

/// Trains a policy on 20 episodes with returns of 0, and twice on the later ones.
pub fn train(recogniser: &mut Recogniser, policy: usize, mut seen: Vec<EpisodeSummary>) {
    let (first, later) = seen.split_at_mut(20);
    set_returns(first, |_| 0.0);
    for rollout in [&*first, &*later, &*later] {
        recogniser.record_training(policy, rollout, &mut rng()).unwrap();
    }
}

/// 20 episodes of a group that come later than those that the recogniser remembers.
pub fn rollout(kind: WorldKind, seed: u64, group: usize, as_group: usize) -> Vec<EpisodeSummary> {
    let all = summaries(stream(kind, seed, &[(group, 12)], 5), 12, Some(as_group));
    all[40..].to_vec()
}

/// Twelve numbers around this one, which scatter widely: most of the distance of two clouds is
/// chance.
fn around(centre: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
    (0..12).map(|_| centre + rng.random_range(-0.5..0.5)).collect()
}

/// Episodes whose image features scatter around one number and motion around another.
pub fn episodes(
    count: usize,
    image: f32,
    motion: f32,
    rng: &mut ChaCha8Rng,
) -> Vec<EpisodeSummary> {
    let episode = |began| EpisodeSummary {
        began,
        image_features: around(image, rng),
        first_vector: vec![0.0],
        motion: Some(around(motion, rng)),
        reward_gradient: Some(vec![1.0]),
        episode_return: Some(1.0),
    };
    (0..count).map(episode).collect()
}

/// A recogniser of policies that trained on episodes whose image features scatter around these
/// numbers.
pub fn knowing_images(images: &[f32]) -> (Recogniser, ChaCha8Rng) {
    let (mut rng, mut recogniser) = (rng(), fresh());
    for (policy, &image) in images.iter().enumerate() {
        let seen = episodes(40, image, 1.0, &mut rng);
        recogniser.record_training(policy, &seen, &mut rng).unwrap();
    }
    (recogniser, rng)
}
