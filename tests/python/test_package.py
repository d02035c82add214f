"""The package `nacre`: against the tools, against packages that share no code with it, and in the hands of someone who makes mistakes."""

import ast
import gc
import inspect
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
import venv
from pathlib import Path

import numpy as np
import PyMoosh
import pytest
import tmm
from built import BIN, ROOT, run

import nacre
from nacre import _nacre

COARSE = {
    "paper": {"solver": "doubling", "accuracy": 5},
    "akoya": {"solver": "walk", "paths": 2000, "incident_deg": [0, 45, 80], "cells": (40, 20), "azimuth": "space", "seed": 7},
}


@pytest.fixture(scope="module", params=COARSE)
def baked(request, tmp_path_factory):
    """A table, its name, and the file that the tool bakes of the same."""
    options = COARSE[request.param]
    flags = {
        "incident_deg": lambda angles: ",".join(map(str, angles)),
        "cells": lambda cells: "x".join(map(str, cells)),
    }
    args = [word for name, value in options.items() for word in ("--" + name.replace("_", "-"), flags.get(name, str)(value))]
    path = tmp_path_factory.mktemp(request.param) / "table.exr"
    run("bake-brdf", request.param, *args, "-q", "-o", path)
    return nacre.bake(request.param, **options), request.param, path


def directions(count, seed):
    random = np.random.default_rng(seed)
    v = random.normal(size=(count, 3))
    v[:, 2] = np.abs(v[:, 2]) * np.where(random.uniform(size=count) < 0.2, 0.05, 1.0) + 1e-3
    return v / np.linalg.norm(v, axis=1)[:, None]


# Bakes and tables --------------------------------------------------------------------------------------------------------------------


def test_a_bake_has_the_bytes_of_the_tools_on_any_threads(baked):
    table, name, path = baked
    assert table.to_bytes() == path.read_bytes()
    assert nacre.bake(nacre.Recipe(name), threads=1, **COARSE[name]).to_bytes() == path.read_bytes()


def test_a_recipe_comes_from_a_name_a_path_or_a_dict(tmp_path):
    assert nacre.recipes() == sorted(path.stem for path in (ROOT / "data" / "recipes").iterdir())
    for name in nacre.recipes():
        path = ROOT / "data" / "recipes" / f"{name}.json"
        of_name = nacre.Recipe(name)
        assert of_name.name == name
        marked = tmp_path / "marked.json"
        marked.write_text("\ufeff" + path.read_text(), encoding="utf-8")
        assert nacre.Recipe(marked) == of_name
        assert (
            of_name == nacre.Recipe(path) == nacre.Recipe(str(path)) == nacre.Recipe(json.loads(path.read_text())) == nacre.Recipe(of_name.to_dict())
        )
    named = json.loads(run("bake-brdf", "plan", "akoya", "--json"))
    assert nacre.plan("akoya")["pearls"][0]["effects"].keys() == named["pearls"][0]["effects"].keys()
    assert run("thinfilm", "colour", "golden", "--json", "--members", 2) == run(
        "thinfilm", "colour", ROOT / "data" / "recipes" / "golden.json", "--json", "--members", 2
    )


def test_a_dict_may_have_numbers_of_numpy():
    layers, sigma, body = np.arange(3, 5)[0], np.float32(1.5), np.array([0.25, 0.5, 0.75])
    recipe = nacre.Recipe({"stack": {"layers": layers}, "facets": {"slope_sd_deg": sigma}, "look": {"body_rgb": body}})
    assert recipe == nacre.Recipe({"stack": {"layers": 3}, "facets": {"slope_sd_deg": 1.5}, "look": {"body_rgb": [0.25, 0.5, 0.75]}})


def test_a_table_survives_its_file(baked, tmp_path):
    table, _, path = baked
    table.save(tmp_path / "saved.exr")
    assert (tmp_path / "saved.exr").read_bytes() == path.read_bytes()
    assert table == nacre.Table(path) == nacre.Table.from_bytes(path.read_bytes())
    info = json.loads(run("lut", "info", path, "--json"))
    assert table.meta["per_incidence"] == info["per_incidence"]
    np.testing.assert_allclose(np.degrees(table.theta_i), [row["theta_i_deg"] for row in info["per_incidence"]], rtol=1e-15)


