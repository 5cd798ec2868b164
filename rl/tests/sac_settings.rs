//! Settings of soft actor-critic: ranges, files, and what the paper lists.

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
    type Spoil = fn(&mut SacSettings);
    let cases: [(&str, Spoil); 17] = [
        ("gamma", |s| s.gamma = 1.5),
        ("batch", |s| s.batch = 0),
        ("batch", |s| s.batch = 1 << 17),
        ("window", |s| s.window = 0),
        ("window", |s| s.window = 3),
        ("window", |s| s.window = 1024),
        ("updates_per_step", |s| s.updates_per_step = -1.0),
        ("updates_per_step", |s| s.updates_per_step = 1e30),
        ("learning_rate", |s| s.learning_rate = 0.0),
        ("adam_epsilon", |s| s.adam_epsilon = 0.0),
        ("max_gradient", |s| s.max_gradient = f32::NAN),
        ("tau", |s| s.tau = 0.0),
        ("newest_share", |s| s.newest_share = 1.1),
        ("cloning_weight", |s| s.cloning_weight = f32::INFINITY),
        ("temperature", |s| s.temperature = Temperature::Fixed(-0.1)),
        ("temperature.initial", |s| {
            s.temperature = learned(0.0, -1.0)
        }),
        ("temperature.target", |s| {
            s.temperature = learned(1.0, f32::NAN)
        }),
    ];
    let policy = SacPolicy::new(&network(), None, &spec(), 0).unwrap();
    for (name, spoil) in cases {
        let mut settings = SacSettings::default();
        spoil(&mut settings);
        let message = Sac::new(settings, &policy).unwrap_err().to_string();
        assert!(message.starts_with(&format!("{name} =")), "{message}");
    }
}

fn learned(initial: f32, target: f32) -> Temperature {
    Temperature::Learned { initial, target }
}

#[test]
fn networks_and_contexts_that_do_not_fit_are_refused_by_name() {
    let refused = |settings: &NetworkSettings, context, name: &str| {
        let error = SacPolicy::new(settings, context, &spec(), 0).unwrap_err();
        assert!(
            error.to_string().starts_with(&format!("{name} ")),
            "{error}"
        );
    };
    let pooled = NetworkSettings {
        critic: Critic::Pooled { width: 8 },
        ..network()
    };
    refused(&pooled, None, "critic.pooled.width");
    let narrow = NetworkSettings {
        log_std: -5.0,
        ..network()
    };
    refused(&narrow, None, "log_std");
    let context = |size, length| Some(ContextSettings { size, length });
    refused(&network(), context(30, 5), "context.size");
    refused(&network(), context(0, 5), "context.size");
    refused(&network(), context(8, 65), "context.length");
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
