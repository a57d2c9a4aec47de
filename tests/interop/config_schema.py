#!/usr/bin/env python3
"""Checks the JSON Schema of configs against the program: both must accept the same files.

    python config_schema.py --binary target/release/cartpole-dqn

The files are the shipped configs, and for every key of the schema values within, at and beyond what it allows.
"""

import argparse
import copy
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from jsonschema import Draft202012Validator

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
# Only the program checks the rules that concern several keys. These values keep the rules.
ROOM = {"replay": {"warmup_steps": 0, "batch_size": 1}, "exploration": {"initial": 1.0, "final": 0.0}}


def boundaries(schema):
    """Values at and just beyond what a leaf's schema allows, of its type and of others."""
    yield from (None, True, "no such name", -1, 0, 0.5, 2**64, [], [1, 2], {}, {"x": 1})
    yield schema.get("default")
    yield from schema.get("enum", [])
    for limit in ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"):
        if limit in schema:
            value = schema[limit]
            yield from (value, value + 1, value - 1)
            if schema["type"] == "number":
                yield from (value * (1 + 1e-12), value * (1 - 1e-12))
    if schema.get("type") == "array":
        largest = schema.get("maxItems", 4)
        for item in boundaries(schema["items"]):
            # A long list of long numbers would be too large a file.
            sizes = (0, 1, largest, largest + 1) if largest <= 16 or item == 0.5 else (0, 1)
            yield from ([item] * size for size in sizes)
    for alternative in schema.get("anyOf", []):
        if alternative.get("type") != "object":
            yield from boundaries(alternative)


def leaves(schema, path=()):
    for name, member in schema.get("properties", {}).items():
        if "properties" in member:
            yield from leaves(member, (*path, name))
        else:
            yield (*path, name), member
        for shape in member.get("anyOf", []):
            yield from leaves(shape, (*path, name))


def with_value(config, path, value):
    config = copy.deepcopy(config)
    group = config
    for name in path[:-1]:
        if not isinstance(group.get(name), dict):
            group[name] = {}
        group = group[name]
    group[path[-1]] = value
    return config


def variants(schema):
    yield {}
    shapes = {"exploration": ["linear", "per_episode"], "target": ["hard", "soft", "none"]}
    for path, leaf in leaves(schema):
        for value in boundaries(leaf):
            yield with_value({}, path, value)
            yield with_value(ROOM, path, value)
            if path[0] == "table":
                yield with_value({"agent": "q_table"}, path, value)
            for name in shapes.get(path[0], []):
                key = "schedule" if path[0] == "exploration" else "kind"
                yield with_value({path[0]: {key: name}}, path, value)
        yield with_value({}, (*path[:-1], path[-1] + "x"), 1)
    yield {"replay.capacity": 5000}
    yield {"target": {"every_steps": 5, "every_episodes": 5}}


def program_accepts(binary, config, directory):
    file = Path(directory) / "config.json"
    file.write_text(json.dumps(config))
    result = subprocess.run([binary, "config", "show", "--config", file], capture_output=True, text=True)
    if result.returncode not in (0, 2):
        sys.exit(f"FAILED: {config}: exit code {result.returncode}, {result.stderr}")
    return result.returncode == 0, result.stderr


def binds_several_keys(message):
    """Whether the program refused what the schema cannot know."""
    return any(
        words in message
        for words in (
            "GiB of memory", "at most `replay.capacity`", "at most `exploration.initial`", "or nothing is learned", '"target" only if',
            "observation coordinates", "belongs to the agent", "that ascend", "below `table.high`", "fewer cells",
        )
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", required=True, help="the cartpole-dqn to compare with")
    binary = parser.parse_args().binary
    schema = json.loads(subprocess.run([binary, "config", "schema"], capture_output=True, check=True).stdout)
    Draft202012Validator.check_schema(schema)
    validator = Draft202012Validator(schema)

    for file in [*CONFIGS.glob("*.json"), *CONFIGS.glob("studies/*.json")]:
        errors = [error.message for error in validator.iter_errors(json.loads(file.read_text()))]
        if errors:
            sys.exit(f"FAILED: {file}: {errors}")

    verdicts = {True: 0, False: 0}
    seen = set()
    with tempfile.TemporaryDirectory() as directory:
        for config in variants(schema):
            text = json.dumps(config, sort_keys=True)
            if text in seen:
                continue
            seen.add(text)
            valid = validator.is_valid(config)
            accepted, message = program_accepts(binary, config, directory)
            if valid != accepted and not (valid and binds_several_keys(message)):
                sys.exit(f"FAILED: {text}: the schema says {valid}, the program {accepted} {message}")
            verdicts[valid] += 1
    print(f"schema and program agree on {verdicts[True]} valid and {verdicts[False]} invalid configs")
    if min(verdicts.values()) < 100:
        sys.exit("FAILED: too few of either")


if __name__ == "__main__":
    main()