def test_channels_are_views_that_outlive_the_name_of_their_table(baked):
    table, _, path = baked
    again = nacre.Table(path)
    view = again.channel("interior")
    assert np.shares_memory(view, again.channel("interior"))
    assert not view.flags.writeable
    with pytest.raises(ValueError, match="cannot set WRITEABLE flag"):
        view.setflags(write=True)
    del again
    gc.collect()
    np.testing.assert_array_equal(view, table.channel("interior"))
    for name in table.channels:
        assert table.channel(name).shape == view.shape
    columns, azimuths = table.edges(1)
    assert view.shape[-1] == len(columns) - 1
    assert (azimuths is None) if view.ndim == 2 else view.shape[1] == len(azimuths) - 1
    # Light by cell adds up to the share that the metadata state: f·cos θo times the extent of the cell.
    row = table.channel("interior")[1].astype(float) + table.channel("surface")[1]
    if azimuths is not None:
        extent = np.outer(np.diff(azimuths), np.diff(-np.cos(columns))) * 2
        assert (row * extent).sum() == pytest.approx(table.meta["per_incidence"][1]["albedo"], rel=0.02)


def test_operations_say_what_the_tools_say(baked, tmp_path):
    table, name, path = baked
    run("lut", "export", path, "--to", "arrays", "-o", tmp_path / "a.npz")
    stored, arrays = np.load(tmp_path / "a.npz"), nacre.arrays(table)
    assert list(arrays) == list(stored)
    for key, array in arrays.items():
        assert array.dtype == np.float32
        np.testing.assert_array_equal(array, stored[key])
    check = json.loads(run("lut", "check", path, "--json"))
    assert nacre.check(table) == {key: check[key] for key in ("pass", "checks", "recipe_not_read")}
    other = nacre.bake(name, **{**COARSE[name], "incident_deg": [10, 60], "seed": 9})
    other.save(tmp_path / "other.exr")
    done = subprocess.run([BIN / "lut", "diff", path, tmp_path / "other.exr", "--json"], capture_output=True, text=True)
    said = json.loads(done.stdout)
    assert nacre.diff(table, other) == {key: value for key, value in said.items() if key not in ("schema", "significance")}


FORMATS = "arrays, bsdf-rgb, bsdf-spectral, merl, radiance, microfacet, blender, blender-add-on, three, gltf, openpbr, csv, astm, zemax"


@pytest.mark.parametrize("form", FORMATS.split(", "))
def test_exports_have_the_bytes_of_the_tool_and_say_what_it_says(form, tmp_path):
    table = nacre.bake("paper", **COARSE["paper"])
    table.save(tmp_path / "table.exr")
    said = json.loads(run("lut", "export", tmp_path / "table.exr", "--to", form, "--json", "-o", tmp_path / "tool"))
    ours = nacre.export(table, form, tmp_path / "ours")
    assert (tmp_path / "ours").read_bytes() == (tmp_path / "tool").read_bytes()
    assert ours == {**said, "output": str(tmp_path / "ours")}


# Interruption ------------------------------------------------------------------------------------------------------------------------


def test_progress_ascends_while_others_run():
    counted, told, done = 0, [], threading.Event()

    def count():
        nonlocal counted
        while not done.is_set():
            counted += 1
            time.sleep(0.001)

    thread = threading.Thread(target=count)
    thread.start()
    nacre.bake("paper", solver="walk", time_budget=0.6, incident_deg=[30], threads=1, progress=lambda *at: told.append(at))
    done.set()
    thread.join()
    shares, seconds = zip(*told)
    assert list(shares) == sorted(shares) and shares[-1] == 1.0 and len(shares) >= 3
    assert list(seconds) == sorted(seconds)
    assert counted > 50


def test_an_exception_in_progress_stops_a_bake():
    def refuse(share, seconds):
        raise LookupError("enough")

    started = time.monotonic()
    with pytest.raises(LookupError, match="enough"):
        nacre.bake("paper", solver="walk", time_budget=60, progress=refuse)
    assert time.monotonic() - started < 30


