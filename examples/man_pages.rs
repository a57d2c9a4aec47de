//! Writes a man page for each command: `cargo run --example man_pages DIRECTORY`. An example, so that the program itself needs no
//! crate for it.

use std::{env, fs, io};

fn main() -> io::Result<()> {
    let directory = env::args_os().nth(1).ok_or_else(|| io::Error::other("usage: man_pages DIRECTORY"))?;
    fs::create_dir_all(&directory)?;
    clap_mangen::generate_to(cartpole_dqn::cli::command(), directory)
}
