#!/usr/bin/env python3
"""The package `nacre` side by side with other Python packages for thin films and with the library it is made of, in one run, one thread.

    cargo build --release -p pearl-bsdf --example rate
    pip install ./crates/python tmm==0.2.0 PyMoosh==4.0.1
    pip install --no-deps tmm-fast==0.3.0    # needs PyTorch: pip install torch, or Debian's python3-torch and "numpy<2"
    python3 tools/peers/package.py

Three tables: seconds for a pearl (500 layers, 81 wavelengths, 90 angles, s and p) and for a batch (1,000 stacks of 20 layers, 201
wavelengths); microseconds of one call on small stacks; nanoseconds a pair of directions. Peers that are slow are timed on a part of the
waves, evenly thinned out, and their time is scaled up. Medians over rounds. Peers whose packages are missing are named and left out.
Exit code 3 if a peer's R is off by more than 1e-11.
"""

import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ[variable] = "1"

import numpy as np  # noqa: E402

import nacre  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]
RATE = ROOT / "target/release/examples/rate"
PAIRS = 200_000
ROUNDS = 5
# Largest difference of R that a peer may have.
AGREEMENT = 1e-11


class Tmm:
    """One wave at a call."""

    def __init__(self):
        import tmm

        self.solve = tmm.coh_tmm

    def spectrum(self, n, d, nm, degrees):
        stacks = range(len(d))
        return np.array(
            [
                [[[self.solve(pol, n[k], [np.inf, *d[k], np.inf], angle, w)["R"] for w in nm] for angle in np.radians(degrees)] for k in stacks]
                for pol in "sp"
            ]
        )


class PyMoosh:
    """One wave at a call."""

    def __init__(self):
        import PyMoosh

        self.package = PyMoosh

    def spectrum(self, n, d, nm, degrees):
        found = np.empty((2, len(d), len(degrees), len(nm)))
        for k in range(len(d)):
            unique, numbers = np.unique(n[k], return_inverse=True)
            structure = self.package.Structure([complex(x) ** 2 for x in unique], list(numbers), [0, *d[k], 0], verbose=False)
            for pol in (0, 1):
                for a, angle in enumerate(np.radians(degrees)):
                    found[pol, k, a] = [self.package.coefficient_S(structure, w, angle, pol)[2] for w in nm]
        return found


class TmmFast:
    """All stacks, angles and wavelengths at a call."""

    def __init__(self):
        import torch
        from tmm_fast import coh_tmm

        torch.set_num_threads(1)
        self.solve = coh_tmm

    def spectrum(self, n, d, nm, degrees):
        indices = np.repeat(np.asarray(n, complex)[:, :, None], len(nm), axis=2)
        thicknesses = np.pad(d, ((0, 0), (1, 1)), constant_values=np.inf)
        return np.array([self.solve(pol, indices, thicknesses, np.radians(degrees), np.asarray(nm))["R"] for pol in "sp"])


PEERS = {"tmm": Tmm, "PyMoosh": PyMoosh, "tmm_fast": TmmFast}


def ours(n, d, nm, degrees):
    found = nacre.thinfilm.spectrum(n, d, nm, degrees)
    return np.array([found.R.s, found.R.p])


def seconds(work, rounds=ROUNDS):
    """Median, and the last result."""
    times, result = [], work()
    for _ in range(rounds):
        start = time.perf_counter()
        result = work()
        times.append(time.perf_counter() - start)
    return statistics.median(times), result


def calls(work, least=0.2):
    """Seconds of one of many calls."""
    count = 1
    while seconds(lambda: [work() for _ in range(count)], 1)[0] < least / ROUNDS:
        count *= 2
    return seconds(lambda: [work() for _ in range(count)])[0] / count


def print_row(*cells):
    print("| " + " | ".join(cells) + " |")


