//! The requests of the protocol, and what their answers mean.

use base64::Engine;

use super::super::{EnvironmentError, Image, Outcome, Spec};
use super::Answer;
use super::process::{MAX_ANSWER, Process, shortened};

const PROTOCOL: u64 = 1;
const MAX_SIDE: u16 = 2048;
/// Longest picture in bytes of base64.
const MAX_FRAME: usize = 4 * MAX_SIDE as usize * MAX_SIDE as usize + 64;
/// Steps in a second of simulated time where the program does not say.
const STEPS_PER_SECOND: f64 = 50.0;

/// The answer to `hello`. Other keys are ignored.
#[derive(serde::Deserialize)]
struct Hello {
    protocol: u64,
    name: String,
    observation_size: usize,
    actions: usize,
    max_steps: u32,
    solved_return: Option<f64>,
    return_range: Option<(f64, f64)>,
    steps_per_second: Option<f64>,
    action_names: Option<Vec<String>>,
    observation_names: Option<Vec<String>>,
    mirror: Option<crate::mirror::Mirror>,
}

impl Hello {
    fn spec(self) -> Result<Spec, String> {
        let limit = f64::from(self.max_steps);
        let solved = self.solved_return.unwrap_or(0.0);
        let numbered = |count: usize| (0..count.min(Spec::MAX_OBSERVATION)).map(|i| i.to_string()).collect();
        let spec = Spec {
            id: self.name,
            observation_size: self.observation_size,
            num_actions: self.actions,
            max_steps: self.max_steps,
            solved_return: self.solved_return,
            // As of rewards from −1 to 1.
            return_range: self.return_range.unwrap_or((solved.min(-limit), solved.max(limit))),
            steps_per_second: self.steps_per_second.unwrap_or(STEPS_PER_SECOND),
            actions: self.action_names.unwrap_or_else(|| numbered(self.actions)),
            observations: self.observation_names.unwrap_or_else(|| numbered(self.observation_size)),
            mirror: self.mirror,
            map: None,
        };
        spec.checked()
    }
}

impl Process {
    pub(super) fn hello(&mut self) -> Answer<Spec> {
        let request = format!("hello {PROTOCOL}");
        let line = self.answer(&request, MAX_ANSWER)?;
        let parsed = serde_json::from_str::<Hello>(&line).map_err(|error| error.to_string());
        let spec = parsed.and_then(|hello| match hello.protocol {
            PROTOCOL => hello.spec(),
            other => Err(format!("`protocol` is {other}, and this program speaks version {PROTOCOL} alone")),
        });
        spec.map_err(|error| self.nonsense(&request, &line, &format!("that is no JSON of a task: {error}")))
    }

    /// Starts an episode. The first time that is done twice, and must be the same.
    pub(super) fn reset(&mut self, seed: u64, observation: &mut [f32]) -> Answer<()> {
        let request = format!("reset {seed}");
        self.reset_once(&request, observation)?;
        if !self.is_checked {
            let first = observation.to_vec();
            self.reset_once(&request, observation)?;
            if first != observation {
                return Err(self.error(&format!(
                    "it is not deterministic: it answered `{request}` with {first:?} and then with {observation:?}. An \
                     episode must be a function of the seed and the actions"
                )));
            }
            self.is_checked = true;
        }
        Ok(())
    }

    fn reset_once(&mut self, request: &str, observation: &mut [f32]) -> Answer<()> {
        let line = self.answer(request, MAX_ANSWER)?;
        let mut words = line.split_ascii_whitespace();
        let read = match words.next() {
            Some("reset") => read_observation(words, observation),
            _ => Err("it does not begin with `reset`".into()),
        };
        read.map_err(|problem| {
            let expected = format!("{problem}; the answer is `reset` and {}", numbers(observation));
            self.nonsense(request, &line, &expected)
        })
    }

