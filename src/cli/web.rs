//! `cartpole-dqn web`

use super::ui::{Failure, cannot_write, print};

/// Write the page that trains in a browser: one HTML file for a web server, or to be opened as it is.
///
/// The page has the same trainer as this program, compiled to WebAssembly. It needs no network.
#[derive(Debug, clap::Args)]
#[command(after_help = "Example: cartpole-dqn web --out site")]
pub(super) struct WebArguments {
    /// Directory that index.html is written to; it is made if it is missing
    #[arg(long, value_name = "DIR")]
    out: std::path::PathBuf,
}

/// The page that `web/build.sh` has built.
const PAGE: &[u8] = include_bytes!(env!("CARTPOLE_DQN_WEB_PAGE"));
const TITLE: &[u8] = b"<title>A deep Q-network learns";

pub(super) fn run(arguments: &WebArguments) -> Result<(), Failure> {
    let path = &arguments.out.join("index.html");
    let is_own = |start: &[u8]| start.windows(TITLE.len()).any(|window| window == TITLE);
    let output = super::output::Output { option: "--out", path, what: "this page", is_own };
    output.check()?;
    crate::files::create_directories(&arguments.out)
        .map_err(|error| cannot_write(&arguments.out, &error, "; choose another --out"))?;
    output.write(|file| file.write_all(PAGE))?;
    print(&format!("written: {}\n", crate::text::shown(path)))
}
