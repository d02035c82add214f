"""Compact tables (`lut fit`): four pearls in both geometries are as small and as near as promised, and what the plugin makes
of a compact file is what `pearl` makes of it. NACRE_FULL=1 takes all eight tables; CI takes two."""

import base64
import json
import os
import subprocess
import zlib

import numpy as np
import pytest
from built import BIN, ROOT, run

FULL = os.environ.get("NACRE_FULL", "") not in ("", "0")

mi = pytest.importorskip("mitsuba")
OpenEXR = pytest.importorskip("OpenEXR")
import test_plugin  # noqa: E402

import nacre.mitsuba  # noqa: E402, F401

RECIPES = ["paper", "akoya", "mother-of-pearl", "golden"]
TABLES = [(recipe, azimuth) for recipe in RECIPES for azimuth in ("decay", "space")]
FEW = [("paper", "decay"), ("paper", "space")]
FORMS = {
    "analytic": ["--form", "analytic"],
    "table": ["--form", "table"],
    "half": ["--form", "table", "--total-variation", "0"],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("compact")


@pytest.fixture(scope="module", params=TABLES if FULL else FEW, ids="-".join)
def fitted(request, folder):
    """A baked table, and of each form its file and what `lut fit` said."""
    recipe, azimuth = request.param
    table = folder / f"{recipe}-{azimuth}.exr"
    source = ROOT / "data" / "recipes" / f"{recipe}.json"
    # One lobe for all wavelengths: a compact file holds no more.
    one_lobe = ["--effects", "surface,blur,azimuth,absorption,coherent,emission"] if recipe == "golden" else []
    # In space 0.7 per cent takes as many cells as a tenth in the plane.
    accuracy = 0.1 if azimuth == "decay" else 0.7
    run("bake-brdf", source, *one_lobe, "--azimuth", azimuth, "--solver", "doubling", "--accuracy", accuracy, "-q", "-o", table)
    forms = {}
    for name, args in FORMS.items():
        # A table that has no more rows and cells than its accuracy takes loses as much again where it is made smaller.
        args = [*args, "--total-variation", 1.4] if azimuth == "space" and name == "table" else args
        small = folder / f"{recipe}-{azimuth}-{name}.exr"
        forms[name] = small, json.loads(run("lut", "fit", table, *args, "-o", small, "--json"))
    return table, forms


def test_a_compact_table_is_ten_times_smaller_and_looks_the_same(fitted):
    table, forms = fitted
    for name, (small, said) in forms.items():
        assert small.stat().st_size == said["bytes"] and table.stat().st_size == said["source_bytes"]
        look = said["error"]["delta_e_2000"]
        print(table.stem, name, f"{said['ratio']:.1f}x, TV {said['error']['total_variation_percent']:.3f} %", look)
    for name in ("analytic", "table"):
        said = forms[name][1]
        assert said["ratio"] >= 10.0, name
        assert said["error"]["delta_e_2000"]["percentile_99"] < 0.5, name
        assert said["error"]["total_variation_percent"] < 1.5, name
    # Every cell kept, in half precision: no pixel differs by a tenth.
    assert forms["half"][1]["ratio"] >= 3.0
    assert forms["half"][1]["error"]["delta_e_2000"]["largest"] < 0.1


def pairs(count):
    random = np.random.default_rng(11)
    z = random.uniform(0.02, 1.0, (2, count))
    phi = random.uniform(0.0, 2.0 * np.pi, (2, count))
    sin = np.sqrt(1.0 - z * z)
    wi, wo = np.stack([sin * np.cos(phi), sin * np.sin(phi), z], axis=-1)
    near = wi[::2] * [-1, -1, 1] + random.normal(0.0, 0.08, (len(wi[::2]), 3))
    near[:, 2] = np.maximum(np.abs(near[:, 2]), 0.01)
    wo[::2] = near / np.linalg.norm(near, axis=1, keepdims=True)
    return wi, wo


def test_the_plugin_and_the_tool_expand_the_same_table(fitted):
    test_plugin.use_rgb()
    wi, wo = pairs(200)
    lines = "\n".join(json.dumps({"wi": a, "wo": b}) for a, b in zip(wi.tolist(), wo.tolist()))
    for name, (small, _) in fitted[1].items():
        rust = np.array([json.loads(line)["rgb"] for line in run("pearl", "eval", small, "--input", "-", input=lines).splitlines()])
        found, _ = test_plugin.plugin(test_plugin.load(small), wi.astype(np.float32), wo.astype(np.float32))
        # The measure: relative where there is a thousandth of the peak.
        bright = rust > 1e-3 * rust.max()
        assert bright.sum() > 100
        assert np.abs(found / rust - 1.0)[bright].max() < 1e-4, name


def test_the_documented_rule_expands_an_analytic_file(fitted):
    """A reader written from docs/LUT-FORMAT.md §11 alone finds the albedos of the table."""
    table, forms = fitted
    with OpenEXR.File(str(forms["analytic"][0]), separate_channels=True) as file:
        outer = json.loads(file.header()["pearl"])
        coefficients = file.channels()["interior"].pixels.astype(float)
    meta = json.loads(zlib.decompress(base64.b64decode(outer["packed"])))
    assert outer["schema"] == "pearl-lut/1.1"
    with OpenEXR.File(str(table), separate_channels=True) as file:
        weights = file.channels()["weight_sr"].pixels.astype(float)
    axis = meta["exit_axis"]
    columns, rows = (axis["cells"], 1) if axis["kind"] == "plane" else (axis["theta_cells"], axis["phi_cells"])
    x, y = 2 * (np.arange(columns) + 0.5) / columns - 1, (np.arange(rows) + 0.5) / rows
    terms = meta["compact"]["form"]["terms"]
    for i, at in enumerate(meta["per_incidence"]):
        polynomial = sum(c * np.cos(m * np.arccos(x))[None, :] * np.cos(2 * n * np.arccos(y))[:, None] for c, (m, n) in zip(coefficients[i], terms))
        light = (np.exp(polynomial) * weights[i * rows : (i + 1) * rows]).sum()
        assert light == pytest.approx(at["albedo"] - at["surface"], rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("damage", ["not base64", "AAAA"])
def test_the_plugin_refuses_damaged_metadata_in_one_line(fitted, folder, damage):
    mi.set_variant("scalar_rgb")
    with OpenEXR.File(str(fitted[1]["analytic"][0]), separate_channels=True) as file:
        header, channels = dict(file.header()), file.channels()
        header["pearl"] = json.dumps({"schema": "pearl-lut/1.1", "packed": damage})
        OpenEXR.File(header, channels).write(str(folder / "damaged.exr"))
    with pytest.raises(Exception) as refused:
        mi.load_dict({"type": "pearl", "filename": str(folder / "damaged.exr")})
    assert "attribute pearl field packed" in str(refused.value) and "bake-brdf" in str(refused.value)
    done = subprocess.run([BIN / "lut", "info", folder / "damaged.exr"], capture_output=True, text=True)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1 and "packed" in done.stderr