    pub(super) fn step(&mut self, action: usize, observation: &mut [f32]) -> Answer<Outcome> {
        let request = format!("step {action}");
        let line = self.answer(&request, MAX_ANSWER)?;
        read_step(&line, observation).map_err(|problem| {
            let expected = format!(
                "{problem}; the answer is `step REWARD TERMINATED TRUNCATED` and {}",
                numbers(observation)
            );
            self.nonsense(&request, &line, &expected)
        })
    }

    /// The picture of what there is now; none if the program draws nothing.
    pub(super) fn render(&mut self) -> Answer<Option<Image>> {
        let line = self.answer("render", MAX_FRAME)?;
        if line == "no frame" {
            return Ok(None);
        }
        let image = read_frame(&line).ok_or_else(|| {
            let expected = format!(
                "the answer is `no frame`, or `frame WIDTH HEIGHT` and 3 · WIDTH · HEIGHT bytes in base64, at most \
                 {MAX_SIDE} in each direction"
            );
            self.nonsense("render", &line, &expected)
        });
        image.map(Some)
    }

    fn answer(&mut self, request: &str, max_bytes: usize) -> Answer<String> {
        let line = self.ask(request, max_bytes)?;
        match line.strip_prefix("error") {
            Some(message) if message.is_empty() || message.starts_with(' ') => {
                let message = shortened(message);
                Err(self.error(&format!("it answered `{request}` with the error `{}`", message.trim())))
            }
            _ => Ok(line),
        }
    }

    fn nonsense(&self, request: &str, line: &str, problem: &str) -> EnvironmentError {
        self.error(&format!("it answered `{request}` with `{}`: {problem}", shortened(line)))
    }
}

fn numbers(observation: &[f32]) -> String {
    match observation.len() {
        1 => "one number".into(),
        count => format!("{count} numbers"),
    }
}

/// A finite number that is also one as f32.
fn read_number(word: &str) -> Result<f64, String> {
    match word.parse::<f64>() {
        Ok(number) if (number as f32).is_finite() => Ok(number),
        Ok(_) => Err(format!("`{}` is not finite, or too large for 32 bits", shortened(word))),
        Err(_) => Err(format!("`{}` is no number", shortened(word))),
    }
}

fn read_observation<'a>(words: impl Iterator<Item = &'a str>, observation: &mut [f32]) -> Result<(), String> {
    let mut count = 0;
    for word in words {
        let number = read_number(word)?;
        if let Some(place) = observation.get_mut(count) {
            *place = number as f32;
        }
        count += 1;
    }
    if count == observation.len() { Ok(()) } else { Err(format!("the observation has {count} numbers")) }
}

fn read_step(line: &str, observation: &mut [f32]) -> Result<Outcome, String> {
    let mut words = line.split_ascii_whitespace();
    if words.next() != Some("step") {
        return Err("it does not begin with `step`".into());
    }
    let reward = read_number(words.next().ok_or("the reward is missing")?)?;
    let mut flag = || match words.next() {
        Some("0") => Ok(false),
        Some("1") => Ok(true),
        _ => Err("a flag is neither 0 nor 1"),
    };
    let (terminated, truncated) = (flag()?, flag()?);
    read_observation(words, observation)?;
    Ok(Outcome { reward, terminated, truncated })
}

fn read_frame(line: &str) -> Option<Image> {
    let mut words = line.split_ascii_whitespace();
    let (frame, width, height, pixels) = (words.next()?, words.next()?, words.next()?, words.next()?);
    let side = |word: &str| word.parse().ok().filter(|side| (1..=MAX_SIDE).contains(side));
    let (width, height) = (side(width)?, side(height)?);
    let rgb = base64::engine::general_purpose::STANDARD.decode(pixels).ok()?;
    let is_whole = rgb.len() == 3 * usize::from(width) * usize::from(height);
    (frame == "frame" && words.next().is_none() && is_whole).then_some(Image { width, height, rgb })
}
