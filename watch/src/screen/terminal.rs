//! The terminal, which is as it was whichever way a program leaves it.

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
/// What panics said while a screen was up; none while no screen is.
type Said = Arc<Mutex<Option<Vec<String>>>>;

/// A terminal that a program draws on. What it showed before comes back when the value is dropped,
/// then what panics said meanwhile is printed. A panic that is caught disturbs nothing.
pub struct Screen {
    /// Never dropped: it would print to a terminal that may be gone, and panic.
    terminal: ManuallyDrop<Terminal<CrosstermBackend<Stdout>>>,
    said: Said,
}

impl Screen {
    /// Takes the terminal that standard output is.
    ///
    /// # Errors
    /// [`RunError::Write`] where standard output is no terminal.
    pub fn open() -> Result<Self, RunError> {
        let terminal = Terminal::new(CrosstermBackend::new(stdout())).map_err(broken)?;
        enable_raw_mode().map_err(broken)?;
        let said = Arc::new(Mutex::new(Some(Vec::new())));
        keep(Arc::clone(&said));
        // from here on dropping the value restores
        let screen = Self { terminal: ManuallyDrop::new(terminal), said };
        execute!(stdout(), EnterAlternateScreen).map_err(broken)?;
        Ok(screen)
    }

    /// Draws anew.
    ///
    /// # Errors
    /// [`RunError::Write`] of a terminal that is gone.
    pub fn draw(&mut self, draw: impl FnOnce(&mut Frame)) -> Result<(), RunError> {
        self.terminal.draw(draw).map_err(broken)?;
        Ok(())
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        // a terminal that is gone needs no more
        let _ = disable_raw_mode();
        let _ = restore(&mut stdout());
        for said in release(&self.said) {
            let _ = writeln!(stderr(), "{said}");
        }
    }
}

/// An error of the terminal.
pub fn broken(error: io::Error) -> RunError {
    RunError::write(Path::new("the terminal"), error)
}

fn restore(out: &mut impl Write) -> io::Result<()> {
    execute!(out, LeaveAlternateScreen, Show)
}

/// From now on what panics say is kept while `said` holds a list, and printed as ever otherwise.
fn keep(said: Said) {
    let before = panic::take_hook();
    panic::set_hook(Box::new(move |panic| {
        let kept = said.lock().is_ok_and(|mut said| {
            said.as_mut().is_some_and(|said| {
                said.push(panic.to_string());
                true
            })
        });
        if !kept {
            before(panic);
        }
    }));
}

/// What was kept; nothing is kept from now on.
fn release(said: &Said) -> Vec<String> {
    let said = said.lock().ok().and_then(|mut said| said.take());
    said.unwrap_or_default()
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
        let said = Arc::new(Mutex::new(Some(Vec::new())));
        keep(Arc::clone(&said));
        let caught = panic::catch_unwind(|| panic!("a worker fell over"));
        assert!(caught.is_err());
        let kept = release(&said);
        assert!(kept.iter().any(|line| line.contains("a worker fell over")), "{kept:?}");
        assert!(release(&said).is_empty());
    }
}
