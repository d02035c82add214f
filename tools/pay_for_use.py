#!/usr/bin/env python3
"""What a crossing costs in instructions, and that an effect which is off costs none.

    cargo build --release -p transport --example pay_for_use
    python3 tools/pay_for_use.py                              # prints the table; needs valgrind
    python3 tools/pay_for_use.py --document docs/EFFECTS.md   # and writes it into the page
    python3 tools/pay_for_use.py --json

Callgrind counts the instructions of a short walk and of a longer one; their difference over the difference in crossings has
no set-up in it. The walk of the library with every effect off is compared with kernels written without effects
(crates/transport/examples/pay_for_use), which give the same exits, bit by bit. Exit code 3 if it takes over 1 % more than they do
or the exits differ. Callgrind knows no AVX-512, so that both are compiled for AVX2.
"""
import argparse
import json
import pathlib
import re
import shutil
import subprocess
import sys

from measured import write_table

ROOT = pathlib.Path(__file__).resolve().parents[1]
DEFAULT = ROOT / "target" / "release" / "examples" / "pay_for_use"
LIMIT = 0.01
EFFECTS = {
    2: ["absorption", "visible", "explicit", "polarisation", "polarisation+absorption", "f64", "sheets", "sheets+absorption"],
    3: ["absorption", "visible", "explicit", "f64", "sheets", "sheets+absorption"],
}
NAMES = {
    "visible": "visible normals",
    "explicit": "layers one by one",
    "f64": "64 bits",
    "sheets": "coherent sheets (64 bits)",
    "polarisation+absorption": "polarisation and absorption",
    "sheets+absorption": "coherent sheets and absorption (64 bits)",
}


def counted(example, *args):
    """(instructions, crossings) of a run."""
    command = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", str(example), *map(str, args)]
    done = subprocess.run(command, capture_output=True, text=True)
    found = re.search(r"Collected\s*:\s*(\d+)", done.stderr)
    if done.returncode != 0 or not found:
        sys.exit(f"pay_for_use: {' '.join(command)}: {(done.stderr.strip().splitlines() or ['failed'])[-1]}")
    return int(found[1]), json.loads(done.stdout)["crossings"]


def per_crossing(example, paths, *args):
    (few, crossed), (many, more) = (counted(example, *args, "--paths", n) for n in paths)
    return (many - few) / (more - crossed)


def table(measured):
    lines = [
        "| walk | instructions a crossing | against all off |",
        "|---|---|---|",
    ]
    for dim, rows in measured.items():
        geometry = "plane" if dim == 2 else "space"
        off = rows["off"]
        for name, value in rows.items():
            label = {"off": "**all effects off**", "lean": "kernel written without effects"}.get(name, NAMES.get(name, name))
            against = "" if name == "off" else f"{100 * (value / off - 1):+.2f} %"
            lines.append(f"| {geometry}, {label} | {value:.3f} | {against} |")
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--example", type=pathlib.Path, default=DEFAULT)
    parser.add_argument("--paths", type=int, default=2_000, help="of the short walk; the long one has three times as many")
    parser.add_argument("--only-off", action="store_true", help="leave out the kernels with an effect")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--document", type=pathlib.Path, help="page to write the table into")
    o = parser.parse_args()
    if not shutil.which("valgrind"):
        sys.exit("pay_for_use: valgrind is not installed (apt-get install valgrind)")
    if not o.example.is_file():
        sys.exit(f"pay_for_use: {o.example} is missing: cargo build --release -p transport --example pay_for_use")
    same = subprocess.run([o.example, "--compare"], capture_output=True, text=True)
    paths = (o.paths, 3 * o.paths)
    measured = {}
    for dim, effects in EFFECTS.items():
        measured[dim] = {
            "off": per_crossing(o.example, paths, "--dim", dim),
            "lean": per_crossing(o.example, paths, "--dim", dim, "--kernel", "lean"),
        }
        for effect in [] if o.only_off else effects:
            measured[dim][effect] = per_crossing(o.example, paths, "--dim", dim, "--effect", effect)
    apart = {dim: rows["off"] / rows["lean"] - 1 for dim, rows in measured.items()}
    if o.json:
        print(json.dumps({"schema": "pay-for-use/1", "same_bits": same.returncode == 0, "apart": apart, "instructions": measured}))
    else:
        print(table(measured))
    if o.document:
        write_table(o.document, "pay_for_use", table(measured))
    if same.returncode != 0:
        sys.exit(f"pay_for_use: the two kernels give other exits: {same.stdout.strip()}") if same.returncode != 3 else None
        print(f"pay_for_use: {same.stdout.strip()}", file=sys.stderr)
        return 3
    return 3 if any(a > LIMIT for a in apart.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
