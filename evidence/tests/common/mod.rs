//! Episodes of worlds, acted by experts.

#![allow(dead_code, clippy::unwrap_used)]

use evidence::{
    Account, Accountant, Album, Course, Finding, Recogniser, RecogniserSettings, Situation,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{Observations, Transition, VectorEnv};
use symmetry::Irrep;
use worlds::{TaskStream, Visit, World, WorldKind};

pub const HORIZON: usize = 12;
const AXES: [Irrep; 2] = [Irrep::X, Irrep::Y];

/// Shows groups of a world for some rounds each.
pub fn stream(kind: WorldKind, seed: u64, visits: &[(usize, usize)], envs: usize) -> TaskStream {
    let visits = visits.iter().map(|&(group, rounds)| Visit::new(group, rounds));
    let world = World::random(kind, seed);
    let stream = TaskStream::new(world, visits.collect(), envs).unwrap();
    stream.with_horizon(HORIZON)
}

/// The courses of `rounds` rounds, acted for the group `as_group`; without one, for the group that
/// runs.
pub fn courses(mut stream: TaskStream, rounds: usize, as_group: Option<usize>) -> Vec<Course> {
    let spec = stream.spec().clone();
    let mut now = Observations::new(&spec);
    stream.reset(&mut now).unwrap();
    let mut transition = Transition::new(&spec);
    let mut all = Vec::new();
    for round in 0..rounds {
        let mut courses: Vec<Course> = now
            .images
            .chunks(spec.image_len())
            .map(|image| Course {
                began: round * HORIZON * spec.num_envs,
                image: image.to_vec(),
                is_whole: true,
                ..Course::default()
            })
            .collect();
        for _ in 0..HORIZON {
            let group = as_group.unwrap_or(stream.group_in_round(stream.num_rounds_ended()));
            let actions = (0..spec.num_envs).flat_map(|env| stream.expert_action(env, group));
            let actions: Vec<f32> = actions.collect();
            stream.step(&actions, &mut transition).unwrap();
            for (env, course) in courses.iter_mut().enumerate() {
                course.vectors.extend(&now.vectors[2 * env..2 * env + 2]);
                course.actions.extend(&actions[2 * env..2 * env + 2]);
                course.rewards.push(transition.rewards[env]);
            }
            now.clone_from(&transition.observations);
        }
        all.extend(courses);
    }
    all
}

pub fn accounts(stream: TaskStream, rounds: usize, as_group: Option<usize>) -> Vec<Account> {
    accounts_of(&courses(stream, rounds, as_group))
}

pub fn accounts_of(courses: &[Course]) -> Vec<Account> {
    let filters = RecogniserSettings::default().filters;
    let accountant = Accountant::new([48, 48, 6], &AXES, &AXES, filters).unwrap();
    accountant.accounts(courses, &mut Album::default()).unwrap()
}

/// Evidence on each policy, as text.
pub fn said(finding: &Finding) -> Vec<String> {
    finding.opinions.iter().map(ToString::to_string).collect()
}

pub fn rng() -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(0)
}

/// Decision of a recogniser on a rollout that it may leave undecided. It does not remember the
/// rollout.
pub fn look(recogniser: &Recogniser, seen: &[Account], collector: usize) -> Finding {
    recogniser.clone().assign(seen, Situation::of(collector), &mut rng()).unwrap()
}

/// Decision of a recogniser on a rollout that it must decide. It does not remember the rollout.
pub fn settle(recogniser: &Recogniser, seen: &[Account], collector: usize) -> Finding {
    let situation = Situation { can_wait: false, ..Situation::of(collector) };
    recogniser.clone().assign(seen, situation, &mut rng()).unwrap()
}

/// A recogniser of the groups 0, 1, ... of a world, each known from two rollouts of its own policy;
/// the first of them earned nothing.
pub fn knowing(kind: WorldKind, seed: u64, groups: usize) -> Recogniser {
    let mut recogniser = Recogniser::new(RecogniserSettings::default()).unwrap();
    for group in 0..groups {
        let mut home = accounts(stream(kind, seed, &[(group, 8)], 5), 8, None);
        let (first, later) = home.split_at_mut(20);
        first.iter_mut().for_each(|a| a.earned = Some(0.0));
        recogniser.learn(group, first, &mut rng()).unwrap();
        recogniser.learn(group, later, &mut rng()).unwrap();
        recogniser.learn(group, later, &mut rng()).unwrap();
    }
    recogniser
}

/// 20 episodes of a group that come later than those that the recogniser remembers.
pub fn rollout(kind: WorldKind, seed: u64, group: usize, as_group: usize) -> Vec<Account> {
    let all = accounts(stream(kind, seed, &[(group, 12)], 5), 12, Some(as_group));
    all[40..].to_vec()
}

/// Twelve numbers around this one, which scatter widely: most of the distance of two clouds is
/// chance.
fn around(centre: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
    (0..12).map(|_| centre + rng.random_range(-0.5..0.5)).collect()
}

/// Episodes of which the picture scatters around one number and motion around another.
pub fn episodes(count: usize, picture: f32, motion: f32, rng: &mut ChaCha8Rng) -> Vec<Account> {
    let episode = |began| Account {
        began,
        picture: around(picture, rng),
        vector: vec![0.0],
        motion: Some(around(motion, rng)),
        slope: Some(vec![1.0]),
        earned: Some(1.0),
    };
    (0..count).map(episode).collect()
}

/// A recogniser of policies at home in episodes whose pictures scatter around these numbers.
pub fn knowing_pictures(pictures: &[f32]) -> (Recogniser, ChaCha8Rng) {
    let mut rng = rng();
    let mut recogniser = Recogniser::new(RecogniserSettings::default()).unwrap();
    for (policy, &picture) in pictures.iter().enumerate() {
        let home = episodes(40, picture, 1.0, &mut rng);
        recogniser.learn(policy, &home, &mut rng).unwrap();
    }
    (recogniser, rng)
}