def films(peers):
    random = np.random.default_rng(1)
    pearl = (np.array([[1, *[1.53, 1.43] * 250, 1.53]]), np.array([[450.0, 25.0] * 250]), np.linspace(380, 780, 81), np.arange(90.0))
    batch = (
        np.column_stack([np.ones(1000), random.uniform(1.3, 2.4, (1000, 20)), np.full(1000, 1.5)]),
        random.uniform(20, 400, (1000, 20)),
        np.linspace(400, 700, 201),
        np.array([0.0]),
    )
    agree = True
    print_row("", "pearl, s", "ratio", "batch, s", "ratio", "off ours by")
    print_row(*["---"] * 6)
    own = [seconds(lambda case=case: ours(*case)) for case in (pearl, batch)]
    print_row("nacre", f"{own[0][0]:.4f}", "1", f"{own[1][0]:.4f}", "1", "-")
    for name, peer in peers.items():
        cells, worst = [], 0.0
        for case, (mine, expected) in zip((pearl, batch), own):
            n, d, nm, degrees = case
            thin = (1, 1, 1) if name == "tmm_fast" else (40, 30, 1) if len(d) == 1 else (40, 1, 50)
            waves, angles, stacks = thin
            part = (n[::stacks], d[::stacks], nm[::waves], degrees[::angles])
            taken, found = seconds(lambda part=part: peer.spectrum(*part), 1 if name != "tmm_fast" else 3)
            taken *= (len(nm) / len(part[2])) * (len(degrees) / len(part[3])) * (len(d) / len(part[1]))
            worst = max(worst, np.abs(found - expected[:, ::stacks, ::angles, ::waves]).max())
            cells += [f"{taken:.3g}", f"{taken / mine:,.0f}"]
        agree &= bool(worst < AGREEMENT)
        print_row(name, *cells, f"{worst:.0e}")
    return agree


def small(peers):
    print()
    print_row("one call, µs: stacks × layers × wavelengths × angles", "nacre", *peers)
    print_row(*["---"] * (2 + len(peers)))
    for stacks, layers, waves, angles in [(1, 2, 1, 1), (1, 2, 10, 1), (1, 10, 100, 1), (1, 2, 1, 90), (10, 4, 10, 3), (1, 500, 1, 1)]:
        case = (
            np.tile([1.0, *([1.5, 1.7] * layers)[:layers], 1.5], (stacks, 1)),
            np.full((stacks, layers), 120.0),
            np.linspace(400, 700, waves),
            np.linspace(0, 80, angles),
        )
        times = [calls(lambda: ours(*case)), *(calls(lambda peer=peer: peer.spectrum(*case)) for peer in peers.values())]
        print_row(f"{stacks} × {layers} × {waves} × {angles}", *(f"{1e6 * taken:.1f}" for taken in times))


def pairs():
    table = nacre.bake("paper", solver="doubling", accuracy=1)
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "pearl.exr"
        table.save(path)
        rust = lambda: json.loads(subprocess.run([RATE, path, str(PAIRS)], check=True, capture_output=True, text=True).stdout)
        random = np.random.default_rng(1)
        wi, wo = (v / np.linalg.norm(v, axis=1)[:, None] for v in np.abs(random.normal(size=(2, PAIRS, 3))))
        u, pearl = random.random((PAIRS, 3)), nacre.Pearl(table)
        calls = {"eval": lambda: pearl.eval(wi, wo), "pdf": lambda: pearl.pdf(wi, wo), "sample": lambda: pearl.sample(wi, u)}
        # In turn, so that what disturbs the machine disturbs both.
        turns = [(rust(), {name: seconds(call)[0] for name, call in calls.items()}) for _ in range(ROUNDS)]
    print()
    print_row("many pairs at a call, ns a pair", "Rust", "nacre", "rate of Rust's")
    print_row(*["---"] * 4)
    for name in calls:
        theirs = statistics.median(rates[f"{name}_ns"] for rates, _ in turns)
        mine = statistics.median(1e9 * taken[name] / PAIRS for _, taken in turns)
        print_row(name, f"{theirs:.0f}", f"{mine:.0f}", f"{theirs / mine:.2f}")


def main():
    peers = {}
    for name, peer in PEERS.items():
        try:
            peers[name] = peer()
        except ImportError as problem:
            print(f"left out: {name}: {problem}", file=sys.stderr)
    agree = films(peers)
    small(peers)
    pairs()
    sys.exit(0 if agree else 3)


if __name__ == "__main__":
    main()