@pytest.mark.skipif(sys.platform != "linux", reason="names of threads are read from /proc")
@pytest.mark.parametrize("grid", [{"incident_deg": [0, 80], "cells": (20, 10)}, {}], ids=["solves", "places"])
def test_a_doubling_that_is_stopped_leaves_no_thread_working(grid):
    def named():
        return {path for path in Path("/proc/self/task").glob("*/comm") if path.read_text() == "nacre-bake\n"}

    # Threads of the common pool have the name of the bake that came first, and stay.
    others = named()

    def working():
        return named() - others

    def refuse(share, seconds):
        assert working()
        raise LookupError("enough")

    narrow, effects = {"facets": {"slope_sd_deg": 1}}, "surface,blur,azimuth:space"
    with pytest.raises(LookupError, match="enough"):
        nacre.bake(narrow, solver="doubling", accuracy=0.1, effects=effects, threads=2, progress=refuse, **grid)
    # By the processor's time: all of it takes 18 s with a grid, and more where one is placed first.
    spent = time.process_time()
    while working() and time.process_time() - spent < 9:
        time.sleep(0.01)
    print(f"went on for {time.process_time() - spent:.2f} s")
    assert not working()


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGINT to one process")
def test_ctrl_c_stops_a_bake():
    code = "import nacre; print('ready', flush=True); nacre.bake('paper', solver='walk', time_budget=60, incident_deg=[30])"
    # What a shell starts in the background ignores it, and so do all that come after.
    heard = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    child = subprocess.Popen([sys.executable, "-c", code], preexec_fn=heard, **pipes)
    assert child.stdout.readline() == "ready\n"
    time.sleep(0.5)
    child.send_signal(signal.SIGINT)
    _, said = child.communicate(timeout=30)
    assert "KeyboardInterrupt" in said and child.returncode != 0


# The BSDF ----------------------------------------------------------------------------------------------------------------------------


def test_values_are_those_of_the_tools(baked):
    table, _, path = baked
    wi, wo = directions(600, 1), directions(600, 2)
    lines = "".join(json.dumps({"wi": list(i), "wo": list(o)}) + "\n" for i, o in zip(wi, wo))
    flags = ["--depth", 0.7, "--coherence", 0.9, "--brightness", 0.8, "--body-rgb", "0.9,0.5,0.2", "--tint-rgb", "1,0.8,0.6"]
    said = [json.loads(line) for line in run("pearl", "eval", path, "--input", "-", "--wavelengths-nm", "450,600", *flags, input=lines).splitlines()]
    pearl = nacre.Pearl(table, depth=0.7, coherence=0.9, brightness=0.8, body_color=(0.9, 0.5, 0.2), tint=[1, 0.8, 0.6])
    close = lambda ours, theirs: np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-14)
    close(pearl.eval(wi, wo), [line["rgb"] for line in said])
    close(pearl.pdf(wi, wo), [line["pdf"] for line in said])
    close(pearl.eval_spectrum(wi, wo, [450, 600]), [line["spectral"] for line in said])
    close(pearl.eval_components(wi, wo), [[line["components"][name] for name in nacre.Pearl.COMPONENTS] for line in said])


def test_samples_have_the_value_and_the_density_of_their_direction(baked):
    pearl = nacre.Pearl(baked[0], depth=0.6)
    wi, u = directions(3000, 3), np.random.default_rng(4).random((3000, 3))
    wo, pdf, value = pearl.sample(wi, u)
    found = pdf > 0
    assert found.mean() > 0.99
    assert not wo[~found].any() and not value[~found].any()
    np.testing.assert_allclose(pearl.pdf(wi, wo + ~found[:, None])[found], pdf[found], rtol=1e-9)
    np.testing.assert_allclose(pearl.eval(wi, wo + ~found[:, None])[found], value[found], rtol=1e-9, atol=1e-15)


def test_samples_integrate_to_the_albedo(baked):
    pearl = nacre.Pearl(baked[0], depth=0)
    u = np.random.default_rng(5).random((200_000, 3))
    for degrees in (0.0, 50.0, 80.0):
        wi = [np.sin(np.radians(degrees)), 0, np.cos(np.radians(degrees))]
        _, pdf, value = pearl.sample(wi, u)
        weights = value[pdf > 0] / pdf[pdf > 0, None]
        mean, error = weights.sum(axis=0) / len(u), weights.std(axis=0) / np.sqrt(len(u))
        expected = pearl.albedo(degrees).sum(axis=0)
        # Five standard errors, and what quadrature of the albedo leaves.
        assert (np.abs(mean - expected) < 5 * error + 1e-3 * expected).all()


