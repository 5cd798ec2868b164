//! Runs of one method with different seeds.

use envs::{Camera, VecEnvSettings};

use crate::ReportError;
use experiments::presets::Budget;
use experiments::{CheckpointPlan, Experiment, NearestPreset, RunData};
use learner::LearnerSettings;
use learner::overrides::setting_differences;
use symmetry::D2;

use super::metrics::{GroupMetrics, RunMetrics};
use super::preset_match::PresetMatch;
use super::statistics::MethodScores;

/// Text between the method and the seed in a folder's name, as `covers sweep` names folders.
const SEED: &str = "-seed";
const OTHER_STREAM: &str = "leave it out and report it alone, or train it again with the stream and \
    the evaluation of the others: `--budget` and the settings below `schedule` and `evaluation`";
const OTHER_SETTINGS: &str = "rename its folder, so that the part before `-seed` names a method of \
    its own";
const SAME_SEED: &str = "leave one of the two out, or rename its folder, so that the part before \
    `-seed` names a method of its own";

/// Runs of one method, which differ in their seeds and in the number of threads alone.
#[derive(Clone, Debug)]
pub struct MethodRuns {
    /// Name of the method: the name of its runs' folders without `-seed` and what follows.
    pub name: String,
    /// Preset that the settings agree with; all runs share it.
    pub preset_match: PresetMatch,
    /// Preset that each run's settings are most like, in the order of `runs`.
    pub nearest_presets: Vec<NearestPreset>,
    /// Data of each run: its settings and tables.
    pub runs: Vec<RunData>,
    /// Metrics of each run, in the order of `runs`.
    pub metrics: Vec<RunMetrics>,
}

impl MethodRuns {
    /// Groups runs by method, the part of a folder's name before `-seed`, in the order in which the
    /// methods appear.
    ///
    /// # Errors
    /// [`ReportError::IncomparableRuns`] for runs of another stream or evaluation than the first
    /// one's, for runs of one name whose settings differ in more than the seed and the number of
    /// threads, and for two of one seed.
    pub fn group_by_method(runs: Vec<RunData>) -> Result<Vec<Self>, ReportError> {
        let mut methods: Vec<Self> = Vec::new();
        for run in runs {
            if let Some(first) = methods.first() {
                let [first, own] = [&first.runs[0], &run].map(|run| world(&run.experiment));
                refuse(&run, own_value_last(setting_differences(&first, &own)?), OTHER_STREAM)?;
            }
            let name =
                run.name.rsplit_once(SEED).map_or(&run.name[..], |(name, _)| name).to_owned();
            match methods.iter_mut().find(|method| method.name == name) {
                Some(method) => method.add(run)?,
                None => {
                    let preset_match = PresetMatch::compare(&name, &run.experiment)?;
                    let nearest = NearestPreset::of_run(preset_match.method, &run.experiment)?;
                    methods.push(Self {
                        nearest_presets: vec![nearest],
                        preset_match,
                        name,
                        metrics: vec![RunMetrics::of_run(&run)],
                        runs: vec![run],
                    });
                }
            }
        }
        Ok(methods)
    }

    fn add(&mut self, run: RunData) -> Result<(), ReportError> {
        let seed = |any: &RunData| any.experiment.learner.seed();
        let mut others = self.runs.iter();
        match others.find(|other| seed(other) == seed(&run)) {
            Some(_) => refuse(&run, format!("two runs have seed {}", seed(&run)), SAME_SEED)?,
            None => {
                let differences = setting_differences(&unseeded(&self.runs[0]), &unseeded(&run))?;
                refuse(&run, own_value_last(differences), OTHER_SETTINGS)?;
            }
        }
        let nearest = NearestPreset::of_run(self.preset_match.method, &run.experiment)?;
        self.nearest_presets.push(nearest);
        self.metrics.push(RunMetrics::of_run(&run));
        self.runs.push(run);
        Ok(())
    }

    /// Returns `true` if any run has the budget that only tests the program.
    pub fn is_smoke_test(&self) -> bool {
        self.nearest_presets.iter().any(|nearest| nearest.budget == Budget::Smoke)
    }

    /// Returns the values `[groups][seeds]` of a metric in these task groups for all runs of the
    /// method.
    pub fn scores(&self, groups: &[String], metric: fn(&GroupMetrics) -> f64) -> MethodScores {
        let of_group = |group: &String| -> Vec<f64> {
            let metrics = self.metrics.iter().flat_map(|metrics| &metrics.groups);
            metrics.filter(|own| own.group == *group).map(metric).collect()
        };
        MethodScores::new(groups.iter().map(of_group).collect())
    }

