//! The direction of dependencies: `rng, env, nn <- agent <- trainer <- cli`, and who stays out of whose way.

use std::path::Path;

/// A part of the crate, and the parts that it must not use.
const FORBIDDEN: [(&str, &[&str]); 17] = [
    ("rng.rs", &["env", "nn", "agent", "trainer", "config", "checkpoint", "sink", "study", "report", "cli"]),
    ("env", &["nn", "agent", "trainer", "config", "checkpoint", "sink", "study", "report", "cli"]),
    ("nn", &["env", "agent", "trainer", "config", "checkpoint", "sink", "study", "report", "cli"]),
    ("agent", &["env", "trainer", "config", "checkpoint", "sink", "study", "report", "cli"]),
    ("trainer", &["sink", "study", "report", "cli"]),
    ("checkpoint.rs", &["env", "agent", "trainer", "config", "sink", "study", "report", "cli"]),
    ("check", &["env", "trainer", "config", "checkpoint", "sink", "study", "report", "cli"]),
    ("config.rs", &["checkpoint", "sink", "study", "report", "cli"]),
    ("config", &["checkpoint", "sink", "study", "report", "cli"]),
    ("sink", &["env", "nn", "agent", "config", "checkpoint", "study", "report", "cli"]),
    ("study", &["sink", "render", "report", "cli"]),
    ("render.rs", &["nn", "agent", "trainer", "config", "checkpoint", "sink", "study", "report", "cli"]),
    ("render", &["nn", "agent", "trainer", "config", "checkpoint", "sink", "study", "report", "cli"]),
    ("view.rs", &["checkpoint", "config", "sink", "study", "render", "report", "cli"]),
    ("view", &["checkpoint", "config", "sink", "study", "render", "report", "cli"]),
    ("report", &["nn", "agent", "sink", "cli"]),
    (
        "files.rs",
        &["env", "nn", "agent", "trainer", "config", "checkpoint", "sink", "study", "report", "cli"],
    ),
];

fn sources(path: &Path) -> Vec<(String, String)> {
    if path.is_file() {
        return vec![(path.display().to_string(), std::fs::read_to_string(path).unwrap())];
    }
    std::fs::read_dir(path).unwrap().flat_map(|entry| sources(&entry.unwrap().path())).collect()
}

#[test]
fn no_module_uses_what_lies_above_it() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    for (part, forbidden) in FORBIDDEN {
        for (file, text) in sources(&src.join(part)) {
            for module in forbidden {
                for edge in [format!("crate::{module}::"), format!("crate::{module};")] {
                    assert!(!text.contains(&edge), "{file} uses {edge}");
                }
            }
        }
    }
}

#[test]
fn only_the_command_line_and_sinks_print_and_only_kernels_are_unsafe() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    for (file, text) in sources(&src) {
        let code: String = text.lines().filter(|line| !line.trim_start().starts_with("//")).collect();
        let prints = ["println!", "eprintln!", "print!(", "io::stdout()", "io::stderr()"];
        let may_print = ["/cli/", "/sink/", "/view"].iter().any(|part| file.contains(part));
        assert!(may_print || !prints.iter().any(|print| code.contains(print)), "{file} prints");
        assert!(file.contains("/nn/kernels/") || !code.contains("unsafe {"), "{file} is unsafe");
    }
}
