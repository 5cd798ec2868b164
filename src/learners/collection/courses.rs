//! The episodes of a rollout as they ran: what no policy's features show.

use evidence::Course;

use super::first_frames::Rollout;

/// Every episode that begins in `rollout`, which must begin with a reset after `before` decisions.
pub(super) fn courses<R: Rollout>(rollout: &R, before: usize) -> Vec<Course> {
    let envs = rollout.spec().num_envs;
    let mut courses = Vec::new();
    for env in 0..envs {
        let mut start = 0;
        while start < rollout.shown() {
            let ends = (start..rollout.shown()).find(|&step| rollout.outcome(step, env).ended());
            let stop = ends.map_or(rollout.shown(), |last| last + 1);
            courses.push(Course {
                began: before + start * envs,
                is_whole: ends.is_some(),
                ..course(rollout, env, start..stop)
            });
            start = stop;
        }
    }
    courses
}

fn course<R: Rollout>(rollout: &R, env: usize, steps: std::ops::Range<usize>) -> Course {
    let mut course = Course {
        image: rollout.observation(steps.start, env).0.to_vec(),
        ..Course::default()
    };
    for step in steps {
        course.vectors.extend(rollout.observation(step, env).1);
        course.actions.extend(rollout.action(step, env));
        course.rewards.push(rollout.reward(step, env));
    }
    course
}
