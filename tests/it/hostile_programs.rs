//! Programs that are environments and do everything wrong: each ends in a clear message, none in a hang, and none leaves a
//! process.

use std::fs;
use std::path::Path;
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::{Duration, Instant};

use cartpole_dqn::env::program::Programs;
use cartpole_dqn::env::{Environment, EnvironmentError, Start};

use crate::program::compiled;

/// What a program does, and what the message must say.
const HOSTILE: &[(&str, &[&str])] = &[
    ("silent", &["did not answer `hello 1` with a line within 5 s", "environment.timeout_seconds"]),
    ("drip", &["did not answer `hello 1` with a line within 5 s"]),
    ("endless line", &["answered `hello 1` with a line of more than 1048576 bytes", "begins with `xxx"]),
    ("endless lines", &["answered `hello 1` with more than one line", "standard error"]),
    ("binary", &["answered `hello 1` with", "not UTF-8"]),
    ("banner", &["more than one line: `Welcome to my task!", "must go to its standard error"]),
    ("no json", &["answered `hello 1` with `hello yourself`", "no JSON of a task"]),
    ("list", &["answered `hello 1` with `[1, 2]`"]),
    ("protocol", &["`protocol` is 2, and this program speaks version 1"]),
    ("huge size", &["the size of an observation must be 1 to 4096"]),
    ("no actions", &["the number of actions must be 1 to 256"]),
    ("missing", &["missing field `observation_size`"]),
    ("huge", &["more than 1048576 bytes"]),
    ("names", &["each action must have a name"]),
    ("steering", &["no control characters"]),
    ("mirror", &["`mirror` must be"]),
    ("error", &["answered `hello 1` with the error `no display \\u{1b}[31m`"]),
    ("killed", &["ended (signal: 9 (SIGKILL)) and did not answer `hello 1`"]),
    ("import", &["ended (exit status: 1)", "ModuleNotFoundError"]),
    ("grandchild", &["ended (exit status: 4) and did not answer `hello 1`"]),
    ("flood", &["ended (exit status: 5)", "\\u{1b}[31mno line break"]),
    ("dies at reset", &["ended (exit status: 3) and did not answer `reset 7`"]),
    ("silent at reset", &["did not answer `reset 7` with a line within 5 s"]),
    ("count", &["answered `reset 7` with `reset 1 2 3`", "3 numbers", "`reset` and 2 numbers"]),
    ("random", &["is not deterministic: it answered `reset 7` with"]),
    ("empty", &["answered `reset 7` with ``: it does not begin with `reset`"]),
    ("words", &["answered `reset 7` with `reset one two`", "`one` is no number"]),
    ("stderr", &["ended (exit status: 1)", "the disk is on fire"]),
    ("dies at step", &["ended (exit status: 3) and did not answer `step 1`"]),
    ("segfault", &["ended (signal: 11 (SIGSEGV)"]),
    ("ignores SIGTERM", &["did not answer `step 1` with a line within 5 s"]),
    ("nan", &["answered `step 1` with `step 1 0 0 nan 1`", "`nan` is not finite"]),
    ("infinite", &["`inf` is not finite"]),
    ("large", &["`1e300` is not finite, or too large for 32 bits"]),
    ("flag", &["a flag is neither 0 nor 1", "`step REWARD TERMINATED TRUNCATED` and 2 numbers"]),
    ("short", &["the observation has 1 numbers"]),
    ("bare", &["the reward is missing"]),
    ("prints", &["answered `step 1` with more than one line: `I go left", "standard error"]),
    ("other", &["answered `step 1` with `reset 1 2`", "does not begin with `step`"]),
    ("late", &["it wrote `step 9 0 0 9 9` before it was asked `step 1`"]),
    ("error at step", &["answered `step 1` with the error `no such action`"]),
    ("closes", &["closed its standard input or output and did not answer `step 1`"]),
    ("exception", &["ended (exit status: 1)", "ZeroDivisionError"]),
    ("frame", &["answered `render` with `frame 10 10 AAAA`", "3 · WIDTH · HEIGHT bytes in base64"]),
    ("base64", &["answered `render` with `frame 1 1 ????`"]),
    ("size", &["at most 2048 in each direction"]),
    ("endless frame", &["answered `render` with a line of more than"]),
];

/// Programs that are silent, and wait to be ended.
const SILENT: [&str; 4] = ["silent", "drip", "silent at reset", "ignores SIGTERM"];

