#!/usr/bin/env bash
# The files of a release, in the directory DIST (default: dist). The workflow release.yml calls nothing else.
#
#   scripts/release.sh page                     builds the page of `web`, which the program of a release has in it
#   scripts/release.sh archive TARGET [BINARY]  builds the program for a target of rustc (or takes BINARY) and packs it with the
#                                               completions of four shells, man pages and all licences; beside it its SHA-256
#   scripts/release.sh wheel TARGET             builds the wheel with maturin, which it installs in a venv of its own. On Linux the wheel
#                                               runs on every system since manylinux2014 (glibc 2.17): zig links it
#   scripts/release.sh check-archive TARGET     unpacks the archive and trains with its program
#   scripts/release.sh check-wheel FILE         installs a wheel in a new venv, trains, and tests the Python module
#   scripts/release.sh draft TAG                makes a draft of the release with all files of DIST, by GitHub's gh
#   scripts/release.sh notes                    prints the part of CHANGELOG.md about this version
#   scripts/release.sh check-version TAG        requires the tag vVERSION of Cargo.toml's version, and notes in CHANGELOG.md
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD
dist=${DIST:-dist}
version=$(sed -n 's/^version = "\(.*\)"$/\1/p' Cargo.toml | head -1)
# Windows has no python3.
python=$(command -v python3 || command -v python)

fail() { printf 'FAILED: %s\n' "$*" >&2; exit 1; }
usage() { sed -n '2,/^set /s/^# \{0,1\}//p' "$0" >&2; exit 2; }
tmp=$(mktemp -d)
licenses=
trap 'rm -rf "$tmp" ${licenses:+"$licenses"}' EXIT

# The page is the same on every system, so it can be built on another.
page=${CARTPOLE_DQN_WEB_PAGE:-$root/target/web/page/index.html}
require_page() {
    [ -f "$page" ] || fail "there is no $page: run scripts/release.sh page, or set CARTPOLE_DQN_WEB_PAGE to a page that it has built"
    export CARTPOLE_DQN_WEB_PAGE=$page
}

# programs_of VENV: the directory of its programs.
programs_of() { if [ -d "$1/bin" ]; then echo "$1/bin"; else echo "$1/Scripts"; fi; }

# The extensions of programs and of archives for a target.
program_extension() { case $1 in *windows*) echo .exe ;; esac; }
archive_extension() { case $1 in *windows*) echo zip ;; *) echo tar.gz ;; esac; }

build_archive() {
    local target=$1 binary=${2:-} name=cartpole-dqn-$version-$1 shell web=
    if [ -z "$binary" ]; then
        require_page
        web=1
        rustup target add "$target"
        cargo build --release --locked --features web --target "$target" --config profile.release.strip=true
        binary=${CARGO_TARGET_DIR:-target}/$target/release/cartpole-dqn$(program_extension "$target")
    fi
    [ -f "$binary" ] || fail "there is no program $binary"
    rm -rf "${dist:?}/$name"
    mkdir -p "$dist/$name/completions"
    cp "$binary" "$dist/$name/cartpole-dqn$(program_extension "$target")"
    cp README.md CHANGELOG.md LICENSE "$dist/$name"
    "$python" scripts/release/third_party_licenses.py "$target" >"$dist/$name/THIRD_PARTY_LICENSES.txt"
    # The names under which the shells look for them.
    for shell in bash:cartpole-dqn.bash zsh:_cartpole-dqn fish:cartpole-dqn.fish powershell:_cartpole-dqn.ps1; do
        "$binary" completions "${shell%%:*}" >"$dist/$name/completions/${shell#*:}"
        [ -s "$dist/$name/completions/${shell#*:}" ] || fail "no completions for ${shell%%:*}"
    done
    # For the computer that packs, with the commands of the program that is packed.
    cargo run --quiet --locked ${web:+--features web} --example man_pages -- "$dist/$name/man/man1"
    "$python" scripts/release/archive.py "$dist/$name" "$(archive_extension "$target")"
    rm -rf "${dist:?}/$name"
}

build_wheel() {
    local target=$1 bin
    require_page
    rustup target add "$target"
    "$python" -m venv "$tmp/maturin"
    bin=$(programs_of "$tmp/maturin")
    "$bin/python" -m pip install --quiet --disable-pip-version-check 'maturin[zig]==1.16.0'
    case $target in
        *linux*) set -- --zig --compatibility manylinux2014 ;;
        *) set -- ;;
    esac
    # maturin packs everything in the directory of the module.
    licenses=python/cartpole_dqn/THIRD_PARTY_LICENSES.txt
    "$python" scripts/release/third_party_licenses.py "$target" >"$licenses"
    # zig is a module of the Python that is found first.
    PATH=$bin:$PATH maturin build --release --locked --features web --target "$target" --out "$dist" "$@"
}

