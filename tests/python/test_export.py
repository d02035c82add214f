"""Stock Mitsuba reads what `lut export` writes: its `measured` BSDF says what the table says, to the error that the export
printed.

The tools are found through NACRE_BIN (a folder with `bake-brdf`, `lut` and `pearl`), else in target/release.
"""

import json

import numpy as np
import pytest
from built import run

mi = pytest.importorskip("mitsuba")

THETA_I_DEG = [0.0, 30.0, 64.7, 80.0, 85.5, 88.5]
# Of the file (the middles of its bands of 5 nm) and between them.
WAVELENGTHS_NM = [442.5, 444.1, 596.0, 665.0]
SAMPLES = 600


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    path = tmp_path_factory.mktemp("export") / "pearl.exr"
    run("bake-brdf", "--solver", "doubling", "--accuracy", 1, "-q", "-o", path)
    return path


def pairs(table, theta_i_deg):
    """Exit directions as the table samples them, with what it says there: wi, [(wo, pdf, rgb, spectral)]."""
    theta = np.radians(theta_i_deg)
    wi = [float(0.6 * np.sin(theta)), float(-0.8 * np.sin(theta)), float(np.cos(theta))]
    drawn = run("pearl", "sample", table, f"--wi={wi[0]},{wi[1]},{wi[2]}", "-n", SAMPLES, "--seed", 5)
    samples = [s for s in map(json.loads, drawn.splitlines()) if s["wo"]]
    lines = "\n".join(json.dumps({"wi": wi, "wo": s["wo"]}) for s in samples)
    nm = ",".join(map(str, WAVELENGTHS_NM))
    values = [json.loads(line) for line in run("pearl", "eval", table, "--input", "-", "--wavelengths-nm", nm, input=lines).splitlines()]
    return wi, [(s["wo"], s["pdf"], v["rgb"], v["spectral"]) for s, v in zip(samples, values)]


@pytest.mark.parametrize("kind, variant", [("rgb", "scalar_rgb"), ("spectral", "scalar_spectral")])
def test_measured_evaluates_and_samples_the_exported_file(table, tmp_path, kind, variant):
    mi.set_variant(variant)
    path = tmp_path / "pearl.bsdf"
    report = json.loads(run("lut", "export", table, "--to", f"bsdf-{kind}", "--json", "-o", path))
    printed = {row["theta_i_deg"]: row["error_percent"] for row in report["round_trip"]["per_incidence"]}
    bsdf = mi.load_dict({"type": "measured", "filename": str(path)})
    context, surface = mi.BSDFContext(), mi.SurfaceInteraction3f()
    if kind == "spectral":
        surface.wavelengths = WAVELENGTHS_NM
    for theta_i_deg in THETA_I_DEG:
        wi, drawn = pairs(table, theta_i_deg)
        surface.wi = wi
        found = np.array([np.array(bsdf.eval(context, surface, mi.Vector3f(*wo))).ravel() for wo, *_ in drawn])
        truth = np.array([rgb if kind == "rgb" else spectral for *_, rgb, spectral in drawn])
        pdf = np.array([pdf for _, pdf, *_ in drawn])[:, None]
        light = (truth / pdf).sum()
        error = 100 * (np.abs(found - truth) / pdf).sum() / light
        # Other directions than the export's 4,096, and four wavelengths for 37: half as much again, and f32 on top.
        assert 0 < error < 1.5 * printed[theta_i_deg] + 0.1, (theta_i_deg, error, printed[theta_i_deg])
        assert printed[theta_i_deg] < (0.5 if theta_i_deg <= 80 else 3), (theta_i_deg, printed[theta_i_deg])
        # What its sampling finds is the albedo of what it evaluates: 5 standard errors.
        random = np.random.default_rng(9)
        weights = []
        for u, v, w in random.random((4 * SAMPLES, 3)):
            sample, weight = bsdf.sample(context, surface, float(u), mi.Point2f(v, w))
            weights.append(np.array(weight).ravel().mean() if sample.wo.z > 0 else 0.0)
        albedo = light / truth.shape[1] / SAMPLES
        spread = 5 * np.std(weights) / np.sqrt(len(weights)) + 5 * np.std((truth / pdf).mean(1)) / np.sqrt(SAMPLES)
        assert abs(np.mean(weights) - albedo) < spread + 0.01 * albedo, (theta_i_deg, np.mean(weights), albedo)


def test_merl_has_the_size_and_the_sign_of_its_readers(table, tmp_path):
    path = tmp_path / "pearl.binary"
    run("lut", "export", table, "--to", "merl", "-q", "-o", path)
    raw = path.read_bytes()
    assert np.frombuffer(raw, "<i4", 3).tolist() == [90, 90, 180]
    values = np.frombuffer(raw, "<f8", offset=12).reshape(3, 90, 90, 180)
    assert np.isfinite(values).all()
    # Bin of half vector 0: both directions are at θd, always above the horizon; far bins at grazing are below it.
    assert (values[:, 0] > 0).all() and (values[:, 89, 89] < 0).any()
