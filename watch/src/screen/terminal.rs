//! Terminal in full-screen mode, restored however the program leaves it.

use std::io::{self, Stdout, Write, stderr, stdout};
use std::mem::ManuallyDrop;
use std::panic;
use std::path::Path;
use std::sync::{Arc, Mutex};

use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::cursor::Show;
use ratatui::crossterm::execute;
use ratatui::crossterm::terminal::{
    EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode,
};
use ratatui::{Frame, Terminal};

use experiments::RunError;

/// Messages of panics while a screen is open; `None` while no screen is.
type PanicMessages = Arc<Mutex<Option<Vec<String>>>>;

/// Terminal in full-screen mode. Dropping it restores the former contents, then prints the messages
/// of panics that happened meanwhile, so that a caught panic does not garble the screen.
pub struct FullScreenTerminal {
    /// Backend that is never dropped: its destructor prints to a terminal that may be gone, and
    /// would panic.
    terminal: ManuallyDrop<Terminal<CrosstermBackend<Stdout>>>,
    messages: PanicMessages,
}

impl FullScreenTerminal {
    /// Switches the terminal of standard output to full-screen mode.
    ///
    /// # Errors
    /// [`RunError::Write`] if standard output is not a terminal.
    pub fn open() -> Result<Self, RunError> {
        let terminal = Terminal::new(CrosstermBackend::new(stdout())).map_err(terminal_error)?;
        enable_raw_mode().map_err(terminal_error)?;
        let messages = Arc::new(Mutex::new(Some(Vec::new())));
        keep(Arc::clone(&messages));
        // before the next call, which may fail: from here on, dropping the value restores the
        // terminal
        let screen = Self { terminal: ManuallyDrop::new(terminal), messages };
        execute!(stdout(), EnterAlternateScreen).map_err(terminal_error)?;
        Ok(screen)
    }

    /// Redraws the whole screen with what `draw` puts on its frame.
    ///
    /// # Errors
    /// [`RunError::Write`] if the terminal is gone.
    pub fn draw(&mut self, draw: impl FnOnce(&mut Frame)) -> Result<(), RunError> {
        self.terminal.draw(draw).map_err(terminal_error)?;
        Ok(())
    }
}

impl Drop for FullScreenTerminal {
    fn drop(&mut self) {
        // errors mean that the terminal is gone, and then there is nothing to restore
        let _ = disable_raw_mode();
        let _ = restore(&mut stdout());
        for message in release(&self.messages) {
            let _ = writeln!(stderr(), "{message}");
        }
    }
}

/// Converts an error of the terminal to a [`RunError`].
pub fn terminal_error(error: io::Error) -> RunError {
    RunError::cannot_write(Path::new("the terminal"), error)
}

fn restore(out: &mut impl Write) -> io::Result<()> {
    execute!(out, LeaveAlternateScreen, Show)
}

/// Collects the messages of panics while `messages` holds a list; afterwards they are printed as
/// before.
fn keep(messages: PanicMessages) {
    let before = panic::take_hook();
    panic::set_hook(Box::new(move |panic| {
        let kept = messages.lock().is_ok_and(|mut messages| {
            messages.as_mut().is_some_and(|messages| {
                messages.push(panic.to_string());
                true
            })
        });
        if !kept {
            before(panic);
        }
    }));
}

fn release(messages: &PanicMessages) -> Vec<String> {
    messages.lock().ok().and_then(|mut messages| messages.take()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leaving_shows_what_was_there_and_the_cursor() {
        let mut out = Vec::new();
        restore(&mut out).unwrap();
        assert_eq!(String::from_utf8(out).unwrap(), "\x1b[?1049l\x1b[?25h");
    }

    #[test]
    fn what_a_panic_says_is_kept_while_a_screen_is_up() {
        let messages = Arc::new(Mutex::new(Some(Vec::new())));
        keep(Arc::clone(&messages));
        let caught = panic::catch_unwind(|| panic!("a worker fell over"));
        assert!(caught.is_err());
        let kept = release(&messages);
        assert!(kept.iter().any(|line| line.contains("a worker fell over")), "{kept:?}");
        assert!(release(&messages).is_empty());
    }
}
