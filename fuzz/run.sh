#!/usr/bin/env bash
# fuzz/run.sh config|checkpoint|update [seconds]: fuzzes a parser with libFuzzer, on the stable toolchain, from
# tests/data/corpus; what it finds on the way stays in fuzz/target. Ends with an error and the input at the first panic, the first
# input that takes 10 s, and the first allocation of more than 9 GiB (a config may ask for 8).
set -euo pipefail
cd "$(dirname "$0")"
target=${1:?config, checkpoint or update}
seconds=${2:-600}
# What `cargo fuzz` sets, but for the sanitizer, which takes a nightly toolchain: the only `unsafe` code is in kernels.
export RUSTFLAGS='--cfg fuzzing -Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4
 -Cllvm-args=-sanitizer-coverage-inline-8bit-counters -Cllvm-args=-sanitizer-coverage-pc-table
 -Cllvm-args=-sanitizer-coverage-trace-compares -Ccodegen-units=1'
cargo build --release --bin "$target" --target "$(rustc -vV | sed -n 's/^host: //p')"
program=$(echo target/*/release/"$target")
mkdir -p "target/corpus/$target" "target/findings"
"$program" -max_total_time="$seconds" -timeout=10 -rss_limit_mb=9216 -malloc_limit_mb=9216 -max_len=20000 -use_value_profile=1 \
    -print_final_stats=1 -artifact_prefix=target/findings/ "target/corpus/$target" "../tests/data/corpus/$target"
