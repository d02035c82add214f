"""What `--accuracy` promises against what a reader gets between rows and between cells.

Tables are read by the NumPy evaluator of docs/ARRAYS.md. The truth is a doubling ten times as accurate, with rows at the
incidences that are read, which are no rows of the table. Every figure is printed. Run by `cargo xtask long`.
"""

import itertools
import json

import numpy as np
import pytest
from built import run

INCIDENCES = 60
WALK_INCIDENCES = 30
# Exit directions of an incidence: over θo (signed in decay tables) and φ.
EXITS = {"decay": (301, 24), "space": (181, 144)}
PERCENT = {"decay": [5, 1, 0.1, 0.01], "space": [5, 1, 0.1]}
# Cells of the truth in space where as many as its accuracy takes would be more than a table holds.
TRUTH_CELLS, TRUTH_CELLS_BELOW = "630x860", 0.05
# What is walked, per cent, and with which seeds: 130 tables.
WALKED = {"decay": [5, 2], "space": [5]}
SEEDS = [1, 2, 3, 4, 5]
RECIPES = {
    "paper": {},
    "one-layer": {"stack": {"layers": 1}},
    "two-layers-near-match": {
        "stack": {"layers": 2, "ambient": {"n": 1.33}, "aragonite": {"n": 1.53}, "conchiolin": {"n": 1.505}, "substrate": {"n": 1.53}},
    },
    "absorbing": {"stack": {"layers": 60, "aragonite": {"k": 2e-4}, "conchiolin": {"k": 5e-3}}},
    "narrow": {"stack": {"layers": 40}, "facets": {"slope_sd_deg": 0.3}},
    "broad": {"stack": {"layers": 50}, "facets": {"slope_sd_deg": 14}},
    "deep": {"stack": {"layers": 1999, "aragonite": {"n": 1.6}, "conchiolin": {"n": 1.45}}},
    "matched-ambient": {"stack": {"layers": 30, "ambient": {"n": 1.4078}}, "facets": {"slope_sd_deg": 4}},
    "visible": {"stack": {"layers": 12}, "facets": {"slope_sd_deg": 5, "normals": "visible"}},
}


def table(folder, name, recipe, *how):
    """Arrays and `lut info` of a table without colours, which do not matter here."""
    text, path, arrays = folder / f"{name}.json", folder / f"{name}.exr", folder / f"{name}.npz"
    text.write_text(json.dumps(recipe))
    run("bake-brdf", text, "--effects", "surface,blur,azimuth,absorption", *how, "-q", "-o", path)
    run("lut", "export", path, "--to", "arrays", "-o", arrays, "-q")
    return {k: v.astype(float) for k, v in np.load(arrays).items()}, json.loads(run("lut", "info", path, "--json"))


def exits(theta_i, azimuth, width):
    """θo, φ and the solid angle of each of a grid that is dense around the mirror direction."""
    thetas, phis = EXITS[azimuth]

    def dense(count, lo, hi, centre, scale):
        below, above = np.arcsinh((lo - centre) / scale), np.arcsinh((hi - centre) / scale)
        edges = centre + scale * np.sinh(np.linspace(below, above, count + 1))
        return 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)

    theta, d_theta = dense(thetas, 0.0, np.pi / 2, theta_i, width)
    phi, d_phi = dense(phis, 0.0, np.pi, 0.0, max(width / max(np.tan(theta_i), 1e-3), 1e-4))
    theta, phi = np.meshgrid(theta, phi, indexing="ij")
    return theta.ravel(), phi.ravel(), 2 * (np.sin(theta) * np.outer(d_theta, d_phi)).ravel()


