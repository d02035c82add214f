"""Tables of every kind, as `pearl eval` and as the independent reader of `table_reader.py` read them."""

import json
from typing import Any

import numpy as np
import table_reader as reader
from built import ROOT, run

PAIRS = 1500
WAVELENGTHS_NM = [370.0, 451.3, 545.0, 612.4, 790.0]
DOUBLING = ["--solver", "doubling", "--accuracy", "2"]
# Recipe, what is changed of it, how it is baked, how it is made compact.
TABLES: dict[str, tuple[str, dict[str, Any], list[str], Any]] = {
    "decay": ("paper", {}, [*DOUBLING, "--azimuth", "decay"], None),
    "space": ("mother-of-pearl", {}, [*DOUBLING, "--azimuth", "space", "--incident-deg", "5:85:8"], None),
    "visible": ("paper", {"facets": {"slope_sd_deg": 5, "normals": "visible"}}, [*DOUBLING, "--azimuth", "space"], None),
    "visible-decay": ("akoya", {"facets": {"normals": "visible"}}, [*DOUBLING, "--azimuth", "decay"], None),
    "reciprocal-decay": ("paper", {}, [*DOUBLING, "--reciprocal", "--azimuth", "decay"], None),
    "reciprocal-space": ("paper", {}, [*DOUBLING, "--reciprocal", "--azimuth", "space", "--incident-deg", "0:90:9"], None),
    "analytic": ("akoya", {}, [*DOUBLING, "--azimuth", "decay"], ["--form", "analytic"]),
    "analytic-space": ("paper", {}, [*DOUBLING, "--azimuth", "space"], ["--form", "analytic"]),
    "half": ("akoya", {}, [*DOUBLING, "--azimuth", "decay"], ["--form", "table"]),
    "dispersed": ("golden", {}, [*DOUBLING, "--azimuth", "decay"], None),
    "walk": ("paper", {}, ["--solver", "walk", "--paths", "30000", "--azimuth", "decay", "--incident-deg", "0:90:10"], None),
    "no-colours": ("paper", {}, [*DOUBLING, "--effects", "surface,blur,azimuth,absorption", "--azimuth", "decay"], None),
}
LOOKS = {
    "recipe": {},
    "painted": {"depth": 0.7, "brightness": 0.6, "coherence": 0.9, "body_rgb": [0.95, 0.6, 0.2], "tint_rgb": [0.6, 1.0, 0.8]},
}


def baked(folder, kind):
    """Path of a table of a kind, and the table as it is read."""
    name, change, how, compact = TABLES[kind]
    recipe = json.loads((ROOT / "data" / "recipes" / f"{name}.json").read_text())
    for key, value in change.items():
        recipe.setdefault(key, {}).update(value)
    (folder / "recipe.json").write_text(json.dumps(recipe))
    path = folder / "table.exr"
    run("bake-brdf", folder / "recipe.json", *how, "-q", "-o", path)
    if compact:
        path, full = folder / "compact.exr", path
        run("lut", "fit", full, *compact, "-q", "-o", path)
    return path, reader.Pearl(path)


def pairs():
    """Half at random, half around the mirror direction; some near the horizon. Shape (3, pairs)."""
    random = np.random.default_rng(7)
    z = random.uniform(0.0, 1.0, (2, PAIRS)) * np.where(random.uniform(size=(2, PAIRS)) < 0.15, 0.05, 1.0) + 1e-3
    z = np.minimum(z, 0.99999)  # at the pole itself there is no azimuth
    phi, sin = random.uniform(0.0, 2.0 * np.pi, (2, PAIRS)), np.sqrt(1.0 - z * z)
    wi, wo = np.stack([sin * np.cos(phi), sin * np.sin(phi), z], axis=1)
    near = wi * [[-1.0], [-1.0], [1.0]] + random.normal(0.0, 0.05, wi.shape)
    near[2] = np.maximum(np.abs(near[2]), 1e-3)
    return wi, np.where(np.arange(PAIRS) % 2, near / np.sqrt((near**2).sum(0)), wo)


def apart(found, expected):
    """Largest relative difference of what is above a thousandth of the largest."""
    assert expected.max() > 0
    above = expected > 1e-3 * expected.max()
    return (np.abs(found - expected)[above] / expected[above]).max()


def judge(folder, kind):
    """Asserts that both say the same of every component, in rgb and at wavelengths, in each look."""
    path, pearl = baked(folder, kind)
    wi, wo = pairs()
    lines = "\n".join(json.dumps({"wi": a, "wo": b}) for a, b in zip(wi.T.tolist(), wo.T.tolist()))
    nm = ",".join(map(str, WAVELENGTHS_NM))
    for name, look in LOOKS.items():
        if kind == "no-colours":
            look = {key: value for key, value in look.items() if key not in ("depth", "coherence")}
        written = [[f"--{key.replace('_', '-')}", ",".join(map(str, np.atleast_1d(value)))] for key, value in look.items()]
        said = run("pearl", "eval", path, "--input", "-", "--wavelengths-nm", nm, *sum(written, []), input=lines)
        said = [json.loads(line) for line in said.splitlines()]
        expected = np.moveaxis(np.array([[line["components"][part] for part in reader.COMPONENTS] for line in said]), 0, -1)
        worst = {}
        for part, a, b in zip(reader.COMPONENTS, pearl.rgb(wi, wo, **look), expected):
            if part == "incoherent" and kind == "no-colours":
                assert not a.any() and not b.any()
                continue
            worst[part] = apart(a, b)
        spectral = np.array([line["spectral"] for line in said]).T
        worst["spectral"] = apart(np.array([pearl.at(wi, wo, nm, **look).sum(0) for nm in WAVELENGTHS_NM]), spectral)
        print(kind, name, {part: f"{value:.1e}" for part, value in worst.items()})
        # Fringes of single bands are narrower than these few cells: both quadratures of ⟨M⟩ miss some.
        most = {part: 5e-4 if (kind, part) == ("visible", "spectral") else 1e-4 for part in worst}
        assert all(worst[part] < most[part] for part in worst), worst
