//! `covers man`: manual pages of all commands.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::{Args, Command};
use clap_mangen::Man;

use experiments::RunError;
use experiments::cli::print_escaped;

/// Options of `covers man`.
#[derive(Clone, Debug, Args)]
#[command(
    after_help = "Examples:\n  covers man | man -l -\n  covers man check mask | man -l -\n  \
    covers man --out ~/.local/share/man/man1"
)]
pub struct ManualOptions {
    /// Command whose page is printed, such as `check mask` (default: `covers` itself).
    #[arg(value_name = "COMMAND")]
    pub command: Vec<String>,
    /// Write the pages of all commands to this folder, and create it if needed.
    #[arg(long, value_name = "DIR", conflicts_with = "command")]
    pub out: Option<PathBuf>,
}

impl ManualOptions {
    /// Prints the page of one of `program`'s commands in roff, or writes the pages of all.
    ///
    /// # Errors
    /// [`RunError::InvalidSetting`] for an unknown command; a folder or `out` that cannot be
    /// written to.
    pub fn run(&self, program: Command, out: &mut impl Write) -> Result<(), RunError> {
        let mut program = program.disable_help_subcommand(true);
        // sets the display names of nested commands, which are the titles of their pages
        program.build();
        match &self.out {
            Some(folder) => {
                let pages = write(&program, folder)?;
                print_escaped(out, &format!("{pages} pages in {}", folder.display()))
            }
            None => {
                let page = render(self.chosen(&program)?);
                page.and_then(|page| out.write_all(&page))
                    .map_err(RunError::write_error_mapper(Path::new("standard output")))
            }
        }
    }

    fn chosen<'a>(&self, program: &'a Command) -> Result<&'a Command, RunError> {
        let mut words = self.command.iter();
        let chosen = words.try_fold(program, |command, word| command.find_subcommand(word));
        chosen.ok_or_else(|| {
            RunError::invalid(
                "command",
                self.command.join(" "),
                "a command that `covers --help` lists",
            )
        })
    }
}

/// Writes the pages of a command and its subcommands, and returns their number.
fn write(command: &Command, folder: &Path) -> Result<usize, RunError> {
    fs::create_dir_all(folder).map_err(RunError::write_error_mapper(folder))?;
    let path = folder.join(format!("{}.1", title(command)));
    render(command)
        .and_then(|page| fs::write(&path, page))
        .map_err(RunError::write_error_mapper(&path))?;
    let below = command.get_subcommands().map(|own| write(own, folder));
    below.sum::<Result<usize, _>>().map(|below| 1 + below)
}

/// Returns the name of a command's page: its words joined by hyphens.
fn title(command: &Command) -> &str {
    command.get_display_name().unwrap_or_else(|| command.get_name())
}

fn render(command: &Command) -> std::io::Result<Vec<u8>> {
    let mut page = Vec::new();
    let source = concat!("covers ", env!("CARGO_PKG_VERSION"));
    Man::new(command.clone()).source(source).render(&mut page)?;
    Ok(page)
}
