//! Episodes of a stream, acted by stand-ins.

use evidence::{Account, Accountant, Course};
use rand_chacha::ChaCha8Rng;
use rl::{Observations, Transition, VectorEnv};
use worlds::Stream;

use crate::stand_in::StandIn;
use crate::trial::{ENVS, HORIZON, TrialError};

/// Lets a stand-in act for some rounds.
pub fn roll_out(
    stream: &mut Stream,
    now: &mut Observations,
    actor: &StandIn,
    (accountant, rounds): (&Accountant, usize),
    rng: &mut ChaCha8Rng,
) -> Result<Vec<Account>, TrialError> {
    let mut accounts = Vec::new();
    for _ in 0..rounds {
        let courses = round(stream, now, actor, rng)?;
        accounts.extend(accountant.accounts(&courses)?);
    }
    Ok(accounts)
}

fn round(
    stream: &mut Stream,
    now: &mut Observations,
    actor: &StandIn,
    rng: &mut ChaCha8Rng,
) -> Result<Vec<Course>, TrialError> {
    let spec = stream.spec().clone();
    let began = stream.rounds() * ENVS * HORIZON;
    let images = now.images.chunks(spec.image_len());
    let course = |image: &[u8]| Course {
        began,
        image: image.to_vec(),
        is_whole: true,
        ..Course::default()
    };
    let mut courses: Vec<Course> = images.map(course).collect();
    let mut transition = Transition::new(&spec);
    for _ in 0..HORIZON {
        let mut actions = Vec::with_capacity(2 * ENVS);
        for env in 0..ENVS {
            actions.extend(actor.act(stream, env, rng));
        }
        let stepped = stream.step(&actions, &mut transition);
        stepped.map_err(TrialError::Environment)?;
        for (env, course) in courses.iter_mut().enumerate() {
            course.vectors.extend(&now.vectors[2 * env..2 * env + 2]);
            course.actions.extend(&actions[2 * env..2 * env + 2]);
            course.rewards.push(transition.rewards[env]);
        }
        now.clone_from(&transition.observations);
    }
    Ok(courses)
}
