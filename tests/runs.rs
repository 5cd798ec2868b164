//! Whole runs: the same bytes for the same seed and any number of threads, and clear refusals.

use std::fs;
use std::path::{Path, PathBuf};

use clap::Parser;
use covers::cli::ContinualStreamExampleOptions;
use covers::presets::{Budget, Method};
use covers::{
    CoversLearner, CoversSettings, DeviceChoice, Experiment, LearnerSettings, Run, RunFolder,
    RunSummary, SwitchableVecEnv,
};
use envs::{Camera, Embodiment, Layout, TaskGroup, TaskRegistry, VecEnvSettings};
use symmetry::Group;

use crate::common::runs::{crash_after, newest, two_groups};
use crate::common::{covers as command, faulty::Faulty, scratch::Scratch};

/// The folder of the policies that come with the project.
fn pretrained() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/pretrained")
}

const FILES: [&str; 6] = [
    "experiment.json",
    "metrics.csv",
    "evaluation.csv",
    "units.csv",
    "recognition.csv",
    "contact_sheet.png",
];

fn smoke() -> Experiment {
    Budget::Smoke.preset_experiment(Method::Covers)
}

/// A run over three groups with visits of 4 and 5 rollouts, evaluated after each visit and after
/// every third turn.
fn experiment(seed: u64, threads: usize) -> Experiment {
    let mut experiment = smoke().with_seed(seed).with_threads(threads);
    experiment.schedule.groups.truncate(3);
    let groups = &mut experiment.schedule.groups;
    groups.iter_mut().for_each(|plan| plan.decisions = 4 * 80);
    // the last visit, if the seed is 3
    groups[1].decisions = 5 * 80;
    experiment.evaluation.visit_episodes_per_env = 1;
    experiment.evaluation.every = Some(3);
    experiment
}

fn start(parent: &Path, experiment: Experiment) -> Run {
    Run::start(experiment, RunFolder::create(parent, "run").unwrap()).unwrap()
}

/// Runs to the end; returns the summary and the bytes of the files and of the last checkpoint.
fn finish(mut run: Run) -> (RunSummary, Vec<Vec<u8>>) {
    while run.advance().unwrap().is_some() {}
    let folder = run.folder().path();
    let files = FILES.map(|file| folder.join(file)).into_iter();
    let bytes = files.chain([newest(folder)]).map(|file| fs::read(file).unwrap());
    let bytes = bytes.collect();
    (run.summary().unwrap().unwrap(), bytes)
}

fn lines(bytes: &[u8]) -> usize {
    bytes.iter().filter(|&&byte| byte == b'\n').count()
}

#[test]
fn equal_seeds_give_equal_bytes_on_any_number_of_threads() {
    let scratch = Scratch::new("bytes");
    let whole =
        |seed, threads| finish(start(&scratch.0, smoke().with_seed(seed).with_threads(threads)));
    let (summary, reference) = whole(3, 1);
    assert_eq!((summary.groups.len(), summary.variants.len()), (4, 16));
    assert!(summary.policies >= 1 && summary.decisions >= 8 * 80);
    // two iterations of one rollout; the third one takes the rest of the stream, since each visit
    // ends before its new policy acts
    assert_eq!(lines(&reference[1]), 1 + 3, "a header and a row a turn");
    assert_eq!(lines(&reference[2]), 1 + 16, "sixteen variants after the stream");
    assert_eq!(lines(&reference[4]), 1 + 16 * 3, "an answer to 1, 4 and 20 episodes of each");
    let (_, two_threads) = whole(3, 2);
    assert!(two_threads[1..] == reference[1..], "two threads differ");
    // the first turn shows it
    let other = smoke().with_seed(4).with_threads(1);
    let other = crash_after(1, start(&scratch.0, other));
    let metrics = fs::read(other.join(FILES[1])).unwrap();
    assert_eq!(lines(&metrics), 1 + 1);
    assert!(!reference[1].starts_with(&metrics), "the seed does nothing");
}

