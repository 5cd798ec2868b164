//! Environments that show vectors alone, images alone, or images that are not square.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Algorithm, CriticSettings, EncoderSettings, EnvSpec, ExportPolicy,
    NetworkSettings, Observations, Ppo, PpoSettings, RecurrentContextSettings, ReplayBuffer,
    ReplaySettings, RlError, RolloutState, Sac, SacPolicy, SacSettings, Transition, ValueFunction,
    VectorEnv, check_env_symmetry, collect_experience,
};
use symmetry::Group;

use crate::common::steps::{
    OnPolicyRun, Spoiling, TOLERANCE, assert_equivariant_under_only, equivariance_errors, error,
    joint, random_observations, transformed,
};
use crate::common::{EPISODE, PointReach};

const ENVS: usize = 6;

/// An image and the components of a vector.
type Space = ([usize; 3], usize);

const VECTOR_ONLY: Space = (EnvSpec::NO_IMAGE, 4);
const SPACES: [Space; 5] =
    [VECTOR_ONLY, ([8, 8, 2], 0), ([8, 12, 2], 2), ([16, 8, 2], 0), ([8, 4, 2], 4)];

fn env((image, components): Space) -> PointReach {
    PointReach::showing(ENVS, 1, image, components)
}

fn encoders() -> [EncoderSettings; 2] {
    [vec![2], vec![2, 2]].map(|fields| EncoderSettings::Strided { fields })
}

fn network(encoder: EncoderSettings, group: Group) -> NetworkSettings {
    NetworkSettings { group, action_gain: 1.0, ..joint(encoder, 4) }
}

/// Two updates from collected rollouts; returns the policy, which has moved.
fn trained_by_ppo(space: Space, network: &NetworkSettings) -> ActorCriticPolicy {
    let env = env(space);
    let policy = ActorCriticPolicy::new(network, env.spec(), 2).unwrap();
    let before = policy.params().to_vec();
    let settings = PpoSettings { max_kl: 1.0, ..PpoSettings::default() };
    let mut ppo = Ppo::new(settings, &policy).unwrap();
    let mut run = OnPolicyRun::new(env, policy, EPISODE + 3);
    for _ in 0..2 {
        run.collect();
        let stats = ppo.update(&mut run.policy, &run.buffer, &mut run.rng).unwrap();
        assert!(stats.steps > 0 && stats.grad_norm > 0.0);
    }
    run.buffer.reevaluate(&mut run.policy).unwrap();
    let trained = run.policy.network();
    for own in [trained.encoder_param_range(), trained.non_encoder_param_range()] {
        assert!(own.is_empty() || run.policy.params()[own.clone()] != before[own]);
    }
    run.policy
}

#[test]
fn ppo_trains_an_equivariant_policy_in_every_space() {
    for space in SPACES {
        for encoder in encoders() {
            for group in [Group::D2, Group::D1x] {
                let joint = network(encoder.clone(), group);
                let critic = CriticSettings::Pooled { width: 3 };
                for network in [NetworkSettings { critic, ..joint.clone() }, joint] {
                    let spec = env(space).spec().clone();
                    let mut policy = trained_by_ppo(space, &network);
                    let what = format!("{space:?}");
                    assert_equivariant_under_only(group, &what, |g| {
                        equivariance_errors(&mut policy, &spec, g)
                    });
                    let seen = random_observations(&spec, &mut ChaCha8Rng::seed_from_u64(11));
                    for &g in group.elements() {
                        let moved = transformed(&spec, &seen, g, g);
                        let [here, there] = [&seen, &moved].map(|seen| {
                            let mut values = vec![0.0; ENVS];
                            policy.values(seen, &mut values).unwrap();
                            values
                        });
                        assert!(error(&there, &here) < TOLERANCE, "{space:?} {g}");
                    }
                }
            }
        }
    }
}

