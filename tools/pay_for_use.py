#!/usr/bin/env python3
"""What a crossing costs in instructions, and that an effect which is off costs none.

    cargo build --release -p transport --example pay_for_use
    python3 tools/pay_for_use.py                              # prints the table; needs valgrind
    python3 tools/pay_for_use.py --document docs/EFFECTS.md   # and writes it into the page
    python3 tools/pay_for_use.py --json

Callgrind counts the instructions of a short walk and of a longer one; their difference over the difference in crossings has
no set-up in it. The walk of the library in the plane, all effects off, is compared with a kernel that is written for this case alone
(crates/transport/examples/pay_for_use); it gives the same exits, bit by bit. Exit code 3 if the walk takes over 1 % more than
that kernel or the exits differ. Callgrind knows no AVX-512, so that both are compiled for AVX2.
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
    2: ["off", "absorption", "visible", "explicit", "polarisation", "polarisation+absorption", "f64", "sheets", "sheets+absorption"],
    3: ["off", "absorption", "visible", "explicit", "f64", "sheets", "sheets+absorption"],
}
NAMES = {
    "off": "**all effects off**",
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


def table(rows, lean):
    lines = ["| walk | instructions a crossing | against all off |", "|---|---|---|"]
    for (geometry, effect), walk in rows.items():
        against = "" if effect == "off" else f"{100 * (walk / rows[geometry, 'off'] - 1):+.2f} %"
        lines.append(f"| {geometry}, {NAMES.get(effect, effect)} | {walk:.3f} | {against} |")
    against = 100 * (lean / rows["plane", "off"] - 1)
    lines.append(f"| the kernel written for the plane and no effect | {lean:.3f} | {against:+.2f} % |")
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--example", type=pathlib.Path, default=DEFAULT)
    parser.add_argument("--paths", type=int, default=2_000, help="of the short walk; the long one has three times as many")
    parser.add_argument("--only-lean", action="store_true", help="count only what a kernel is written for")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--document", type=pathlib.Path, help="page to write the table into")
    o = parser.parse_args()
    if not shutil.which("valgrind"):
        sys.exit("pay_for_use: valgrind is not installed (apt-get install valgrind)")
    if not o.example.is_file():
        sys.exit(f"pay_for_use: {o.example} is missing: cargo build --release -p transport --example pay_for_use")
    same = subprocess.run([o.example, "--compare"], capture_output=True, text=True)
    paths = (o.paths, 3 * o.paths)
    lean = per_crossing(o.example, paths, "--kernel", "lean")
    rows = {}
    for dim, effects in EFFECTS.items():
        for effect in effects:
            if o.only_lean and (dim, effect) != (2, "off"):
                continue
            terms = ["--dim", dim, *([] if effect == "off" else ["--effect", effect])]
            rows["plane" if dim == 2 else "space", effect] = per_crossing(o.example, paths, *terms)
    apart = rows["plane", "off"] / lean - 1
    if o.json:
        instructions = {", ".join(name): walk for name, walk in rows.items()}
        report = {"schema": "pay-for-use/3", "same_bits": same.returncode == 0, "apart": apart, "lean": lean, "instructions": instructions}
        print(json.dumps(report))
    else:
        print(table(rows, lean))
    if o.document:
        write_table(o.document, "pay_for_use", table(rows, lean))
    if same.returncode != 0:
        sys.exit(f"pay_for_use: the kernel gives other exits: {same.stdout.strip()}") if same.returncode != 3 else None
        print(f"pay_for_use: {same.stdout.strip()}", file=sys.stderr)
        return 3
    return 3 if apart > LIMIT else 0


if __name__ == "__main__":
    sys.exit(main())
