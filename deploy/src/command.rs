//! `covers deploy`: trials of all variants on a robot.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::RangedU64ValueParser;
use envs::carriers::Arm;
use envs::{TaskGroup, TaskRegistry};

use crate::DeployError;
use experiments::cli::say;
use experiments::{RunError, RunFolder};
use learner::disk::{LocalDisk, replace};
use render::gif;

use super::deployment::Deployment;
use super::faults::{Fault, FaultSweep};
use super::options::{RobotKind, SiteOptions};
use super::results::Results;
use super::rig::{Rig, Trial};
use super::settings::SightSettings;
use super::simulated::{SimulatedRig, SimulationSettings};
use super::strip::Strip;
use super::table::{TrialScore, deployment_table};

/// What is wrong with a simulated rig, and how its pictures are looked at.
type Wrong = (SimulationSettings, SightSettings);
/// A fault, its amounts, and the settings with each.
type Amounts = (Fault, Vec<(f64, Wrong)>);

/// What to try.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Examples:\n  \
    covers deploy assets/pretrained-robot --trials 5 --video films --gif\n  \
    covers deploy assets/pretrained-robot --trials 5 --out swept --sweep angle-error=0,1,2,3\n  \
    covers deploy assets/pretrained-robot --calibration calibration.json\n  \
    covers deploy assets/pretrained-robot --dry-run")]
pub struct DeployOptions {
    #[command(flatten)]
    #[allow(missing_docs)]
    pub site: SiteOptions,
    /// Trials of each variant.
    #[arg(long, default_value_t = 20, value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub trials: usize,
    /// This group alone, as `goal-reach` (default: all groups of the run).
    #[arg(long, visible_alias = "group")]
    pub task: Option<String>,
    /// Do all but move: one trial of the first variant on the table as it is. Prints the decisions,
    /// the commands that were withheld, and how long each stage takes.
    #[arg(long, conflicts_with_all = ["json", "out", "sweep", "sweep_trials", "video"])]
    pub dry_run: bool,
    /// Folder for strips of pictures (PNG) of the first trial of each variant and of each trial
    /// that failed: what the camera saw, the mask, and what the policy was shown.
    #[arg(long)]
    pub video: Option<PathBuf>,
    /// Moving pictures (GIF) of all decisions instead of strips.
    #[arg(long, requires = "video")]
    pub gif: bool,
    /// Print all trials as one JSON value, in the last line.
    #[arg(long)]
    pub json: bool,
    /// Then run the trials once for each amount of something that is wrong, as
    /// `position-error=0,5,10,20,30`: position-error and mask-growth (mm), angle-error (degrees),
    /// picture-latency and command-latency (ms), exposure-drift and balance-drift (%). May be given
    /// several times, for one fault each.
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
    /// Runs all trials, then those of the sweeps, and prints to `out`.
    ///
    /// # Errors
    /// As [`Deployment::trial`]; folders and an `out` that cannot be written to; options that do
    /// not fit each other.
    pub fn run(&self, out: &mut impl Write) -> Result<(), DeployError> {
        let nominal = self.site.rig.settings()?;
        let sweeps = self.amounts(nominal)?;
        let (mut deployment, mut rig) = self.simulated(nominal)?;
        if self.dry_run {
            // a table that is there, which a rehearsal does not set
            let set_up = rig.set_up(&self.first(self.groups()?[0]));
            set_up.map_err(|source| DeployError::Rig { source })?;
        }
        let arm = rig.arm().clone();
        let results = self.results()?;
        let scores = self.act(&mut deployment, (&mut rig, &arm), results.as_ref(), out)?;
        match results {
            Some(results) => self.sweep(&sweeps, (nominal, &scores), &results, out),
            None => Ok(()),
        }
    }

    /// The trials on a rig of somebody's own; `arm` is what is known of its robot.
    ///
    /// # Errors
    /// As [`DeployOptions::run`], and single faults and sweeps, which nobody can set there.
    pub fn run_on(
        &self,
        rig: &mut dyn Rig,
        arm: &Arm,
        out: &mut impl Write,
    ) -> Result<(), DeployError> {
        let single = self.site.rig.fault.iter().map(|of| of.fault);
        let mut faults = self.sweep.iter().map(|of| of.fault).chain(single);
        if let Some(fault) = faults.next() {
            return Err(RunError::Setting {
                name: "fault",
                value: fault.name().to_owned(),
                expected: "none: faults are set in simulated rigs alone",
            }
            .into());
        }
        let mut deployment = self.site.deployment(SightSettings::default())?;
        let results = self.results()?;
        self.act(&mut deployment, (rig, arm), results.as_ref(), out)?;
        Ok(())
    }

    fn results(&self) -> Result<Option<Results>, DeployError> {
        let faults = || self.sweep.iter().map(|sweep| sweep.fault);
        let folder = self.out.as_deref();
        let results = folder.map(|folder| Results::create(folder, faults()));
        results.transpose()
    }

    /// The trials, or the rehearsal of one.
    fn act(
        &self,
        deployment: &mut Deployment,
        (rig, arm): (&mut dyn Rig, &Arm),
        results: Option<&Results>,
        out: &mut impl Write,
    ) -> Result<Vec<TrialScore>, DeployError> {
        let groups = self.groups()?;
        if self.dry_run {
            let rehearsal = deployment.rehearse(rig, arm, &self.first(groups[0]))?;
            say(out, rehearsal.text().trim_end())?;
            return Ok(Vec::new());
        }
        let video = self.video.as_deref();
        let scores = self.trials(out, deployment, (rig, arm), (&groups, self.trials), video)?;
        if let Some(results) = results {
            results.write_trials(&scores)?;
        }
        if self.json {
            say(out, &serde_json::json!(scores).to_string())?;
        }
        Ok(scores)
    }

