//! Tests that presets can finish, and differ only as documented.

use envs::{Camera, TaskRegistry};
use learner::overrides::apply_overrides;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;

#[test]
fn every_preset_is_a_run_that_can_be_finished() {
    for method in Method::ALL {
        for budget in Budget::value_variants() {
            let experiment = budget.preset_experiment(method);
            experiment.check(&TaskRegistry::with_all()).unwrap();
        }
        let option = method.to_possible_value().unwrap();
        assert_eq!(option.get_name(), method.name());
    }
    for budget in Budget::value_variants() {
        let option = budget.to_possible_value().unwrap();
        assert_eq!(option.get_name(), budget.name());
    }
}

#[test]
fn all_budgets_but_that_of_the_table_show_close_ups() {
    for budget in Budget::value_variants() {
        let camera = budget.preset_experiment(Method::Covers).envs.camera;
        let table = *budget == Budget::TableProtocol;
        assert_eq!(camera == Camera::default(), table, "{budget:?}");
        assert_eq!(camera.extra_views == ExtraViews::CloseUp, !table);
    }
    for method in [Method::Clear, Method::ThreeRl, Method::CoversRandomised] {
        let camera = Budget::Full.preset_experiment(method).envs.camera;
        assert_eq!(camera, Camera::default(), "{method:?}");
    }
    let paper = |budget: Budget| budget.preset_experiment(Method::Paper).envs;
    assert_eq!(paper(Budget::TableProtocol), paper(Budget::Full));
    assert_eq!(paper(Budget::Full).camera.size, PAPER_PICTURES);
}

/// The protocol of the table: "same decisions, same evaluation, 100 episodes of each group and
/// variant".
#[test]
fn the_budget_of_the_table_is_the_same_for_all_methods() {
    let of = |method| Budget::TableProtocol.preset_experiment(method);
    let covers = of(Method::Covers);
    for method in Method::ALL {
        let run = of(method);
        assert_eq!(run.schedule, covers.schedule, "{method:?}");
        assert_eq!(run.evaluation, covers.evaluation, "{method:?}");
        let evaluation = run.evaluation;
        assert_eq!(evaluation.episodes_per_env * run.envs.num_envs, 100, "{method:?}");
        assert!(
            evaluation.visit_episodes_per_env > 0
                && evaluation.visit_episodes_per_env < evaluation.episodes_per_env
        );
    }
    for (budget, of_covers, of_covers_sac) in [
        (Budget::TableProtocol, 204_000, 204_000),
        (Budget::Full, 159_000, 63_000),
        (Budget::Short, 100_000, 40_000),
        (Budget::ZeroShot, 174_000, 40_000),
        (Budget::Ten, 886_000, 228_000),
        (Budget::Mt10, 1_000_000, 370_000),
        (Budget::All, 1_370_000, 440_000),
    ] {
        let decisions = |method| budget.preset_experiment(method).schedule.total_decisions();
        let found = [Method::Covers, Method::CoversSac].map(decisions);
        assert_eq!(found, [of_covers, of_covers_sac], "{budget:?}");
    }
}

/// Handles are pulled in streams of ten groups and more, where noise that lasts is the default.
#[test]
fn noise_lasts_in_streams_of_many_groups_alone() {
    let noise = |budget: Budget| match budget.preset_experiment(Method::CoversSac).learner {
        LearnerSettings::OffPolicy(settings) => settings.noise_correlation,
        other => panic!("{other:?}"),
    };
    assert_eq!([Budget::Ten, Budget::Mt10, Budget::All].map(noise), [0.5; 3]);
    assert_eq!([Budget::Smoke, Budget::Short, Budget::Full].map(noise), [0.0; 3]);
    let group = r#"[{"group": "door-open", "decisions": 9500, "variants": ["identity"]}]"#;
    let stream = format!("schedule.groups={group}");
    let own = serde_json::to_string(&Budget::Full.preset_experiment(Method::CoversSac).learner);
    let own = own.unwrap().replace("\"noise_correlation\":0.0", "\"noise_correlation\":0.125");
    for (set, expected) in [
        (vec![&stream[..]], 0.5),
        (vec![&stream, "off_policy.noise_correlation=0.25"], 0.25),
        (vec!["off_policy.sac.gamma=0.9"], 0.0),
        (vec![&stream, &format!("learner={own}")], 0.125),
    ] {
        let set: Vec<SettingOverride> = set.iter().map(|text| text.parse().unwrap()).collect();
        let preset = Budget::Full.preset_experiment(Method::CoversSac);
        let run = apply_overrides(&set, preset).unwrap();
        let run = Method::CoversSac.adapt_to_stream(run, &set);
        let LearnerSettings::OffPolicy(settings) = run.learner else { panic!("not off-policy") };
        assert_eq!(settings.noise_correlation, expected, "{set:?}");
    }
}

