//! Does the number of updates and of whole training steps that it is told, so that their instructions can be counted:
//! see benches/instructions.sh.
#![allow(clippy::unwrap_used, missing_docs)]

use std::hint::black_box;

use cartpole_dqn::config::Config;
use cartpole_dqn::trainer::Event;

fn main() {
    // `cargo bench` passes --bench.
    let mut arguments = std::env::args().skip(1).filter(|argument| argument != "--bench");
    let steps: u64 = arguments.next().map_or(1000, |steps| steps.parse().unwrap());
    let every = arguments.next().unwrap_or_else(|| "1".into());
    let sets = [
        "network.hidden=[24,24]".into(),
        "budget.steps=1000000000".into(),
        "evaluation.every_steps=1000000000".into(),
        "checkpoint.every_steps=1000000000".into(),
        format!("learn.every_steps={every}"),
    ];
    let mut trainer =
        Config::from_layers(Some(("plain_dqn.json", include_str!("../tests/data/plain_dqn.json"))), &sets)
            .unwrap()
            .make_trainer()
            .unwrap();
    let mut events: Vec<Event> = Vec::new();
    for _ in 0..1000 + steps {
        trainer.step(&mut events).unwrap();
    }
    black_box(trainer.agent());
    println!("{steps} steps after the first 1000, {} updates", trainer.progress().updates);
}
