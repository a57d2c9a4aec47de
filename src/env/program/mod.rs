//! An environment that is another process, in any language. docs/environments.md describes the protocol: we write a line to
//! the standard input of the program, and the program answers with a line on its standard output.

mod answer;
mod process;

use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use super::{Answer, Environment, EnvironmentError, Image, Outcome, Spec, Start};
use process::Process;

/// The program of the repository that a shipped config names.
const ADAPTER: &str = "adapters/gymnasium.py";

/// Takes the name of a program and a line of its standard error. Returns whether somebody has seen the line: the others are
/// repeated when the program fails.
pub(crate) type ShowLine = fn(&str, &str) -> bool;

/// Starts a program as often as is needed, and keeps the processes that nobody uses for later.
pub struct Programs {
    command: Vec<String>,
    processes: usize,
    timeout: Duration,
    show: ShowLine,
    /// What every process must say of its task.
    task: OnceLock<Arc<Spec>>,
    idle: Mutex<Vec<Process>>,
}

impl Programs {
    /// A program that is not started yet. `task` is what is known of the task from before, if anything is. Evaluations play
    /// in up to `processes` processes at the same time.
    pub fn new(
        command: Vec<String>, processes: usize, timeout: Duration, task: Option<Spec>, show: ShowLine,
    ) -> Self {
        let known = task.map_or_else(OnceLock::new, |task| OnceLock::from(Arc::new(task)));
        Self { command, processes, timeout, show, task: known, idle: Mutex::default() }
    }

    /// An environment with a process of its own, as long as the environment lives.
    pub fn make(self: &Arc<Self>) -> Answer<Program> {
        let (process, spec) = self.take()?;
        Ok(Program { programs: Arc::clone(self), spec, process: Some(process) })
    }

    fn idle(&self) -> MutexGuard<'_, Vec<Process>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn take(&self) -> Answer<(Process, Arc<Spec>)> {
        let idle = self.idle().pop();
        if let (Some(process), Some(task)) = (idle, self.task.get()) {
            return Ok((process, Arc::clone(task)));
        }
        if self.command.iter().any(|word| word == ADAPTER) && !std::path::Path::new(ADAPTER).exists() {
            return Err(EnvironmentError::new(
                &crate::text::excerpt(&crate::text::shell_line(&self.command), 200),
                &format!(
                    "the current directory has no {ADAPTER}, which is part of the repository. Type the command in a clone, or \
                     give the file's whole path with --set 'environment={{\"command\":[…]}}'"
                ),
            ));
        }
        let mut process = Process::start(&self.command, self.timeout, self.show)?;
        let said = process.hello()?;
        let known = self.task.get_or_init(|| Arc::new(said.clone()));
        if said != **known {
            let [known, said] = [&**known, &said].map(|task| serde_json::to_string(task).unwrap_or_default());
            return Err(process.error(&format!(
                "it answered `hello 1` with another task than before. Before: {known}. Now: {said}. If that is meant, start a \
                 new run"
            )));
        }
        Ok((process, Arc::clone(known)))
    }
}

/// An environment in a process of its own. An episode is a function of the seed of its `reset` and of its actions.
pub struct Program {
    programs: Arc<Programs>,
    spec: Arc<Spec>,
    /// None after a failure.
    process: Option<Process>,
}

impl Program {
    /// Lets the process do something. A process that fails is ended.
    fn with<T>(&mut self, act: impl FnOnce(&mut Process) -> Answer<T>) -> Answer<T> {
        let mut process = self.process.take().ok_or_else(|| {
            EnvironmentError::new(&self.spec.id, "its program has failed before and was ended")
        })?;
        let result = act(&mut process)?;
        self.process = Some(process);
        Ok(result)
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let process = self.process.take();
        self.programs.idle().extend(process);
    }
}

impl Environment for Program {
    fn spec(&self) -> &Spec {
        &self.spec
    }

    fn reset(&mut self, start: Start<'_>, observation: &mut [f32]) -> Answer<()> {
        let seed = match start {
            Start::Seed(seed) => seed,
            // Many languages have no larger integers.
            Start::Stream(rng) => rng.next_u64() >> 1,
        };
        self.with(|process| process.reset(seed, observation))
    }

    fn step(&mut self, action: usize, observation: &mut [f32]) -> Answer<Outcome> {
        self.with(|process| process.step(action, observation))
    }

    fn image(&mut self) -> Answer<Option<Image>> {
        self.with(Process::render)
    }

    fn processes(&self) -> Option<usize> {
        Some(self.programs.processes)
    }
}