# trains BINARY: the recorded weights, from another directory.
trains() {
    (cd "$tmp" && "$1" train --config "$root/configs/smoke.json" --out run --quiet)
    grep -q "\"$(cat tests/data/smoke_weights.sha256)\"" "$tmp/run/summary.json" || fail "$1 trains to other weights"
}

check_archive() {
    local name=cartpole-dqn-$version-$1 archive binary files
    archive=$name.$(archive_extension "$1")
    (cd "$dist" && "$python" -c 'import hashlib, sys
digest, name = open(sys.argv[1] + ".sha256").read().split()
sys.exit(name != sys.argv[1] or hashlib.sha256(open(name, "rb").read()).hexdigest() != digest)' "$archive") ||
        fail "$dist/$archive and its SHA-256 differ"
    "$python" -c 'import shutil, sys; shutil.unpack_archive(*sys.argv[1:])' "$dist/$archive" "$tmp"
    files=$(cd "$tmp/$name" && find . -type f | sort | tr '\n' ' ')
    for file in CHANGELOG.md LICENSE README.md THIRD_PARTY_LICENSES.txt \
        completions/{cartpole-dqn.bash,_cartpole-dqn,cartpole-dqn.fish,_cartpole-dqn.ps1}; do
        [ -s "$tmp/$name/$file" ] || fail "$archive has no $file, but $files"
    done
    binary=$tmp/$name/cartpole-dqn$(program_extension "$1")
    chmod +x "$binary"
    for file in $("$binary" __words -- '' | cut -f1 | grep -vx help); do
        [ -s "$tmp/$name/man/man1/cartpole-dqn-$file.1" ] || fail "$archive has no man page of $file, but $files"
    done
    [ "$("$binary" --version)" = "cartpole-dqn $version" ] || fail "$binary is not of version $version"
    trains "$binary"
    echo "$archive: $files"
}

check_wheel() {
    local wheel bin
    wheel=$("$python" -c 'import os, sys; sys.stdout.write(os.path.abspath(sys.argv[1]))' "$1")
    "$python" -m venv "$tmp/venv"
    bin=$(programs_of "$tmp/venv")
    "$bin/python" -m pip install --quiet --disable-pip-version-check "$wheel"
    "$bin/python" -m pip install --quiet --disable-pip-version-check -r tests/interop/requirements-module.txt
    trains "$bin/cartpole-dqn"
    (cd "$tmp" && "$bin/python" "$root/tests/interop/python_module.py" --installed --binary "$bin/cartpole-dqn")
    (cd "$tmp" && "$bin/python" -c 'import cartpole_dqn, pathlib
assert pathlib.Path(cartpole_dqn.__file__).with_name("THIRD_PARTY_LICENSES.txt").stat().st_size > 10_000') || fail "$1 has no licences of third parties"
    (cd "$tmp" && "$bin/cartpole-dqn" web --out site && [ -s site/index.html ]) || fail "$1 has no page of web"
}

check_version() {
    [ "$1" = "v$version" ] || fail "the tag is $1, and Cargo.toml has version $version"
    grep -q "^## \[$version\]" CHANGELOG.md || fail "CHANGELOG.md has no heading [$version]"
    grep -q '^repository = "https://' Cargo.toml || fail 'Cargo.toml has no repository, the address that archives and wheels name'
}

notes() {
    awk -v heading="## [$version]" 'index($0, "## [") == 1 { inside = index($0, heading) == 1; next } inside' CHANGELOG.md
}

case ${1:-}/$# in
    page/1) web/build.sh "$(dirname "$page")" ;;
    archive/2 | archive/3) build_archive "$2" "${3:-}" ;;
    wheel/2) build_wheel "$2" ;;
    check-archive/2) check_archive "$2" ;;
    check-wheel/2) check_wheel "$2" ;;
    notes/1) notes ;;
    draft/2)
        check_version "$2"
        notes >"$tmp/notes"
        gh release create "$2" --draft --verify-tag --title "$2" --notes-file "$tmp/notes" "$dist"/*
        ;;
    check-version/2) check_version "$2" ;;
    *) usage ;;
esac
