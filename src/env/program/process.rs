//! One process of a program: its pipes, its time limits and its end.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read, Write};
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use super::super::EnvironmentError;
use super::{Answer, ShowLine};
use crate::os::programs;
use crate::text::{excerpt, shell_line, visible};

/// Longest answer in bytes; a picture may be longer.
pub(super) const MAX_ANSWER: usize = 1 << 20;
/// Longest line of standard error in bytes. A longer one is shown in parts.
const MAX_ERROR_LINE: u64 = 1 << 12;
const LAST_LINES: usize = 5;
/// How long a process has for its end, first after the end of its standard input and then after SIGTERM.
const GRACE: Duration = Duration::from_secs(1);

/// A running program. It is in a process group of its own, which ends with this value, and also when our process is killed.
pub(super) struct Process {
    name: String,
    timeout: Duration,
    child: Child,
    guard: Option<Child>,
    /// None once the process is to end.
    pipes: Option<(ChildStdin, ChildStdout)>,
    buffer: Vec<u8>,
    errors: JoinHandle<()>,
    last_lines: Arc<Mutex<VecDeque<String>>>,
    /// Whether an episode has been started twice and was the same.
    pub(super) is_checked: bool,
}

impl Process {
    pub(super) fn start(command: &[String], timeout: Duration, show: ShowLine) -> Answer<Self> {
        let name = excerpt(&shell_line(command), LENGTH);
        let error = |problem: String| EnvironmentError::new(&name, &problem);
        let (program, arguments) =
            command.split_first().ok_or_else(|| error("there is no command".into()))?;
        let mut command = Command::new(program);
        command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = programs::start(&mut command).map_err(|problem| match problem.kind() {
            std::io::ErrorKind::Unsupported => error(problem.to_string()),
            _ => error(format!(
                "cannot be started: {problem}. `environment.command` is a list of the program and its arguments; without a \
                 slash the program is searched in PATH, and other paths begin at the current directory"
            )),
        })?;
        let guard = programs::guard(&child);
        let last_lines = Arc::new(Mutex::new(VecDeque::new()));
        let pipes = child.stdin.take().zip(child.stdout.take());
        let (stderr, kept, mark) = (child.stderr.take(), Arc::clone(&last_lines), name.clone());
        let errors =
            thread::spawn(move || stderr.into_iter().for_each(|pipe| relay(pipe, &mark, show, &kept)));
        let buffer = Vec::new();
        Ok(Self { name, timeout, child, guard, pipes, buffer, errors, last_lines, is_checked: false })
    }

    pub(super) fn ask(&mut self, request: &str, max_bytes: usize) -> Answer<String> {
        if self.is_readable(Duration::ZERO) && self.read().is_ok_and(|count| count > 0) {
            let line = shortened(&String::from_utf8_lossy(&self.buffer));
            return Err(self.error(&format!("it wrote `{line}` before it was asked `{request}`; {STDOUT}")));
        }
        let deadline = Instant::now() + self.timeout;
        let written = match &mut self.pipes {
            // A request is shorter than what a pipe with room takes without blocking.
            Some((stdin, _)) if programs::is_writable(stdin, self.timeout) => {
                stdin.write_all(format!("{request}\n").as_bytes())
            }
            Some(_) => return Err(self.silence("read", request, "")),
            None => Ok(()),
        };
        loop {
            if self.buffer.contains(&b'\n') {
                return self.line(request);
            }
            if self.buffer.len() > max_bytes {
                let start = shortened(&String::from_utf8_lossy(&self.buffer));
                return Err(self.error(&format!(
                    "it answered `{request}` with a line of more than {max_bytes} bytes, which begins with `{start}`"
                )));
            }
            let left = deadline.saturating_duration_since(Instant::now());
            let is_silent = written.is_ok() && !self.is_readable(left.min(GRACE));
            // A process that the program has started can keep the pipe open after the end of the program.
            let has_ended = written.is_err()
                || (is_silent && self.child.try_wait().is_ok_and(|status| status.is_some()))
                || (!is_silent && self.read().is_ok_and(|count| count == 0));
            if has_ended {
                let end = self.end();
                return Err(self.error(&format!("it {end} and did not answer `{request}`")));
            }
            if is_silent && left.is_zero() {
                return Err(self.silence("answer", request, " with a line"));
            }
        }
    }

