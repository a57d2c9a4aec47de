//! Reads the events of a run from its `metrics.jsonl`.

use std::io::{self, BufRead, BufReader, Read};

use crate::trainer::Event;

/// Longest line that is read, in bytes; a line of `train` has a few hundred.
const MAX_LINE: u64 = 1 << 16;

/// Shows `take` the events of a run, the first one first. Half a line at the end, which a killed run leaves, is ignored.
///
/// # Errors
/// When the file cannot be read, a line is not an event, or the steps of an event are fewer than those before.
pub(crate) fn read_events(path: &std::path::Path, mut take: impl FnMut(Event)) -> io::Result<()> {
    let mut reader = BufReader::new(crate::files::open_ordinary(path)?);
    let (mut line, mut last_step) = (Vec::new(), 0);
    for number in 1.. {
        let bad = |what: String| io::Error::new(io::ErrorKind::InvalidData, format!("line {number} {what}"));
        line.clear();
        let length = (&mut reader).take(MAX_LINE).read_until(b'\n', &mut line)?;
        if length == 0 || (line.last() != Some(&b'\n') && (length as u64) < MAX_LINE) {
            break;
        }
        let event: Event =
            serde_json::from_slice(&line).map_err(|_| bad("is not an event of a run".into()))?;
        let step = event.env_steps();
        if step < last_step {
            return Err(bad(format!("goes back to `env_steps` {step}, from {last_step}")));
        }
        last_step = step;
        take(event);
    }
    Ok(())
}
