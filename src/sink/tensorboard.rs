//! TensorBoard's event files: TFRecords of a few protocol buffers, with the tags of Stable-Baselines3.
//!
//! The messages (tensorflow/core/util/event.proto, framework/summary.proto) are so few and so frozen that they are
//! encoded here: `Event { double wall_time = 1; int64 step = 2; string file_version = 3; Summary summary = 5; }`,
//! `Summary { repeated Value value = 1; }`, `Value { string tag = 1; float simple_value = 2; }`.

use std::collections::VecDeque;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use crc::{CRC_32_ISCSI, Crc};

use super::TENSORBOARD_PREFIX;
use crate::trainer::{Event, Observer};

const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISCSI);
/// Episodes of a running mean, as in `mean_return_100`.
const RECENT: usize = 100;

/// Appends events to an event file. The format demands wall-clock times: of a run's files its bytes alone differ each time.
pub(crate) struct TensorBoard {
    file: BufWriter<File>,
    learning_rate: Box<dyn Fn(u64) -> f64>,
    recent_lengths: VecDeque<u64>,
    /// When the first event came, and its environment steps.
    start: Option<(Instant, u64)>,
}

impl TensorBoard {
    /// Creates a new file in a directory, which is made if it is missing, for a run that has made `env_steps` steps.
    pub fn create(
        directory: &crate::files::Directory, path: &Path, env_steps: u64,
        learning_rate: impl Fn(u64) -> f64 + 'static,
    ) -> io::Result<Self> {
        directory.create_dir(path)?;
        // TensorBoard reads the files of a directory by name, so the new one must be the last.
        let latest = latest_second(path)?;
        let second = latest.map_or(0, |latest| latest + 1).max(wall_time() as u64);
        let name = format!("{TENSORBOARD_PREFIX}{second}.cartpole-dqn.{}", std::process::id());
        let file = BufWriter::new(directory.create_file(&path.join(name))?);
        let learning_rate = Box::new(learning_rate);
        let mut sink = Self { file, learning_rate, recent_lengths: VecDeque::new(), start: None };
        sink.write_event(None, 3, b"brain.Event:2")?;
        if latest.is_some() {
            // `SessionLog { status = START }`: TensorBoard then forgets what earlier files hold from this step on. A run
            // that begins again at step 0 has no event of that step.
            sink.write_event(Some(if env_steps == 0 { 0 } else { env_steps + 1 }), 7, &[1 << 3, 1])?;
        }
        sink.file.flush()?;
        Ok(sink)
    }

    fn write_scalars(
        &mut self, step: u64, scalars: impl IntoIterator<Item = (impl AsRef<str>, f64)>,
    ) -> io::Result<()> {
        let mut summary = Vec::new();
        for (tag, value) in scalars {
            let mut scalar = Vec::new();
            put_bytes(&mut scalar, 1, tag.as_ref().as_bytes());
            varint(&mut scalar, 2 << 3 | 5);
            scalar.extend((value as f32).to_le_bytes());
            put_bytes(&mut summary, 1, &scalar);
        }
        self.write_event(Some(step), 5, &summary)
    }

    /// A record with the event of now: its length and the event, each with its checksum.
    fn write_event(&mut self, step: Option<u64>, field: u64, content: &[u8]) -> io::Result<()> {
        let mut event = Vec::new();
        varint(&mut event, 1 << 3 | 1);
        event.extend(wall_time().to_le_bytes());
        if let Some(step) = step {
            varint(&mut event, 2 << 3);
            varint(&mut event, step);
        }
        put_bytes(&mut event, field, content);
        for part in [&(event.len() as u64).to_le_bytes()[..], &event] {
            self.file.write_all(part)?;
            self.file.write_all(&masked_crc(part).to_le_bytes())?;
        }
        Ok(())
    }

    /// Since the first event; none at that event.
    fn steps_per_second(&mut self, env_steps: u64) -> Option<f64> {
        let (start, first) = *self.start.get_or_insert_with(|| (Instant::now(), env_steps));
        (env_steps > first).then(|| (env_steps - first) as f64 / start.elapsed().as_secs_f64().max(1e-9))
    }
}

impl Observer for TensorBoard {
    fn event(&mut self, event: &Event) -> io::Result<()> {
        match event {
            Event::Episode { env_steps, length, mean_return_100, epsilon, loss, updates, .. } => {
                let env_steps = *env_steps;
                self.recent_lengths.truncate(RECENT - 1);
                self.recent_lengths.push_front(*length);
                let mean_length =
                    self.recent_lengths.iter().sum::<u64>() as f64 / self.recent_lengths.len() as f64;
                let mut scalars = vec![
                    ("rollout/ep_rew_mean", *mean_return_100),
                    ("rollout/ep_len_mean", mean_length),
                    ("rollout/exploration_rate", *epsilon),
                    ("time/total_timesteps", env_steps as f64),
                    ("train/n_updates", *updates as f64),
                    ("train/learning_rate", (self.learning_rate)(env_steps)),
                ];
                scalars.extend(loss.map(|loss| ("train/loss", loss)));
                scalars.extend(self.steps_per_second(env_steps).map(|fps| ("time/fps", fps)));
                self.write_scalars(env_steps, scalars)
            }
            Event::Evaluation { env_steps, mean, std, min, max, mean_length, .. } => {
                let scalars = [
                    ("eval/mean_reward", *mean),
                    ("eval/mean_ep_length", *mean_length),
                    ("eval/std_reward", *std),
                    ("eval/min_reward", *min),
                    ("eval/max_reward", *max),
                ];
                self.write_scalars(*env_steps, scalars)?;
                self.file.flush()
            }
            Event::Statistics { env_steps, numbers } => {
                let scalar = |(name, number): &(String, f64)| (format!("diagnostics/{name}"), *number);
                self.write_scalars(*env_steps, numbers.0.iter().map(scalar))?;
                self.file.flush()
            }
            Event::End { .. } => self.file.flush(),
        }
    }
}

fn latest_second(path: &Path) -> io::Result<Option<u64>> {
    let names: Vec<_> = fs::read_dir(path)?.map(|entry| Ok(entry?.file_name())).collect::<io::Result<_>>()?;
    let second =
        |name: &OsString| name.to_str()?.strip_prefix(TENSORBOARD_PREFIX)?.split('.').next()?.parse().ok();
    // A name that somebody has changed can hold any number.
    Ok(names.iter().filter_map(second).map(|second: u64| second.min(u64::MAX - 1)).max())
}

fn wall_time() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}

/// TFRecord's checksum: a CRC of data that holds its own CRC would be weak, so it is rotated and shifted.
fn masked_crc(data: &[u8]) -> u32 {
    CRC.checksum(data).rotate_right(15).wrapping_add(0xa282_ead8)
}

/// The bytes of a number, seven bits each, the lowest first; all but the last have the highest bit set.
fn varint(message: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        message.push(value as u8 | 0x80);
        value >>= 7;
    }
    message.push(value as u8);
}

fn put_bytes(message: &mut Vec<u8>, field: u64, bytes: &[u8]) {
    varint(message, field << 3 | 2);
    varint(message, bytes.len() as u64);
    message.extend(bytes);
}

#[cfg(test)]
#[path = "../../tests/unit/sink_tensorboard.rs"]
mod tests;