#[test]
fn an_interrupted_run_goes_on_to_the_same_bytes() {
    let scratch = Scratch::new("resume");
    // the run with labels has the arm
    let experiment = experiment(3, 2).with_embodiment(Embodiment::FLOATING_HAND);
    let (summary, reference) = finish(start(&scratch.0, experiment.clone()));
    // turns that hand over take three rollouts
    let evaluated = [0, 3, 4, 6, 8];
    assert_eq!(lines(&reference[1]), 1 + 8);
    assert_eq!(lines(&reference[2]), 1 + 12 * evaluated.len());
    // checkpoints are written after 3, 6 and 8 turns: the row behind is written twice
    let folder = crash_after(7, start(&scratch.0, experiment));
    let resumed = Run::resume(&folder, Some(1)).unwrap();
    assert_eq!(resumed.stats().rollouts, 6);
    assert_eq!(resumed.stats().created_for_group.len(), 2);
    let (again, bytes) = finish(resumed);
    let files = FILES.iter().chain(&["the last checkpoint"]);
    for (file, (got, expected)) in files.zip(bytes.iter().zip(&reference)) {
        assert!(got == expected, "{file} differs");
    }
    let timeless = |timed: &RunSummary| {
        let mut timed = timed.clone();
        timed.seconds = 0.0;
        timed.decisions_per_second = None;
        timed.table_checksums.remove("timings.csv").unwrap();
        timed
    };
    assert_eq!(timeless(&again), timeless(&summary));
    // what has ended stays as it is
    let mut ended = Run::resume(&folder, None).unwrap();
    assert!(ended.advance().unwrap().is_none());
    assert_eq!(timeless(&ended.summary().unwrap().unwrap()), timeless(&summary));
}

/// Two groups, and a checkpoint after every second rollout.
fn small(method: Method) -> Experiment {
    let mut experiment = two_groups(method).with_threads(2);
    experiment.checkpoints.every = 2;
    experiment
}

#[test]
fn every_other_method_runs_its_smoke_budget() {
    let scratch = Scratch::new("methods");
    // the runs of `covers` are those of the other tests, and those with replays of the next
    for method in Method::ALL.into_iter().skip(1) {
        if matches!(small(method).learner, LearnerSettings::OffPolicy(_)) {
            continue;
        }
        let (summary, _) = finish(start(&scratch.0, small(method)));
        let many = small(method).learner.may_hold_several_policies();
        assert_eq!(summary.policies > 1, many, "{method:?}");
        if method == Method::CoversGt {
            assert_eq!((summary.policies, summary.assignment_accuracy), (2, Some(1.0)));
            let mut groups = summary.groups.iter();
            assert!(groups.all(|group| group.policies.len() == 1));
        }
    }
}

#[test]
fn replays_mirrored_decisions_and_randomised_pictures_go_on_to_the_same_bytes_on_any_number_of_threads()
 {
    let scratch = Scratch::new("replays");
    let off_policy = [Method::Clear, Method::ClearBc, Method::ThreeRl, Method::EquiSac];
    let others = [Method::CnnDrac, Method::CoversRandomised];
    for method in [&off_policy[..], &others].concat() {
        let (summary, reference) = finish(start(&scratch.0, small(method)));
        let many = small(method).learner.may_hold_several_policies();
        assert_eq!(summary.policies > 1, many, "{method:?}");
        let folder = crash_after(2, start(&scratch.0, small(method)));
        let resumed = Run::resume(&folder, Some(1)).unwrap();
        assert!(resumed.stats().rollouts == 2 && !resumed.is_finished());
        let (_, bytes) = finish(resumed);
        assert!(bytes == reference, "{method:?}");
        if off_policy.contains(&method) {
            let metrics = String::from_utf8_lossy(&reference[1]);
            let mut names = metrics.lines().next().unwrap().split(',');
            let column = names.position(|name| name == "steps").unwrap();
            let steps = metrics.lines().skip(1).map(|row| row.split(',').nth(column));
            assert!(steps.flatten().any(|steps| steps != "0"), "nothing is learnt");
        }
    }
}

#[test]
fn an_interrupted_run_with_labels_goes_on_to_the_same_bytes() {
    let scratch = Scratch::new("labels");
    let mut experiment = small(Method::CoversGt).with_embodiment(Embodiment::SAWYER);
    experiment.checkpoints.every = 4;
    // the fourth turn hands over to the second policy and takes two rollouts; one more is left
    let groups = &mut experiment.schedule.groups;
    groups.iter_mut().for_each(|plan| plan.decisions = 3 * 80);
    let (_, reference) = finish(start(&scratch.0, experiment.clone()));
    let folder = crash_after(4, start(&scratch.0, experiment));
    let resumed = Run::resume(&folder, Some(1)).unwrap();
    assert_eq!(resumed.stats().rollouts, 4);
    assert_eq!(resumed.stats().created_for_group.len(), 2);
    assert!(!resumed.is_finished());
    let (_, bytes) = finish(resumed);
    assert!(bytes == reference);
}

