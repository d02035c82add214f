#!/usr/bin/env python3
"""The thin film side by side with its peers, in one run: layer evaluations (layer x wavelength x angle x polarisation) per
second for 500 layers, one thread, and whether all give the same R.

    cargo build --release -p thinfilm --example dense_rate
    pip install "numpy<2" scipy tmm==0.2.0 PyMoosh==4.0.1 refnx==0.1.60
    pip install --no-deps tmm-fast==0.3.0   # needs PyTorch: pip install torch, or Debian's python3-torch (docs/THINFILM.md)
    python3 tools/peers/thinfilm.py [--document docs/THINFILM.md]

Peers whose packages are missing are left out, and the table says which package that is. `--document` replaces the table between the marks
`<!-- bench -->` and `<!-- /bench -->` of a page. Exit code 3 if a peer's R is off by more than 1e-8.
"""

import argparse
import json
import os
import pathlib
import platform
import subprocess
import sys
import time

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import numpy as np  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]
RATE = ROOT / "target/release/examples/dense_rate"
N = [1.0] + [1.53, 1.43] * 250 + [1.53]
D = [450.0, 25.0] * 250  # nm
# How often ours are timed.
TURNS = 4
# Waves that a peer is timed with: the grid of 81 x 90, thinned out for the slow ones.
NM = np.linspace(380, 780, 81)
THETA = np.radians(np.arange(90))


def rate(evaluate, evaluations, rounds=3):
    evaluate()
    seconds = []
    for _ in range(rounds):
        start = time.perf_counter()
        evaluate()
        seconds.append(time.perf_counter() - start)
    return evaluations / min(seconds)


def tmm():
    import tmm as package

    inf = float("inf")
    one = lambda pol, nm, theta: package.coh_tmm(pol, N, [inf, *D, inf], theta, nm)["R"]
    waves = [(pol, nm, theta) for pol in "sp" for nm in NM[::40] for theta in THETA[::30]]
    return one, rate(lambda: [one(*wave) for wave in waves], 500 * len(waves))


def pymoosh():
    import PyMoosh

    structure = PyMoosh.Structure([1.0, 1.53**2, 1.43**2, 1.53**2], [0] + [1, 2] * 250 + [3], [0.0, *D, 0.0], verbose=False)
    one = lambda pol, nm, theta: PyMoosh.coefficient_S(structure, nm, theta, "sp".index(pol))[2]
    waves = [(pol, nm, theta) for pol in "sp" for nm in NM[::20] for theta in THETA[::15]]
    return one, rate(lambda: [one(*wave) for wave in waves], 500 * len(waves))


def refnx():
    """s only: what neutrons are to refnx, s light is here. Its scattering length densities stand for k0^2 (1 - n^2)/4 pi."""
    from refnx.reflect.reflect_model import abeles

    def spectrum(nm, theta):
        k0 = 2 * np.pi / (10 * nm)  # per angstrom
        layers = np.zeros((502, 4))
        layers[1:-1, 0] = 10 * np.array(D)
        layers[:, 1] = k0**2 * (1 - np.array(N) ** 2) / (4 * np.pi) * 1e6
        return abeles(2 * k0 * np.cos(theta), layers, threads=1)

    one = lambda pol, nm, theta: spectrum(nm, np.array([theta]))[0] if pol == "s" else None
    return one, rate(lambda: [spectrum(nm, THETA) for nm in NM], 500 * NM.size * THETA.size)


def tmm_fast():
    import torch
    from tmm_fast import coh_tmm

    torch.set_num_threads(1)

    def spectrum(pol, nm, theta):
        indices = np.tile(np.array(N, complex)[None, :, None], (1, 1, nm.size))
        thicknesses = np.array([[np.inf, *D, np.inf]])
        return coh_tmm(pol, indices, thicknesses, theta, nm)["R"][0]

    one = lambda pol, nm, theta: float(spectrum(pol, np.array([nm]), np.array([theta]))[0, 0])
    return one, rate(lambda: [spectrum(pol, NM, THETA) for pol in "sp"], 500 * NM.size * THETA.size * 2)


PEERS = {"tmm": tmm, "tmm_fast": tmm_fast, "PyMoosh (S matrices)": pymoosh, "refnx (C, s only)": refnx}


def ours(threads):
    return json.loads(subprocess.run([RATE, str(threads)], check=True, capture_output=True, text=True).stdout)


def disagreement(one, samples):
    differences = []
    for nm, degrees, *expected in samples:
        for pol, value in zip("sp", expected):
            found = one(pol, nm, np.radians(degrees))
            if found is not None:
                differences.append(abs(found - value))
    return max(differences)


def fastest(reports):
    """One report, with the fastest rounds of all."""
    best = dict(reports[0])
    best["ensemble_seconds"] = min(report["ensemble_seconds"] for report in reports)
    best["rates"] = {name: {"best": max(report["rates"][name]["best"] for report in reports)} for name in best["rates"]}
    return best


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--document", type=pathlib.Path)
    o = parser.parse_args()
    # In turn, so that a machine that others disturb disturbs both.
    runs = {threads: [] for threads in (1, 2)}
    for _ in range(TURNS):
        for threads, reports in runs.items():
            reports.append(ours(threads))
    alone, both = (fastest(reports) for reports in runs.values())
    rows, agree = [], True
    for name, value in alone["rates"].items():
        two = both["rates"][name]["best"] if "thread" not in name else None
        rows.append((f"ours: {name.removesuffix(', one thread')}", value["best"], two, "-"))
    for name, peer in PEERS.items():
        try:
            one, speed = peer()
        except ImportError as problem:
            print(f"left out: {name}: {problem}", file=sys.stderr)
            rows.append((name, None, None, f"not run: {problem}"))
            continue
        difference = disagreement(one, alone["samples"])
        agree &= difference < 1e-8
        rows.append((name, speed, None, f"{difference:.0e}"))
    number = lambda x: "-" if x is None else f"{x:.2e}"
    lines = ["| program | one thread | two threads | off ours by |", "|---|---|---|---|"]
    lines += [f"| {name} | {number(a)} | {number(b)} | {note} |" for name, a, b, note in rows]
    lines += [
        "",
        f"Fastest of {TURNS} times 15 rounds, one thread and two in turn (peers: of 3), {processor()}, {os.cpu_count()} processors."
        " The ensemble of 64 irregular stacks"
        f" (90 angles, 801 wavelengths, s and p, 500 layers) took {both['ensemble_seconds']:.1f} s on two threads,"
        f" {alone['ensemble_seconds']:.1f} s on one.",
    ]
    text = "\n".join(lines)
    print(text)
    if o.document:
        page = o.document.read_text()
        before, rest = page.split("<!-- bench -->\n", 1)
        after = rest.split("<!-- /bench -->", 1)[1]
        o.document.write_text(f"{before}<!-- bench -->\n{text}\n<!-- /bench -->{after}")
    sys.exit(0 if agree else 3)


def processor():
    try:
        info = pathlib.Path("/proc/cpuinfo").read_text()
        fields = dict(line.split(":", 1) for line in info.split("\n\n")[0].splitlines() if ":" in line)
        fields = {key.strip(): value.strip() for key, value in fields.items()}
        return f"{fields['model name']} (family {fields['cpu family']}, model {fields['model']})"
    except (OSError, KeyError):
        return platform.processor() or platform.machine()


if __name__ == "__main__":
    main()
