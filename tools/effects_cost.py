#!/usr/bin/env python3
"""Seconds and bytes that each effect adds to a bake: baked with and without it.

    cargo build --release -p bake-brdf
    python3 tools/effects_cost.py                              # prints the table
    python3 tools/effects_cost.py --document docs/EFFECTS.md   # and writes it into the page

Medians of --repeats bakes of data/recipes/golden.json, which has matter for every effect but coherent sheets (they may
not absorb). Seconds are processor seconds of the whole command with `--threads 1`, which other work on the machine
changes little; bytes are those of the file.
"""

import argparse
import pathlib
import statistics
import subprocess
import sys
import tempfile

from measured import processor_seconds, write_table

ROOT = pathlib.Path(__file__).resolve().parents[1]
LOBE = "surface,blur,azimuth"
PAPER = {"recipe": None}
# The lobe differs between wavelengths through its absorption; one band is enough for 5 %.
BANDS = {"--solver": "doubling", "--accuracy": "1"}
# (what is added, effects with it, effects without it, terms with it, terms of both)
ROWS = [
    ("body (the file alone)", "body", None, {}, {}),
    ("surface", "surface,body", "body", {}, {}),
    ("blur, azimuth:decay", f"{LOBE},body", "surface,body", {}, {}),
    ("azimuth:space", f"{LOBE},body", f"{LOBE},body", {"--azimuth": "space"}, {}),
    ("polarisation", f"{LOBE},polarisation,body", f"{LOBE},body", {}, {}),
    ("absorption", f"{LOBE},absorption,body", f"{LOBE},body", {}, {}),
    ("choosing the bands of dispersion", f"{LOBE},dispersion,body", f"{LOBE},body", {}, {}),
    ("dispersion, with absorption, doubling to 1 %", f"{LOBE},absorption,dispersion,body", f"{LOBE},absorption,body", {}, BANDS),
    ("coherent_sheets, the paper's pearl", f"{LOBE},coherent_sheets,body", f"{LOBE},body", {}, PAPER),
    ("coherent", f"{LOBE},coherent,body", f"{LOBE},body", {}, {}),
    ("emission", f"{LOBE},emission,body", f"{LOBE},body", {}, {}),
    ("irregularity of coherent", f"{LOBE},coherent,irregularity,body", f"{LOBE},coherent,body", {}, {}),
    ("irregularity of emission", f"{LOBE},emission,irregularity,body", f"{LOBE},emission,body", {}, {}),
]


def baked(o, folder, effects, other):
    """(processor seconds, bytes) of a bake; `other` takes the place of terms."""
    table = folder / "t.exr"
    terms = {"--accuracy": o.accuracy, "--solver": "walk", "--incident-deg": o.incident_deg, **other}
    recipe = terms.pop("recipe", o.recipe)
    flags = [word for term in terms.items() for word in term]
    command = [o.bin, *([recipe] if recipe else []), "--effects", effects, *flags, "--threads", "1", "-o", table, "-q"]
    seconds = []
    for _ in range(o.repeats):
        before = processor_seconds()
        done = subprocess.run([*map(str, command)], capture_output=True, text=True)
        if done.returncode != 0:
            sys.exit(f"effects_cost: {' '.join(map(str, command))}: {done.stderr.strip()}")
        seconds.append(processor_seconds() - before)
    return statistics.median(seconds), table.stat().st_size


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bin", default=ROOT / "target" / "release" / "bake-brdf")
    parser.add_argument("--recipe", default=ROOT / "data" / "recipes" / "golden.json")
    parser.add_argument("--accuracy", default="5")
    parser.add_argument("--incident-deg", default="0:90:10")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--document", type=pathlib.Path, help="page to write the table into")
    o = parser.parse_args()
    lines = ["| effect | seconds added | bytes added | the bake with it: seconds | bytes |", "|---|---|---|---|---|"]
    known = {}
    with tempfile.TemporaryDirectory() as folder:

        def once(effects, terms):
            key = (effects, *terms.items())
            if key not in known:
                known[key] = baked(o, pathlib.Path(folder), effects, terms)
            return known[key]

        for name, effects, without, terms, both in ROWS:
            seconds, size = once(effects, {**both, **terms})
            less = once(without, both) if without else (0.0, 0)
            lines.append(f"| {name} | {seconds - less[0]:+.3f} | {size - less[1]:+d} | {seconds:.3f} | {size} |")
            print(lines[-1], file=sys.stderr, flush=True)
    print("\n".join(lines))
    if o.document:
        write_table(o.document, "effects_cost", "\n".join(lines))


if __name__ == "__main__":
    main()
