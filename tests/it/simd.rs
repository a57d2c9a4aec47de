//! `CARTPOLE_DQN_SIMD`: every instruction set gives the same run.

use cartpole_dqn::nn::kernels::Path;

use crate::cli::Sandbox;

fn train(sandbox: &Sandbox, path: &str, out: &str) -> assert_cmd::assert::Assert {
    sandbox
        .command(&[
            "train",
            "--config",
            concat!(env!("CARGO_MANIFEST_DIR"), "/configs/smoke.json"),
            "--out",
            out,
        ])
        .env(Path::VARIABLE, path)
        .assert()
}

#[test]
fn every_path_of_this_cpu_gives_the_same_bytes() {
    let sandbox = Sandbox::new();
    train(&sandbox, "scalar", "scalar").success();
    for path in Path::available().into_iter().filter(|&path| path != Path::Scalar) {
        train(&sandbox, path.name(), path.name()).success();
        for file in ["metrics.jsonl", "checkpoints/best.safetensors", "checkpoints/last.safetensors"] {
            let bytes = |path: &str| std::fs::read(sandbox.path(&format!("{path}/{file}"))).unwrap();
            assert!(bytes(path.name()) == bytes("scalar"), "{path:?}: {file}");
        }
    }
}

#[test]
fn refuses_a_path_that_this_cpu_does_not_have() {
    let sandbox = Sandbox::new();
    let output = train(&sandbox, "avx1024", "run").code(2).get_output().stderr.clone();
    let message = String::from_utf8(output).unwrap();
    assert!(message.contains("CARTPOLE_DQN_SIMD is \"avx1024\"") && message.contains("scalar"), "{message}");
    assert!(sandbox.files().is_empty());
}
