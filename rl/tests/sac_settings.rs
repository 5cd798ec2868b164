//! Settings of soft actor-critic: ranges, files, and what the paper lists.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

use rl::{
    ContextSettings, Critic, Encoder, EnvSpec, NetworkSettings, PpoSettings, ReplaySettings, Sac,
    SacPolicy, SacSettings, Temperature,
};
use symmetry::{Group, Irrep};

fn spec() -> EnvSpec {
    EnvSpec {
        num_envs: 1,
        image: [8, 8, 2],
        vector: vec![Irrep::X, Irrep::Y],
        action: vec![Irrep::X, Irrep::Y],
    }
}

fn network() -> NetworkSettings {
    NetworkSettings {
        encoder: Encoder::Strided { fields: vec![3, 4] },
        ..NetworkSettings::default()
    }
}

/// A recorded step is part of as many gradients as a decision is in an update of PPO.
#[test]
fn the_default_passes_a_step_as_often_as_ppo_does() {
    let (sac, ppo) = (SacSettings::default(), PpoSettings::default());
    let passes = sac.updates_per_step * sac.batch as f32;
    assert!((passes - ppo.epochs as f32).abs() < 1e-4);
    let smaller = SacSettings { batch: 64, ..sac }.as_often_as(&PpoSettings::paper());
    assert_eq!(smaller.updates_per_step, 8.0 / 64.0);
}

#[test]
fn settings_out_of_range_are_refused_by_name() {
    let spec = spec();
    let policy = SacPolicy::new(&network(), None, &spec, 0).unwrap();
    let all = SacSettings::default;
    let learned = |initial, target| SacSettings {
        temperature: Temperature::Learned { initial, target },
        ..all()
    };
    for (name, wrong) in [
        (
            "gamma",
            SacSettings {
                gamma: 1.5,
                ..all()
            },
        ),
        ("batch", SacSettings { batch: 0, ..all() }),
        (
            "updates_per_step",
            SacSettings {
                updates_per_step: -1.0,
                ..all()
            },
        ),
        (
            "learning_rate",
            SacSettings {
                learning_rate: 0.0,
                ..all()
            },
        ),
        (
            "adam_epsilon",
            SacSettings {
                adam_epsilon: 0.0,
                ..all()
            },
        ),
        (
            "max_gradient",
            SacSettings {
                max_gradient: f32::NAN,
                ..all()
            },
        ),
        ("tau", SacSettings { tau: 0.0, ..all() }),
        (
            "newest_share",
            SacSettings {
                newest_share: 1.1,
                ..all()
            },
        ),
        (
            "cloning_weight",
            SacSettings {
                cloning_weight: f32::INFINITY,
                ..all()
            },
        ),
        (
            "temperature",
            SacSettings {
                temperature: Temperature::Fixed(-0.1),
                ..all()
            },
        ),
        ("temperature.initial", learned(0.0, -1.0)),
        ("temperature.target", learned(1.0, f32::NAN)),
    ] {
        let message = Sac::new(wrong, &policy).unwrap_err().to_string();
        assert!(message.starts_with(&format!("{name} =")), "{message}");
    }
    let of = |settings: &NetworkSettings, context| {
        let message = SacPolicy::new(settings, context, &spec, 0)
            .unwrap_err()
            .to_string();
        message.split(' ').next().unwrap().to_owned()
    };
    let pooled = NetworkSettings {
        critic: Critic::Pooled { width: 8 },
        ..network()
    };
    assert_eq!(of(&pooled, None), "critic.pooled.width");
    let narrow = NetworkSettings {
        log_std: -5.0,
        ..network()
    };
    assert_eq!(of(&narrow, None), "log_std");
    let context = |size, length| Some(ContextSettings { size, length });
    assert_eq!(of(&network(), context(30, 5)), "context.size");
    assert_eq!(of(&network(), context(0, 5)), "context.size");
    assert_eq!(of(&network(), context(8, 65)), "context.length");
}

#[test]
fn settings_survive_a_file() {
    let settings = SacSettings {
        temperature: Temperature::Learned {
            initial: 0.3,
            target: -1.0,
        },
        augmentation: Group::D1y,
        ..SacSettings::default()
    };
    let text = serde_json::to_string(&settings).unwrap();
    assert_eq!(
        serde_json::from_str::<SacSettings>(&text).unwrap(),
        settings
    );
    let few = r#"{"temperature": {"fixed": 0.1}}"#;
    let fixed: SacSettings = serde_json::from_str(few).unwrap();
    assert_eq!(fixed.temperature, Temperature::Fixed(0.1));
    assert!(serde_json::from_str::<SacSettings>(r#"{"tua": 1}"#).is_err());
    let papers = serde_json::from_str::<ContextSettings>("{}").unwrap();
    assert_eq!((papers.size, papers.length), (30, 5));
    let replay = serde_json::from_str::<ReplaySettings>(r#"{"capacity": 7}"#).unwrap();
    assert_eq!((replay.capacity, replay.warm_up), (7, 1000));
}
