"""2,000 random requests to `thinfilm spectrum` against 40 digits and against very many waves: part of `cargo xtask long`.

NACRE_REQUESTS sets another number, NACRE_SEED the first seed (else another one every time; it is printed).
"""

import collections
import concurrent.futures
import os
import random

import thinfilm_truth as truth

REQUESTS = int(os.environ.get("NACRE_REQUESTS", "2000"))
SEED = int(os.environ.get("NACRE_SEED", random.SystemRandom().randrange(1 << 40)))


def outcome(folder, seed):
    try:
        return truth.judge(folder, seed)
    except AssertionError as failure:
        return "missed", str(failure), 0.0, 0.0


def test_random_requests_are_answered_as_promised_or_refused(tmp_path):
    print(f"seeds from {SEED}")
    with concurrent.futures.ProcessPoolExecutor() as pool:
        seeds = range(SEED, SEED + REQUESTS)
        outcomes = list(pool.map(outcome, [tmp_path] * REQUESTS, seeds, chunksize=8))
    found = collections.defaultdict(list)
    for kind, verdict, error, ratio in outcomes:
        found[kind, verdict if kind != "missed" else ""].append((error, ratio))
    for (kind, verdict), errors in sorted(found.items()):
        worst = [max(column) for column in zip(*errors)]
        print(f"{kind:>10} {verdict:>8}: {len(errors):5}, off by {worst[0]:.1e} at most, {worst[1]:.2f} of what is promised")
    missed = [text for kind, text, *_ in outcomes if kind == "missed"]
    assert not missed, f"{len(missed)} of {REQUESTS}:\n" + "\n".join(missed[:20])
