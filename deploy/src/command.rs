//! `covers deploy`: runs trials of all variants on a robot.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::RangedU64ValueParser;
use envs::embodiments::Arm;
use envs::{TaskGroup, TaskRegistry};

use crate::DeployError;
use experiments::cli::{print_escaped, progress_bar};
use experiments::{RunError, RunFolder};
use learner::disk::{LocalDisk, check_path_writable, write_atomically};
use render::encode_gif;

use super::deployment::Deployment;
use super::faults::{FaultSweep, SimulatedFault};
use super::film_strip::FilmStrip;
use super::options::RunAndRigOptions;
use super::results::ResultsFolder;
use super::rig::{Rig, Trial};
use super::settings::{RigAndVisionSettings, VisionSettings};
use super::simulated::SimulatedRig;
use super::table::{TrialResult, trial_success_table};

/// Fault of the simulated rig, with the rig's settings for each amount of the fault.
type SweepSettings = (SimulatedFault, Vec<(f64, RigAndVisionSettings)>);

/// Task groups of one batch of trials, with the number of trials and the folder for pictures.
#[derive(Clone, Copy)]
struct Batch<'a> {
    groups: &'a [TaskGroup],
    /// Number of trials of each task variant.
    trials: usize,
    /// Folder for pictures of the trials; `None` to keep none.
    video: Option<&'a Path>,
}

/// Options of `covers deploy`: the policies, the robot, the trials and their outputs.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Examples:\n  \
    covers deploy assets/pretrained-robot --trials 5 --video films --gif\n  \
    covers deploy assets/pretrained-robot --trials 5 --out swept --sweep angle-error=0,1,2,3\n  \
    covers deploy assets/pretrained-robot --calibration calibration.json\n  \
    covers deploy assets/pretrained-robot --robot arm.urdf\n  \
    covers deploy assets/pretrained-robot --dry-run")]
pub struct DeployOptions {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub run_and_rig: RunAndRigOptions,
    /// Number of trials of each variant.
    #[arg(long, default_value_t = 20, value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub trials: usize,
    /// Group to try, as `goal-reach` (default: all groups of the run).
    #[arg(long, visible_alias = "group")]
    pub task: Option<String>,
    /// Run one trial of the first variant on the table as it is, without sending commands to the
    /// robot. Prints the decisions, the commands that were withheld, and how long each stage takes.
    #[arg(long, conflicts_with_all = ["json", "out", "sweep", "sweep_trials", "video"])]
    pub dry_run: bool,
    /// Folder for film strips (PNG) of the first trial of each variant and of each trial that
    /// failed: the camera's pictures, the masks and the policy's pictures.
    #[arg(long)]
    pub video: Option<PathBuf>,
    /// Write films (GIF) of all decisions instead of strips.
    #[arg(long, requires = "video")]
    pub gif: bool,
    /// Print all trials as one JSON value, in the last line.
    #[arg(long)]
    pub json: bool,
    /// Then run the trials again for each amount of a fault, as `position-error=0,5,10,20,30`.
    /// Faults: position-error and mask-growth (mm), angle-error (degrees), picture-latency and
    /// command-latency (ms), exposure-drift and balance-drift (%). May be given several times, for
    /// one fault each.
    #[arg(long, value_name = "FAULT=AMOUNTS", requires = "out", conflicts_with = "json")]
    pub sweep: Vec<FaultSweep>,
    /// Trials of each variant for each amount of a sweep (default: as many as `--trials`).
    #[arg(long, value_name = "TRIALS", requires = "sweep")]
    #[arg(value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub sweep_trials: Option<usize>,
    /// Folder for the table (`table.md`), all trials (`trials.csv`), and the table (CSV) and figure
    /// (SVG) of each sweep, named after the fault.
    #[arg(long)]
    pub out: Option<PathBuf>,
}

impl DeployOptions {
    /// Runs all trials on a simulated rig, then those of the sweeps, or a dry run alone, and prints
    /// the results to `out`.
    ///
    /// # Errors
    /// As [`Deployment::run_trial`]; folders and an `out` that cannot be written to; options that
    /// contradict each other.
    pub fn run(&self, out: &mut impl Write) -> Result<(), DeployError> {
        let nominal = self.run_and_rig.rig.settings()?;
        // check the sweeps before the first trial
        let sweeps = self.sweep_settings(nominal)?;
        let (mut deployment, mut rig) = self.simulated(nominal)?;
        if self.dry_run {
            // a dry run does not set the table up, and a simulation has none before its first
            // set-up
            let first = self.first(self.groups()?[0]);
            rig.set_up(&first).map_err(|source| DeployError::Rig { source })?;
        }
        let arm = rig.arm().clone();
        let results = self.results()?;
        let scores = self.act(&mut deployment, &mut rig, &arm, results.as_ref(), out)?;
        match results {
            Some(results) => self.sweep(&sweeps, nominal, &scores, &results, out),
            None => Ok(()),
        }
    }

