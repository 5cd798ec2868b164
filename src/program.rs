//! The command `covers`: its subcommands and exit codes.

use std::io::Write;

use clap::{CommandFactory, Parser, Subcommand};

use crate::CoversError;
use crate::check::CheckCommand;
use crate::commands::TrainingRunCommand;
use crate::completions::CompletionsOptions;
use crate::doctor::DoctorOptions;
use crate::export::ExportOptions;
use crate::list::ListRunsOptions;
use crate::manual::ManualOptions;
use crate::model::ModelCommand;
use crate::preset_list::PresetsOptions;
use crate::robot::RobotCommand;
use deploy::{CalibrateOptions, DeployOptions};
use experiments::{catch_file_size_signal, memory};
use render::RenderOptions;
use watch::WatchOptions;

const AFTER_HELP: &str = "\
Examples:
  covers train --budget short
  covers watch runs/covers-sac-short-seed0
  covers report runs/covers-sac-short-seed0 --out report

Exit codes:
  0    success: the command finished, and all checks passed
  1    an error, printed on standard error; a failed check; a part that `covers doctor` finds BAD
  2    invalid options
  3    a run stopped early by a signal or a closed output; `covers resume` continues it
  128 plus the number of a signal that ended the program at once (130 for Ctrl-C, 143 for SIGTERM);
       141 if the output was closed, but no training had to stop, as in `covers presets | head -1`";

/// Continual vision-based reinforcement learning with group symmetries.
#[derive(Debug, Parser)]
#[command(name = "covers", version, after_help = AFTER_HELP)]
pub struct CoversCli {
    #[command(subcommand)]
    subcommand: Subcommands,
}

#[derive(Debug, Subcommand)]
enum Subcommands {
    #[command(flatten)]
    Learner(TrainingRunCommand),
    /// Runs the policies of a run on a robot with a camera.
    Deploy(DeployOptions),
    /// Calibrates a robot's camera with a ball that the arm carries.
    Calibrate(CalibrateOptions),
    /// Lists the runs of a folder with their state, success and size.
    List(ListRunsOptions),
    /// Shows a run in progress: learning curves, groups and policies, distances.
    Watch(WatchOptions),
    /// Renders policies in action, as a GIF or an mp4.
    Render(RenderOptions),
    /// Exports a policy for other programs: ONNX, and safetensors for PyTorch.
    Export(ExportOptions),
    /// Checks the environments or a robot's mask, and fails if a value exceeds its bound.
    #[command(subcommand, after_help = "Example: covers check symmetry --embodiment hand")]
    Check(CheckCommand),
    /// Checks a robot's URDF, or converts it to MJCF.
    #[command(subcommand, after_help = "Example: covers robot check arm.urdf")]
    Robot(RobotCommand),
    /// Checks whether the left and the right side of a model are mirror images.
    #[command(subcommand, after_help = "Example: covers model check robot.xml")]
    Model(ModelCommand),
    /// Reports what this machine has, how fast it is, and how to fix what is missing.
    Doctor(DoctorOptions),
    /// Lists methods and budgets, or prints all settings of a preset.
    Presets(PresetsOptions),
    /// Prints a script with which a shell completes commands and options.
    Completions(CompletionsOptions),
    /// Prints manual pages.
    Man(ManualOptions),
}

