//! Tells the program the git revision that it is built from, where there is one, and where the page of its feature `web` is.

use std::env;
use std::path::{Path, absolute};
use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=src");
    println!("cargo::rerun-if-changed=build.rs");
    if env::var_os("CARGO_FEATURE_WEB").is_some() {
        find_page();
    }
    // A package from a registry has no `.git`, and may lie in somebody else's repository.
    if !Path::new(".git").exists() {
        return;
    }
    // Grows with every commit and checkout. A file that is not there would make every build run this again.
    if let Some(log) = git(&["rev-parse", "--git-path", "logs/HEAD"]).filter(|log| Path::new(log).exists()) {
        println!("cargo::rerun-if-changed={log}");
    }
    if let Some(revision) = git(&["describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]) {
        println!("cargo::rustc-env=CARTPOLE_DQN_REVISION={revision}");
    }
}

/// Tells the program where `web/build.sh` has written the page.
fn find_page() {
    println!("cargo::rerun-if-env-changed=CARTPOLE_DQN_WEB_PAGE");
    let page = env::var("CARTPOLE_DQN_WEB_PAGE").unwrap_or_else(|_| "target/web/page/index.html".into());
    println!("cargo::rerun-if-changed={page}");
    match absolute(&page).map(|path| path.display().to_string()) {
        Ok(path) if Path::new(&path).is_file() => println!("cargo::rustc-env=CARTPOLE_DQN_WEB_PAGE={path}"),
        _ => println!(
            "cargo::error=the feature `web` needs the page, and there is no {page}: run `web/build.sh target/web/page`, \
             or set CARTPOLE_DQN_WEB_PAGE to a page that it has built"
        ),
    }
}

/// What git says, unless it is missing or fails.
fn git(arguments: &[&str]) -> Option<String> {
    let output =
        Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
}