    /// Runs the trials, or the dry run, on your own rig and prints the results to `out`; `arm` is
    /// the model of the rig's robot.
    ///
    /// # Errors
    /// As [`DeployOptions::run`], and `--robot`, faults and sweeps, which are for a simulated rig
    /// alone.
    pub fn run_on_rig(
        &self,
        rig: &mut dyn Rig,
        arm: &Arm,
        out: &mut impl Write,
    ) -> Result<(), DeployError> {
        self.run_and_rig.rig.reject_simulation_options(self.sweep.iter().map(|of| of.fault))?;
        let mut deployment = self.run_and_rig.load_deployment(VisionSettings::default())?;
        let results = self.results()?;
        self.act(&mut deployment, rig, arm, results.as_ref(), out)?;
        Ok(())
    }

    fn results(&self) -> Result<Option<ResultsFolder>, DeployError> {
        let faults = || self.sweep.iter().map(|sweep| sweep.fault);
        self.out.as_deref().map(|folder| ResultsFolder::create(folder, faults())).transpose()
    }

    /// Runs the trials on a rig, or the dry run of one trial.
    fn act(
        &self,
        deployment: &mut Deployment,
        rig: &mut dyn Rig,
        arm: &Arm,
        results: Option<&ResultsFolder>,
        out: &mut impl Write,
    ) -> Result<Vec<TrialResult>, DeployError> {
        let groups = self.groups()?;
        if self.dry_run {
            let report = deployment.dry_run(rig, arm, &self.first(groups[0]));
            let report = self.run_and_rig.name_file_in_error(report)?;
            print_escaped(out, report.text().trim_end())?;
            return Ok(Vec::new());
        }
        if let Some(folder) = &self.video {
            // before an arm moves in vain
            std::fs::create_dir_all(folder).map_err(RunError::write_error_mapper(folder))?;
            check_path_writable(&LocalDisk, &folder.join("trial.png"))?;
        }
        let batch = Batch { groups: &groups, trials: self.trials, video: self.video.as_deref() };
        let scores = self.trials(out, deployment, rig, arm, batch)?;
        if let Some(results) = results {
            results.write_trials(&scores)?;
        }
        if self.json {
            print_escaped(out, &serde_json::json!(scores).to_string())?;
        }
        Ok(scores)
    }

    /// Returns the first trial of a task group's first variant.
    fn first(&self, group: TaskGroup) -> Trial {
        Trial { variant: group.variants()[0], index: 0, seed: self.run_and_rig.rig.seed }
    }

    fn groups(&self) -> Result<Vec<TaskGroup>, RunError> {
        let schedule =
            RunFolder::from_path(&self.run_and_rig.run_folder).read_experiment()?.schedule;
        schedule.resolve_group_or_all(self.task.as_deref(), &TaskRegistry::with_all())
    }

    fn simulated(
        &self,
        settings: RigAndVisionSettings,
    ) -> Result<(Deployment, SimulatedRig), DeployError> {
        let deployment = self.run_and_rig.load_deployment(settings.vision)?;
        let robot = self.run_and_rig.rig.simulated_robot();
        let rig = SimulatedRig::new(settings.simulation, *deployment.training_camera(), robot)?;
        Ok((deployment, rig))
    }

    /// Returns the rig's settings for each amount of each fault to sweep.
    fn sweep_settings(
        &self,
        nominal: RigAndVisionSettings,
    ) -> Result<Vec<SweepSettings>, DeployError> {
        let mut sweeps: Vec<SweepSettings> = Vec::new();
        for FaultSweep { fault, amounts } in &self.sweep {
            let refused = |expected| RunError::invalid("sweep", fault.name(), expected);
            if sweeps.iter().any(|(of, _)| of == fault) {
                return Err(refused("each fault once").into());
            }
            let replaced =
                matches!(fault, SimulatedFault::PositionError | SimulatedFault::AngleError);
            if replaced && self.run_and_rig.calibration.is_some() {
                return Err(refused(
                    "another fault, or no --calibration: the file takes the place of the \
                     calibration that would be wrong, so all amounts would be one",
                )
                .into());
            }
            let settings =
                amounts.iter().map(|&amount| Ok((amount, fault.set_amount(amount, nominal)?)));
            sweeps.push((*fault, settings.collect::<Result<_, DeployError>>()?));
        }
        Ok(sweeps)
    }

