//! `covers deploy`: trials of all variants on a robot.

use std::io::Write;
use std::path::PathBuf;

use clap::builder::RangedU64ValueParser;
use clap::{Args, ValueEnum};
use envs::{TaskGroup, TaskRegistry};

use crate::cli::say;
use crate::disk::{LocalDisk, replace};
use crate::error::CoversError;
use crate::render::gif;
use crate::runs::RunFolder;

use super::deployment::Deployment;
use super::faults::FaultSweep;
use super::rig::Trial;
use super::settings::SightSettings;
use super::simulated::{SimulatedRig, SimulationSettings};
use super::strip::Strip;
use super::sweep::Files;
use super::table::{TrialScore, deployment_table};

/// A robot that the command knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum RobotKind {
    /// A Kinova Gen3 in simulation, which no policy was trained with.
    KinovaSim,
}

/// What is wrong with a simulated robot and its camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Faults {
    /// Nothing.
    Off,
    /// About what is wrong with real ones.
    Nominal,
}

/// What to try.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Example: covers deploy assets/pretrained --trials 5 --video films --gif")]
pub struct DeployOptions {
    /// The folder of a run, or one that `covers pack` made.
    pub run: PathBuf,
    /// The robot.
    #[arg(long, value_enum, default_value = "kinova-sim")]
    pub robot: RobotKind,
    /// Trials of each variant.
    #[arg(long, default_value_t = 20, value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub trials: usize,
    /// This group alone, as `goal-reach` (default: all groups of the run).
    #[arg(long, visible_alias = "group")]
    pub task: Option<String>,
    /// Seed of placements and faults.
    #[arg(long, default_value_t = 0)]
    pub seed: u64,
    /// What is wrong with the camera and the arm.
    #[arg(long, value_enum, default_value = "nominal")]
    pub faults: Faults,
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
        let folder = RunFolder::open(&self.run);
        let tasks = TaskRegistry::standard();
        let schedule = folder.experiment()?.schedule;
        let groups = schedule.chosen(self.task.as_deref(), &tasks)?;
        let settings = match self.faults {
            Faults::Off => SimulationSettings::OFF,
            Faults::Nominal => SimulationSettings::NOMINAL,
        };
        let settings = (settings, SightSettings::default());
        if let (Some(sweep), Some(figures)) = (&self.sweep, &self.figures) {
            let steps = sweep.amounts.iter().map(|&amount| {
                let settings = sweep.fault.set(amount, settings)?;
                Ok((amount, settings))
            });
            let steps = steps.collect::<Result<Vec<_>, CoversError>>()?;
            let files = Files::create(figures, sweep.fault)?;
            let mut swept = Vec::new();
            for (amount, settings) in steps {
                say(out, &format!("{}: {amount}", sweep.fault.axis()))?;
                swept.push((amount, self.trials(out, &folder, &groups, settings)?));
                files.write(&groups, &swept)?;
            }
            return Ok(());
        }
        let scores = self.trials(out, &folder, &groups, settings)?;
        match self.json {
            true => say(out, &serde_json::json!(scores).to_string()),
            false => Ok(()),
        }
    }

    /// Runs the trials of all variants of `groups` and prints their table.
    fn trials(
        &self,
        out: &mut impl Write,
        folder: &RunFolder,
        groups: &[TaskGroup],
        (settings, sight): (SimulationSettings, SightSettings),
    ) -> Result<Vec<TrialScore>, CoversError> {
        let mut deployment = Deployment::load(folder, sight)?;
        let RobotKind::KinovaSim = self.robot;
        let mut rig = SimulatedRig::new(settings, *deployment.camera())?;
        let arm = rig.arm().clone();
        let mut scores = Vec::new();
        for variant in groups.iter().flat_map(|group| group.variants()) {
            let of_variant = scores.len();
            for number in 0..self.trials {
                let seed = self.seed;
                let trial = Trial {
                    variant,
                    number,
                    seed,
                };
                let mut strip = self.video.as_ref().map(|_| Strip::default());
                let score = deployment.trial(&mut rig, &arm, &trial, strip.as_mut())?;
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
