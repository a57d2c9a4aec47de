//! `train --live`: a sink that hands what happens to a view in a thread of its own.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use ratatui::crossterm::event::{KeyCode, KeyEvent};

use super::dashboard::Dashboard;
use super::pace::{Pace, Pacer, Shared};
use super::{FRAME, NoView, Screen, is_quit};
use crate::agent::Policy;
use crate::trainer::{Budget, Event, Observer};

/// A key that is held down is one wish to quit.
const HELD: Duration = Duration::from_secs(1);

/// What a view and the process's handlers of signals tell each other.
#[derive(Clone, Debug, Default)]
pub(crate) struct Interrupts {
    /// Ends the run at its next step. Set by the first signal and by whoever quits the view.
    pub(crate) stop: Arc<AtomicBool>,
    /// Set by every signal, and taken back by the view.
    pub(crate) arrived: Arc<AtomicBool>,
    /// Whether the handlers end the process. The view sets it when it has given the terminal back.
    pub(crate) at_once: Arc<AtomicBool>,
}

/// Shows a run in the terminal and holds it back to a pace.
///
/// Once the run has ended, dropping it waits until somebody quits; a run that was stopped or failed is closed at once.
pub(crate) struct Live {
    messages: Sender<Message>,
    pacer: Pacer,
    shared: Arc<Shared>,
    stop: Arc<AtomicBool>,
    ended: bool,
    view: Option<JoinHandle<io::Result<()>>>,
}

enum Message {
    Event(Event),
    Policy(Policy),
}

impl Live {
    /// Opens the view of a run that has done so many steps. The first quit stops the run after its current step; a second one
    /// restores the terminal and calls `end_process`.
    pub fn open(
        name: &str, environment: Box<dyn crate::env::Environment>, budget: Budget, env_steps: u64,
        pace: Pace, interrupts: &Interrupts, end_process: impl FnOnce() + Send + 'static,
    ) -> Result<Self, NoView> {
        let screen = Screen::open()?;
        let shared = Arc::new(Shared::new(pace, environment.spec().steps_per_second, env_steps));
        close_in_panic(Arc::clone(&shared));
        let ((messages, inbox), dashboard) = (channel(), Dashboard::new(name, environment, budget));
        let (_closed, interrupts, asked) = (Closed(interrupts.clone()), interrupts.clone(), None);
        let stop = Arc::clone(&interrupts.stop);
        let view = View { screen, dashboard, inbox, shared: Arc::clone(&shared), interrupts, asked, _closed };
        let view = thread::Builder::new().name("view".into()).spawn(|| {
            if view.run()? {
                end_process();
            }
            Ok(())
        })?;
        Ok(Self { messages, pacer: Pacer::new(env_steps), shared, stop, ended: false, view: Some(view) })
    }
}

/// The screen that the panic of another thread has restored must stay so.
fn close_in_panic(shared: Arc<Shared>) {
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        shared.closing.store(true, Ordering::SeqCst);
        hook(panic);
    }));
}

impl Observer for Live {
    fn event(&mut self, event: &Event) -> io::Result<()> {
        self.ended |= matches!(event, Event::End { .. });
        if let Event::Episode { env_steps, .. } | Event::Evaluation { env_steps, .. } = event {
            self.pacer.wait(*env_steps, &self.shared, &self.stop);
        }
        // A view that has failed has set `stop`.
        let _ = self.messages.send(Message::Event(event.clone()));
        Ok(())
    }

    fn policy(&mut self, policy: &Policy) {
        let _ = self.messages.send(Message::Policy(policy.clone()));
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        if !self.ended {
            self.shared.closing.store(true, Ordering::SeqCst);
        }
        // What went wrong with the terminal can be told to nobody.
        let _ = self.view.take().map(JoinHandle::join);
    }
}

struct View {
    screen: Screen,
    dashboard: Dashboard,
    inbox: Receiver<Message>,
    shared: Arc<Shared>,
    interrupts: Interrupts,
    asked: Option<Instant>,
    /// The last field, because it must be dropped after the screen.
    _closed: Closed,
}

impl View {
    /// Shows the run until there is nothing more to show, or until somebody does not want to wait for the end of the step: true.
    fn run(mut self) -> io::Result<bool> {
        let mut last = Instant::now();
        loop {
            for message in self.inbox.try_iter() {
                match message {
                    Message::Event(event) => self.dashboard.take(&event),
                    Message::Policy(policy) => self.dashboard.set_policy(&policy),
                }
            }
            if self.interrupts.arrived.swap(false, Ordering::Relaxed) && self.quit(Duration::ZERO) {
                return Ok(true);
            }
            let stopped = self.interrupts.stop.load(Ordering::Relaxed);
            if self.shared.closing.load(Ordering::SeqCst) || (stopped && self.dashboard.ended) {
                return Ok(false);
            }
            self.dashboard.advance(last.elapsed(), self.shared.allowed_steps.load(Ordering::Relaxed));
            last = Instant::now();
            let status = match self.shared.pace() {
                _ if self.dashboard.ended => "finished".into(),
                _ if stopped => "stopping; q again ends at once".into(),
                (pace, true) => format!("paused at {pace}"),
                (pace, false) => pace.to_string(),
            };
            self.screen.draw(|frame| self.dashboard.draw(frame, &status))?;
            while let Some(key) = self.screen.key((2 * FRAME).saturating_sub(last.elapsed()))? {
                match is_quit(key) {
                    true if self.quit(HELD) => return Ok(true),
                    true => {}
                    false => self.press(key),
                }
            }
        }
    }

    /// Stops the run. Whether somebody has wanted that before, at least so long ago.
    fn quit(&mut self, ago: Duration) -> bool {
        self.interrupts.stop.store(true, Ordering::Relaxed);
        let again = self.asked.is_some_and(|asked| asked.elapsed() >= ago);
        self.asked.get_or_insert_with(Instant::now);
        again
    }

    fn press(&self, key: KeyEvent) {
        let (pace, paused) = self.shared.pace();
        match key.code {
            KeyCode::Char('+' | '=') => self.shared.set_pace(pace.faster(), paused),
            KeyCode::Char('-') => self.shared.set_pace(pace.slower(), paused),
            KeyCode::Char('f') => self.shared.set_pace(Pace::FULL, false),
            KeyCode::Char(' ') => self.shared.set_pace(pace, !paused),
            _ => {}
        }
    }
}

/// Stops the run when its view is gone, even in a panic: nobody could see it. From then on a signal can end the process.
struct Closed(Interrupts);

impl Drop for Closed {
    fn drop(&mut self) {
        self.0.stop.store(true, Ordering::Relaxed);
        self.0.at_once.store(true, Ordering::Relaxed);
    }
}
