//! Interactive session: the screen with keys and signals, for a run of this process or another one.

use std::cell::Cell;
use std::fs;
use std::io::{self, IsTerminal, stdin};
use std::panic::resume_unwind;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyModifiers};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::{flag, low_level};

use experiments::sheet::{Picture, crop_first_variant};
use experiments::{LatestFrame, Run, RunError, StopSignal};

use super::RunSnapshot;
use super::draw::{ScreenContents, draw_run_screen};
use super::terminal::{FullScreenTerminal, terminal_error};

/// Polling interval of keys, signals and the run's tables.
const TICK: Duration = Duration::from_millis(200);
/// Time after a request to quit in which `q` is not a second request: a key that is held repeats.
const HELD: Duration = Duration::from_secs(2);
/// Exit code of a program that a signal ended, less the signal's number.
const SIGNALLED: usize = 128;
/// Exit code after Ctrl-C.
const INTERRUPTED: u8 = (SIGNALLED + SIGINT as usize) as u8;

/// Exit code after SIGHUP.
const HUNG_UP: u8 = (SIGNALLED + SIGHUP as usize) as u8;

/// Shows on the terminal, until the user quits, a run that another process trains. Returns the exit
/// code: 0 after `q`, 128 plus its number after a signal.
///
/// # Errors
/// A terminal that is gone, tables that cannot be read.
pub(crate) fn watch_run(mut snapshot: RunSnapshot) -> Result<u8, RunError> {
    let (quit, sheet) = (QuitListener::listen()?, contact_sheet(&snapshot));
    let mut screen = FullScreenTerminal::open()?;
    loop {
        let picture = current_group(&snapshot, sheet.as_ref());
        show(&mut screen, &snapshot, picture, "q quits", quit.explained.get())?;
        if let Some(code) = quit.requested()? {
            return Ok(code);
        }
        snapshot.refresh()?;
    }
}

/// Trains to the end of the run or until the user quits; a second thread shows the screen.
///
/// # Errors
/// Errors of the run; a terminal that is gone, in which case the run is saved first.
pub fn train_with_screen(run: &mut Run) -> Result<(), RunError> {
    let (stop, latest_frame) = (StopSignal::default(), LatestFrame::default());
    run.set_stop_signal(stop.clone());
    run.publish_frames_to(latest_frame.clone());
    let viewer = Viewer {
        quit: QuitListener::listen()?,
        snapshot: RunSnapshot::open(run.folder().path())?,
        screen: FullScreenTerminal::open()?,
        stop,
        latest_frame,
    };
    let over = AtomicBool::new(false);
    let (trained, viewed) = thread::scope(|scope| {
        let viewer = scope.spawn(|| viewer.view(&over));
        let trained = {
            let _over = SetOnDrop(&over);
            advance_to_end(run)
        };
        (trained, viewer.join())
    });
    let shown = match viewed {
        Ok(result) => result,
        Err(panic) => {
            // the screen's panic stopped training in good order, so nothing of it need be lost
            if trained.is_ok() {
                run.save_checkpoint()?;
            }
            resume_unwind(panic)
        }
    };
    trained?;
    if shown.is_err() {
        run.save_checkpoint()?;
    }
    shown
}

fn advance_to_end(run: &mut Run) -> Result<(), RunError> {
    while run.advance()?.is_some() {}
    Ok(())
}

/// Guard that sets a flag when it is dropped, which a panic does, too.
struct SetOnDrop<'a>(&'a AtomicBool);

impl Drop for SetOnDrop<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::SeqCst);
    }
}

/// Screen of a run that trains in this process, with the means to stop the run.
struct Viewer {
    quit: QuitListener,
    snapshot: RunSnapshot,
    screen: FullScreenTerminal,
    stop: StopSignal,
    latest_frame: LatestFrame,
}

impl Viewer {
    /// Draws the screen until the run is over. The first request to quit stops the run, the second
    /// one ends the process. Tables that cannot be read do not stop the run: the screen keeps the
    /// older ones.
    fn view(mut self, over: &AtomicBool) -> Result<(), RunError> {
        // without a screen nobody could stop the run, so it stops when this function ends
        let _stop = StopOnDrop(self.stop.clone());
        let mut unreadable: Option<String> = None;
        let mut first_request: Option<Instant> = None;
        while !over.load(Ordering::SeqCst) {
            let picture = self.latest_frame.newest();
            let picture = picture.map(|picture| ("environment 0, now".to_owned(), picture));
            let keys = match (&unreadable, self.stop.is_requested()) {
                (_, true) => "stops after this rollout; q again ends at once",
                (Some(error), false) => error.as_str(),
                (None, false) => "q stops with a checkpoint",
            };
            let explained = self.quit.explained.get();
            show(&mut self.screen, &self.snapshot, picture, keys, explained)?;
            let since = first_request.map(|first| first.elapsed());
            match self.quit.requested()?.filter(|&code| counts(code, since)) {
                None => {}
                // a terminal that closes may send SIGHUP twice, and SIGTERM may follow
                Some(HUNG_UP) => self.stop.request(),
                Some(code) if first_request.is_some() => {
                    // `exit` runs no destructors: restore the terminal first
                    drop(self.screen);
                    // `q` ends a run as Ctrl-C does
                    low_level::exit(i32::from(if code == 0 { INTERRUPTED } else { code }));
                }
                Some(_) => {
                    first_request = Some(Instant::now());
                    self.stop.request();
                }
            }
            unreadable = self.snapshot.refresh().err().map(|error| error.to_string());
        }
        Ok(())
    }
}

/// Guard that stops a run when it is dropped.
struct StopOnDrop(StopSignal);

