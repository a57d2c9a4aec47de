//! An update of any content: an error, or a verdict.
#![no_main]

use cartpole_dqn::check::{Update, check};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let Ok(update) = Update::from_bytes(data) else { return };
    let is_small = update.online.parameters().len() * update.batch.rewards.len() <= 10_000;
    if is_small {
        serde_json::to_string(&check(&update)).unwrap();
    }
});