#[test]
fn a_run_over_a_group_of_somebody_elses_resumes_with_its_registry_alone() {
    let scratch = Scratch::new("alias");
    let mut tasks = TaskRegistry::with_standard();
    static ALIAS: Faulty = Faulty::new("alias", usize::MAX, || unreachable!("it never fails"));
    tasks.register(TaskGroup::from_task(&ALIAS)).unwrap();
    let mut experiment = small(Method::Covers);
    experiment.schedule.groups[1].group = "alias".to_owned();
    experiment.checkpoints.every = 1;
    let folder = || RunFolder::create(&scratch.0, "run").unwrap();
    let start = |place| Run::start_with_tasks(experiment.clone(), tasks.clone(), place);
    let message = Run::start(experiment.clone(), folder()).err().unwrap();
    assert!(message.to_string().contains("alias"), "{message}");
    let (_, reference) = finish(start(folder()).unwrap());
    let path = crash_after(1, start(folder()).unwrap());
    assert!(Run::resume(&path, None).is_err());
    let crashed = RunFolder::from_path(&path);
    let run = Run::resume_with_tasks(crashed, Some(1), DeviceChoice::Cpu, tasks.clone()).unwrap();
    let (summary, bytes) = finish(run);
    assert!(bytes == reference);
    assert!(summary.groups.iter().any(|group| group.group.name() == "alias"));
}

#[test]
fn a_run_whose_settings_were_edited_is_refused_with_what_differs() {
    let scratch = Scratch::new("edited");
    let hand = experiment(0, 2).with_embodiment(Embodiment::FLOATING_HAND);
    let folder = RunFolder::from_path(&crash_after(4, start(&scratch.0, hand)));
    let settings = folder.read_experiment().unwrap();
    let mut longer = settings.clone();
    longer.schedule.groups[0].decisions += 80;
    let cases = [
        (settings.clone().with_seed(9), "`seed` 9 and 0"),
        (longer, "`schedule.groups.0.decisions` 400 and 320"),
    ];
    for (edited, difference) in cases {
        folder.write_experiment(&edited).unwrap();
        let message = Run::resume(folder.path(), None).err().unwrap().to_string();
        assert!(message.contains(difference), "{message}");
    }
    folder.write_experiment(&settings.with_threads(1)).unwrap();
    assert!(Run::resume(folder.path(), None).is_ok());
}

/// Scores without those of the groups' own policies.
fn without_own(scores: &str) -> serde_json::Value {
    let mut scores = serde_json::from_str(scores).unwrap();
    remove_own(&mut scores);
    scores
}

fn remove_own(value: &mut serde_json::Value) {
    match value {
        serde_json::Value::Object(map) => {
            map.remove("own");
            map.values_mut().for_each(remove_own);
        }
        serde_json::Value::Array(values) => values.iter_mut().for_each(remove_own),
        _ => (),
    }
}

