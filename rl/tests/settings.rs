//! Settings: presets, ranges and files.

use std::fmt::Debug;

use rl::{
    EncoderSettings, EntropyTemperatureSettings, LearningRateSchedule, NetworkSettings, Ppo,
    PpoSettings, RecurrentContextSettings, ReplayBuffer, ReplaySettings, RlError, Sac, SacPolicy,
    SacSettings, SymmetryLossSettings,
};
use serde::Serialize;
use serde::de::DeserializeOwned;
use symmetry::Group;

use crate::common::episodes;
use crate::common::sac::network;
use crate::common::steps::{policy, spec};

/// Change that makes settings invalid.
type Change<S> = fn(&mut S);

/// Checks that `settings` are valid and that each change is refused with the name of the setting.
fn assert_refused<S: Clone, const N: usize>(
    settings: &S,
    check: impl Fn(&S) -> Result<(), RlError>,
    changes: [(&str, Change<S>); N],
) {
    check(settings).unwrap();
    for (name, change) in changes {
        let mut wrong = settings.clone();
        change(&mut wrong);
        let message = check(&wrong).unwrap_err().to_string();
        assert!(message.starts_with(name) && message.contains("expected"), "{message}");
    }
}

#[test]
fn settings_of_learners_out_of_range_are_refused_by_name() {
    assert_refused(
        &PpoSettings::paper(),
        PpoSettings::check,
        [
            ("gamma =", |s| s.gamma = 1.1),
            ("clip =", |s| s.clip = f32::NAN),
            ("max_kl =", |s| s.max_kl = f32::INFINITY),
            ("epochs =", |s| s.epochs = 0),
            ("minibatch =", |s| s.minibatch = 1),
            ("schedule.steps =", |s| s.schedule = LearningRateSchedule::Linear { steps: 0 }),
            ("schedule.steps =", |s| s.schedule = LearningRateSchedule::Cosine { steps: 0 }),
            ("symmetry.weight = -1:", |s| s.symmetry = symmetry_loss(Group::D2, -1.0)),
            ("the order of symmetry.group = 1:", |s| s.symmetry = symmetry_loss(Group::C1, 0.1)),
        ],
    );
    assert_refused(
        &SacSettings::paper(),
        SacSettings::check,
        [
            ("gamma =", |s| s.gamma = 1.5),
            ("batch =", |s| s.batch = 0),
            ("batch =", |s| s.batch = 1 << 17),
            ("window =", |s| s.window = 0),
            ("window =", |s| s.window = 3),
            ("window =", |s| s.window = 1024),
            ("updates_per_step =", |s| s.updates_per_step = -1.0),
            ("updates_per_step =", |s| s.updates_per_step = 1e30),
            ("learning_rate =", |s| s.learning_rate = 0.0),
            ("encoder_learning_rate =", |s| s.encoder_learning_rate = Some(0.0)),
            ("adam_epsilon =", |s| s.adam_epsilon = 0.0),
            ("max_gradient =", |s| s.max_gradient = f32::NAN),
            ("tau =", |s| s.tau = 0.0),
            ("average_rate =", |s| s.average_rate = Some(0.0)),
            ("average_rate =", |s| s.average_rate = Some(f32::NAN)),
            ("average_rate =", |s| s.average_rate = Some(1.5)),
            ("newest_share =", |s| s.newest_share = 1.1),
            ("random_shift =", |s| s.random_shift = 17),
            ("cloning_weight =", |s| s.cloning_weight = f32::INFINITY),
            ("temperature =", |s| s.temperature = EntropyTemperatureSettings::Fixed(-0.1)),
            ("temperature.initial =", |s| s.temperature = learned(0.0, -1.0)),
            ("temperature.target =", |s| s.temperature = learned(1.0, f32::NAN)),
        ],
    );
    assert_refused(
        &ReplaySettings::default(),
        |settings| settings.check(&episodes::spec(1)),
        [
            ("capacity", |s| s.capacity = 0),
            ("steps", |s| s.steps = 0),
            ("still_channels", |s| s.still_channels = 4),
        ],
    );
}

fn symmetry_loss(group: Group, weight: f32) -> Option<SymmetryLossSettings> {
    Some(SymmetryLossSettings { group, weight })
}

