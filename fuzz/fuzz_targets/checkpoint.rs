//! A checkpoint of any content, as it is and with a SHA-256 that fits: an error, or a run that goes on.
#![no_main]

use cartpole_dqn::checkpoint::{Checkpoint, seal};
use cartpole_dqn::env::CartPole;
use cartpole_dqn::trainer::{Budget, Event, Header, Trainer};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    load(data);
    let mut sealed = data.to_vec();
    seal(&mut sealed);
    if sealed != data {
        load(&sealed);
    }
});

fn load(bytes: &[u8]) {
    let Ok(checkpoint) = Checkpoint::from_bytes(bytes) else { return };
    let _ = checkpoint.policy(4, 2);
    let _ = checkpoint.header::<Header>();
    let Ok(mut trainer) = Trainer::resume(&checkpoint, CartPole::v1()) else { return };
    let config = trainer.config();
    let is_small = config.evaluation.episodes <= 20
        && config.learn.updates <= 4
        && config.replay.batch_size <= 64
        && config.network.hidden.iter().sum::<usize>() <= 64;
    if is_small && trainer.set_budget(Budget::Steps(trainer.progress().env_steps + 3)) {
        let mut events: Vec<Event> = Vec::new();
        for _ in 0..3 {
            if trainer.step(&mut events, None).is_err() {
                return;
            }
        }
    }
    let written = trainer.checkpoint().unwrap().to_bytes().unwrap();
    let again = Checkpoint::from_bytes(&written).unwrap();
    Trainer::resume(&again, CartPole::v1()).unwrap();
}
