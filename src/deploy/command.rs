//! `covers deploy`: trials of all variants on a robot.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::RangedU64ValueParser;
use envs::carriers::Arm;
use envs::{TaskGroup, TaskRegistry};

use crate::cli::say;
use crate::disk::{LocalDisk, replace};
use crate::error::CoversError;
use crate::render::gif;
use crate::runs::RunFolder;

use super::deployment::Deployment;
use super::faults::{Fault, FaultSweep};
use super::options::{RobotKind, SiteOptions};
use super::rig::{Rig, Trial};
use super::settings::SightSettings;
use super::simulated::{SimulatedRig, SimulationSettings};
use super::strip::Strip;
use super::sweep::Files;
use super::table::{TrialScore, deployment_table};

/// What to try.
#[derive(Clone, Debug, Args)]
#[command(
    after_help = "Examples:\n  covers deploy assets/pretrained --trials 5 --video films --gif\n  \
    covers deploy assets/pretrained --calibration calibration.json\n  \
    covers deploy assets/pretrained --dry-run"
)]
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
    #[arg(long, conflicts_with_all = ["json", "sweep", "video"])]
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
    /// Run the trials once for each amount of something that is wrong, as
    /// `position-error=0,5,10,20,30`: position-error and mask-growth (mm), angle-error (degrees),
    /// picture-latency and command-latency (ms), exposure-drift and balance-drift (%).
    #[arg(long, value_name = "FAULT=AMOUNTS", requires = "figures")]
    #[arg(conflicts_with_all = ["json", "video"])]
    pub sweep: Option<FaultSweep>,
    /// Folder for the table (CSV) and the figure (SVG) of a sweep, named after the fault.
    #[arg(long, requires = "sweep")]
    pub figures: Option<PathBuf>,
}

