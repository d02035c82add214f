"""`bake-brdf --reciprocal`: f(a → b) = f(b → a), in the evaluator and in the plugin, for both azimuth modes."""

import json
import subprocess

import numpy as np
import pytest
from built import BIN, ROOT

mi = pytest.importorskip("mitsuba")
import llvm  # noqa: E402
import test_plugin  # noqa: E402

import nacre.mitsuba  # noqa: E402, F401


def run(tool, *args, expect=0, **keywords):
    done = subprocess.run([BIN / tool, *map(str, args)], capture_output=True, text=True, **keywords)
    assert done.returncode == expect, done.stderr
    return done


@pytest.fixture(scope="module", params=["decay", "space"])
def table(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("reciprocal") / "table.exr"
    bake = ["--azimuth", request.param, "--solver", "doubling", "--accuracy", 1, "-q", "--reciprocal", "-o", path]
    run("bake-brdf", *bake)
    return path


def pairs(count):
    random = np.random.default_rng(3)
    z = random.uniform(0.005, 1.0, (2, count))
    phi = random.uniform(0.0, 2.0 * np.pi, (2, count))
    sin = np.sqrt(1.0 - z * z)
    a, b = np.stack([sin * np.cos(phi), sin * np.sin(phi), z], axis=-1)
    near = a[::2] * [-1, -1, 1] + random.normal(0.0, 0.1, (len(a[::2]), 3))
    near[:, 2] = np.maximum(np.abs(near[:, 2]), 0.005)
    b[::2] = near / np.linalg.norm(near, axis=1, keepdims=True)
    return a, b


def tool(path, wi, wo):
    lines = "\n".join(json.dumps({"wi": a, "wo": b}) for a, b in zip(wi.tolist(), wo.tolist()))
    said = run("pearl", "eval", path, "--depth", 0, "--input", "-", input=lines).stdout
    return np.array([json.loads(line)["rgb"] for line in said.splitlines()])


def plugin(path, wi, wo):
    test_plugin.use_rgb()
    return test_plugin.plugin(test_plugin.load(path, depth=0.0), wi.astype(np.float32), wo.astype(np.float32))[0]


def test_the_defect_is_below_a_hundred_thousandth(table):
    a, b = pairs(200)
    # f·cos θi·cos θo both ways; the base is reciprocal at depth 0. The plugin counts in single precision.
    for evaluate, most in ((tool, 1e-9), (plugin, 1e-5)):
        there, back = evaluate(table, a, b) * a[:, 2:], evaluate(table, b, a) * b[:, 2:]
        assert np.abs(there - back).sum() / (there + back).sum() < most, evaluate.__name__
        bright = np.maximum(there, back) > 1e-3 * there.max()
        assert (np.abs(there - back) / np.maximum(there, back))[bright].max() < 10 * most, evaluate.__name__


def test_the_plugin_and_the_tool_agree(table):
    a, b = pairs(200)
    rust, found = tool(table, a, b), plugin(table, a, b)
    bright = rust > 1e-3 * rust.max()
    assert np.abs(found / rust - 1.0)[bright].max() < 1e-4


@pytest.fixture(scope="module")
def rough(tmp_path_factory):
    """Facets of 25°: light is far from its mirror direction, so that much of a lobe is read at the larger angle."""
    folder = tmp_path_factory.mktemp("rough")
    recipe = folder / "rough.json"
    recipe.write_text(json.dumps({
        "schema": "pearl-recipe/1", "stack": {"layers": 300}, "facets": {"slope_sd_deg": 25},
    }))  # fmt: skip
    run("bake-brdf", recipe, "--solver", "doubling", "--accuracy", 1, "-q", "--reciprocal", "-o", folder / "rough.exr")
    return folder / "rough.exr"


@pytest.mark.parametrize("variant", ["llvm_ad_rgb", "llvm_ad_spectral"])
def test_colours_and_every_component_of_rough_facets_are_those_of_the_evaluator(variant, rough):
    """What the lobes leave to the base takes their colours over all their light, read at the larger angle."""
    llvm.use(variant)
    wi, wo = test_plugin.random_pairs(4000, seed=8)
    args = ["--body-rgb", "1,1,1", "--coherence", 1, "--depth", 0]
    parameters = {"body_color": test_plugin.rgb([1.0] * 3), "coherence": 1.0, "depth": 0.0}
    for shown in ("diffuse,incoherent,mirror,blur", "diffuse", "mirror", "blur"):
        values, densities, _ = test_plugin.rust(rough, wi, wo, *map(str, args), "--components", shown)
        found, pdf = test_plugin.plugin(test_plugin.load(rough, components=shown, **parameters), wi, wo)
        for channel, expected in zip(found.T, test_plugin.expected_of(values).T):
            test_plugin.assert_close(channel, expected, shown)
        test_plugin.assert_close(pdf, densities, shown)


def test_the_checks_judge_it_and_the_bake_repeats_it(table):
    said = json.loads(run("lut", "check", table, "--json").stdout)
    finding = next(check for check in said["checks"] if check["check"] == "reciprocity")
    assert finding["pass"] is True and finding["worst"] <= 1e-5
    run("bake-brdf", "--reproduce", table)


@pytest.mark.parametrize("look", [[], ["--depth", "0", "--coherence", "0"], ["--depth", "0", "--coherence", "1"]])
def test_a_white_furnace_stays_white(table, look):
    """Read at the larger angle the lobes send back up to 0.2 % more or less than their albedo; the base makes up for it."""
    said = run("pearl", "furnace", table, "--body-rgb", "1,1,1", "--tint-rgb", "1,1,1", "--steps", 73, "--json", *look).stdout
    albedos = [albedo for row in json.loads(said)["per_incidence"] for albedo in row["albedo"]]
    assert max(albedos) <= 1.0 + 1e-4
    if look:
        assert min(albedos) >= 1.0 - 3e-4


def test_the_plugin_s_white_furnace_stays_white(table):
    """What samples of the plugin bring back from a white surrounding, by stratified numbers."""
    llvm.use("llvm_ad_rgb")
    white = {"type": "rgb", "value": [1.0] * 3}
    bsdf = mi.load_dict({"type": "pearl", "filename": str(table), "body_color": white, "depth": 0.0, "coherence": 1.0})
    random, side, batches = np.random.default_rng(4), 600, 16
    y, x = np.divmod(np.arange(side * side), side)
    for angle in (0.0, 60.0, 88.0):
        si = mi.SurfaceInteraction3f()
        si.wi = mi.Vector3f(float(np.sin(np.radians(angle))), 0.0, float(np.cos(np.radians(angle))))
        means = []
        for _ in range(batches):
            u, v = (x + random.random(side**2)) / side, (y + random.random(side**2)) / side
            lobe = random.permutation((np.arange(side**2) + random.random(side**2)) / side**2)
            _, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(lobe), mi.Point2f(u, v))
            means.append(np.array(weight).mean(axis=1))
        albedo, error = np.mean(means, axis=0), np.std(means, axis=0, ddof=1) / np.sqrt(batches)
        print(f"furnace of the plugin, reciprocal, {angle}°: {albedo} ± {error}")
        # Five standard errors of 16 batches: Student's t has 2e-4 beyond them.
        assert (albedo <= 1.0 + 1e-4 + 5 * error).all(), (angle, albedo, error)
        assert (albedo >= 1.0 - 3e-4 - 5 * error).all(), (angle, albedo, error)