impl CoversCli {
    /// Runs the subcommand, prints to `out`, and returns the exit code, as `covers --help` lists
    /// them.
    ///
    /// # Errors
    /// Errors of the subcommand, or an `out` that cannot be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<u8, CoversError> {
        catch_file_size_signal()?;
        // a renderer that finds no memory would end the process without a message
        if self.renders() {
            memory::check_environment_memory(1)?;
        }
        let done = |()| 0;
        Ok(match &self.subcommand {
            Subcommands::Learner(command) => command.run(out)?.exit_code(),
            Subcommands::Deploy(deploy) => deploy.run(out).map(done)?,
            Subcommands::Calibrate(calibrate) => calibrate.run(out).map(done)?,
            Subcommands::List(list) => list.run(out).map(done)?,
            Subcommands::Watch(watch) => watch.run(out)?,
            Subcommands::Render(render) => render.run(out).map(done)?,
            Subcommands::Export(export) => export.run(out).map(done)?,
            Subcommands::Check(check) => u8::from(!check.run(out)?),
            Subcommands::Robot(robot) => u8::from(!robot.run(out)?),
            Subcommands::Model(model) => u8::from(!model.run(out)?),
            Subcommands::Doctor(doctor) => u8::from(!doctor.run(out)?),
            Subcommands::Presets(presets) => presets.run(out).map(done)?,
            Subcommands::Completions(shell) => shell.run(Self::command(), out).map(done)?,
            Subcommands::Man(manual) => manual.run(Self::command(), out).map(done)?,
        })
    }

    /// Returns `true` for commands that render images of simulations.
    fn renders(&self) -> bool {
        match &self.subcommand {
            Subcommands::Deploy(_)
            | Subcommands::Calibrate(_)
            | Subcommands::Render(_)
            | Subcommands::Export(_)
            | Subcommands::Check(_) => true,
            Subcommands::Learner(TrainingRunCommand::Report(report)) => report.films,
            // runs and evaluations check what their threads need, and the doctor reports it
            Subcommands::Learner(_)
            | Subcommands::Doctor(_)
            | Subcommands::Robot(_)
            | Subcommands::Model(_)
            | Subcommands::List(_)
            | Subcommands::Watch(_)
            | Subcommands::Presets(_)
            | Subcommands::Completions(_)
            | Subcommands::Man(_) => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the output of the program with these arguments.
    fn printed(words: &[&str]) -> Result<String, CoversError> {
        let mut out = Vec::new();
        let program = CoversCli::try_parse_from([&["covers"], words].concat()).unwrap();
        assert_eq!(program.run(&mut out)?, 0);
        Ok(String::from_utf8(out).unwrap())
    }

    /// Returns the words of every command below `command`, without `help`.
    fn commands(command: &clap::Command, words: &[String]) -> Vec<Vec<String>> {
        let below = command.get_subcommands().flat_map(|own| {
            let words = [words, &[own.get_name().to_owned()]].concat();
            let deeper = commands(own, &words);
            std::iter::once(words).chain(deeper)
        });
        below.collect()
    }

    #[test]
    fn options_agree_with_one_another() {
        CoversCli::command().debug_assert();
    }

    #[test]
    fn every_help_has_an_example() {
        for words in commands(&CoversCli::command(), &[]) {
            let mut command = CoversCli::command();
            for word in &words {
                command = command.find_subcommand(word).unwrap().clone();
            }
            let help = command.render_help().to_string();
            let example = format!("covers {}", words.join(" "));
            let (_, below) = help.split_once("Example").unwrap_or_default();
            assert!(below.contains(&example), "{example}: {help}");
        }
        let help = CoversCli::command().render_help().to_string();
        assert!(help.contains("Example") && help.contains("Exit codes"), "{help}");
    }

    #[test]
    fn completions_know_every_command_in_every_shell() {
        for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
            let script = printed(&["completions", shell]).unwrap();
            let apart = |letter: char| !letter.is_alphanumeric();
            let said: Vec<&str> = script.split(apart).collect();
            for words in commands(&CoversCli::command(), &[]) {
                let name = words.last().unwrap();
                assert!(said.contains(&name.as_str()), "{shell}: {name}");
            }
        }
        let script = printed(&["completions", "bash"]).unwrap();
        assert!(script.contains(" covers.ppo.gamma "), "paths of settings");
        for words in commands(&CoversCli::command(), &[]) {
            let case = format!("covers__subcmd__{}", words.join("__subcmd__"));
            assert!(script.contains(&case), "{case}: {script}");
        }
    }

    #[test]
    fn every_command_has_a_manual_page() {
        let page = printed(&["man"]).unwrap();
        for expected in [".TH covers 1", "Exit codes", "covers\\-watch(1)"] {
            assert!(page.contains(expected), "{expected}: {page}");
        }
        for words in commands(&CoversCli::command(), &[]) {
            let words: Vec<&str> = words.iter().map(String::as_str).collect();
            let command_page = printed(&[&["man"], &words[..]].concat()).unwrap();
            let title = format!(".TH covers-{} 1", words.join("-"));
            assert!(
                command_page.contains(&title) && command_page.contains("Example"),
                "{title}: {command_page}"
            );
        }
        let unknown = printed(&["man", "fly"]).unwrap_err().to_string();
        assert!(unknown.contains("`command` is fly"), "{unknown}");
    }

    #[test]
    fn pages_are_files_of_a_folder() {
        let folder = std::env::temp_dir().join(format!("covers-man-{}", std::process::id()));
        let said = printed(&["man", "--out", folder.to_str().unwrap()]).unwrap();
        let pages = 1 + commands(&CoversCli::command(), &[]).len();
        assert!(said.starts_with(&format!("{pages} pages in ")), "{said}");
        for name in ["covers.1", "covers-train.1", "covers-check-mask.1"] {
            assert!(folder.join(name).is_file(), "{name}");
        }
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), pages);
        std::fs::remove_dir_all(folder).unwrap();
    }
}
