//! A config file of any content, and any `--set` on top of it: an error or a config, which is then a file that gives
//! itself again.
#![no_main]

use cartpole_dqn::config::Config;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    // What follows a line of its own with `--set` is one.
    let mut parts = text.split("\n--set ").map(str::to_owned);
    let file = parts.next().unwrap_or_default();
    let sets: Vec<String> = parts.collect();
    if let Ok(config) = Config::from_layers(Some(("file", &file)), &sets) {
        let written = serde_json::to_string(&config).unwrap();
        assert_eq!(Config::from_layers(Some(("written", &written)), &[]).unwrap(), config);
    }
});