def apart(evaluator, table, truth, info, azimuth, theta_i):
    """Total variation of all light, of the interior and of the re-hits, in per cent by the rule of docs/LUT-FORMAT.md §4."""
    theta, phi, solid = exits(theta_i, azimuth, max(float(table["cell_width"]), 0.01))
    wi = np.repeat([[np.sin(theta_i)], [0.0], [np.cos(theta_i)]], len(theta), axis=1)
    wo = np.stack([-np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    got, want = (evaluator["lobes"](arrays, 0, wi, wo) for arrays in (table, truth))
    degrees = np.degrees(theta_i)
    row = min(info["per_incidence"], key=lambda row: abs(row["theta_i_deg"] - degrees))
    light = row["albedo"]
    own = [light - row["surface"], row["rehit"]]
    difference = got - want
    found = [0.5 * np.abs(difference.sum(0)) @ solid / light]
    found += [0.5 * np.abs(difference[k]) @ solid / np.sqrt(light * max(own[k], 1e-4 * light)) for k in (0, 1)]
    return 100 * np.array(found)


def incidences(count):
    """Angles that are no nodes of a table, a third of them beyond 70°, a few of those next to the horizon, degrees."""
    random = np.random.default_rng(7)
    incident = np.degrees(np.arccos(random.uniform(0.0, 1.0, count)))
    incident[: count // 3] = 90 - random.uniform(0.0, 1.0, count // 3) ** 2 * 20
    incident[:3] = [89.55, 89.88, 89.95]
    return np.round(np.sort(incident), 4)


def truth(folder, recipe, azimuth, percent, incident):
    how = ["--solver", "doubling", "--azimuth", azimuth, "--accuracy", percent]
    if azimuth == "space" and percent < TRUTH_CELLS_BELOW:
        how += ["--cells", TRUTH_CELLS]
    return table(folder, "truth", recipe, *how, "--incident-deg", ",".join(map(str, incident)))


def found(evaluator, folder, name, azimuth, percent, against, incident, *how):
    """The worst of all light, of the interior and of the re-hits over the incidences, per cent, and what the table states."""
    read, said = table(folder, f"a{percent}", RECIPES[name], "--azimuth", azimuth, "--accuracy", percent, *how)
    exact, info = against
    missed = np.array([apart(evaluator, read, exact, info, azimuth, np.radians(angle)) for angle in incident])
    worst, stated = missed.max(0), said["accuracy"]["reached_percent"]
    print(
        f"{name} {azimuth} {percent} %: all {worst[0]:.4f} at {incident[missed[:, 0].argmax()]}°, interior {worst[1]:.4f}, "
        f"re-hits {worst[2]:.4f}; said {stated:.4f}, {len(said['per_incidence'])} rows, {said['exit_axis']}"
    )
    return worst.max(), stated


@pytest.mark.parametrize("azimuth", ["decay", "space"])
@pytest.mark.parametrize("name", RECIPES)
def test_doubling_keeps_its_promise_wherever_it_is_read(name, azimuth, evaluator, tmp_path):
    if name == "narrow" and azimuth == "space":
        pytest.skip("lobes of 0.3° in space are beyond the solver's memory, as it says")
    percents, incident = PERCENT[azimuth], incidences(INCIDENCES)
    against = truth(tmp_path, RECIPES[name], azimuth, percents[-1] / 10, incident)
    for percent in percents:
        worst, stated = found(evaluator, tmp_path, name, azimuth, percent, against, incident, "--solver", "doubling")
        assert worst <= percent
        assert stated <= percent


def test_the_walk_breaks_its_promise_at_most_once_in_a_hundred_tables(evaluator, tmp_path):
    broken, tables = [], 0
    for name, azimuth in itertools.product(RECIPES, WALKED):
        if name == "narrow" and azimuth == "space":
            continue
        incident = incidences(WALK_INCIDENCES)
        folder = tmp_path / f"{name}-{azimuth}"
        folder.mkdir()
        against = truth(folder, RECIPES[name], azimuth, WALKED[azimuth][-1] / 10, incident)
        for percent, seed in itertools.product(WALKED[azimuth], SEEDS):
            how = ["--solver", "walk", "--seed", seed]
            # What is stated may be more, where it is estimated from the rows alone.
            worst, _ = found(evaluator, folder, name, azimuth, percent, against, incident, *how)
            tables += 1
            if worst > percent:
                broken.append((name, azimuth, percent, seed, worst))
    print(f"{tables} tables, {len(broken)} broken promises: {broken}")
    assert len(broken) <= tables / 100