fn learned(initial: f32, target: f32) -> EntropyTemperatureSettings {
    EntropyTemperatureSettings::Learned { initial, target }
}

#[test]
fn settings_of_networks_out_of_range_are_refused_by_name() {
    NetworkSettings::so2_paper_128px().check().unwrap();
    assert_refused(
        &NetworkSettings::default(),
        NetworkSettings::check,
        [
            ("encoder.strided.fields", |s| s.encoder = strided(vec![4, usize::MAX])),
            ("encoder.strided.fields", |s| s.encoder = strided(vec![])),
            ("encoder.strided.fields", |s| s.encoder = strided(vec![4, 0])),
            ("encoder.pooled.inner", |s| {
                s.encoder = EncoderSettings::Pooled { fields: vec![], inner: [1, 0] };
            }),
            ("action_gain", |s| s.action_gain = 0.0),
            ("log_std", |s| s.log_std = f32::NAN),
        ],
    );
}

fn strided(fields: Vec<usize>) -> EncoderSettings {
    EncoderSettings::Strided { fields }
}

#[test]
fn learners_and_buffers_check_their_settings() {
    let sac = SacPolicy::new(&network(EncoderSettings::Blind), None, &spec(), 0).unwrap();
    assert!(Sac::new(SacSettings { gamma: 1.5, ..SacSettings::default() }, &sac).is_err());
    assert!(Ppo::new(PpoSettings { gamma: 1.5, ..PpoSettings::default() }, &policy()).is_err());
    let empty = ReplaySettings { capacity: 0, ..ReplaySettings::default() };
    assert!(ReplayBuffer::new(empty, &spec()).is_err());
}

#[test]
fn the_presets_of_ppo_differ_in_what_was_measured_alone() {
    PpoSettings::default().check().unwrap();
    let papers = PpoSettings {
        gamma: 0.99,
        head_learning_rate: 3e-4,
        encoder_learning_rate: 3e-4,
        value_weight: 0.5,
        epochs: 8,
        ..PpoSettings::tuned()
    };
    assert_eq!(papers, PpoSettings::paper());
}

fn assert_survives<S: Serialize + DeserializeOwned + PartialEq + Debug>(settings: &S) {
    let text = serde_json::to_string(settings).unwrap();
    assert_eq!(&serde_json::from_str::<S>(&text).unwrap(), settings);
}

fn read<S: DeserializeOwned>(text: &str) -> S {
    serde_json::from_str(text).unwrap()
}

fn assert_unknown<S: DeserializeOwned>(name: &str) {
    let error = serde_json::from_str::<S>(&format!(r#"{{"{name}": 1}}"#)).err().unwrap();
    assert!(error.to_string().contains(&format!("unknown field `{name}`")), "{error}");
}

#[test]
fn settings_survive_a_file_and_unknown_names_are_refused() {
    assert_survives(&PpoSettings::paper());
    assert_survives(&PpoSettings::tuned());
    assert_survives(&NetworkSettings {
        log_std: -0.3,
        group: Group::D1y,
        ..NetworkSettings::default()
    });
    assert_survives(&NetworkSettings::so2_paper_128px());
    let temperature = learned(0.3, -1.0);
    assert_survives(&SacSettings {
        temperature,
        augmentation: Group::D1y,
        ..SacSettings::default()
    });
    // what a file leaves out has its default value
    let expected = PpoSettings { clip: 0.1, ..PpoSettings::default() };
    assert_eq!(read::<PpoSettings>(r#"{"clip": 0.1}"#), expected);
    let plain = NetworkSettings { group: Group::C1, ..NetworkSettings::default() };
    assert_eq!(read::<NetworkSettings>(r#"{"group": "C1"}"#), plain);
    let fixed: SacSettings = read(r#"{"temperature": {"fixed": 0.1}}"#);
    assert_eq!(fixed.temperature, EntropyTemperatureSettings::Fixed(0.1));
    let papers: RecurrentContextSettings = read("{}");
    assert_eq!((papers.size, papers.length), (30, 5));
    let replay: ReplaySettings = read(r#"{"capacity": 7}"#);
    assert_eq!((replay.capacity, replay.warm_up), (7, 1000));
    assert_unknown::<PpoSettings>("clipp");
    assert_unknown::<NetworkSettings>("tops");
    assert_unknown::<SacSettings>("tua");
}
