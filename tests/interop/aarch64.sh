#!/usr/bin/env bash
# Trains configs/smoke.json as an aarch64 program under qemu and requires the hash of x86-64. For Debian on x86-64, as
# root; installs Debian's own compiler, cross linker and emulator. The aarch64 standard library, which must be of that
# compiler's version, comes from the package for arm64.
set -euo pipefail
cd "$(dirname "$0")/../.."
target=aarch64-unknown-linux-gnu
work=${WORK:-$(mktemp -d)}

dpkg --add-architecture arm64
apt-get update --quiet=2
apt-get install --yes --quiet=2 --no-install-recommends \
    rustc-web qemu-user gcc-aarch64-linux-gnu libc6-dev-arm64-cross

# A compiler looks for the standard library in its sysroot. The host's own programs keep theirs.
version=$(dpkg-query --show --showformat='${Version}' rustc-web)
mkdir -p "$work/packages" "$work/sysroot/lib/rustlib"
(
    cd "$work/packages"
    apt-get download "libstd-rust-web-dev:arm64=$version"
    dpkg -x libstd-rust-web-dev_*_arm64.deb "$work/arm64"
)
ln -sfn "$work/arm64/usr/lib/rustlib/$target" "$work/sysroot/lib/rustlib/$target"

RUSTC=/usr/bin/rustc RUSTFLAGS="--sysroot=$work/sysroot" CARGO_TARGET_DIR="$work/target" \
    CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc \
    cargo build --release --locked --target "$target"

qemu-aarch64 -L /usr/aarch64-linux-gnu "$work/target/$target/release/cartpole-dqn" \
    train --config configs/smoke.json --out "$work/run" --force --quiet
expected=$(cat tests/data/smoke_weights.sha256)
if ! grep "\"weights_sha256\": *\"$expected\"" "$work/run/summary.json"; then
    echo "FAILED: on aarch64 the weights are not $expected: $work/run/summary.json" >&2
    exit 1
fi
