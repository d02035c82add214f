"""What two builds of the tools take for the same work, side by side.

    python tools/speeds.py OLD NEW                  folders with the binaries of two builds
    python tools/speeds.py OLD NEW --only preview   one case

Each case runs with the old build and the new one in turn. What is compared is processor time, which other work on the machine
disturbs least; with `--wall` it is time by the clock, for an idle machine. Medians of the rounds, as a Markdown table. Always by the
clock are the studio's first picture and the BSDF, which wants `cargo build --release -p pearl-bsdf --example rate` in both builds.
"""

import argparse
import http.client
import json
import resource
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.parse
from collections.abc import Callable
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
    "arrays of golden": ["lut", "export", "GOLDEN", "--to", "arrays", "-o", "OUT.npz"],
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
FIRST_PICTURE = "studio, recipe to arrays of the first picture"
# By name: the table, and what `rate` prints of it.
RATES = {
    f"{what}, {how} at a call, {where}": (table, f"{what}_{key}ns")
    for where, table in {"plane": "TABLE", "space": "SPACE"}.items()
    for how, key in {"a pair": "one_", "many": ""}.items()
    for what in ("eval", "pdf", "sample")
}
# Few enough pairs that a round is seldom interrupted.
PAIRS = 1500


def seconds(command: list[str], wall: bool) -> float:
    """Of one run: of all its threads, or by the clock."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)}: {done.stderr.strip()}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.monotonic() - start if wall else spent


def first_picture(build: Path, round_: int) -> float:
    """Seconds by the clock that `pearl studio` says it took from a recipe to prepared arrays, coarse; warm."""
    server = subprocess.Popen([build / "pearl", "studio", "paper", "--no-browser"], stdout=subprocess.PIPE, text=True)
    try:
        url = urllib.parse.urlsplit(server.stdout.readline().strip() if server.stdout else "")
        token = url.fragment.removeprefix("token=")

        def baked(thickness_nm: float) -> float:
            recipe = {"stack": {"aragonite": {"thickness_nm": thickness_nm}}, "look": {"depth": 0.5, "coherence": 0.5}}
            connection = http.client.HTTPConnection(url.hostname or "", url.port)
            body = json.dumps({"recipe": recipe, "quality": "coarse"})
            connection.request("POST", "/api/bake", body, {"X-Nacre-Token": token})
            answer = connection.getresponse()
            said = answer.read()
            if answer.status != 200:
                sys.exit(f"{build}/pearl studio: {said.decode(errors='replace')}")
            return float(answer.headers["x-nacre-seconds"])

        baked(400.0)
        return statistics.median(baked(401.0 + 10 * round_ + k) for k in range(5))
    finally:
        server.terminate()
        server.wait()


def rate(build: Path, table: Path, key: str) -> float:
    """Nanoseconds a pair."""
    tool = build / "examples" / "rate"
    if not tool.is_file():
        sys.exit(f"{tool}: is not there; `cargo build --release -p pearl-bsdf --example rate` makes it")
    done = subprocess.run([tool, table, str(PAIRS)], check=True, capture_output=True, text=True)
    return json.loads(done.stdout)[key]


def compare(name: str, unit: str, builds: list[Path], rounds: int, measure: Callable[[Path, int], float]) -> None:
    """Prints a row."""
    took: dict[Path, list[float]] = {build: [] for build in builds}
    for round_ in range(rounds):
        for build, runs in took.items():
            runs.append(measure(build, round_))
    old, new = (statistics.median(runs) for runs in took.values())
    digits = 2 if unit == "s" else 0
    print(f"| {name} | {old:.{digits}f} {unit} | {new:.{digits}f} {unit} | {new / old:.2f} |", flush=True)


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path, help="folder with the binaries of one build")
    parser.add_argument("new", type=Path, help="folder with those of the other")
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--rounds", type=int, default=3, help="runs of each (default: %(default)s)")
    parser.add_argument("--wall", action="store_true", help="time by the clock in place of processor time")
    args = parser.parse_args()
    names = [name for name in (*CASES, FIRST_PICTURE, *RATES) if args.only in name]
    if not names:
        sys.exit(f"--only {args.only}: no such case; they are {', '.join((*CASES, FIRST_PICTURE, *RATES))}")
    builds = [args.old.resolve(), args.new.resolve()]
    with tempfile.TemporaryDirectory() as folder:
        files = {"OUT": "out", "OUT.exr": "out.exr", "OUT.npz": "out.npz"}
        files |= {"TABLE": "table.exr", "SPACE": "space.exr", "GOLDEN": "golden.exr"}
        places = {part: Path(folder) / name for part, name in files.items()}
        for name, recipe in RECIPES.items():
            places[name] = Path(folder) / f"{name.lower()}.json"
            places[name].write_text(recipe)
        tables = {"TABLE": PLANE, "SPACE": SPACE, "GOLDEN": ["bake-brdf", "golden", "--solver", "doubling"]}
        wanted = {part for name in names for part in (*CASES.get(name, ()), RATES.get(name, ("",))[0])} & tables.keys()
        for part in sorted(wanted):
            tool, *rest = tables[part]
            seconds([str(builds[0] / tool), *rest, "--accuracy", "1", "-q", "-o", str(places[part])], args.wall)
        print("| case | before | after | after / before |\n|---|---|---|---|")
        for name in names:
            if name in CASES:
                tool, *rest = (str(places.get(part, part)) for part in CASES[name])
                run = lambda build, _, tool=tool, rest=rest: seconds([str(build / tool), *rest, "-q"], args.wall)
                compare(name, "s", builds, args.rounds, run)
            elif name == FIRST_PICTURE:
                compare(name, "ms", builds, args.rounds, lambda build, round_: 1e3 * first_picture(build, round_))
            else:
                part, key = RATES[name]
                run = lambda build, _, table=places[part], key=key: rate(build, table, key)
                compare(name, "ns", builds, 3 * args.rounds, run)


if __name__ == "__main__":
    main()