#[test]
fn packed_policies_act_and_recognise_like_the_whole_learner() {
    let scratch = Scratch::new("pack");
    let mut hand = experiment(3, 2).with_embodiment(Embodiment::FLOATING_HAND);
    hand.evaluation = smoke().evaluation;
    // close-ups are not randomised
    hand.envs.camera = Camera::default();
    let run = start(&scratch.0, hand);
    let folder = run.folder().path().to_owned();
    finish(run);
    let packed = scratch.0.join("packed");
    let command = |arguments: &[&str]| command(arguments).unwrap();
    let (folder, packed) = (folder.to_str().unwrap(), packed.to_str().unwrap());
    let said = command(&["pack", folder, "--out", packed, "--episodes", "100"]);
    assert!(said.contains("policies in"), "{said}");
    let size = |at: &str| fs::metadata(newest(Path::new(at))).unwrap().len();
    assert!(size(packed) < size(folder));
    let scores = command(&["eval", folder, "--episodes", "16", "--json"]);
    assert!(scores.contains(r#""group":"drawer-close""#), "{scores}");
    // a packed folder has no counts of rollouts, so it knows no group's own policy
    assert!(scores.contains(r#""own":{"policy":"#), "{scores}");
    let packed_scores = command(&["eval", packed, "--episodes", "16", "--json"]);
    assert_eq!(without_own(&packed_scores), without_own(&scores));
    let other = command(&["eval", packed, "--seed", "9", "--episodes", "16", "--json"]);
    assert_ne!(other, scores);
    let random = ["eval", packed, "--randomised", "--episodes", "16", "--json"];
    assert_ne!(command(&random), scores);
    let off = ["eval", packed, "--set", "envs.camera.misalignment.shift_mm=[90,0]", "--json"];
    assert_ne!(command(&[&off[..], &["--episodes", "16"]].concat()), scores);
    let refusal = |arguments: &[&str]| crate::common::covers(arguments).unwrap_err().to_string();
    let ignored = "envs.randomisation.max_position_error_mm=20";
    for (set, part) in [
        ("evaluation.rounds=2", "`--set` is evaluation.rounds"),
        ("envs.threads=7", "`--set` is envs.threads"),
        (ignored, "envs.randomisation.max_position_error_mm"),
        ("envs.camera.misalignment.shift_mm=[300,0]", "expected at most 200 mm"),
    ] {
        let message = refusal(&["eval", packed, "--set", set]);
        assert!(message.contains(part), "{message}");
    }
    let (few, none) = (scratch.0.join("few"), scratch.0.join("none"));
    command(&["pack", folder, "--out", few.to_str().unwrap(), "--episodes", "4"]);
    let table = command(&["eval", few.to_str().unwrap(), "--episodes", "16"]);
    assert_eq!(table.lines().count(), 3 + 3, "{table}");
    let message = refusal(&["pack", folder, "--out", none.to_str().unwrap(), "--episodes", "3"]);
    assert!(message.contains("`episodes` is 3"), "{message}");
    let sawyer = command(&["eval", packed, "--embodiment", "sawyer", "--episodes", "16"]);
    assert_eq!(sawyer.lines().count(), 3 + 3, "{sawyer}");
}

#[test]
fn a_packed_folder_is_not_resumed_and_says_what_is() {
    let scratch = Scratch::new("packed");
    let folder = RunFolder::create(&scratch.0, "run").unwrap();
    fs::create_dir(folder.checkpoint_folder()).unwrap();
    for file in ["experiment.json", "checkpoints/000000.safetensors"] {
        fs::copy(pretrained().join(file), folder.path().join(file)).unwrap();
    }
    let message = Run::resume(folder.path(), None).err().unwrap().to_string();
    for part in ["000000.safetensors", "policies only", "`covers eval`"] {
        assert!(message.contains(part), "{message}");
    }
    let path = folder.path().to_str().unwrap();
    let refused = command(&["report", path]).unwrap_err().to_string();
    assert!(refused.contains("without the history") && refused.contains("`covers eval`"));
    let listed = command(&["list", path]).unwrap();
    assert!(listed.contains("packed") && !listed.contains("unreadable"), "{listed}");
}

/// Tables of a finished run must be whole, and a folder above runs holds them.
#[test]
fn a_damaged_run_and_a_folder_of_runs_are_told_apart_from_a_run() {
    let scratch = Scratch::new("listed");
    let runs = scratch.0.to_str().unwrap();
    command(&["train", "--budget", "smoke", "--seed", "3", "--runs", runs]).unwrap();
    let refused = command(&["report", runs]).unwrap_err().to_string();
    assert!(refused.contains(&format!("name one, such as {runs}/covers-sac")), "{refused}");
    let whole = command(&["list", runs]).unwrap();
    assert!(whole.contains("finished") && !whole.contains("unreadable"), "{whole}");
    let run = fs::read_dir(runs).unwrap().next().unwrap().unwrap().path();
    // runs are often kept on another disk
    let linked = Scratch::new("linked");
    std::os::unix::fs::symlink(&run, linked.0.join("elsewhere")).unwrap();
    std::os::unix::fs::symlink(&linked.0, linked.0.join("circle")).unwrap();
    let through_link = command(&["list", linked.0.to_str().unwrap()]).unwrap();
    assert_eq!(through_link.matches("finished").count(), 1, "{through_link}");
    assert!(through_link.contains("elsewhere"), "{through_link}");
    let table = run.join("metrics.csv");
    let text = fs::read_to_string(&table).unwrap();
    fs::write(&table, &text[..text.len() / 2]).unwrap();
    let damaged = command(&["list", runs]).unwrap();
    assert!(damaged.contains("unreadable") && damaged.contains("metrics.csv"), "{damaged}");
}

#[test]
fn packing_starts_no_environments() {
    let scratch = Scratch::new("unstarted");
    // no stream can start in this layout, which has one variant of each group
    let mut experiment = RunFolder::from_path(&pretrained()).read_experiment().unwrap();
    experiment.envs.layout = Layout::MetaWorld;
    let folder = RunFolder::create(&scratch.0, "run").unwrap();
    folder.write_experiment(&experiment).unwrap();
    fs::create_dir(folder.checkpoint_folder()).unwrap();
    let copy = folder.checkpoint_folder().join("000000.safetensors");
    fs::copy(newest(&pretrained()), copy).unwrap();
    let (folder, packed) = (folder.path().to_str().unwrap(), scratch.0.join("new/packed"));
    let message = command(&["eval", folder]).unwrap_err().to_string();
    assert!(message.contains("metaworld"), "{message}");
    let pack = ["pack", folder, "--out", packed.to_str().unwrap()];
    let said = command(&pack).unwrap();
    assert!(said.contains("4 policies in"), "{said}");
    let again = command(&pack).unwrap_err().to_string();
    assert!(again.ends_with("exists already: choose another name, or remove it"), "{again}");
}

#[test]
fn no_run_overwrites_another() {
    let scratch = Scratch::new("folders");
    let paths: Vec<_> = (0..3)
        .map(|_| RunFolder::create(&scratch.0, "short-seed0").unwrap())
        .map(|folder| folder.path().file_name().unwrap().to_owned())
        .collect();
    assert_eq!(paths, ["short-seed0", "short-seed0-2", "short-seed0-3"]);
}

#[test]
fn a_folder_that_cannot_be_made_is_named() {
    let scratch = Scratch::new("blocked");
    let file = scratch.0.join("file");
    fs::write(&file, "not a folder").unwrap();
    let message = RunFolder::create(&file, "run").unwrap_err().to_string();
    assert!(message.contains(&file.display().to_string()), "{message}");
}

#[test]
fn options_are_checked_and_named() {
    let refuse = |arguments: &[&str]| {
        let all = [&["continual_stream"], arguments].concat();
        ContinualStreamExampleOptions::try_parse_from(all).unwrap_err().to_string()
    };
    assert!(refuse(&["--budgit", "short"]).contains("--budgit"));
    assert!(
        refuse(&["--budget", "long"])
            .contains("[possible values: smoke, short, full, table, zero-shot, ten, mt10, all]")
    );
    let most = envs::MAX_THREADS;
    assert!(refuse(&["--threads", "0"]).contains(&format!("0 is not in 1..={most}")));
    let threads = envs::VecEnvSettings { threads: most + 1, ..Default::default() };
    let message = threads.check().unwrap_err().to_string();
    assert!(message.contains(&format!("expected 1 to {most}")), "{message}");
    assert!(refuse(&["--seed", "minus one"]).contains("minus one"));
    assert!(
        refuse(&["--embodiment", "ur5"])
            .contains("unknown embodiment `ur5`: expected one of sawyer, hand, kinova_gen3")
    );
}

#[test]
fn changes_reach_the_experiment() {
    let line = "continual_stream --embodiment hand --group C1 --set off_policy.sac.gamma=0.97";
    let options = ContinualStreamExampleOptions::parse_from(line.split(' '));
    let experiment = options
        .run_options
        .settings
        .apply_to_experiment(options.budget.preset_experiment(Method::default()))
        .unwrap();
    assert_eq!(experiment.envs.embodiment, Embodiment::FLOATING_HAND);
    let LearnerSettings::OffPolicy(settings) = experiment.learner else {
        panic!("{:?}", experiment.learner);
    };
    assert_eq!((settings.network.group, settings.sac.gamma), (Group::C1, 0.97));
}

#[test]
fn an_image_size_that_breaks_exactness_is_refused_with_the_rule() {
    let camera = Camera { size: 44, ..Camera::default() };
    let spec = SwitchableVecEnv::env_spec(&VecEnvSettings { camera, ..VecEnvSettings::default() });
    let message = CoversLearner::new(CoversSettings::default(), &spec).err().unwrap().to_string();
    assert!(message.contains("44") && message.contains("16"));
}