/// The path of the program, which does what its first argument says.
fn hostile() -> String {
    static HOSTILE: OnceLock<String> = OnceLock::new();
    HOSTILE.get_or_init(|| compiled("tests/programs/hostile.c", "hostile")).clone()
}

fn programs(directory: &Path, mode: &str) -> Arc<Programs> {
    let command = [hostile(), mode.into(), directory.display().to_string()];
    // A busy machine takes long to start a program.
    let seconds = if SILENT.contains(&mode) { 5 } else { 60 };
    Arc::new(Programs::new(command.into(), 1, Duration::from_secs(seconds), None, |_, _| false))
}

/// An episode, and a picture of its end.
fn play(programs: &Arc<Programs>) -> Result<(), EnvironmentError> {
    let mut environment = programs.make()?;
    let mut observation = vec![0.0; environment.spec().observation_size];
    environment.reset(Start::Seed(7), &mut observation)?;
    assert_eq!(observation, [0.5, 0.25]);
    for _ in 0..3 {
        environment.step(1, &mut observation)?;
        // What a program prints late is there before the next request.
        thread::sleep(Duration::from_millis(200));
    }
    environment.image().map(drop)
}

/// The command lines of processes with a mark in it.
fn processes(mark: &str) -> Vec<String> {
    let command = |entry: fs::DirEntry| {
        let bytes = fs::read(entry.path().join("cmdline")).ok()?;
        Some(String::from_utf8_lossy(&bytes).replace('\0', " "))
    };
    let all = fs::read_dir("/proc").into_iter().flatten().flatten().filter_map(command);
    all.filter(|command| command.contains(mark)).collect()
}

#[test]
fn a_hostile_program_ends_in_a_clear_message_without_a_hang_or_a_process() {
    let directory = tempfile::tempdir().unwrap();
    assert!(HOSTILE.len() >= 30);
    for some in HOSTILE.chunks(8) {
        thread::scope(|scope| {
            for (mode, expected) in some {
                let directory = directory.path();
                scope.spawn(move || {
                    let start = Instant::now();
                    let error = play(&programs(directory, mode)).expect_err(mode).to_string();
                    assert!(start.elapsed() < Duration::from_secs(30), "{mode}: {:?}", start.elapsed());
                    assert!(error.starts_with("the environment /"), "{mode}: {error}");
                    for text in *expected {
                        assert!(error.contains(text), "{mode}: {text:?} is not in: {error}");
                    }
                    assert!(error.len() < 3000 && !error.contains('\u{1b}'), "{mode}: {error}");
                });
            }
        });
    }
    assert_eq!(processes(&directory.path().display().to_string()), [""; 0]);
}

#[test]
fn a_program_that_cannot_be_started_is_an_error() {
    for (command, expected) in [
        (vec!["./no-such-program"], "cannot be started: No such file or directory"),
        (vec!["/"], "cannot be started: Permission denied"),
        (vec!["true"], "ended (exit status: 0) and did not answer `hello 1`"),
        (vec!["cat"], "answered `hello 1` with `hello 1`: that is no JSON"),
        // Before or after the request.
        (vec!["yes"], "its standard output is for answers alone"),
        (vec![], "there is no command"),
    ] {
        let command = command.into_iter().map(String::from).collect();
        let programs = Arc::new(Programs::new(command, 1, Duration::from_secs(5), None, |_, _| false));
        let error = programs.make().map(drop).expect_err(expected).to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
#[cfg(target_os = "linux")]
fn the_time_limit_holds_for_a_program_that_never_reads() {
    let command = vec![hostile(), "deaf".into()];
    let programs = Arc::new(Programs::new(command, 1, Duration::from_secs(2), None, |_, _| false));
    let mut environment = programs.make().unwrap();
    let mut observation = [0.0];
    environment.reset(Start::Seed(1_000_000_007), &mut observation).unwrap();
    let error = (0..10_000).find_map(|_| environment.step(1, &mut observation).err()).unwrap().to_string();
    assert!(error.contains("it did not read `step 1` within 2 s (`environment.timeout_seconds`)"), "{error}");
}

#[test]
fn a_program_that_never_ends_is_ended() {
    let directory = tempfile::tempdir().unwrap();
    let programs = programs(directory.path(), "never ends");
    play(&programs).unwrap();
    let mark = directory.path().display().to_string();
    assert_eq!(processes(&mark).len(), 1, "the process is kept for the next episode");
    drop(programs);
    assert_eq!(processes(&mark), [""; 0]);
}