/// Streams of many groups visit each twice, in an order that the seed draws, and rollouts of two
/// episodes do not end where visits do.
#[test]
fn streams_of_many_groups_follow_the_seed_and_switch_within_rollouts() {
    let budgets = [
        (Budget::Ten, &TaskGroup::TEN_WITHOUT_GRASPING[..]),
        (Budget::Mt10, &TaskGroup::MT10),
        (Budget::All, &TaskGroup::ALL),
    ];
    for (budget, groups) in budgets {
        let run = budget.preset_experiment(Method::Paper);
        let rollout = run.learner.rollout_steps();
        let orders = [1, 2].map(|seed| {
            let rng = &mut ChaCha8Rng::seed_from_u64(seed);
            let visits = run.schedule.draw_visits(1, rng);
            assert_eq!(visits.len(), 2 * groups.len());
            for group in groups {
                let of_group = visits.iter().filter(|visit| visit.group == group.name());
                assert_eq!(of_group.count(), 2, "{budget:?} {group}");
            }
            assert!(visits.iter().all(|visit| !visit.decisions.is_multiple_of(rollout)));
            visits.into_iter().map(|visit| visit.group).collect::<Vec<_>>()
        });
        assert_ne!(orders[0], orders[1], "{budget:?}");
    }
}

#[test]
fn settings_tell_the_method_and_settings_of_ones_own_are_none() {
    for method in Method::ALL {
        for budget in Budget::value_variants() {
            let mut run = budget.preset_experiment(method).with_seed(7).with_threads(3);
            run.schedule.cycles += 1;
            run.checkpoints.keep = 7;
            assert_eq!(Method::from_experiment(&run), Some(method));
            let other = run.clone().with_embodiment(envs::Embodiment::FLOATING_HAND);
            assert_eq!(Method::from_experiment(&other), None);
            match &mut run.learner {
                LearnerSettings::Covers(settings) => settings.ppo.gamma = 0.5,
                LearnerSettings::OffPolicy(settings) => settings.sac.gamma = 0.5,
            }
            assert_eq!(Method::from_experiment(&run), None);
        }
    }
}

#[test]
fn the_slim_network_has_as_many_parameters_as_the_equivariant_one() {
    let parameters = |method: Method| {
        let experiment = Budget::TableProtocol.preset_experiment(method);
        let spec = crate::stream::SwitchableVecEnv::env_spec(&experiment.envs);
        let network = &method.covers().network;
        let network = rl::ActorCritic::<f32>::new(network, &spec).unwrap();
        network.num_params() as f64
    };
    let covers = parameters(Method::Covers);
    let ratio = |method| parameters(method) / covers;
    assert!((ratio(Method::CoversCnnSlim) - 1.0).abs() < 0.02);
    assert!(ratio(Method::CoversCnn) > 3.5);
}

#[test]
fn randomised_pictures_without_close_ups_are_all_that_a_preset_changes() {
    for budget in Budget::value_variants() {
        let mut run = budget.preset_experiment(Method::CoversRandomised);
        assert_eq!(run.envs.randomisation, Some(VisualDomainRandomisation::NOMINAL));
        let covers = budget.preset_experiment(Method::Covers);
        run.envs = run.envs.for_evaluation();
        run.envs.camera = covers.envs.camera;
        assert_eq!(run, covers);
    }
}

#[test]
fn methods_of_covers_differ_in_networks_groupings_and_symmetries_alone() {
    let covers = Method::Covers.covers();
    for method in [
        Method::CoversGt,
        Method::CoversCnn,
        Method::CoversCnnSlim,
        Method::Equi,
        Method::Cnn,
        Method::CnnDrac,
    ] {
        let mut settings = method.covers();
        assert_ne!(settings, covers, "{method:?}");
        settings.network = covers.network.clone();
        settings.grouping = covers.grouping;
        if method == Method::CnnDrac {
            assert_eq!(2 * settings.ppo.epochs, covers.ppo.epochs);
            settings.ppo.epochs = covers.ppo.epochs;
            settings.ppo.symmetry = covers.ppo.symmetry;
        }
        assert_eq!(settings, covers, "{method:?}");
    }
}
