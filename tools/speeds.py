"""What two builds of the tools take for the same work, side by side.

    python tools/speeds.py OLD NEW                  folders with the binaries of two builds
    python tools/speeds.py OLD NEW --only preview   one case

Each case runs with the old build and the new one in turn. What is compared is processor time, which other work on the machine
disturbs least; with `--wall` it is time by the clock, for an idle machine. Medians of the rounds, as a Markdown table.
"""

import argparse
import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

DEGREES = "0:90:1"
SPACE = ["bake-brdf", "paper", "--solver", "doubling", "--azimuth", "space"]
PLANE = ["bake-brdf", "paper", "--solver", "doubling", "--azimuth", "decay"]
LOBE = ["--effects", "surface,blur,azimuth"]
FILMS = ["--members", "64", "--angles-deg", "0:89:1", "--wavelengths-nm", "380:780:401"]
# By name: the command; `TABLE` is a table of the paper's pearl, `OUT` a file or folder to write, other capitals are recipes.
CASES = {
    "preview, all pictures": ["pearl", "preview", "TABLE", "-o", "OUT"],
    "space, 91 incidences, 0.1 %": [*SPACE, *LOBE, "--accuracy", "0.1", "--incident-deg", DEGREES, "-o", "OUT.exr"],
    "space, 1 %": [*SPACE, "--accuracy", "1", "-o", "OUT.exr"],
    "plane, 0.01 %": [*PLANE, "--accuracy", "0.01", "-o", "OUT.exr"],
    "akoya": ["bake-brdf", "akoya", "--solver", "doubling", "-o", "OUT.exr"],
    "golden": ["bake-brdf", "golden", "--solver", "doubling", "-o", "OUT.exr"],
    "plan of 10,000 layers": ["bake-brdf", "plan", "DEEP", "--solver", "walk"],
    "64 irregular stacks, clear": ["thinfilm", "spectrum", "CLEAR", *FILMS],
    "64 irregular stacks, absorbing": ["thinfilm", "spectrum", "ABSORBING", *FILMS],
}


def irregular(k: float) -> str:
    """Recipe of the paper's stack with thicknesses that differ by 3 %, each layer with an extinction coefficient."""
    layers = {"aragonite": {"k": k, "thickness_sd_nm": 13.5}, "conchiolin": {"k": k, "thickness_sd_nm": 0.75}}
    return json.dumps({"stack": layers})


RECIPES = {
    "DEEP": '{"stack": {"layers": 10000}, "facets": {"slope_sd_deg": 0.2}}',
    "CLEAR": irregular(0.0),
    "ABSORBING": irregular(1e-3),
}


def seconds(command: list[str], wall: bool) -> float:
    """Of one run: of all its threads, or by the clock."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)}: {done.stderr.strip()}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.monotonic() - start if wall else spent


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path, help="folder with the binaries of one build")
    parser.add_argument("new", type=Path, help="folder with those of the other")
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--rounds", type=int, default=3, help="runs of each (default: %(default)s)")
    parser.add_argument("--wall", action="store_true", help="time by the clock in place of processor time")
    args = parser.parse_args()
    cases = {name: command for name, command in CASES.items() if args.only in name}
    if not cases:
        sys.exit(f"--only {args.only}: no such case; they are {', '.join(CASES)}")
    print("| case | before, s | after, s | after / before |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        table, out = Path(folder) / "table.exr", Path(folder) / "out"
        places = {"TABLE": table, "OUT": out, "OUT.exr": out.with_suffix(".exr")}
        for name, recipe in RECIPES.items():
            places[name] = Path(folder) / f"{name.lower()}.json"
            places[name].write_text(recipe)
        bake = [args.old / "bake-brdf", "paper", "--solver", "doubling", "--accuracy", "1", "-o", table]
        seconds([str(part) for part in bake], args.wall)
        for name, (tool, *rest) in cases.items():
            took: dict[Path, list[float]] = {args.old: [], args.new: []}
            for _ in range(args.rounds):
                for build, runs in took.items():
                    command = [str(build / tool), *(str(places.get(part, part)) for part in rest), "-q"]
                    runs.append(seconds(command, args.wall))
            old, new = (statistics.median(runs) for runs in took.values())
            print(f"| {name} | {old:.2f} | {new:.2f} | {new / old:.2f} |", flush=True)


if __name__ == "__main__":
    main()