def test_shapes_are_those_of_the_directions(baked):
    pearl = nacre.Pearl(baked[0])
    wi, wo = directions(24, 6).reshape(2, 4, 3, 3), directions(24, 7).reshape(2, 4, 3, 3)
    grid = pearl.eval(wi, wo)
    assert grid.shape == (2, 4, 3, 3) and pearl.pdf(wi, wo).shape == (2, 4, 3)
    assert pearl.eval_components(wi, wo).shape == (2, 4, 3, 4, 3) and pearl.eval_spectrum(wi, wo, [500]).shape == (2, 4, 3, 1)
    np.testing.assert_allclose(pearl.eval(wi[0, 0, 0], wo)[1, 2, 1], pearl.eval(wi[0, 0, 0], wo[1, 2, 1]), rtol=1e-12)
    np.testing.assert_allclose(pearl.eval(wi, wo[0, 0, 0])[1, 2, 1], pearl.eval(wi[1, 2, 1], wo[0, 0, 0]), rtol=1e-12)
    # Any length but 0, any layout and any kind of number.
    np.testing.assert_allclose(pearl.eval(3e200 * wi, 1e-200 * wo), grid, rtol=1e-12)
    np.testing.assert_allclose(pearl.eval(np.asfortranarray(wi)[::-1], wo[::-1]), grid[::-1], rtol=1e-12)
    np.testing.assert_allclose(pearl.eval(wi.astype(np.float32), wo.astype(np.float32)), grid, rtol=1e-3, atol=1e-4)
    assert pearl.eval(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0, 3)
    assert pearl.sample([0, 0, 1], np.zeros((0, 3)))[0].shape == (0, 3)
    # More than a piece, so that threads share them.
    many = directions(5000, 8)
    np.testing.assert_array_equal(pearl.eval(many, many[::-1])[:700], pearl.eval(many[:700], many[::-1][:700]))


# Thin films --------------------------------------------------------------------------------------------------------------------------

INF = np.inf
ANGLES = [0.0, 17.0, 45.0, 80.0]
WAVELENGTHS = [400.0, 520.0, 740.0]


def stack(seed):
    random = np.random.default_rng(seed)
    count = random.integers(1, 25)
    k = np.where(random.uniform(size=count) < 0.5, 0.0, 10 ** random.uniform(-5, -1, count))
    n = random.uniform(1.3, 2.5, count) + 1j * k
    return np.array([1.0, *n, complex(random.uniform(1.3, 2.0), random.choice([0, 2.5]))]), random.uniform(5, 400, count)


@pytest.mark.parametrize("seed", range(8))
def test_waves_agree_with_tmm(seed):
    n, d = stack(seed)
    spectrum, amplitudes = (of(n, d, WAVELENGTHS, ANGLES) for of in (nacre.thinfilm.spectrum, nacre.thinfilm.amplitudes))
    field = nacre.thinfilm.field(n, d, WAVELENGTHS, ANGLES)
    depths = np.linspace(0, d.sum(), 7)[1:-1]
    intensity = nacre.thinfilm.intensity(n, d, WAVELENGTHS, ANGLES, depths)
    for a, angle in enumerate(ANGLES):
        for w, nm in enumerate(WAVELENGTHS):
            for pol in "sp":
                theirs = tmm.coh_tmm(pol, n, [INF, *d, INF], np.radians(angle), nm)
                at = lambda pair: getattr(pair, pol)[..., a, w]
                close = lambda ours, theirs: np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-11)
                close(
                    [at(spectrum.R), at(spectrum.T), at(spectrum.A)],
                    [theirs["R"], theirs["T"], 1 - theirs["R"] - theirs["T"] if n[1:-1].imag.any() else 0],
                )
                close([at(amplitudes.r), at(amplitudes.t)], [theirs["r"], theirs["t"]])
                close(at(field.absorptance), tmm.absorp_in_each_layer(theirs)[1:-1])
                for depth, found in zip(depths, getattr(intensity, pol)[a, w]):
                    layer, inside = tmm.find_in_structure_with_inf([INF, *d, INF], depth)
                    data = tmm.position_resolved(layer, inside, theirs)
                    squared = sum(abs(data[axis]) ** 2 for axis in ("Ex", "Ey", "Ez"))
                    np.testing.assert_allclose(found, squared, rtol=1e-9)