impl DeployOptions {
    /// Runs all trials and prints to `out`.
    ///
    /// # Errors
    /// As [`Deployment::trial`]; folders and an `out` that cannot be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<(), CoversError> {
        let settings = self.site.rig.settings()?;
        if let (Some(sweep), Some(figures)) = (&self.sweep, &self.figures) {
            return self.sweep(sweep, figures, settings, out);
        }
        let (settings, sight) = settings;
        let mut deployment = self.site.deployment(sight)?;
        let mut rig = self.simulated(settings, &deployment)?;
        if self.dry_run {
            // a table that is there, which a rehearsal does not set
            let set_up = rig.set_up(&self.first(self.groups()?[0]));
            set_up.map_err(|source| CoversError::Rig { source })?;
        }
        let arm = rig.arm().clone();
        self.act(&mut deployment, &mut rig, &arm, out)
    }

    /// The same on a rig of somebody's own; `arm` is what is known of its robot. What the options
    /// say of faults and of sweeps is for simulated rigs.
    ///
    /// # Errors
    /// As [`DeployOptions::run`].
    pub fn run_on(
        &self,
        rig: &mut dyn Rig,
        arm: &Arm,
        out: &mut impl Write,
    ) -> Result<(), CoversError> {
        let mut deployment = self.site.deployment(SightSettings::default())?;
        self.act(&mut deployment, rig, arm, out)
    }

    fn act(
        &self,
        deployment: &mut Deployment,
        rig: &mut dyn Rig,
        arm: &Arm,
        out: &mut impl Write,
    ) -> Result<(), CoversError> {
        let groups = self.groups()?;
        if self.dry_run {
            let rehearsal = deployment.rehearse(rig, arm, &self.first(groups[0]))?;
            return say(out, rehearsal.text().trim_end());
        }
        let scores = self.trials(out, deployment, (rig, arm), &groups)?;
        match self.json {
            true => say(out, &serde_json::json!(scores).to_string()),
            false => Ok(()),
        }
    }

    /// The first trial of a group.
    fn first(&self, group: TaskGroup) -> Trial {
        Trial {
            variant: group.variants()[0],
            number: 0,
            seed: self.site.rig.seed,
        }
    }

    fn groups(&self) -> Result<Vec<TaskGroup>, CoversError> {
        let schedule = RunFolder::open(&self.site.run).experiment()?.schedule;
        schedule.chosen(self.task.as_deref(), &TaskRegistry::standard())
    }

    fn simulated(
        &self,
        settings: SimulationSettings,
        deployment: &Deployment,
    ) -> Result<SimulatedRig, CoversError> {
        let RobotKind::KinovaSim = self.site.rig.robot;
        SimulatedRig::new(settings, *deployment.camera())
    }

    /// Refuses errors of a calibration that a file would take the place of.
    fn check_sweep(&self, fault: Fault) -> Result<(), CoversError> {
        let replaced = matches!(fault, Fault::PositionError | Fault::AngleError);
        if !replaced || self.site.camera.calibration.is_none() {
            return Ok(());
        }
        Err(CoversError::Setting {
            name: "sweep",
            value: fault.name().to_owned(),
            expected: "another fault, or no --calibration: the file takes the place of the \
                       calibration that would be wrong, so all amounts would be one",
        })
    }

    /// Runs all trials for each amount of a fault.
    fn sweep(
        &self,
        sweep: &FaultSweep,
        figures: &Path,
        settings: (SimulationSettings, SightSettings),
        out: &mut impl Write,
    ) -> Result<(), CoversError> {
        self.check_sweep(sweep.fault)?;
        let groups = self.groups()?;
        let steps = sweep.amounts.iter().map(|&amount| {
            let settings = sweep.fault.set(amount, settings)?;
            Ok((amount, settings))
        });
        let steps = steps.collect::<Result<Vec<_>, CoversError>>()?;
        let files = Files::create(figures, sweep.fault)?;
        let mut swept = Vec::new();
        for (amount, (settings, sight)) in steps {
            say(out, &format!("{}: {amount}", sweep.fault.axis()))?;
            let mut deployment = self.site.deployment(sight)?;
            let mut rig = self.simulated(settings, &deployment)?;
            let arm = rig.arm().clone();
            let scores = self.trials(out, &mut deployment, (&mut rig, &arm), &groups)?;
            swept.push((amount, scores));
            files.write(&groups, &swept)?;
        }
        Ok(())
    }

    /// Runs the trials of all variants of `groups` and prints their table.
    fn trials(
        &self,
        out: &mut impl Write,
        deployment: &mut Deployment,
        (rig, arm): (&mut dyn Rig, &Arm),
        groups: &[TaskGroup],
    ) -> Result<Vec<TrialScore>, CoversError> {
        let mut scores = Vec::new();
        for variant in groups.iter().flat_map(|group| group.variants()) {
            let of_variant = scores.len();
            for number in 0..self.trials {
                let trial = Trial {
                    variant,
                    number,
                    seed: self.site.rig.seed,
                };
                let mut strip = self.video.as_ref().map(|_| Strip::default());
                let score = deployment.trial(rig, arm, &trial, strip.as_mut())?;
                self.keep(&trial, &score, strip)?;
                scores.push(score);
            }
            let solved = scores[of_variant..].iter().filter(|score| score.success);
            say(
                out,
                &format!("{variant}: {} of {}", solved.count(), self.trials),
            )?;
        }
        say(out, &deployment_table(&scores))?;
        Ok(scores)
    }

    fn keep(
        &self,
        trial: &Trial,
        score: &TrialScore,
        strip: Option<Strip>,
    ) -> Result<(), CoversError> {
        let (Some(folder), Some(strip)) = (&self.video, strip) else {
            return Ok(());
        };
        if score.success && trial.number > 0 {
            return Ok(());
        }
        let variant = trial.variant.to_string().replace(' ', "-");
        let outcome = if score.success { "solved" } else { "failed" };
        let ending = if self.gif { "gif" } else { "png" };
        let path = folder.join(format!("{variant}-{}-{outcome}.{ending}", trial.number));
        let written = |error| CoversError::write(&path, error);
        std::fs::create_dir_all(folder).map_err(written)?;
        let bytes = match self.gif {
            true => {
                let title = format!("{}, trial {}", trial.variant, trial.number);
                gif(&strip.film(&title)).map_err(|error| CoversError::write(&path, error))?
            }
            false => {
                let png = strip.picture().to_png();
                png.map_err(|error| CoversError::write(&path, error))?
            }
        };
        replace(&LocalDisk, &path, &bytes)
    }
}
