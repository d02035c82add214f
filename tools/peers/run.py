#!/usr/bin/env python3
"""The walk side by side with its peers, in one run: ns of CPU a crossing, and whether all give the same albedo.

    cargo build --release -p transport --example walk_rate
    pip install drjit numba numpy          # Dr.Jit needs libLLVM: 17 or newer for all processors
    python3 tools/peers/run.py [--repeats 3] [--extra "python3 other.py --preset tuned" ...]

Peers whose packages are missing are left out with a note. Rounds go through all peers in turn and the median of the
rounds is printed, so that a busy machine disturbs all alike. An `--extra` command is given the same options
(`--paths --theta --dim --threads`) and must print the same JSON. Exit code 3 if an albedo is off by more than five
standard errors of the difference.
"""

import argparse
import json
import math
import pathlib
import shlex
import statistics
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent
RATE = HERE.parent.parent / "target/release/examples/walk_rate"


def commands(extra):
    """(name, command, share of the paths): slow peers walk fewer paths."""
    yield "nacre", [str(RATE)], 1
    yield "nacre, avx2", [str(RATE), "--level", "avx2"], 1
    for command in extra:
        yield command, shlex.split(command), 1
    yield "drjit", [sys.executable, str(HERE / "drjit_walk.py")], 1
    yield "numba", [sys.executable, str(HERE / "numba_walk.py")], 0.1
    yield "scalar f64 (reference)", [str(RATE), "--walk", "reference"], 0.1
    yield "numpy", [sys.executable, str(HERE / "numpy_walk.py")], 0.1


def run(command, options):
    done = subprocess.run(command + options, capture_output=True, text=True)
    if done.returncode != 0:
        return None, (done.stderr.strip().splitlines() or ["failed"])[-1]
    return json.loads(done.stdout.splitlines()[-1]), None


def compare(o, theta, dim):
    rows = {}
    for round_ in range(o.repeats):
        for name, command, share in commands(o.extra):
            options = {"--paths": int(o.paths * share), "--theta": theta, "--dim": dim, "--threads": o.threads, "--seed": round_ + 1}
            result, problem = run(command, [str(part) for pair in options.items() for part in pair])
            if problem:
                print(f"left out: {name}: {problem}", file=sys.stderr) if round_ == 0 else None
                continue
            rows.setdefault(name, []).append(result)
    ours = rows["nacre"]
    pooled = lambda results: statistics.fmean(r["albedo"] for r in results)
    base, base_time = pooled(ours), statistics.median(r["ns_per_crossing_cpu"] for r in ours)
    agree = True
    print(f"\n{'space' if dim == 3 else 'plane'} walk, {theta} degrees, {o.threads} thread(s)")
    print(f"{'':40} ns/crossing  against nacre   albedo  z")
    for name, results in rows.items():
        time = statistics.median(r["ns_per_crossing_cpu"] for r in results)
        albedo = pooled(results)
        paths = [sum(r["paths"] for r in rs) for rs in (results, ours)]
        error = math.sqrt(sum(base * (1 - base) / n for n in paths))
        z = 0.0 if name.startswith("nacre") else (albedo - base) / error
        agree &= abs(z) < 5
        print(f"{name[:40]:40} {time:11.2f} {time / base_time:14.2f} {albedo:8.4f} {z:+.1f}")
    return agree


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--paths", type=float, default=200_000)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--theta", type=float, nargs="+", default=[30, 85])
    parser.add_argument("--dim", type=int, nargs="+", default=[2, 3])
    parser.add_argument("--extra", action="append", default=[], help="a further command to compare with")
    o = parser.parse_args()
    if not RATE.exists():
        sys.exit(f"{RATE} is missing: cargo build --release -p transport --example walk_rate")
    agree = [compare(o, theta, dim) for dim in o.dim for theta in o.theta]
    sys.exit(0 if all(agree) else 3)


main()