def test_waves_agree_with_pymoosh():
    for seed in range(100, 104):
        n, d = stack(seed)
        materials = [*(complex(index) ** 2 for index in n)]
        theirs = PyMoosh.Structure(materials, list(range(len(n))), [0, *d, 0], verbose=False)
        spectrum = nacre.thinfilm.spectrum(n, d, [550.0], [40.0])
        for number, pol in enumerate("sp"):
            _, _, r, t = PyMoosh.coefficient_S(theirs, 550.0, np.radians(40), number)
            assert getattr(spectrum.R, pol)[0, 0] == pytest.approx(r, abs=1e-11)
            assert getattr(spectrum.T, pol)[0, 0] == pytest.approx(t, abs=1e-11)


def test_help_says_what_the_stubs_say():
    stubs = ast.parse((ROOT / "crates" / "python" / "nacre" / "_nacre.pyi").read_text())
    shown = [(_nacre, each) for each in stubs.body if isinstance(each, (ast.FunctionDef, ast.ClassDef))]
    shown += [(getattr(_nacre, one.name), each) for _, one in shown for each in one.body if isinstance(each, ast.FunctionDef)]
    documented = [(getattr(holder, each.name), text) for holder, each in shown if (text := ast.get_docstring(each))]
    assert len(documented) > 30
    for found, text in documented:
        assert inspect.getdoc(found) == text, found


def test_a_batch_is_its_stacks_one_by_one():
    random = np.random.default_rng(1)
    n = random.uniform(1.3, 2.2, (5, 6, 3)) + 1j * random.choice([0, 0.01], (5, 6, 3)) * [[[0], [1], [1], [0], [1], [0]]]
    d = random.uniform(20, 300, (5, 4))
    one = lambda of, k, k_d: of(n[k], d[k_d], WAVELENGTHS, ANGLES)
    for of, first in ((nacre.thinfilm.spectrum, "R"), (nacre.thinfilm.amplitudes, "r"), (nacre.thinfilm.field, "integral")):
        batches = [
            (of(n, d, WAVELENGTHS, ANGLES), lambda k: one(of, k, k)),
            (of(n, d[2], WAVELENGTHS, ANGLES), lambda k: one(of, k, 2)),
            (of(n[1], d, WAVELENGTHS, ANGLES), lambda k: one(of, 1, k)),
        ]
        for batch, single in batches:
            for k in range(5):
                np.testing.assert_array_equal(getattr(batch, first).p[k], getattr(single(k), first).p)
    constant = nacre.thinfilm.spectrum(n[:, :, 0], d, WAVELENGTHS, ANGLES)
    np.testing.assert_array_equal(constant.T.s[3], nacre.thinfilm.spectrum(n[3, :, :1], d[3], WAVELENGTHS, ANGLES).T.s)


def test_a_batch_of_no_stacks_has_no_results():
    for n, d in ((np.ones((0, 4)), [10, 20]), ([1, 1.5, 1.4, 1], np.ones((0, 2)))):
        assert np.shape(nacre.thinfilm.spectrum(n, d, [500, 600], [0]).R.s) == (0, 1, 2)
        assert np.shape(nacre.thinfilm.amplitudes(n, d, [500, 600], [0]).r.p) == (0, 1, 2)
        assert np.shape(nacre.thinfilm.field(n, d, [500, 600], [0]).integral.s) == (0, 2, 1, 2)


def test_indices_by_wavelength_come_in_any_order():
    nm, d = np.array([400.0, 500.0, 700.0]), [300, 40]
    n = np.array([1, 1.5, 1.4, 1.6])[:, None] * np.ones(3) + [0.0, 0.01, 0.03]
    up = nacre.thinfilm.ensemble(n, d, 9, nm, [0, 40], members=8)
    down = nacre.thinfilm.ensemble(n[:, ::-1], d, 9, nm[::-1], [0, 40], members=8)
    np.testing.assert_array_equal(down.R, up.R[:, ::-1])
    twice = nacre.thinfilm.ensemble(n[:, [0, 1, 1, 2]], d, 9, nm[[0, 1, 1, 2]], [0, 40], members=8)
    np.testing.assert_array_equal(twice.R, up.R[:, [0, 1, 1, 2]])


