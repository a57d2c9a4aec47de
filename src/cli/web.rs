//! `cartpole-dqn web`

use std::path::PathBuf;

use clap::Args;

use super::output::Output;
use super::ui::{Failure, cannot_write, print};
use crate::files::{create_folders, write_whole};
use crate::text::shown;

/// Write the page that trains in a browser: one HTML file for a web server, or to be opened as it is.
///
/// The page has the same trainer as this program, compiled to WebAssembly. It needs no network.
#[derive(Debug, Args)]
#[command(after_help = "Example: cartpole-dqn web --out site")]
pub(super) struct Arguments {
    /// Directory that index.html is written to; it is made if it is missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// The page that `web/build.sh` has built.
#[cfg(feature = "web")]
const PAGE: Option<&[u8]> = Some(include_bytes!(env!("CARTPOLE_DQN_WEB_PAGE")));
#[cfg(not(feature = "web"))]
const PAGE: Option<&[u8]> = None;

/// How the page's own title begins.
const TITLE: &[u8] = b"<title>A deep Q-network learns";

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let Some(page) = PAGE else {
        return Err(Failure::Failed(
            "this program was built without the page; in a clone of the repository, \
             `web/build.sh target/web/page && cargo build --release --features web` builds a program that has it"
                .into(),
        ));
    };
    let path = &arguments.out.join("index.html");
    let is_own = |start: &[u8]| start.windows(TITLE.len()).any(|window| window == TITLE);
    Output { option: "--out", path, what: "this page", is_own }.check()?;
    let hint = "; choose another --out";
    create_folders(&arguments.out).map_err(|error| cannot_write(&arguments.out, &error, hint))?;
    write_whole(path, |file| file.write_all(page)).map_err(|error| cannot_write(path, &error, hint))?;
    print(&format!("written: {}\n", shown(path)))
}