    fn silence(&self, verb: &str, request: &str, how: &str) -> EnvironmentError {
        let seconds = self.timeout.as_secs_f64();
        self.error(&format!(
            "it did not {verb} `{request}`{how} within {seconds} s (`environment.timeout_seconds`)"
        ))
    }

    /// Takes the line that has been read. There must be nothing behind it.
    fn line(&mut self, request: &str) -> Answer<String> {
        let problem = match String::from_utf8(std::mem::take(&mut self.buffer)) {
            Ok(text) => match text.split_once('\n') {
                Some((line, "")) => return Ok(line.trim_end_matches('\r').to_owned()),
                _ => format!("more than one line: `{}`; {STDOUT}", shortened(&text)),
            },
            Err(error) => {
                let text = String::from_utf8_lossy(error.as_bytes());
                format!("`{}`, which is not UTF-8", shortened(&text))
            }
        };
        Err(self.error(&format!("it answered `{request}` with {problem}")))
    }

    /// Waits until there is something to read, or the end of the pipe.
    fn is_readable(&self, timeout: Duration) -> bool {
        self.pipes.as_ref().is_none_or(|(_, stdout)| programs::is_readable(stdout, timeout))
    }

    /// Reads what there is; 0 bytes at the end of the pipe.
    fn read(&mut self) -> std::io::Result<usize> {
        let Some((_, stdout)) = &mut self.pipes else { return Ok(0) };
        let mut part = [0; 1 << 14];
        let count = stdout.read(&mut part)?;
        self.buffer.extend_from_slice(&part[..count]);
        Ok(count)
    }

    /// How a process has ended that gives no answers any more.
    fn end(&mut self) -> String {
        match self.wait() {
            Some(status) => {
                // What it wrote to standard error is on its way.
                let deadline = Instant::now() + GRACE / 2;
                while !self.errors.is_finished() && Instant::now() < deadline {
                    thread::sleep(Duration::from_millis(1));
                }
                format!("ended ({status})")
            }
            None => "closed its standard input or output".into(),
        }
    }

    /// Waits for the end of the process, but not for long.
    fn wait(&mut self) -> Option<ExitStatus> {
        let deadline = Instant::now() + GRACE;
        loop {
            match self.child.try_wait() {
                Ok(Some(status)) => return Some(status),
                Ok(None) if Instant::now() < deadline => thread::sleep(Duration::from_millis(1)),
                _ => return None,
            }
        }
    }

    /// The error with the command, and with what the program last wrote to standard error.
    pub(super) fn error(&self, problem: &str) -> EnvironmentError {
        let lines = self.last_lines.lock().unwrap_or_else(PoisonError::into_inner);
        let lines: Vec<&str> = lines.iter().map(String::as_str).collect();
        let lines = match &lines[..] {
            [] => String::new(),
            lines => format!(". The end of its standard error: {}", lines.join(" | ")),
        };
        EnvironmentError::new(&self.name, &format!("{problem}{lines}"))
    }
}

const STDOUT: &str =
    "its standard output is for answers alone, and everything else must go to its standard error";

impl Drop for Process {
    fn drop(&mut self) {
        self.pipes = None;
        if self.wait().is_none() {
            programs::terminate(&self.child);
            self.wait();
        }
        programs::kill(&self.child);
        let _ = self.child.wait();
        if let Some(guard) = &mut self.guard {
            let _ = guard.kill();
            let _ = guard.wait();
        }
    }
}

/// Shows standard error line by line, and keeps the last lines.
fn relay(pipe: ChildStderr, name: &str, show: ShowLine, kept: &Mutex<VecDeque<String>>) {
    let mut pipe = BufReader::new(pipe);
    let mut line = Vec::new();
    while (&mut pipe).take(MAX_ERROR_LINE).read_until(b'\n', &mut line).is_ok_and(|count| count > 0) {
        let text = visible(String::from_utf8_lossy(&line).trim_end());
        line.clear();
        if show(name, &text) {
            continue;
        }
        let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.push_back(shortened(&text));
        if kept.len() > LAST_LINES {
            kept.pop_front();
        }
    }
}

/// Characters of a foreign text in a message.
const LENGTH: usize = 200;

pub(super) fn shortened(text: &str) -> String {
    excerpt(text, LENGTH)
}
