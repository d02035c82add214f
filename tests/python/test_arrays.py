"""The evaluator printed in docs/ARRAYS.md, run on what `lut export --to arrays` writes, says what `pearl eval` says."""

import json

import numpy as np
import pytest
from built import ROOT, run

PAIRS = 3000
# Between bands and channels, and beyond both ends.
WAVELENGTHS_NM = [370.0, 451.3, 545.0, 612.4, 790.0]
COMPONENTS = ["diffuse", "incoherent", "mirror", "blur"]
# Recipe, what is changed of it, how it is baked, and whether it is made compact.
TABLES = {
    "decay": ("paper", {}, ["--azimuth", "decay", "--incident-deg", "0:90:5"], False),
    "space": ("mother-of-pearl", {}, ["--azimuth", "space", "--incident-deg", "5:85:8"], False),
    "visible": ("paper", {"normals": "visible"}, ["--azimuth", "space", "--incident-deg", "0:90:9"], False),
    "reciprocal-decay": ("paper", {}, ["--reciprocal", "--azimuth", "decay", "--incident-deg", "0:90:6"], False),
    "reciprocal-space": ("paper", {}, ["--reciprocal", "--azimuth", "space", "--incident-deg", "0:90:9"], False),
    "compact": ("akoya", {}, ["--azimuth", "decay", "--incident-deg", "0:90:5"], True),
    "dispersed": ("golden", {}, ["--azimuth", "decay", "--incident-deg", "0:90:6"], False),
}
# Tables with thickness as a control.
THICK = ("space", "reciprocal-decay", "compact", "dispersed")
LOOKS = {
    "recipe": {},
    "painted": {
        "depth": 0.7,
        "brightness": 0.6,
        "coherence": 0.9,
        "body_rgb": [0.95, 0.6, 0.2],
        "tint_rgb": [0.6, 1.0, 0.8],
    },
}


@pytest.fixture(scope="module", params=TABLES)
def table(request, tmp_path_factory):
    """A table, and its arrays."""
    folder = tmp_path_factory.mktemp(request.param)
    name, facets, how, compact = TABLES[request.param]
    recipe = json.loads((ROOT / "data" / "recipes" / f"{name}.json").read_text())
    recipe.setdefault("facets", {}).update(facets)
    if request.param in THICK:
        recipe.setdefault("look", {})["thickness"] = {}
    (folder / "recipe.json").write_text(json.dumps(recipe))
    path, arrays = folder / "table.exr", folder / "table.npz"
    run("bake-brdf", folder / "recipe.json", "--solver", "doubling", "--accuracy", 2, *how, "-q", "-o", path)
    if compact:
        path, full = folder / "compact.exr", path
        run("lut", "fit", full, "-q", "-o", path)
    said = json.loads(run("lut", "export", path, "--to", "arrays", "-o", arrays, "--json"))
    stored = np.load(arrays)
    assert said["arrays"] == {name: list(stored[name].shape) for name in stored}
    assert {array.dtype for array in stored.values()} == {np.dtype("<f4")}
    assert (len(stored["wavelength_nm"]) > 1) == (request.param == "dispersed")
    assert ("scale" in stored) == (request.param in THICK)
    return path, {name: array.astype(float) for name, array in stored.items()}


def pairs():
    """Half at random, half around the mirror direction; a fifth near the horizon. Shape (3, pairs)."""
    random = np.random.default_rng(11)
    z = random.uniform(1e-3, 1.0, (2, PAIRS)) * np.where(random.uniform(size=(2, PAIRS)) < 0.2, 0.05, 1.0)
    phi, sin = random.uniform(0.0, 2.0 * np.pi, (2, PAIRS)), np.sqrt(1.0 - z * z)
    wi, wo = np.stack([sin * np.cos(phi), sin * np.sin(phi), z], axis=1)
    near = wi * [[-1.0], [-1.0], [1.0]] + random.normal(0.0, 0.05, wi.shape)
    near[2] = np.maximum(np.abs(near[2]), 1e-3)
    wo = np.where(np.arange(PAIRS) % 2, near / np.sqrt((near**2).sum(0)), wo)
    # The pole, where there is no azimuth.
    wi[:, 0], wo[:, 2] = [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]
    return wi, wo


def by_rust(path, look, wi, wo):
    """What the tool says: components [component, channel, pair], density, spectra [wavelength, pair]."""
    lines = "\n".join(json.dumps({"wi": a, "wo": b}) for a, b in zip(wi.T.tolist(), wo.T.tolist()))
    written = [[f"--{name.replace('_', '-')}", ",".join(map(str, np.atleast_1d(value)))] for name, value in look.items()]
    nm = ",".join(map(str, WAVELENGTHS_NM))
    said = run("pearl", "eval", path, "--input", "-", "--wavelengths-nm", nm, *sum(written, []), input=lines)
    found = [json.loads(line) for line in said.splitlines()]
    components = np.array([[line["components"][name] for name in COMPONENTS] for line in found])
    return (
        np.moveaxis(components, 0, -1),
        np.array([line["pdf"] for line in found]),
        np.array([line["spectral"] for line in found]).T,
    )


def off(found, expected):
    """Difference in shares of the value, or of a thousandth of the largest one."""
    return np.abs(found - expected) / np.maximum(expected, 1e-3 * expected.max(axis=-1, keepdims=True) + 1e-12)


@pytest.mark.parametrize("look", LOOKS)
def test_the_page_evaluates_what_rust_does(evaluator, table, look):
    path, arrays = table
    wi, wo = pairs()
    given = LOOKS[look] | ({"thickness": 0.83} if "scale" in arrays and look == "painted" else {})
    components, density, spectra = by_rust(path, given, wi, wo)
    look = {"tint_rgb": [1.0, 1.0, 1.0]} | {name: arrays[name] for name in ("depth", "brightness", "coherence", "body_rgb")} | given
    look = {"thickness": 1.0} | look
    assert all(component.max() > 1e-3 for component in components), "every component has light"
    found = {
        **dict(zip(COMPONENTS, zip(evaluator["rgb"](arrays, look, wi, wo), components))),
        "density": (evaluator["pdf"](arrays, look, wi, wo), density),
        "spectra": (
            np.array([evaluator["at_wavelength"](arrays, look, wi, wo, nm).sum(0) for nm in WAVELENGTHS_NM]),
            spectra,
        ),
    }
    for name, (page, rust) in found.items():
        apart = off(page, rust)
        print(f"{path.parent.name} {name}: at most {apart.max():.1e}, 99 of 100 below {np.quantile(apart, 0.99):.1e}")
        # Positions of Rust are single precision: a few parts in 1e5 of what a value gains from a cell to the next.
        assert apart.max() < 3e-5 and np.quantile(apart, 0.99) < 1e-5, name