    /// The first trial of a group.
    fn first(&self, group: TaskGroup) -> Trial {
        Trial { variant: group.variants()[0], number: 0, seed: self.site.rig.seed }
    }

    fn groups(&self) -> Result<Vec<TaskGroup>, RunError> {
        let schedule = RunFolder::open(&self.site.run).experiment()?.schedule;
        schedule.chosen(self.task.as_deref(), &TaskRegistry::standard())
    }

    fn simulated(
        &self,
        (settings, sight): Wrong,
    ) -> Result<(Deployment, SimulatedRig), DeployError> {
        let RobotKind::KinovaSim = self.site.rig.robot;
        let deployment = self.site.deployment(sight)?;
        let rig = SimulatedRig::new(settings, *deployment.camera())?;
        Ok((deployment, rig))
    }

    /// What each amount of each sweep makes of the settings.
    fn amounts(&self, nominal: Wrong) -> Result<Vec<Amounts>, DeployError> {
        let mut sweeps: Vec<Amounts> = Vec::new();
        for FaultSweep { fault, amounts } in &self.sweep {
            let refused = |expected| RunError::Setting {
                name: "sweep",
                value: fault.name().to_owned(),
                expected,
            };
            if sweeps.iter().any(|(of, _)| of == fault) {
                return Err(refused("each fault once").into());
            }
            let replaced = matches!(fault, Fault::PositionError | Fault::AngleError);
            if replaced && self.site.camera.calibration.is_some() {
                return Err(refused(
                    "another fault, or no --calibration: the file takes the place of the \
                     calibration that would be wrong, so all amounts would be one",
                )
                .into());
            }
            let amounts = amounts.iter();
            let steps = amounts.map(|&amount| Ok((amount, fault.set(amount, nominal)?)));
            sweeps.push((*fault, steps.collect::<Result<_, DeployError>>()?));
        }
        Ok(sweeps)
    }

    /// Runs the trials for each amount of each fault; those of `nominal` have been run.
    fn sweep(
        &self,
        sweeps: &[Amounts],
        (nominal, scores): (Wrong, &[TrialScore]),
        results: &Results,
        out: &mut impl Write,
    ) -> Result<(), DeployError> {
        let groups = self.groups()?;
        let trials = self.sweep_trials.unwrap_or(self.trials);
        for (fault, amounts) in sweeps {
            let mut swept = Vec::new();
            for &(amount, wrong) in amounts {
                say(out, &format!("{}: {amount}", fault.axis()))?;
                let scores = if wrong == nominal && trials <= self.trials {
                    say(out, "among the trials above")?;
                    let first = scores.iter().filter(|score| score.number < trials);
                    first.copied().collect()
                } else {
                    let (mut deployment, mut rig) = self.simulated(wrong)?;
                    let arm = rig.arm().clone();
                    let on = (&mut rig as &mut dyn Rig, &arm);
                    self.trials(out, &mut deployment, on, (&groups, trials), None)?
                };
                swept.push((amount, scores));
                results.write_sweep(*fault, &groups, &swept)?;
            }
        }
        Ok(())
    }

    /// Runs so many trials of each variant of `groups` and prints their table; pictures go to
    /// `video`.
    fn trials(
        &self,
        out: &mut impl Write,
        deployment: &mut Deployment,
        (rig, arm): (&mut dyn Rig, &Arm),
        (groups, trials): (&[TaskGroup], usize),
        video: Option<&Path>,
    ) -> Result<Vec<TrialScore>, DeployError> {
        let mut scores = Vec::new();
        for variant in groups.iter().flat_map(|group| group.variants()) {
            let of_variant = scores.len();
            for number in 0..trials {
                let trial = Trial { variant, number, seed: self.site.rig.seed };
                let mut strip = video.map(|_| Strip::default());
                let score = deployment.trial(rig, arm, &trial, strip.as_mut())?;
                if let (Some(folder), Some(strip)) = (video, strip) {
                    self.keep(folder, &trial, &score, &strip)?;
                }
                scores.push(score);
            }
            let solved = scores[of_variant..].iter().filter(|score| score.success);
            say(out, &format!("{variant}: {} of {trials}", solved.count()))?;
        }
        say(out, &deployment_table(&scores))?;
        Ok(scores)
    }

    fn keep(
        &self,
        folder: &Path,
        trial: &Trial,
        score: &TrialScore,
        strip: &Strip,
    ) -> Result<(), DeployError> {
        if score.success && trial.number > 0 {
            return Ok(());
        }
        let variant = trial.variant.to_string().replace(' ', "-");
        let outcome = if score.success { "solved" } else { "failed" };
        let ending = if self.gif { "gif" } else { "png" };
        let path = folder.join(format!("{variant}-{}-{outcome}.{ending}", trial.number));
        let written = |error| RunError::write(&path, error);
        std::fs::create_dir_all(folder).map_err(written)?;
        let bytes = match self.gif {
            true => {
                let title = format!("{}, trial {}", trial.variant, trial.number);
                gif(&strip.film(&title)).map_err(|error| RunError::write(&path, error))?
            }
            false => {
                let png = strip.picture().to_png();
                png.map_err(|error| RunError::write(&path, error))?
            }
        };
        Ok(replace(&LocalDisk, &path, &bytes)?)
    }
}