/// With a context and moved windows; the replay that a state was saved of samples the same steps.
#[test]
fn sac_trains_an_equivariant_policy_in_every_space() {
    let short_context = Some(RecurrentContextSettings { size: 4, length: 3 });
    for space in SPACES {
        for (encoder, context) in encoders().into_iter().zip([None, short_context]) {
            let mut env = env(space);
            let network = network(encoder, Group::D2);
            let mut policy = SacPolicy::new(&network, context, env.spec(), 2).unwrap();
            let output = policy.reference_output(&Observations::new(env.spec()));
            assert_eq!(matches!(output, Err(RlError::NeedsEpisode)), context.is_some());
            let settings = SacSettings {
                batch: 16,
                burn_in: 0,
                updates_per_step: 0.05,
                augmentation: Group::D2,
                ..SacSettings::default()
            };
            let mut sac = Sac::new(settings, &policy).unwrap();
            let replay_settings = ReplaySettings {
                capacity: 100,
                steps: EPISODE + 3,
                warm_up: 20,
                still_channels: 0,
            };
            let mut replay = ReplayBuffer::new(replay_settings.clone(), env.spec()).unwrap();
            let mut rng = ChaCha8Rng::seed_from_u64(3);
            let mut state = RolloutState::from_env_reset(&mut env, &policy).unwrap();
            for _ in 0..2 {
                collect_experience(&mut env, &mut policy, &mut replay, &mut state, &mut rng)
                    .unwrap();
                assert!(sac.update(&mut policy, &replay, &mut rng).unwrap().steps > 0);
            }
            assert_equivariant_under_only(Group::D2, &format!("{space:?}"), |g| {
                equivariance_errors(&mut policy, env.spec(), g)
            });
            let restored =
                ReplayBuffer::restore(replay_settings, env.spec(), &replay.checkpoint_state())
                    .unwrap();
            assert_eq!(restored.checkpoint_state(), replay.checkpoint_state());
        }
    }
}

#[test]
fn irreps_are_checked_in_every_space() {
    for (image, components) in SPACES {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let mut env = PointReach::showing(100, 0, image, components);
        check_env_symmetry(&mut env, Group::D2, 2 * EPISODE, &mut rng).unwrap();
    }
}

#[test]
fn a_network_that_sees_nothing_is_refused() {
    let nothing = env((EnvSpec::NO_IMAGE, 0)).spec().clone();
    let images = env(([8, 8, 2], 0)).spec().clone();
    for (spec, encoder) in [(nothing, encoders()[0].clone()), (images, EncoderSettings::Blind)] {
        let error = ActorCriticPolicy::new(&joint(encoder, 2), &spec, 0).unwrap_err();
        assert!(matches!(error, RlError::NoObservationInput), "{error:?}");
        let message = error.to_string();
        assert!(message.contains("neither images nor vectors"), "{message}");
    }
}

/// Exported layers have the encoder's input, so images that need a canvas cannot be exported.
#[test]
fn policies_that_look_at_one_kind_have_an_ordinary_form_and_those_with_a_canvas_have_none() {
    let plain = |space| {
        let network = network(encoders()[0].clone(), Group::D2);
        let policy = ActorCriticPolicy::new(&network, env(space).spec(), 2).unwrap();
        policy.export()
    };
    let vector = plain(VECTOR_ONLY).unwrap();
    assert!(vector.image.is_none() && vector.vector.is_some());
    let image = plain(([8, 8, 2], 0)).unwrap();
    assert!(image.image.is_some() && image.vector.is_none());
    let refused = plain(([8, 12, 2], 2));
    assert!(matches!(refused, Err(RlError::NotExportable { .. })), "{refused:?}");
}

/// An observation after the end of an episode is the first one of the next.
#[test]
fn an_error_after_a_reset_names_the_first_step() {
    for (steps, expected) in [(EPISODE, 0), (EPISODE - 1, EPISODE - 1)] {
        let mut count = 0;
        let env = Spoiling::new(|transition: &mut Transition| {
            count += 1;
            if count == steps {
                transition.observations.vectors[0] = f32::NAN;
            }
        });
        let network = network(encoders()[0].clone(), Group::D2);
        let policy = ActorCriticPolicy::new(&network, env.spec(), 2).unwrap();
        match OnPolicyRun::new(env, policy, 2 * EPISODE).try_collect() {
            Err(RlError::NotFinite { location, .. }) => assert_eq!(location.step, Some(expected)),
            result => panic!("{result:?}"),
        }
    }
}