def test_stacks_of_recipes_have_the_spectra_of_the_tool():
    for name in ("golden", "paper"):
        path = ROOT / "data" / "recipes" / f"{name}.json"
        n, d, sd = nacre.Recipe(name).films(WAVELENGTHS)
        assert n.shape == (len(d) + 2, 3) and sd.shape == d.shape
        said = json.loads(run("thinfilm", "spectrum", path, "--wavelengths-nm", "400:740:3", "--angles-deg", "0,30", "--pol", "p", "--json"))
        ours = (
            nacre.thinfilm.spectrum(n[:, [0]], d, [400.0, 570.0, 740.0], [0, 30])
            if name == "paper"
            else nacre.thinfilm.spectrum(nacre.Recipe(name).films([400.0, 570.0, 740.0])[0], d, [400.0, 570.0, 740.0], [0, 30])
        )
        np.testing.assert_allclose(ours.R.p, said["R"], atol=2e-12, rtol=0)
        mean = nacre.thinfilm.ensemble(n[:, [0]], d, sd, [570.0], [0, 30], members=8, seed=3)
        if name == "paper":
            assert mean.members == 1 and not np.any(mean.R_error)
        else:
            assert mean.members == 8 and np.all(mean.R_error > 0) and mean.converged


def test_ensembles_and_colours_are_those_of_the_tool(tmp_path):
    recipe = {
        "stack": {
            "ambient": {"n": 1.0},
            "substrate": {"n": 1.5},
            "explicit": [{"n": n, "k": k, "thickness_nm": d, "thickness_sd_nm": sd} for n, k, d, sd in [(1.6, 0.01, 200, 10), (1.4, 0, 90, 5)] * 3],
        }
    }
    (tmp_path / "recipe.json").write_text(json.dumps(recipe))
    n, d, sd = nacre.Recipe(recipe).films([550.0])
    said = json.loads(
        run(
            "thinfilm",
            "spectrum",
            tmp_path / "recipe.json",
            "--members",
            50,
            "--seed",
            3,
            "--wavelengths-nm",
            "400:700:4",
            "--angles-deg",
            "20",
            "--json",
        )
    )
    mean = nacre.thinfilm.ensemble(n, d, sd, [400, 500, 600, 700], [20], members=50, seed=3)
    np.testing.assert_allclose([mean.R, mean.T, mean.A], [said["R"], said["T"], said["A"]], rtol=0, atol=1e-9)
    said = json.loads(run("thinfilm", "colour", tmp_path / "recipe.json", "--members", 16, "--angles-deg", "0,50", "--json"))
    colour = nacre.thinfilm.colour(n, d, [0, 50], sd_nm=sd, members=16)
    np.testing.assert_allclose(colour.lab, [at["lab"] for at in said["colours"]], rtol=0, atol=1e-6)
    assert nacre.thinfilm.colour(n, d, [0]).ensemble_error == [0.0]
    few = nacre.thinfilm.ensemble(n, d, sd, [550.0], [0], members=1)
    assert few.R_error is None and few.members == 1


def test_gain_amplifies_where_it_is_meant():
    n, d = [1.0, 1.5 - 0.01j, 1.5], [500.0]
    with pytest.raises(nacre.InputError, match="gain=True"):
        nacre.thinfilm.spectrum(n, d, [600.0], [0])
    spectrum = nacre.thinfilm.spectrum(n, d, [600.0], [0], gain=True)
    assert spectrum.A.s[0, 0] < 0 < spectrum.R.s[0, 0] + spectrum.T.s[0, 0] - 1


# Wrong input -------------------------------------------------------------------------------------------------------------------------


