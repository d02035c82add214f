#!/usr/bin/env python3
"""Predicted and measured seconds: what `bake-brdf plan --scene` says of the scenes in data/scenes, and what the bakes take.

    cargo build --release -p bake-brdf
    python3 tools/plan_honesty.py                             # prints the table, under a minute on two idle cores
    python3 tools/plan_honesty.py --document docs/EFFECTS.md  # and writes it into the page
    python3 tools/plan_honesty.py --recipes tools/plan_recipes.json   # recipes of a list, each with its own arguments

Predicted are the seconds of `bake-brdf plan --scene`; measured those of the command `bake-brdf --scene` by the clock, its start included, as
the median of --repeats. A list of recipes is JSON: objects of a `name`, a `recipe` and `args`, which go before --accuracy and --incident-deg.
Exit code 3 if a scene that bakes something is off by more than a factor of 1.5. Other work on the machine makes
it fail: `--cpu` compares processor seconds instead (with `--threads 1`), which other work changes less.
"""
import argparse
import json
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

from measured import processor_seconds, write_table

ROOT = pathlib.Path(__file__).resolve().parents[1]
FACTOR = 1.5


def timed(command, clock):
    """(what the command prints, seconds)."""
    started = clock()
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    seconds = clock() - started
    if done.returncode != 0:
        sys.exit(f"plan_honesty: {' '.join(map(str, command))}: {done.stderr.strip()}")
    return json.loads(done.stdout), seconds


def scenes(terms):
    """(name, terms of the plan, terms of a bake into a folder) of every scene in data/scenes."""
    for name in json.loads((ROOT / "data" / "scenes" / "plans.json").read_text()):
        asked = ["--scene", ROOT / "data" / "scenes" / f"{name}.xml", *terms]
        yield name, asked, lambda folder, asked=asked: [*asked, "-o", folder]


def recipes(listed, terms, scratch):
    """The same of every recipe in a list."""
    for number, entry in enumerate(json.loads(listed.read_text())):
        path = pathlib.Path(scratch) / f"{number}.json"
        path.write_text(json.dumps({"schema": "pearl-recipe/1", **entry["recipe"]}))
        own = set(entry["args"][::2])
        rest = [term for pair in zip(terms[::2], terms[1::2]) if pair[0] not in own for term in pair]
        asked = [path, *entry["args"], *rest]
        yield entry["name"], asked, lambda folder, asked=asked: [*asked, "-o", pathlib.Path(folder) / "pearl.exr"]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bin", default=ROOT / "target" / "release" / "bake-brdf")
    parser.add_argument("--accuracy", default="3")
    parser.add_argument("--incident-deg", default="0:90:3")
    parser.add_argument("--threads", default=None, help="default: all")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--cpu", action="store_true", help="measure processor seconds; means --threads 1")
    parser.add_argument("--recipes", type=pathlib.Path, help="a list of recipes in place of the scenes")
    parser.add_argument("--document", type=pathlib.Path, help="page to write the table into")
    o = parser.parse_args()
    threads = "1" if o.cpu else o.threads
    terms = ["--accuracy", o.accuracy, "--incident-deg", o.incident_deg]
    terms += ["--threads", threads] if threads else []
    clock = processor_seconds if o.cpu else time.monotonic
    what = "recipe" if o.recipes else "scene"
    lines, honest = [f"| {what} | solver | predicted, s | measured, s | predicted/measured |", "|---|---|---|---|---|"], True
    scratch = tempfile.TemporaryDirectory()
    for name, asked, into in recipes(o.recipes, terms, scratch.name) if o.recipes else scenes(terms):
        plan, _ = timed([o.bin, "plan", *asked, "--json", "-q"], clock)
        measured = []
        for _ in range(o.repeats):
            with tempfile.TemporaryDirectory() as folder:
                measured.append(timed([o.bin, *into(folder), "--json", "-q"], clock)[1])
        predicted, seconds = plan["seconds"], statistics.median(measured)
        solvers = ", ".join(table["solver"] for table in plan["tables"]) or "–"
        ratio = f"{predicted / seconds:.2f}" if plan["tables"] else "nothing to bake"
        honest &= not plan["tables"] or 1 / FACTOR <= predicted / seconds <= FACTOR
        lines.append(f"| {name} | {solvers} | {predicted:.3f} | {seconds:.3f} | {ratio} |")
        print(lines[-1], file=sys.stderr, flush=True)
    print("\n".join(lines))
    if o.document:
        write_table(o.document, "plan_honesty", "\n".join(lines))
    return 0 if honest else 3


if __name__ == "__main__":
    sys.exit(main())
