//! Terminal views, drawn by ratatui: an agent at play, and a run that is training.
//!
//! They know environments, policies and events, never files. Colours are the terminal's own sixteen; with `NO_COLOR`
//! crossterm leaves them out, so nothing is told by colour alone.

mod dashboard;
mod live;
mod pace;
mod player;
mod watch;

use std::io::{self, IsTerminal, stdout};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::crossterm::execute;
use ratatui::crossterm::terminal::{self, Clear, ClearType, EnterAlternateScreen};
use ratatui::layout::{Rect, Size};
use ratatui::{DefaultTerminal, Frame, TerminalOptions, Viewport};

use crate::text::width;

pub(crate) use live::{Interrupts, Live};
pub(crate) use pace::Pace;
pub(crate) use watch::watch;

const SMALLEST: Size = Size { width: 70, height: 20 };
/// The largest area that a view draws to, however large the terminal claims to be: a view takes memory for every cell.
const LARGEST: Size = Size { width: 500, height: 200 };
/// The time between two pictures: a step of simulated time.
const FRAME: Duration = Duration::from_millis(20);

/// A return as it is shown where there is little room: whole, or with one digit.
fn whole(value: f64) -> String {
    if value.fract() == 0.0 { value.to_string() } else { format!("{value:.1}") }
}

fn fitting(texts: impl Iterator<Item = String>, columns: usize) -> String {
    let mut taken = 0;
    let fits = |text: &String| {
        taken += width(text);
        taken <= columns
    };
    texts.take_while(fits).collect()
}

#[derive(Debug, thiserror::Error)]
pub(crate) enum NoView {
    #[error(
        "this view needs a terminal as standard input and output; `train` without --live shows its progress anywhere, \
         and `render` draws an episode into a file"
    )]
    NoTerminal,
    #[error(
        "this view draws on the terminal, and TERM=dumb says that the terminal cannot do that; `train` alone shows its \
         progress anywhere, and `render` draws an episode into a file"
    )]
    Dumb,
    #[error("the terminal has {} × {} characters, and {} × {} are needed; make it larger", .0.width, .0.height, SMALLEST.width, SMALLEST.height)]
    TooSmall(Size),
    #[error(transparent)]
    Environment(#[from] crate::env::EnvironmentError),
    #[error("the terminal cannot be used: {0}")]
    Terminal(#[from] io::Error),
}

pub(crate) fn check_terminal() -> Result<(), NoView> {
    if [io::stdin().is_terminal(), io::stdout().is_terminal()].contains(&false) {
        return Err(NoView::NoTerminal);
    }
    if std::env::var_os("TERM").is_some_and(|term| term == "dumb") {
        return Err(NoView::Dumb);
    }
    let (width, height) = terminal::size()?;
    let is_large = width >= SMALLEST.width && height >= SMALLEST.height;
    if is_large { Ok(()) } else { Err(NoView::TooSmall(Size { width, height })) }
}

/// The terminal in the hands of a view; dropped, or in a panic, it is as before.
struct Screen {
    terminal: DefaultTerminal,
    area: Rect,
    keys: Receiver<KeyEvent>,
}

fn drawn_area((width, height): (u16, u16)) -> Rect {
    Rect::new(0, 0, width.min(LARGEST.width), height.min(LARGEST.height))
}

/// Clears the whole terminal. Some have no second screen for programs, and show a view over what was there.
fn clear() -> io::Result<()> {
    execute!(stdout(), Clear(ClearType::All), ratatui::crossterm::cursor::MoveTo(0, 0))
}

impl Screen {
    fn open() -> Result<Self, NoView> {
        check_terminal()?;
        Self::try_open().inspect_err(|_| drop(ratatui::try_restore())).map_err(NoView::from)
    }

    fn try_open() -> io::Result<Self> {
        let area = drawn_area(terminal::size()?);
        let viewport = Viewport::Fixed(area);
        let terminal = ratatui::try_init_with_options(TerminalOptions { viewport })?;
        execute!(stdout(), EnterAlternateScreen)?;
        clear()?;
        // In a thread of its own, which ends with the process: crossterm never returns once a terminal has gone away.
        let (sender, keys) = channel();
        std::thread::Builder::new().name("keys".into()).spawn(move || {
            while let Ok(event) = event::read() {
                if let Event::Key(key) = event
                    && key.kind != KeyEventKind::Release
                    && sender.send(key).is_err()
                {
                    return;
                }
            }
        })?;
        Ok(Self { terminal, area, keys })
    }

    fn draw(&mut self, content: impl FnOnce(&mut Frame<'_>)) -> io::Result<()> {
        let area = drawn_area(terminal::size()?);
        if area != self.area {
            clear()?;
            self.terminal.resize(area)?;
            self.area = area;
        }
        self.terminal.draw(|frame| match frame.area() {
            Rect { width, height, .. } if width < SMALLEST.width || height < SMALLEST.height => {
                let text = format!("at least {} × {} characters", SMALLEST.width, SMALLEST.height);
                frame.render_widget(ratatui::widgets::Paragraph::new(text), frame.area());
            }
            _ => content(frame),
        })?;
        Ok(())
    }

    fn key(&self, time: Duration) -> io::Result<Option<KeyEvent>> {
        match self.keys.recv_timeout(time) {
            Ok(key) => Ok(Some(key)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(error @ RecvTimeoutError::Disconnected) => Err(io::Error::other(error)),
        }
    }
}

impl Drop for Screen {
    fn drop(&mut self) {
        // After a panic it has been restored, and what was printed since must stay.
        if terminal::is_raw_mode_enabled().unwrap_or(true) {
            let _ = clear();
            let _ = ratatui::try_restore();
        }
    }
}

fn is_quit(key: KeyEvent) -> bool {
    let control = key.modifiers.contains(KeyModifiers::CONTROL);
    matches!((key.code, control), (KeyCode::Char('q') | KeyCode::Esc, _) | (KeyCode::Char('c'), true))
}

#[cfg(test)]
#[path = "../../tests/unit/view.rs"]
mod tests;