def test_a_table_of_several_bands_is_refused(tmp_path):
    out = tmp_path / "out.exr"
    recipe = ROOT / "data" / "recipes" / "golden.json"
    arguments = [recipe, "--solver", "doubling", "--accuracy", 5, "--incident-deg", "0:90:30", "--reciprocal", "-o", out]
    done = run("bake-brdf", *arguments, expect=2)
    assert "dispersion" in done.stderr and len(done.stderr.splitlines()) == 1 and not out.exists()
    # Before anything is solved: a bake that nobody could wait for is refused as well.
    arguments[arguments.index("doubling")] = "walk"
    arguments[arguments.index("--accuracy") : arguments.index("--accuracy") + 2] = ["--paths", 10**10]
    done = run("bake-brdf", *arguments, expect=2, timeout=60)
    assert "dispersion" in done.stderr and len(done.stderr.splitlines()) == 1 and not out.exists()


def test_the_map_of_the_defect_tells_a_reciprocal_table_from_another(table, tmp_path):
    run("bake-brdf", "--solver", "doubling", "--accuracy", 0.5, "-q", "-o", tmp_path / "plain.exr")
    totals = []
    for path in (table, tmp_path / "plain.exr"):
        run("lut", "plot", path, "-o", tmp_path / "plots")
        assert (tmp_path / "plots" / "reciprocity.png").stat().st_size > 10_000
        found = json.loads((tmp_path / "plots" / "reciprocity.json").read_text())
        assert found["schema"] == "lut-reciprocity/1" and len(found["defect"]) == len(found["theta_deg"])
        totals.append(found["total"])
    assert totals[0] < 1e-12 and totals[1] > 1e-3


def test_it_does_not_go_with_light_from_below(tmp_path):
    out = tmp_path / "out.exr"
    done = run("bake-brdf", "--reciprocal", "--both-sides", "--solver", "doubling", "-o", out, expect=2)
    assert "--reciprocal" in done.stderr and "--both-sides" in done.stderr and not out.exists()