def wrong(pearl, table, folder):
    film = nacre.thinfilm.spectrum
    (folder / "cut.exr").write_bytes(table.to_bytes()[:1000])
    (folder / "utf16.json").write_text("{}", encoding="utf-16")
    (folder / "long.json").write_text(" " * (17 << 20))
    (folder / "bad.json").write_text('{"stack": {"layers": 2, "layer": 3}}')
    bake = lambda **options: nacre.bake("paper", **options)
    return {
        "akoja: there is no such file": lambda: nacre.bake("akoja"),
        "recipe: is a list": lambda: nacre.bake([1, 2]),
        "stack.layers": lambda: nacre.bake({"stack": {"layers": -3}}),
        "utf16.json: is not encoded in UTF-8": lambda: nacre.Recipe(folder / "utf16.json"),
        "long.json: is longer than": lambda: nacre.Recipe(folder / "long.json"),
        "unknown field `layer`": lambda: nacre.Recipe(folder / "bad.json"),
        "stack.aragonite.n: ": lambda: nacre.Recipe({"stack": {"aragonite": {"n": float("nan")}}}),
        "recipe: has a set in it": lambda: nacre.Recipe({"stack": {1, 2}}),
        "accuracy: -1": lambda: bake(accuracy=-1),
        "paths: 0": lambda: bake(paths=0),
        "expected one of them at most": lambda: bake(paths=10, accuracy=1),
        "time_budget: -1": lambda: bake(time_budget=-1),
        "solver: 'x'": lambda: bake(solver="x"),
        "azimuth: 'round'": lambda: bake(azimuth="round"),
        "sparkle": lambda: bake(effects=["surface", "sparkle"]),
        "its azimuth is not that": lambda: bake(effects="surface,blur,azimuth:space", azimuth="decay"),
        "incident_deg": lambda: bake(incident_deg=[10, 5]),
        "incident_deg: is not an array": lambda: bake(incident_deg="all"),
        "threads: 0 is not valid, expected 1 to 4096": lambda: bake(threads=0),
        "threads: 1000000000000 is not valid": lambda: bake(threads=10**12),
        "threads: -1 is not valid": lambda: bake(threads=-1),
        "paths: -1 is not valid": lambda: bake(paths=-1),
        "cells: (8, -1) is not valid": lambda: bake(cells=(8, -1)),
        "seed: 18446744073709551616 is not valid": lambda: bake(seed=2**64),
        "index: -1 is not valid": lambda: nacre.walk_shard("paper", -1, 2, paths=10),
        "both_sides": lambda: bake(both_sides=True, solver="walk"),
        "cannot read the file": lambda: nacre.Table(folder / "none.exr"),
        "cut.exr": lambda: nacre.Table(folder / "cut.exr"),
        "is not OpenEXR": lambda: nacre.Table.from_bytes(b"cut short"),
        f"format: 'png' is not one of {FORMATS}": lambda: nacre.export(table, "png", folder / "png"),
        "channel: 'blue'": lambda: table.channel("blue"),
        "incidence: 99": lambda: table.edges(99),
        "incidence: -1 is not valid": lambda: table.edges(-1),
        "depth: 2": lambda: nacre.Pearl(table, depth=2),
        "body_color[1]: -0.1": lambda: nacre.Pearl(table, body_color=(0.1, -0.1, 0.1)),
        "tint[0]: NaN": lambda: nacre.Pearl(table, tint=np.nan),
        "body_color[2]: 7": lambda: nacre.effects("paper", {"body_color": (0, 0, 7)}),
        "tint: has shape (2,)": lambda: nacre.Pearl(table, tint=(0.1, 0.1)),
        "components: blurr": lambda: nacre.Pearl(table, components="blurr"),
        "wi: direction 1 is [0.0, 0.0, 0.0]": lambda: pearl.eval([[0, 0, 1], [0, 0, 0]], [0, 0, 1]),
        "wo: direction 0 is [NaN": lambda: pearl.pdf([0, 0, 1], [np.nan, 0, 1]),
        "wi: has shape (2,)": lambda: pearl.eval([0, 1], [0, 0, 1]),
        "wo: has shape (3, 3), expected (2, 3)": lambda: pearl.eval(np.ones((2, 3)), np.ones((3, 3))),
        "u: 1 is not a random number": lambda: pearl.sample([0, 0, 1], [[0.1, 0.2, 1.0]]),
        "wavelengths_nm: -5": lambda: pearl.eval_spectrum([0, 0, 1], [0, 0, 1], [-5]),
        "theta_i_deg: 90": lambda: pearl.albedo(90),
        "n: has 3 media, expected 4": lambda: film([1, 1.5, 1], [10, 20], [500], [0]),
        "n: has 2 wavelengths, expected 3": lambda: film(np.ones((3, 2)), [10], [500, 600, 700], [0]),
        "n: has 2 stacks and d_nm 3": lambda: film(np.ones((2, 3, 1)), np.ones((3, 1)), [500], [0]),
        "n: medium 1 of stack 0 is": lambda: film([1, 0, 1], [10], [500], [0]),
        "n: medium 2 of stack 0 is": lambda: film([1, 1, np.nan], [10], [500], [0]),
        "thickness": lambda: film([1, 1.5, 1], [-10], [500], [0]),
        "angles_deg: 91": lambda: film([1, 1.5, 1], [10], [500], [91]),
        "wavelength": lambda: film([1, 1.5, 1], [10], [0], [0]),
        "the wavelength is -500": lambda: film([1, 1.5, 1], [10], [400, -500], [0]),
        "n: ": lambda: film(["glass", 1.5, 1], [10], [500], [0]),
        "are a batch of stacks": lambda: nacre.thinfilm.colour([1, 1.5, 1], [[10], [20]], [0]),
        "pol: 'u'": lambda: nacre.thinfilm.ensemble([1, 1.5, 1], [10], 1, [500], [0], pol="u"),
        "members: -1": lambda: nacre.thinfilm.ensemble([1, 1.5, 1], [10], 1, [500], [0], members=-1),
        "members: 0": lambda: nacre.thinfilm.ensemble([1, 1.5, 1], [10], 1, [500], [0], members=0),
        "sd_nm: has shape (2,)": lambda: nacre.thinfilm.ensemble([1, 1.5, 1], [10], [1, 2], [500], [0]),
        "depths_nm: 11": lambda: nacre.thinfilm.intensity([1, 1.5, 1], [10], [500], [0], [11]),
    }


