#!/usr/bin/env bash
# Validates, without a network, what only GitHub, cargo-deny and citation tools read: workflows, CITATION.cff, deny.toml, pyproject.toml.
# Usage: tests/workflows.sh BIN, the directory of the programs that tests/requirements-workflows.txt installs
set -euo pipefail
bin=$(realpath "${1:?usage: tests/workflows.sh BIN}")
cd "$(dirname "$0")/.."
fail() { printf 'FAILED: %s\n' "$*" >&2; exit 1; }

"$bin/check-jsonschema" --builtin-schema vendor.github-workflows .github/workflows/*.yml
"$bin/zizmor" --offline --quiet --persona pedantic .github/workflows
"$bin/check-jsonschema" --builtin-schema vendor.citation-file-format CITATION.cff
"$bin/validate-pyproject" pyproject.toml
"$bin/cargo-deny" --offline --log-level error check licenses bans sources

# The workflows call scripts that are there, with commands that they have.
grep -ohE 'run: (\.ci|scripts|tests)/[a-z._/]+( [a-z-]+)?' .github/workflows/*.yml | sed 's/^run: //' | sort -u |
    while read -r script command; do
        [ -x "$script" ] || fail "$script is called by a workflow and cannot be run"
        [ -z "$command" ] || grep -qE "^    $command/[0-9]" "$script" || fail "$script has no command $command"
    done
# Only Cargo.toml names the repository's address.
if address=$(sed -n 's/^repository = "https:\/\/\(.*\)"$/\1/p' Cargo.toml) && [ -n "$address" ]; then
    others=$(git grep -lF "$address" -- ':!Cargo.toml' || true)
    [ -z "$others" ] || fail "the address of the repository also stands in $others"
fi
echo 'workflows, citation, licences: all right'
