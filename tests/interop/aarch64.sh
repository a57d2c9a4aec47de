#!/usr/bin/env bash
# 64-bit ARM under qemu: the tests of the kernels, and configs/smoke.json with and without NEON, which must give the hash of x86-64.
# For Debian on x86-64, as root: installs a cross linker and an emulator.
set -euo pipefail
cd "$(dirname "$0")/../.."
target=aarch64-unknown-linux-gnu
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
fail() { echo "FAILED: $*" >&2; exit 1; }

if ! command -v qemu-aarch64 aarch64-linux-gnu-gcc >/dev/null; then
    apt-get update --quiet=2
    apt-get install --yes --quiet=2 --no-install-recommends qemu-user gcc-aarch64-linux-gnu libc6-dev-arm64-cross
fi
rustup target add "$target"
export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc
export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER='qemu-aarch64 -L /usr/aarch64-linux-gnu'

tests=$(cargo test --release --locked --target "$target" --test it kernels:: -- --list | grep -c ': test$') ||
    fail 'there are no tests of the kernels'
cargo test --release --locked --target "$target" --test it kernels::

cargo build --release --locked --target "$target"
binary=${CARGO_TARGET_DIR:-target}/$target/release/cartpole-dqn
expected=$(cat tests/data/smoke_weights.sha256)
for kernels in neon scalar; do
    seconds=$({ TIMEFORMAT=%U; time CARTPOLE_DQN_SIMD=$kernels $CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER "$binary" \
        train --config configs/smoke.json --out "$work/$kernels" --quiet 2>"$work/errors"; } 2>&1) || fail "$(cat "$work/errors")"
    grep -q "\"weights_sha256\": *\"$expected\"" "$work/$kernels/summary.json" || fail "$kernels: the weights are not $expected"
    printf '%-6s weights %s, %s s of user time under qemu\n' "$kernels" "$expected" "$seconds"
done
grep -q '"cpu_path": *"neon"' "$work/neon/summary.json" || fail 'NEON is not chosen'
cmp "$work/neon/metrics.jsonl" "$work/scalar/metrics.jsonl"
echo "$tests tests of the kernels"