    /// Runs the trials for each amount of each fault. `scores` are the results with the `nominal`
    /// settings, which are not run again.
    fn sweep(
        &self,
        sweeps: &[SweepSettings],
        nominal: RigAndVisionSettings,
        scores: &[TrialResult],
        results: &ResultsFolder,
        out: &mut impl Write,
    ) -> Result<(), DeployError> {
        let groups = self.groups()?;
        let trials = self.sweep_trials.unwrap_or(self.trials);
        // pictures of swept trials would overwrite those of the first trials
        let batch = Batch { groups: &groups, trials, video: None };
        for (fault, amounts) in sweeps {
            let mut swept = Vec::new();
            for &(amount, settings) in amounts {
                print_escaped(out, &format!("{}: {amount}", fault.axis_label()))?;
                let scores = if settings == nominal && trials <= self.trials {
                    print_escaped(out, "among the trials above")?;
                    let first = scores.iter().filter(|score| score.trial_index < trials);
                    first.copied().collect()
                } else {
                    let (mut deployment, mut rig) = self.simulated(settings)?;
                    let arm = rig.arm().clone();
                    self.trials(out, &mut deployment, &mut rig, &arm, batch)?
                };
                swept.push((amount, scores));
                // after each amount, so that an interrupted sweep leaves its results
                results.write_sweep(*fault, &groups, &swept)?;
            }
        }
        Ok(())
    }

    /// Runs a batch of trials on a rig and prints a line for each variant and the table of all.
    fn trials(
        &self,
        out: &mut impl Write,
        deployment: &mut Deployment,
        rig: &mut dyn Rig,
        arm: &Arm,
        batch: Batch<'_>,
    ) -> Result<Vec<TrialResult>, DeployError> {
        let Batch { groups, trials, video } = batch;
        let mut scores = Vec::new();
        let variants: Vec<_> = groups.iter().flat_map(|group| group.variants()).collect();
        let bar = progress_bar(variants.len() * trials);
        for variant in variants {
            let of_variant = scores.len();
            for number in 0..trials {
                let trial = Trial { variant, index: number, seed: self.run_and_rig.rig.seed };
                let mut strip = video.map(|_| FilmStrip::default());
                let score = deployment.run_trial(rig, arm, &trial, strip.as_mut());
                let score = self.run_and_rig.name_file_in_error(score)?;
                if let (Some(folder), Some(strip)) = (video, strip) {
                    self.keep(folder, &trial, &score, &strip)?;
                }
                scores.push(score);
                bar.inc(1);
            }
            let solved = scores[of_variant..].iter().filter(|score| score.success);
            let line = format!("{variant}: {} of {trials}", solved.count());
            bar.suspend(|| print_escaped(out, &line))?;
        }
        bar.finish_and_clear();
        print_escaped(out, &trial_success_table(&scores))?;
        Ok(scores)
    }

    /// Writes the film strip or film of a trial that is the first of its variant, or failed.
    fn keep(
        &self,
        folder: &Path,
        trial: &Trial,
        score: &TrialResult,
        strip: &FilmStrip,
    ) -> Result<(), DeployError> {
        if score.success && trial.index > 0 {
            return Ok(());
        }
        let variant = trial.variant.to_string().replace(' ', "-");
        let outcome = if score.success { "solved" } else { "failed" };
        let ending = if self.gif { "gif" } else { "png" };
        let path = folder.join(format!("{variant}-{}-{outcome}.{ending}", trial.index));
        let bytes = if self.gif {
            let ended = if score.success { "solved" } else { "not solved" };
            let title = format!("{}, trial {}: {ended}", trial.variant, trial.index);
            encode_gif(&strip.to_film(&title)).map_err(RunError::write_error_mapper(&path))?
        } else {
            strip.to_picture().to_png().map_err(RunError::write_error_mapper(&path))?
        };
        Ok(write_atomically(&LocalDisk, &path, &bytes)?)
    }
}
