use std::process::Command;

use super::signals::{hangup_is_ignored, survives_hangup};

#[test]
fn a_shell_outlives_a_hangup_if_it_is_ignored() {
    let shell = |trap: &str| {
        let mut shell = Command::new("/bin/sh");
        shell.args(["-c", &format!("{trap} exec /bin/sh \"$@\""), "sh"]);
        shell
    };
    assert!(survives_hangup(shell("trap '' HUP;")));
    assert_eq!(survives_hangup(shell("")), hangup_is_ignored());
}
