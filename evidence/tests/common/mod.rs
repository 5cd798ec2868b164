//! Episodes of worlds, acted by experts.

#![allow(dead_code, clippy::unwrap_used)]

use evidence::{Account, Accountant, Course, RecogniserSettings};
use rl::{Observations, Transition, VectorEnv};
use symmetry::{D2, Irrep};
use worlds::{Kind, Stream, Visit, World};

pub const HORIZON: usize = 12;
const AXES: [Irrep; 2] = [Irrep::X, Irrep::Y];

/// Shows groups of a world for some rounds each.
pub fn stream(kind: Kind, seed: u64, visits: &[(usize, usize)], envs: usize) -> Stream {
    let visits = visits
        .iter()
        .map(|&(group, rounds)| Visit { group, rounds });
    let world = World::draw(kind, seed);
    let stream = Stream::new(world, visits.collect(), envs).unwrap();
    stream.with_horizon(HORIZON)
}

/// The courses of `rounds` rounds, acted for the group `as_group`; without one, for the group that
/// runs.
pub fn courses(mut stream: Stream, rounds: usize, as_group: Option<usize>) -> Vec<Course> {
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
            let group = as_group.unwrap_or(stream.group_at(stream.rounds()));
            let actions = (0..spec.num_envs).flat_map(|env| stream.expert(env, group));
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

pub fn accounts(stream: Stream, rounds: usize, as_group: Option<usize>) -> Vec<Account> {
    let filters = RecogniserSettings::default().filters;
    let accountant = Accountant::new([48, 48, 6], &AXES, &AXES, filters).unwrap();
    accountant
        .accounts(&courses(stream, rounds, as_group))
        .unwrap()
}

pub fn mirrored(stream: Stream, g: D2) -> Stream {
    stream.with_variant(g)
}