impl Drop for StopOnDrop {
    fn drop(&mut self) {
        self.0.request();
    }
}

fn show(
    screen: &mut FullScreenTerminal,
    snapshot: &RunSnapshot,
    picture: Option<(String, Picture)>,
    keys: &str,
    explained: bool,
) -> Result<(), RunError> {
    let RunSnapshot { run, finished, .. } = snapshot;
    let shown = ScreenContents {
        run,
        finished: *finished,
        time_since_change: snapshot.time_since_change(),
        picture,
        key_help: keys,
        explained,
    };
    screen.draw(|frame| draw_run_screen(&shown, frame))
}

/// Reads the run's contact sheet, the first pictures of episodes; `None` if there is none.
fn contact_sheet(snapshot: &RunSnapshot) -> Option<Picture> {
    let bytes = fs::read(snapshot.folder.file_path("contact_sheet.png")).ok()?;
    Picture::from_png(&bytes)
}

/// Returns the first camera picture of an episode of the current group, with a title.
fn current_group(snapshot: &RunSnapshot, sheet: Option<&Picture>) -> Option<(String, Picture)> {
    let run = &snapshot.run;
    let group = &run.rollouts.last()?.last_group;
    let number = run.experiment.schedule.group_index(group)?;
    let size = run.experiment.envs.camera.size;
    let picture = crop_first_variant(sheet?, size, number)?;
    Some((format!("how {group} begins"), picture))
}

/// Listener for requests to quit, by a key or a signal, and for the help key.
struct QuitListener {
    /// Number of the last signal from the operating system; 0 without one since the last call.
    signal: Arc<AtomicUsize>,
    /// `true` if keys come from standard input; otherwise they come from the controlling terminal.
    from_stdin: bool,
    /// `true` while the screen is explained; `?` turns it on and off.
    explained: Cell<bool>,
}

impl QuitListener {
    fn listen() -> Result<Self, RunError> {
        let signal = Arc::new(AtomicUsize::new(0));
        for number in [SIGHUP, SIGINT, SIGTERM] {
            flag::register_usize(number, Arc::clone(&signal), number as usize)
                .map_err(|source| RunError::SignalHandlers { source })?;
        }
        let from_stdin = stdin().is_terminal();
        Ok(Self { signal, from_stdin, explained: Cell::new(false) })
    }

    /// Waits for up to [`TICK`]; returns `true` if a key may have been pressed.
    ///
    /// # Errors
    /// [`io::ErrorKind::BrokenPipe`] for a terminal that is gone.
    fn wait(&self) -> io::Result<bool> {
        if !self.from_stdin {
            return event::poll(TICK);
        }
        // crossterm would wait for ever on a terminal that is gone, so poll standard input here
        let (stdin, tick) = (stdin(), Timespec::try_from(TICK).ok());
        let mut keys = [PollFd::new(&stdin, PollFlags::IN)];
        match poll(&mut keys, tick.as_ref()) {
            Err(Errno::INTR) => return Ok(false),
            waited => waited?,
        };
        let gone = PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL;
        if keys[0].revents().intersects(gone) {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        event::poll(Duration::ZERO)
    }

    /// Waits for up to [`TICK`]; returns the exit code of a request to quit since the last call.
    fn requested(&self) -> Result<Option<u8>, RunError> {
        let waited = self.wait();
        let signal = self.signal.swap(0, Ordering::SeqCst);
        if signal != 0 {
            return Ok(Some((SIGNALLED + signal) as u8));
        }
        if waited.map_err(terminal_error)?
            && let Event::Key(key) = event::read().map_err(terminal_error)?
        {
            if key.is_press() && key.code == KeyCode::Char('?') {
                self.explained.set(!self.explained.get());
            }
            return Ok(code_of(key));
        }
        Ok(None)
    }
}

/// Returns `true` if a request to quit with the exit code `code` counts, `since` being the time
/// since the first one. Code 0 is that of `q`.
fn counts(code: u8, since: Option<Duration>) -> bool {
    code != 0 || since.is_none_or(|since| since >= HELD)
}

/// Returns the exit code that a key requests. Ctrl-C is a key, too, because the terminal is in raw
/// mode.
fn code_of(key: KeyEvent) -> Option<u8> {
    match key.code {
        _ if !key.is_press() => None,
        KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => Some(INTERRUPTED),
        KeyCode::Char('q') => Some(0),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn q_and_ctrl_c_end_and_other_keys_do_not() {
        let key = |code, modifiers| code_of(KeyEvent::new(code, modifiers));
        assert_eq!(key(KeyCode::Char('q'), KeyModifiers::NONE), Some(0));
        assert_eq!(key(KeyCode::Char('c'), KeyModifiers::CONTROL), Some(130));
        assert_eq!(key(KeyCode::Char('c'), KeyModifiers::NONE), None);
        assert_eq!(key(KeyCode::Enter, KeyModifiers::NONE), None);
    }

    #[test]
    fn a_held_q_is_one_request_and_a_second_ctrl_c_is_another() {
        let soon = Some(Duration::from_millis(100));
        assert!(counts(0, None) && !counts(0, soon) && counts(0, Some(HELD)));
        assert!(counts(INTERRUPTED, None) && counts(INTERRUPTED, soon));
    }

    #[test]
    fn a_run_is_over_also_after_a_panic() {
        let over = AtomicBool::new(false);
        let caught = std::panic::catch_unwind(|| {
            let _over = SetOnDrop(&over);
            panic!("the run fell over");
        });
        assert!(caught.is_err() && over.load(Ordering::SeqCst));
    }
}
