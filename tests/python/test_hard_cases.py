"""The hard cases of the Mitsuba plugin (`tests/data/hard_plugin.json`), in single precision against the Rust evaluator.

Those of the Rust side are run by crates/cli/tests/hard_cases.rs. NACRE_WRITE_DOCS=1 writes the plugin's part of docs/HARD-CASES.md anew.
"""

import json
import os

import numpy as np
import pytest

mi = pytest.importorskip("mitsuba")
import llvm  # noqa: E402  (it needs drjit)
import test_plugin  # noqa: E402  (it needs mitsuba)

DOCS = test_plugin.ROOT / "docs" / "HARD-CASES.md"
CASES = json.loads((test_plugin.ROOT / "tests" / "data" / "hard_plugin.json").read_text())["cases"]
HEADING = "## The Mitsuba plugin"
VARIANTS = ["scalar_rgb", "llvm_ad_rgb"]


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    path = tmp_path_factory.mktemp("hard") / "decay.exr"
    test_plugin.run("bake-brdf", "--solver", "doubling", "--accuracy", 0.5, "-q", "-o", path)
    return path


def naive(table, wi, wo):
    """What the Rust evaluator says of directions that went through acos and back in 32 bits."""

    def through_angles(v):
        theta, phi = np.arccos(v[:, 2]), np.arctan2(v[:, 1], v[:, 0])
        return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)

    return test_plugin.rust(table, through_angles(wi), through_angles(wo))


def worst(found, expected):
    """Largest relative difference where the value is above 1e-3 of its peak."""
    above = expected > 1e-3 * expected.max()
    assert above.sum() > 0.01 * expected.size
    return np.abs(found[above] / expected[above] - 1.0).max()


def pairs(table, bsdf, case):
    """Answer, what naive code gives, ours, error."""
    # Fewer where each pair goes through Python by itself.
    wi, wo = test_plugin.random_pairs(20_000 if mi.variant().startswith("llvm") else 1_000)
    which = 1 if case["measure"]["kind"] == "density" else "rgb"
    pick = (lambda answer: answer[1]) if which == 1 else (lambda answer: answer[0]["rgb"])
    expected = pick(test_plugin.rust(table, wi, wo))
    value, density = test_plugin.plugin(bsdf, wi, wo)
    error = worst(density if which == 1 else value, expected)
    return 0.0, worst(pick(naive(table, wi, wo)), expected), error, error


def pair(table, bsdf, case):
    measure = case["measure"]
    wi, wo = (np.array([measure[name]], dtype=float).astype(np.float32) for name in ("wi", "wo"))
    value, density = test_plugin.plugin(bsdf, wi, wo)
    found = np.append(value[0], density)
    if measure.get("dark"):
        # Written so that a NaN is the error that it is.
        largest = np.abs(found).max()
        return 0.0, acos_of_the_cosine(wi, wo), largest, largest
    like = [np.array([measure.get(f"like_{name}", measure[name])], dtype=float) for name in ("wi", "wo")]
    values, densities, _ = test_plugin.rust(table, *like)
    expected = np.append(values["rgb"][0], densities)
    return expected[0], acos_of_the_cosine(wi, wo), found[0], np.abs(found / expected - 1.0).max()


def acos_of_the_cosine(wi, wo):
    """cos φ as naive code has it, in 32 bits: (wi·wo − cos cos)/(sin sin) of angles by acos."""
    with np.errstate(all="ignore"):
        sin = np.sin(np.arccos(wi[0, 2])) * np.sin(np.arccos(wo[0, 2]))
        return float(((wi[0] * wo[0]).sum() - wi[0, 2] * wo[0, 2]) / sin)


MEASURES = {"pairs": pairs, "density": pairs, "pair": pair}
NAIVE = {
    "pairs": "θ by acos of a cosine in 32 bits",
    "density": "θ by acos of a cosine in 32 bits",
    "pair": "cos φ = (wi·wo − cos cos)/(sin sin) of angles by acos",
}


def number(x):
    return f"{x:.6f}" if x == 0 or 1e-3 <= abs(x) < 1e6 else f"{x:.2e}"


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_hard_case_of_the_plugin_has_its_answer(variant, table):
    llvm.use(variant)
    bsdf = test_plugin.load(table)
    rows, failed = [], []
    for case in CASES:
        kind = case["measure"]["kind"]
        answer, naive_gives, ours, error = MEASURES[kind](table, bsdf, case)
        # Written so that a NaN fails.
        passes = error <= case["tolerance"]
        print(
            f"{'ok    ' if passes else 'FAILED'} {case['id']} ({variant}): {answer} ({case['answer']}); naive {naive_gives}; "
            f"ours {ours}; error {error:.1e} of {case['tolerance']}"
        )
        if not passes:
            failed.append(case["id"])
        cells = [case["id"], case["why"], number(answer), case["answer"], NAIVE[kind], number(naive_gives), number(ours), f"{error:.1e}"]
        rows.append(f"| {' | '.join(cells)} |")
    assert not failed
    if os.environ.get("NACRE_WRITE_DOCS") and variant == "llvm_ad_rgb":
        write(rows)


def write(rows):
    before = DOCS.read_text().split(HEADING)[0].rstrip()
    about = (
        "Written by `NACRE_WRITE_DOCS=1 .venv/bin/python -m pytest tests/python/test_hard_cases.py` from\n"
        "`tests/data/hard_plugin.json`: the variant `llvm_ad_rgb`, in single precision, on the paper's\n"
        "pearl in decay mode; values and densities are compared."
    )
    head = "| case | why it is hard | answer | from | naive code | gives | ours | error |\n|---|---|---|---|---|---|---|---|"
    DOCS.write_text("\n".join([before, "", HEADING, "", about, "", head, *rows, ""]))


def test_the_documentation_has_every_case_of_the_plugin():
    text = DOCS.read_text()
    assert not [case["id"] for case in CASES if f"| {case['id']} |" not in text]
