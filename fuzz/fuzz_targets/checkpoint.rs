//! A checkpoint of any content, as it is and with a SHA-256 that fits: an error, or a run that goes on.
#![no_main]

use cartpole_dqn::env::catalogue::EnvironmentId;
use cartpole_dqn::run::{Checkpoint, Header, seal};
use cartpole_dqn::trainer::{Budget, Event};
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
    let _ = checkpoint.policy(&EnvironmentId::CartPoleV1.spec());
    let Ok(Header { mut config, progress: Some(progress), .. }) = checkpoint.header() else { return };
    let is_small = config.evaluation.episodes <= 20
        && config.agent.as_dqn().is_none_or(|dqn| {
            dqn.learn.updates <= 4
                && dqn.replay.batch_size <= 64
                && dqn.network.hidden.iter().sum::<usize>() <= 64
        });
    if !is_small || config.check_memory(1).is_err() {
        return;
    }
    config.budget = Budget::Steps(progress.env_steps.saturating_add(3));
    let Ok(mut trainer) = config.make_trainer().unwrap().resume(progress, &checkpoint.tensors) else { return };
    let mut events: Vec<Event> = Vec::new();
    for _ in 0..3 {
        if trainer.step(&mut events).is_err() {
            return;
        }
    }
    let written = Checkpoint::of_run(&config, trainer.snapshot()).unwrap().to_bytes().unwrap();
    let again = Checkpoint::from_bytes(&written).unwrap();
    let progress = again.header::<Header>().unwrap().progress.unwrap();
    config.make_trainer().unwrap().resume(progress, &again.tensors).unwrap();
}
