//! Keys and signals of who looks on, beside a run of another process or of this one.

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

use experiments::sheet::{Picture, first_variant};
use experiments::{Glimpse, Run, RunError, Stop};

use super::View;
use super::draw::{Shown, draw};
use super::terminal::{Screen, broken};

/// From one look at keys, signals and tables to the next.
const TICK: Duration = Duration::from_millis(200);
/// So long after a wish to end `q` is no second one: a key that is held repeats.
const HELD: Duration = Duration::from_secs(2);
/// The exit code of a program that a signal ended is this and the signal's number.
const SIGNALLED: usize = 128;
/// That after Ctrl-C.
const INTERRUPTED: u8 = (SIGNALLED + SIGINT as usize) as u8;

/// Exit code after SIGHUP.
const HUNG_UP: u8 = (SIGNALLED + SIGHUP as usize) as u8;

/// Shows the run of another process until somebody quits. Returns the exit code: 0 after `q`, 128
/// and its number after a signal.
///
/// # Errors
/// A terminal that is gone, tables that cannot be read.
pub(crate) fn watch(mut view: View) -> Result<u8, RunError> {
    let (wish, sheet) = (Wish::listen()?, sheet(&view));
    let mut screen = Screen::open()?;
    loop {
        let picture = newest_group(&view, sheet.as_ref());
        show(&mut screen, &view, picture, "q quits")?;
        if let Some(code) = wish.uttered()? {
            return Ok(code);
        }
        view.refresh()?;
    }
}

/// Learns to the end, or until somebody quits, and shows it meanwhile.
///
/// # Errors
/// What the run says; a terminal that is gone, after which the run is saved.
pub fn train(run: &mut Run) -> Result<(), RunError> {
    let (stop, glimpse) = (Stop::default(), Glimpse::default());
    run.stop_at(stop.clone());
    run.show_to(glimpse.clone());
    let onlooker = Onlooker {
        wish: Wish::listen()?,
        view: View::open(run.folder().path())?,
        screen: Screen::open()?,
        stop,
        glimpse,
    };
    let over = AtomicBool::new(false);
    let (learnt, shown) = thread::scope(|scope| {
        let onlooker = scope.spawn(|| onlooker.look_on(&over));
        let learnt = {
            let _over = Over(&over);
            learn(run)
        };
        (learnt, onlooker.join())
    });
    let shown = shown.unwrap_or_else(|panic| resume_unwind(panic));
    learnt?;
    if shown.is_err() {
        run.save()?;
    }
    shown
}

fn learn(run: &mut Run) -> Result<(), RunError> {
    while run.advance()?.is_some() {}
    Ok(())
}

/// Says that a run is over when it is dropped, also by a panic.
struct Over<'a>(&'a AtomicBool);

impl Drop for Over<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::SeqCst);
    }
}

/// Who draws while a run learns in this process.
struct Onlooker {
    wish: Wish,
    view: View,
    screen: Screen,
    stop: Stop,
    glimpse: Glimpse,
}

impl Onlooker {
    /// Draws until the run is over. The first wish to end stops the run, the second one ends the
    /// process. Tables that cannot be read disturb no run: what was read before stays.
    fn look_on(mut self, over: &AtomicBool) -> Result<(), RunError> {
        // a run that nobody sees any more stops, whatever became of the screen
        let _last = Last(self.stop.clone());
        let mut unreadable: Option<String> = None;
        let mut wished: Option<Instant> = None;
        while !over.load(Ordering::SeqCst) {
            let picture = self.glimpse.look();
            let picture = picture.map(|picture| ("environment 0, now".to_owned(), picture));
            let keys = match (&unreadable, self.stop.requested()) {
                (_, true) => "stops after this rollout; q again ends at once",
                (Some(error), false) => error.as_str(),
                (None, false) => "q stops with a checkpoint",
            };
            show(&mut self.screen, &self.view, picture, keys)?;
            let since = wished.map(|wished| wished.elapsed());
            match self.wish.uttered()?.filter(|&code| counts(code, since)) {
                None => {}
                // a terminal that closes may send SIGHUP twice, and SIGTERM may follow
                Some(HUNG_UP) => self.stop.request(),
                Some(code) if wished.is_some() => {
                    drop(self.screen);
                    // `q` ends a run as Ctrl-C does
                    low_level::exit(i32::from(if code == 0 { INTERRUPTED } else { code }));
                }
                Some(_) => {
                    wished = Some(Instant::now());
                    self.stop.request();
                }
            }
            unreadable = self.view.refresh().err().map(|error| error.to_string());
        }
        Ok(())
    }
}

