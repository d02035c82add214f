"""200 random recipes by both solvers against an independent walk: part of `cargo xtask long`.

NACRE_REQUESTS sets another number, NACRE_SEED the first seed (else another one every time; it is printed).
"""

import collections
import concurrent.futures
import os
import random

import numpy as np
import transport_truth as truth
from scipy import stats

REQUESTS = int(os.environ.get("NACRE_REQUESTS", "200"))
SEED = int(os.environ.get("NACRE_SEED", random.SystemRandom().randrange(1 << 40)))
# Of all that is compared, taken together, and of each distribution.
SIGNIFICANCE = 1e-3


def test_both_solvers_walk_random_recipes_as_an_independent_program_does(tmp_path):
    print(f"seeds from {SEED}")
    with concurrent.futures.ProcessPoolExecutor() as pool:
        outcomes = list(pool.map(truth.judge, [tmp_path] * REQUESTS, range(SEED, SEED + REQUESTS)))
    refused = [line for verdict, line, _ in outcomes if verdict == "refused"]
    print(f"{len(refused)} refused, {REQUESTS - len(refused)} judged")
    found = collections.defaultdict(list)
    for at, (verdict, rows, _) in enumerate(outcomes):
        for solver, what, z, p in rows if verdict == "judged" else []:
            found[solver, what].append((p, z, SEED + at))
    trials = sum(map(len, found.values()))
    wrong = []
    for (solver, what), rows in sorted(found.items()):
        p = np.array([row[0] for row in rows])
        uniform = stats.kstest(p, "uniform").pvalue
        least, z, seed = min(rows)
        print(
            f"{solver:>8} {what:>16}: {len(rows):4}, least p {least:.1e}"
            + (f" (z {z:+.1f})" if z else "")
            + f" at seed {seed}, uniform p {uniform:.3f}"
        )
        if least * trials < SIGNIFICANCE:
            wrong.append(f"{solver} {what} at seed {seed}: p {least:.1e}")
        # What a doubling may be off by is counted as if it were noise, so that its p are large.
        if solver == "walk" and uniform * len(found) < SIGNIFICANCE:
            wrong.append(f"{solver} {what}: p are not uniform ({uniform:.1e})")
    assert not wrong, "\n".join(wrong)
