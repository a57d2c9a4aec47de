#!/usr/bin/env python3
"""Prints the licences of all crates that are linked into the program for a target, with their texts, from Cargo's registry.

    scripts/release/third_party_licenses.py x86_64-unknown-linux-musl > THIRD_PARTY_LICENSES.txt

Equal texts are printed once. A crate without a text in its package makes the script fail, unless its licence is a choice that
has the MIT licence in it, whose standard text then stands for it.
"""

import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TEXT = re.compile(r"(licen[sc]e|copying|unlicense|notice|copyright)([-._].*)?", re.IGNORECASE)


def linked(target):
    """The crates that the program consists of on a target, but for itself: not those that only build it."""
    command = ["cargo", "metadata", "--format-version", "1", "--locked", "--filter-platform", target]
    metadata = json.loads(subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE).stdout)
    packages = {package["id"]: package for package in metadata["packages"]}
    nodes = {node["id"]: node for node in metadata["resolve"]["nodes"]}
    root = metadata["resolve"]["root"]
    found, left = set(), [root]
    while left:
        package = left.pop()
        kinds = [kind for crate in packages[package]["targets"] for kind in crate["kind"]]
        if package in found or "proc-macro" in kinds:
            continue
        found.add(package)
        left += [dep["pkg"] for dep in nodes[package]["deps"] if any(kind["kind"] is None for kind in dep["dep_kinds"])]
    crates = [packages[package] for package in found - {root}]
    return sorted(crates, key=lambda crate: (crate["name"], crate["version"]))


def texts(crate):
    directory = Path(crate["manifest_path"]).parent
    files = sorted(path for path in directory.iterdir() if path.is_file() and TEXT.fullmatch(path.name))
    return [path.read_text(encoding="utf-8", errors="replace").replace("\r\n", "\n").strip() for path in files]


def main():
    if len(sys.argv) != 2:
        sys.exit("usage: third_party_licenses.py TARGET, a target of rustc")
    sys.stdout.reconfigure(encoding="utf-8", newline="\n")
    crates = linked(sys.argv[1])
    print("cartpole-dqn is built from these packages. Their licences follow.\n")
    print("The standard library of Rust (https://github.com/rust-lang/rust): MIT OR Apache-2.0")
    if "musl" in sys.argv[1]:
        print("musl (https://musl.libc.org), the C library: MIT")
    users = {}
    for crate in crates:
        name = f"{crate['name']} {crate['version']}"
        print(f"{name} ({crate['repository'] or 'https://crates.io/crates/' + crate['name']}): {crate['license']}")
        own = texts(crate)
        if not own and "MIT" not in (crate["license"] or ""):
            sys.exit(f"{name} has no text of its licence, {crate['license']}: add it to {__file__}")
        for text in own or [mit(crate)]:
            users.setdefault(text, []).append(name)
    users.setdefault(mit({"authors": ["The Rust Project contributors"]}), []).append("the standard library of Rust")
    if "musl" in sys.argv[1]:
        users.setdefault(mit({"authors": ["Rich Felker, et al."]}), []).append("musl")
    for text, names in users.items():
        print(f"\n{'=' * 100}\n{', '.join(names)}\n{'-' * 100}\n{text}")


def mit(crate):
    """The MIT licence with the crate's authors."""
    holders = ", ".join(re.sub(r" *<.*?>", "", author) for author in crate["authors"]) or f"the authors of {crate['name']}"
    own = (ROOT / "LICENSE").read_text(encoding="utf-8").strip()
    return re.sub(r"Copyright \(c\).*", f"Copyright (c) {holders}", own)


if __name__ == "__main__":
    main()
