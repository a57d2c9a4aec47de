#!/usr/bin/env bash
# Builds the page: `web/build.sh DIR` writes DIR/index.html, one file that a browser shows from anywhere, without a network.
# With MODULES=PLACE it also writes the WebAssembly modules, for tests, and one for engines without vectors.
set -euo pipefail
[ $# -eq 1 ] || { echo "usage: web/build.sh DIR" >&2; exit 2; }
out=$(realpath -m "$1")
modules=$(realpath -m "${MODULES:-$out}")
CARGO_TARGET_DIR=$(realpath -m "${CARGO_TARGET_DIR:-$(dirname "$0")/../target/web}")
export CARGO_TARGET_DIR
cd "$(dirname "$0")"
parts=$(mktemp -d)
trap 'rm -rf "$parts"' EXIT
target=wasm32-unknown-unknown

# A standard library for WebAssembly: from rustup, or else built from Debian's sources by Debian's compiler.
cargo=(cargo)
if command -v rustup >/dev/null; then
    rustup target add "$target"
elif [ ! -d "$(rustc --print sysroot)/lib/rustlib/$target" ]; then
    if [ ! -d "$(rustc --print sysroot)/lib/rustlib/src/rust/library" ]; then
        echo "rustc has no standard library for $target: install rustup, or Debian's rustc-web, cargo-web, rust-web-src" \
            "and rust-web-llvm" >&2
        exit 1
    fi
    export RUSTC_BOOTSTRAP=1
    cargo+=(-Zbuild-std=std,panic_abort)
fi

# build NAME FLAGS [OPTION…]: the module for browsers with these features.
build() {
    RUSTFLAGS="-Dwarnings $2" "${cargo[@]}" build --release --target "$target" "${@:3}"
    cp "$CARGO_TARGET_DIR/$target/release/cartpole_dqn_web.wasm" "$parts/$1.wasm"
}
build relaxed-simd '-Ctarget-feature=+simd128,+relaxed-simd'
# Few browsers need it. It is built small, and is a fifth slower for that, so that the page has less than 1 MB.
build simd128 '-Ctarget-feature=+simd128' --config 'profile.release.package.cartpole-dqn.opt-level="s"'
if [ -n "${MODULES:-}" ]; then
    build scalar ''
    mkdir -p "$modules"
    cp "$parts"/*.wasm "$modules"
fi

# Writes a file as text: four bytes are five digits of base 85, which is 6 % shorter than base64. `unpacked` in page.js has the same
# digits: every printable character but those that mean something in HTML.
as_text() {
    od -An -v -w4 --endian=big -tu4 "$1" | awk '
        BEGIN { for (code = 33; n < 85; code++) { c = sprintf("%c", code); if (!index("\"&\047<>\\`", c)) digits[n++] = c } }
        { number = $1; text = ""
          for (i = 0; i < 5; i++) { text = digits[number % 85] text; number = int(number / 85) }
          printf "%s", text }'
}

# The modules, the fastest first. A browser that can unpack them has vectors.
for name in relaxed-simd simd128; do
    gzip -9nc "$parts/$name.wasm" >"$parts/$name.gz"
    printf '<script type="application/gzip" data-module="%s" data-size="%s">' "$name" "$(wc -c <"$parts/$name.gz")"
    as_text "$parts/$name.gz"
    printf '</script>\n'
done >"$parts/modules"
for name in cartpole fast plain tutorial q_table $(cd ../configs && printf '%s\n' ladder/*.json | sed 's/[.]json$//'); do
    printf '<script type="application/json" data-preset="%s">\n' "$name"
    cat "../configs/$name.json"
    printf '</script>\n'
done >"$parts/presets"
cat page/{module,worker}.js >"$parts/worker"
cat page/{module,draw,story,settings,page}.js >"$parts/script"

# insert NAME FILE: the file in the place of {{NAME}}.
insert() { printf '/{{%s}}/{\nr %s\nd\n}\n' "$1" "$2"; }
{
    insert style page/style.css
    insert modules "$parts/modules"
    insert presets "$parts/presets"
    insert worker "$parts/worker"
    insert script "$parts/script"
} >"$parts/insert.sed"
sed -f "$parts/insert.sed" page/page.html >"$parts/index.html"
mkdir -p "$out"
cp "$parts/index.html" "$out/index.html"
wc -c "$parts"/*.wasm "$out/index.html"
