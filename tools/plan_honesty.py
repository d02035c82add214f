#!/usr/bin/env python3
"""Predicted and measured seconds: what `bake-brdf plan` says of the tables that the scenes in data/scenes call for, and what the bakes take.

    cargo build --release -p bake-brdf && pip install "./crates/python[mitsuba]"
    python3 tools/plan_honesty.py                             # prints the table, under a minute on two idle cores
    python3 tools/plan_honesty.py --document docs/EFFECTS.md  # and writes it into the page
    python3 tools/plan_honesty.py --recipes tools/plan_recipes.json   # recipes of a list, each with its own arguments

Predicted are the seconds of `bake-brdf plan`; measured those of the command `bake-brdf` by the clock, its start included, as the median of
--repeats. A list of recipes is JSON: objects of a `name`, a `recipe` and `args`, which go before --accuracy and --incident-deg.
Exit code 3 if one is off by more than a factor of 1.5. Other work on the machine makes
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

import nacre

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


def scenes():
    """The tables of every scene in data/scenes, as a list of recipes."""
    for name in json.loads((ROOT / "data" / "scenes" / "plans.json").read_text()):
        plan = nacre.plan(ROOT / "data" / "scenes" / f"{name}.xml")
        for number, table in enumerate(plan["tables"]):
            pearl = next(pearl for pearl in plan["pearls"] if pearl["table"] == number)
            effects = ",".join(effect for effect in table["effects"] if effect != "texture")
            one = name if len(plan["tables"]) == 1 else f"{name}, {pearl['id']}"
            yield {"name": one, "recipe": pearl["recipe"], "args": ["--solver", "auto", "--effects", effects]}


def bakes(entries, terms, scratch):
    """Name and arguments of each of a list of recipes."""
    for number, entry in enumerate(entries):
        path = pathlib.Path(scratch) / f"{number}.json"
        path.write_text(json.dumps({"schema": "pearl-recipe/1", **entry["recipe"]}))
        own = set(entry["args"][::2])
        rest = [term for pair in zip(terms[::2], terms[1::2]) if pair[0] not in own for term in pair]
        yield entry["name"], [path, *entry["args"], *rest]


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
    entries = json.loads(o.recipes.read_text()) if o.recipes else scenes()
    for name, asked in bakes(entries, terms, scratch.name):
        plan, _ = timed([o.bin, "plan", *asked, "--json", "-q"], clock)
        output = ["-o", pathlib.Path(scratch.name) / "pearl.exr"]
        measured = [timed([o.bin, *asked, *output, "--json", "-q"], clock)[1] for _ in range(o.repeats)]
        predicted, seconds = plan["seconds"], statistics.median(measured)
        [table] = plan["tables"]
        honest &= 1 / FACTOR <= predicted / seconds <= FACTOR
        lines.append(f"| {name} | {table['solver']} | {predicted:.3f} | {seconds:.3f} | {predicted / seconds:.2f} |")
        print(lines[-1], file=sys.stderr, flush=True)
    print("\n".join(lines))
    if o.document:
        write_table(o.document, "plan_honesty", "\n".join(lines))
    return 0 if honest else 3


if __name__ == "__main__":
    sys.exit(main())
