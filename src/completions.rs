//! `covers completions`: scripts with which a shell completes commands and options.

use std::io::Write;
use std::path::Path;

use clap::{Args, Command};
use clap_complete::Shell;

use experiments::RunError;

/// Options of `covers completions`.
#[derive(Clone, Copy, Debug, Args)]
#[command(after_help = "Examples:\n  \
    covers completions bash > ~/.local/share/bash-completion/completions/covers\n  \
    covers completions zsh > ~/.zfunc/_covers\n  \
    covers completions fish > ~/.config/fish/completions/covers.fish")]
pub struct CompletionsOptions {
    /// Shell that the script is for.
    #[arg(value_enum)]
    pub shell: Shell,
}

impl CompletionsOptions {
    /// Prints the script with which the shell completes the commands and options of `program`.
    ///
    /// # Errors
    /// An `out` that cannot be written to.
    pub fn run(&self, mut program: Command, out: &mut impl Write) -> Result<(), RunError> {
        let mut script = Vec::new();
        let name = program.get_name().to_owned();
        clap_complete::generate(self.shell, &mut program, name, &mut script);
        out.write_all(&script).map_err(RunError::write_error_mapper(Path::new("standard output")))
    }
}