/// Stops a run when it is dropped.
struct Last(Stop);

impl Drop for Last {
    fn drop(&mut self) {
        self.0.request();
    }
}

fn show(
    screen: &mut Screen,
    view: &View,
    picture: Option<(String, Picture)>,
    keys: &str,
) -> Result<(), RunError> {
    let shown =
        Shown { run: &view.run, finished: view.finished, silence: view.silence(), picture, keys };
    screen.draw(|frame| draw(&shown, frame))
}

/// The pictures with which episodes begin, where the run left them.
fn sheet(view: &View) -> Option<Picture> {
    let bytes = fs::read(view.folder.file("contact_sheet.png")).ok()?;
    Picture::from_png(&bytes)
}

/// How episodes of the group that runs begin.
fn newest_group(view: &View, sheet: Option<&Picture>) -> Option<(String, Picture)> {
    let group = &view.run.rollouts.last()?.last_group;
    let number = view.run.experiment.schedule.number(group)?;
    let size = view.run.experiment.envs.camera.size;
    let picture = first_variant(sheet?, size, number)?;
    Some((format!("how {group} begins"), picture))
}

/// The wish to end, by a key or a signal.
struct Wish {
    /// The number of the last signal; 0 before any.
    signal: Arc<AtomicUsize>,
    /// Whether keys come from standard input; otherwise from the terminal that owns the process.
    from_stdin: bool,
}

impl Wish {
    fn listen() -> Result<Self, RunError> {
        let signal = Arc::new(AtomicUsize::new(0));
        for number in [SIGHUP, SIGINT, SIGTERM] {
            flag::register_usize(number, Arc::clone(&signal), number as usize)
                .map_err(|source| RunError::Signals { source })?;
        }
        let from_stdin = stdin().is_terminal();
        Ok(Self { signal, from_stdin })
    }

    /// Waits for a moment; returns whether a key may have come. The library would wait for ever on
    /// a terminal that is gone, so it does not wait for standard input.
    fn wait(&self) -> io::Result<bool> {
        if !self.from_stdin {
            return event::poll(TICK);
        }
        let (stdin, tick) = (stdin(), Timespec::try_from(TICK).ok());
        let mut keys = [PollFd::new(&stdin, PollFlags::IN)];
        match poll(&mut keys, tick.as_ref()) {
            Err(Errno::INTR) => return Ok(false),
            waited => waited?,
        };
        let gone = PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL;
        match keys[0].revents().intersects(gone) {
            true => Err(io::ErrorKind::BrokenPipe.into()),
            false => event::poll(Duration::ZERO),
        }
    }

    /// Waits for a moment; returns an exit code where somebody wished to end since the last call.
    fn uttered(&self) -> Result<Option<u8>, RunError> {
        let waited = self.wait();
        let signal = self.signal.swap(0, Ordering::SeqCst);
        if signal != 0 {
            return Ok(Some((SIGNALLED + signal) as u8));
        }
        if waited.map_err(broken)?
            && let Event::Key(key) = event::read().map_err(broken)?
        {
            return Ok(code_of(key));
        }
        Ok(None)
    }
}

/// `true` if a wish to end with this code counts, `since` the last one.
fn counts(code: u8, since: Option<Duration>) -> bool {
    code != 0 || since.is_none_or(|since| since >= HELD)
}

/// The exit code that a key asks for: Ctrl-C comes as a key while a screen is up.
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
    fn a_held_q_is_one_wish_and_a_second_ctrl_c_is_another() {
        let soon = Some(Duration::from_millis(100));
        assert!(counts(0, None) && !counts(0, soon) && counts(0, Some(HELD)));
        assert!(counts(INTERRUPTED, None) && counts(INTERRUPTED, soon));
    }

    #[test]
    fn a_run_is_over_also_after_a_panic() {
        let over = AtomicBool::new(false);
        let caught = std::panic::catch_unwind(|| {
            let _over = Over(&over);
            panic!("the run fell over");
        });
        assert!(caught.is_err() && over.load(Ordering::SeqCst));
    }
}