def test_wrong_input_gets_one_line_that_names_it(tmp_path):
    table = nacre.bake("paper", **COARSE["paper"])
    for expected, call in wrong(nacre.Pearl(table), table, tmp_path).items():
        with pytest.raises(nacre.InputError) as caught:
            call()
        said = str(caught.value).replace('"', "'")
        assert expected in said and "\n" not in said, (expected, said)
        assert isinstance(caught.value, ValueError)


def test_errors_of_the_system_are_pythons(tmp_path):
    table = nacre.bake("paper", solver="doubling", accuracy=5, incident_deg=[0, 40], cells=(20, 10))
    with pytest.raises(FileNotFoundError) as caught:
        table.save(tmp_path / "no folder" / "table.exr")
    assert ".part" not in str(caught.value) and "no folder" in str(caught.value)
    with pytest.raises(FileNotFoundError, match="no folder"):
        nacre.export(table, "merl", tmp_path / "no folder" / "pearl.binary")
    with pytest.raises(TypeError):
        nacre.bake("paper", accuracy="fine")


def test_everything_has_documentation():
    for name in nacre.__all__:
        if not name.startswith("__"):
            assert getattr(nacre, name).__doc__, name
    for kind in (nacre.Table, nacre.Pearl, nacre.Recipe):
        for name, member in vars(kind).items():
            if not name.startswith("_") and name != "COMPONENTS":
                assert member.__doc__, (kind, name)


def test_the_stubs_are_what_is_there(tmp_path):
    # The list of its own names that an extension module has. (The plugin has Dr.Jit's types, not ours.)
    (tmp_path / "known").write_text("nacre._nacre.__all__")
    command = [sys.executable, "-m", "mypy.stubtest", "nacre._nacre", "--concise", "--allowlist", "known"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_its_page_runs_as_printed_in_a_fresh_environment(tmp_path):
    page = (ROOT / "crates" / "python" / "README.md").read_text()
    (tmp_path / "page.py").write_text("\n".join(re.findall(r"^```python\n(.*?)^```", page, re.S | re.M)))
    venv.create(tmp_path / "venv", with_pip=True)
    env = {**os.environ, "PATH": f"{tmp_path / 'venv' / 'bin'}:{os.environ['PATH']}", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    shell = lambda line, folder: subprocess.run(["bash", "-ec", line], cwd=folder, env=env, capture_output=True, text=True)
    for line in re.findall(r"^```sh\n(.*?)^```", page, re.S | re.M):
        done = shell(line, ROOT)
        assert done.returncode == 0, done.stderr[-3000:]
    done = shell("python page.py", tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "akoya.exr").stat().st_size > 10_000
