//! The trainer of `cartpole-dqn` for a web page: a WebAssembly module with a few functions and no imports.
//!
//! The functions take numbers. A text or a file goes in through [`input`] and comes out through [`output`]: the page writes
//! the bytes to where `input` says, calls a function, and reads what the function left. A function that returns a `bool` has
//! left an error message if it returns false.
//!
//! The page's worker has an instance that trains ([`trainer`]), and the page itself one that plays ([`player`]).

mod check;
mod player;
mod trainer;

use std::cell::RefCell;

use player::Player;
use trainer::Training;

/// What an instance of the module holds. The module has one thread.
#[derive(Default)]
struct Instance {
    input: Vec<u8>,
    output: Vec<u8>,
    training: Option<Training>,
    player: Option<Player>,
}

thread_local! {
    static INSTANCE: RefCell<Instance> = RefCell::default();
}

/// Runs a function on the input and the instance, and leaves its output, or its error message.
fn call(function: impl FnOnce(&[u8], &mut Instance) -> Result<Vec<u8>, String>) -> bool {
    INSTANCE.with_borrow_mut(|instance| {
        let input = std::mem::take(&mut instance.input);
        let result = function(&input, instance);
        let ok = result.is_ok();
        instance.output = result.unwrap_or_else(String::into_bytes);
        ok
    })
}

fn with_training(function: impl FnOnce(&mut Training) -> Result<Vec<u8>, String>) -> bool {
    call(|_, instance| function(instance.training.as_mut().ok_or("no run has been started")?))
}

fn with_player(function: impl FnOnce(&mut Player) -> Result<Vec<u8>, String>) -> bool {
    call(|_, instance| function(instance.player.as_mut().ok_or("no policy has been loaded")?))
}

/// Room for an input of `len` bytes.
#[unsafe(no_mangle)]
pub extern "C" fn input(len: usize) -> *mut u8 {
    INSTANCE.with_borrow_mut(|instance| {
        instance.input = vec![0; len];
        instance.input.as_mut_ptr()
    })
}

/// Where the output of the latest function is.
#[unsafe(no_mangle)]
pub extern "C" fn output() -> *const u8 {
    INSTANCE.with_borrow(|instance| instance.output.as_ptr())
}

/// Bytes of the output.
#[unsafe(no_mangle)]
pub extern "C" fn output_len() -> usize {
    INSTANCE.with_borrow(|instance| instance.output.len())
}

/// Prepares the run of a config: see [`Training::start`].
#[unsafe(no_mangle)]
pub extern "C" fn start() -> bool {
    call(|input, instance| {
        let (training, description) = Training::start(input)?;
        instance.training = Some(training);
        Ok(description)
    })
}

/// Trains up to `steps` environment steps: see [`Training::train`].
#[unsafe(no_mangle)]
pub extern "C" fn train(steps: u32) -> bool {
    with_training(|training| training.train(steps))
}

/// Takes the run that has been started to where a checkpoint of it was taken: see [`Training::resume`].
#[unsafe(no_mangle)]
pub extern "C" fn resume() -> bool {
    call(|input, instance| {
        let training = instance.training.as_mut().ok_or("no run has been started")?;
        training.resume(input).map(|()| Vec::new())
    })
}

/// The policy as it is now, as the bytes of a checkpoint.
#[unsafe(no_mangle)]
pub extern "C" fn policy() -> bool {
    with_training(|training| training.policy())
}

/// The bytes of the run's `last.safetensors`.
#[unsafe(no_mangle)]
pub extern "C" fn last() -> bool {
    with_training(|training| training.last())
}

/// The bytes of the run's `best.safetensors`.
#[unsafe(no_mangle)]
pub extern "C" fn best() -> bool {
    with_training(|training| training.best())
}

/// Plays the policy of a checkpoint from now on: see [`Player::load`].
#[unsafe(no_mangle)]
pub extern "C" fn load() -> bool {
    call(|input, instance| {
        let (policy, description) = Player::load(input)?;
        match &mut instance.player {
            Some(player) => player.policy = policy,
            None => instance.player = Some(Player::new(policy)),
        }
        Ok(description)
    })
}

/// What the environment says of itself, as JSON: see [`player::task`].
#[unsafe(no_mangle)]
pub extern "C" fn task() -> bool {
    call(|_, _| player::task())
}

/// Begins an episode where Gymnasium's `reset(seed=…)` begins it: see [`Player::reset`].
#[unsafe(no_mangle)]
pub extern "C" fn reset(seed: u32) -> bool {
    with_player(|player| player.reset(seed))
}

/// Plays one step: see [`Player::step`].
#[unsafe(no_mangle)]
pub extern "C" fn step(push: i32) -> bool {
    with_player(|player| player.step(push))
}

/// The preferences of the policy over pole angle and angular velocity: see [`Player::map`].
#[unsafe(no_mangle)]
pub extern "C" fn map(size: usize) -> bool {
    with_player(|player| Ok(player.map(size)))
}

/// How many of the numbers that the kernels compute in random shapes have other bits than the reference's.
#[unsafe(no_mangle)]
pub extern "C" fn differing_numbers(seed: u32) -> u32 {
    check::differing_numbers(seed)
}
