//! `CARTPOLE_DQN_SIMD`: every instruction set gives the same run.

use cartpole_dqn::nn::kernels::InstructionSet;

use crate::cli::Sandbox;

fn train(sandbox: &Sandbox, instruction_set: &str, out: &str) -> assert_cmd::assert::Assert {
    sandbox.assert(
        sandbox
            .command(&[
                "train",
                "--config",
                concat!(env!("CARGO_MANIFEST_DIR"), "/configs/smoke.json"),
                "--out",
                out,
            ])
            .env(InstructionSet::VARIABLE, instruction_set),
    )
}

#[test]
fn every_instruction_set_of_this_cpu_gives_the_same_bytes() {
    let sandbox = Sandbox::new();
    train(&sandbox, "scalar", "scalar").success();
    let others = InstructionSet::available().into_iter().filter(|&set| set != InstructionSet::SCALAR);
    let others: Vec<_> = others.collect();
    if others.is_empty() {
        crate::skipped("this CPU has no instruction set to compare with the scalar one");
    }
    for set in others {
        train(&sandbox, set.name(), set.name()).success();
        for file in ["metrics.jsonl", "checkpoints/best.safetensors", "checkpoints/last.safetensors"] {
            let bytes = |name: &str| std::fs::read(sandbox.path(&format!("{name}/{file}"))).unwrap();
            assert!(bytes(set.name()) == bytes("scalar"), "{}: {file}", set.name());
        }
    }
}

#[test]
fn refuses_an_instruction_set_that_this_cpu_does_not_have() {
    let sandbox = Sandbox::new();
    let output = train(&sandbox, "avx1024", "run").code(2).get_output().stderr.clone();
    let message = String::from_utf8(output).unwrap();
    assert!(message.contains("CARTPOLE_DQN_SIMD is \"avx1024\"") && message.contains("scalar"), "{message}");
    assert!(sandbox.files().is_empty());
}
