//! Who watches a run: metrics, progress, checkpoints, a view, a web page.

use std::io;

use super::{Event, Snapshot};
use crate::agent::Policy;

/// Takes what happens in a run. An error ends the run.
pub trait Observer {
    fn event(&mut self, event: &Event) -> io::Result<()>;

    /// Sees the policy of an evaluation, before its event.
    fn policy(&mut self, _policy: &Policy) {}

    /// May keep a checkpoint. Every event before it must then outlast a crash: resuming expects them.
    fn checkpoint(&mut self, _checkpoint: &DueCheckpoint<'_>) -> io::Result<()> {
        Ok(())
    }
}

/// A checkpoint that is due. Its content is put together only for an observer that asks.
pub struct DueCheckpoint<'a> {
    pub kind: CheckpointKind,
    pub(super) snapshot: &'a dyn Fn() -> Snapshot,
}

impl DueCheckpoint<'_> {
    pub fn snapshot(&self) -> Snapshot {
        (self.snapshot)()
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CheckpointKind {
    /// The best policy so far, alone.
    Best,
    Last {
        /// Whether the one before is a periodic one, which is kept beside it. Otherwise what is kept would show where the run
        /// was interrupted.
        keeps_previous: bool,
    },
}

impl Observer for Vec<Event> {
    fn event(&mut self, event: &Event) -> io::Result<()> {
        self.push(event.clone());
        Ok(())
    }
}

#[derive(Default)]
pub(crate) struct Fanout<'a>(pub Vec<Box<dyn Observer + 'a>>);

impl Observer for Fanout<'_> {
    fn event(&mut self, event: &Event) -> io::Result<()> {
        self.0.iter_mut().try_for_each(|observer| observer.event(event))
    }

    fn policy(&mut self, policy: &Policy) {
        self.0.iter_mut().for_each(|observer| observer.policy(policy));
    }

    fn checkpoint(&mut self, checkpoint: &DueCheckpoint<'_>) -> io::Result<()> {
        self.0.iter_mut().try_for_each(|observer| observer.checkpoint(checkpoint))
    }
}
