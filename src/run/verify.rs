//! Compares a run with its repetition.

use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

use serde_json::{Value, json};

use super::checkpoint::MAX_FILE_SIZE;
use super::names::{BEST, LAST, METRICS, PREVIOUS};
use super::{Checkpoint, Header, RunDir, RunError, RunRecord, bad};
use crate::config::{MAX_BYTES, difference};
use crate::files::{if_there, open_ordinary, read_limited, read_text_limited};

/// Bytes of a line that are compared at a time, and characters that are shown.
const MAX_LINE: u64 = 1 << 20;
const SHOWN: usize = 300;

pub(crate) struct Extent {
    /// None: to its end.
    pub env_steps: Option<u64>,
    pub(crate) lines: u64,
}

/// The differences between the metrics and checkpoints of a run and of its repetition.
pub(crate) fn compare_files(run: &RunDir, again: &RunDir, extent: &Extent) -> Result<Vec<String>, RunError> {
    let read = |path: &Path| read_limited(path, MAX_FILE_SIZE);
    let mut differences = Vec::new();
    differences.extend(compare_lines(&run.metrics(), &again.metrics(), extent.lines)?);
    for name in [BEST, LAST, PREVIOUS] {
        let (path, repeated) = (run.checkpoints().join(name), again.checkpoints().join(name));
        if name == BEST && extent.env_steps.is_some_and(|last| step_of(&path).is_some_and(|step| step > last))
        {
            continue;
        }
        // A process that was killed as it wrote the next one leaves the last one under both names.
        if name == PREVIOUS && extent.env_steps.is_some() && read(&path).ok() == read(&run.last()).ok() {
            continue;
        }
        let problem = match (read(&path), repeated.exists()) {
            (Err(error), false) if error.kind() == io::ErrorKind::NotFound => continue,
            (Err(error), _) => error.to_string(),
            (Ok(_), false) => "there should be none".into(),
            (Ok(bytes), true) => match read(&repeated).map_err(failed)? {
                expected if expected == bytes => continue,
                _ => Checkpoint::from_bytes(&bytes).err().map_or("other content".into(), |e| e.to_string()),
            },
        };
        differences.push(format!("checkpoints/{name}: {problem}"));
    }
    Ok(differences)
}

/// The first of so many lines that differs.
fn compare_lines(recorded: &Path, repeated: &Path, count: u64) -> Result<Option<String>, RunError> {
    let open = |path| open_ordinary(path).map(BufReader::new).map_err(failed);
    let line = |file: &mut BufReader<std::fs::File>| {
        let mut line = Vec::new();
        file.take(MAX_LINE).read_until(b'\n', &mut line).map(|_| line).map_err(failed)
    };
    let (mut recorded, mut repeated) = (open(recorded)?, open(repeated)?);
    for number in 1..=count {
        match (line(&mut recorded)?, line(&mut repeated)?) {
            (a, b) if a != b => {
                let (a, b) = (shown(&a), shown(&b));
                let text = format!("{METRICS}, first at line {number}:\n  recorded {a}\n  repeated {b}");
                return Ok(Some(text));
            }
            (a, _) if a.is_empty() => break,
            _ => {}
        }
    }
    Ok(None)
}

fn shown(line: &[u8]) -> String {
    match String::from_utf8_lossy(line).trim_end() {
        "" => "nothing".into(),
        line => line.chars().filter(|c| !c.is_control()).take(SHOWN).collect(),
    }
}

fn step_of(best: &Path) -> Option<u64> {
    Some(Checkpoint::read(best).ok()?.header::<Header>().ok()?.env_steps)
}

/// The recorded summary, if it is of the config beside it: another config may train for ever.
pub(crate) fn read_summary(run: &RunDir) -> Result<Value, RunError> {
    let unreadable =
        |error: io::Error| bad(run.path(), format!("has a summary.json that cannot be read: {error}"));
    let text = read_text_limited(&run.summary(), MAX_BYTES).map_err(unreadable)?;
    let summary: Value = serde_json::from_str(&text).map_err(|error| unreadable(error.into()))?;
    let files = [
        ("config_sha256", run.config(), MAX_BYTES),
        // None in the summary and no file where the first weights were drawn.
        ("init_sha256", run.init(), MAX_FILE_SIZE),
    ];
    for (field, path, max_bytes) in files {
        let bytes = if_there(read_limited(&path, max_bytes)).map_err(failed)?;
        let found = json!(bytes.map(|bytes| crate::tensors::sha256([bytes])));
        if summary[field] != found {
            return Err(RunError::Failed(format!(
                "{} does not agree: the SHA-256 of its {} is {found}, and summary.json says {}",
                run.path().display(),
                path.strip_prefix(run.path()).unwrap_or(&path).display(),
                summary[field]
            )));
        }
    }
    Ok(summary)
}

/// The difference between the summaries, apart from the circumstances of the training.
pub(crate) fn compare_summaries(recorded: Value, repeated: &RunRecord) -> Option<String> {
    let outcome = |mut summary: Value| {
        if let Some(fields) = summary.as_object_mut() {
            RunRecord::CIRCUMSTANCES.iter().for_each(|field| drop(fields.remove(*field)));
        }
        summary
    };
    let difference = difference("", &outcome(recorded), &outcome(json!(repeated)));
    difference.map(|difference| format!("summary.json: {difference}"))
}

fn failed(error: io::Error) -> RunError {
    RunError::Failed(format!("cannot verify: {error}"))
}