    /// Returns the success after the stream in these task groups, `[groups][seeds]`, for all runs
    /// of the method.
    pub fn success(&self, groups: &[String]) -> MethodScores {
        let placements = self.runs.iter().filter_map(|run| {
            let of_variant = run.last_scores().map(|row| row.episodes).min()?;
            // mirror images of a placement hold hardly more information than one of them
            let own = run.experiment.evaluation.distinct_placements;
            Some((of_variant * if own { D2::ALL.len() } else { 1 }) as u64)
        });
        let placements = placements.min();
        MethodScores { placements, ..self.scores(groups, |group| group.success) }
    }
}

/// Returns the settings of a run with seed and threads replaced by fixed values: runs of one method
/// may differ in these.
fn unseeded(run: &RunData) -> Experiment {
    run.experiment.clone().with_seed(0).with_threads(1)
}

/// Returns the settings that all methods of a report share, the stream and the evaluation, with the
/// rest replaced by defaults. Methods may differ in their learner, their images (size, oversampling,
/// extra images, randomisation, misalignment, occlusion) and their number of environments.
fn world(experiment: &Experiment) -> Experiment {
    let mut world = experiment.clone().with_threads(1);
    let (envs, rollout) = (world.envs.num_envs, world.learner.rollout_steps());
    // rounds are played in all environments and `every` counts rollouts: what must be equal are
    // episodes of a variant and decisions between evaluations
    let plan = &mut world.evaluation;
    plan.episodes_per_env = plan.episodes_per_env.saturating_mul(envs);
    plan.visit_episodes_per_env = plan.visit_episodes_per_env.saturating_mul(envs);
    plan.every = plan.every.map(|every| every.saturating_mul(rollout));
    let any = Camera::default();
    world.envs = VecEnvSettings {
        num_envs: VecEnvSettings::default().num_envs,
        camera: Camera {
            size: any.size,
            oversampling: any.oversampling,
            extra_views: any.extra_views,
            misalignment: any.misalignment,
            arm_occlusion: any.arm_occlusion,
            ..world.envs.camera
        },
        ..world.envs.for_evaluation()
    };
    world.learner = LearnerSettings::default();
    world.checkpoints = CheckpointPlan::default();
    world
}

/// Adds the order of the values to differences of a run from the runs before it, if there are any.
fn own_value_last(differences: String) -> String {
    if differences.is_empty() { differences } else { differences + "; its own value last" }
}

/// Returns [`ReportError::IncomparableRuns`] if there are differences.
fn refuse(run: &RunData, differences: String, remedy: &'static str) -> Result<(), ReportError> {
    if differences.is_empty() {
        return Ok(());
    }
    Err(ReportError::IncomparableRuns { run: run.name.clone(), differences, remedy })
}

#[cfg(test)]
mod tests {
    use super::*;
    use experiments::presets::{Budget, Method};

    #[test]
    fn evaluations_are_compared_by_their_episodes_and_the_decisions_between_them() {
        let mut few = Budget::Full.preset_experiment(Method::Covers);
        few.evaluation.every = Some(8);
        let mut many = few.clone();
        many.envs.num_envs *= 2;
        if let LearnerSettings::Covers(settings) = &mut many.learner {
            settings.rollout_steps *= 2;
        }
        assert_ne!(world(&few), world(&many));
        many.evaluation.episodes_per_env /= 2;
        many.evaluation.visit_episodes_per_env /= 2;
        assert_ne!(world(&few), world(&many));
        many.evaluation.every = Some(4);
        assert_eq!(world(&few), world(&many));
    }

    #[test]
    fn mirror_images_of_a_placement_count_once() {
        let placements = |distinct_placements| {
            let mut run = crate::fixtures::scored_run(&["a"], &[(1, 0.5)]);
            run.experiment.evaluation.distinct_placements = distinct_placements;
            let methods = MethodRuns::group_by_method(vec![run]).unwrap();
            methods[0].success(&["a".to_owned()]).placements
        };
        // the fixture's variants have ten episodes
        assert_eq!([false, true].map(placements), [Some(10), Some(40)]);
    }

    #[test]
    fn methods_have_pictures_of_their_own_of_one_table() {
        let methods = [Method::Covers, Method::CoversRandomised, Method::Paper];
        let mut runs = methods.map(|method| Budget::Full.preset_experiment(method));
        let worlds = runs.each_ref().map(world);
        assert!(runs[0].envs != runs[1].envs && runs[1].envs != runs[2].envs);
        let mut hidden = runs[0].clone();
        hidden.envs.camera.arm_occlusion = 0.5;
        assert_eq!(world(&hidden), worlds[0]);
        assert!(worlds.iter().all(|world| *world == worlds[0]));
        runs[1].envs.camera.height += 0.1;
        assert_ne!(world(&runs[1]), worlds[0]);
    }
}
