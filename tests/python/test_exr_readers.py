"""Stock OpenEXR readers see what `lut` sees, bit by bit, and need no formula.

The tools are found through NACRE_BIN (a folder with `bake-brdf` and `lut`), else in target/release.
"""

import json

import numpy as np
import pytest
from built import run

OpenEXR = pytest.importorskip("OpenEXR")
mi = pytest.importorskip("mitsuba")

LOBES = [f"{component}{suffix}" for component in ("interior", "surface", "rehit") for suffix in ("", "_std_error", "_count")]
COORDINATES = ["theta_i_deg", "theta_o_deg", "phi_deg", "weight_sr"]


@pytest.fixture(scope="module", params=["decay", "space"])
def table(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("table") / f"{request.param}.exr"
    run("bake-brdf", "--azimuth", request.param, "--paths", 20000, "--incident-deg", "0,30,75", "--seed", 11, "-q", "-o", path)
    return path


@pytest.fixture(scope="module")
def info(table):
    return json.loads(run("lut", "info", table, "--json"))


@pytest.fixture(scope="module")
def channels(table):
    """Channel name -> array [incidence, φ row, column], by the official OpenEXR package."""
    with OpenEXR.File(str(table), separate_channels=True) as file:
        assert len(file.parts) == 1
        rows = json.loads(file.header()["pearl"])["per_incidence"]
        pixels = {name: channel.pixels for name, channel in file.channels().items()}
    assert all(array.dtype == np.float32 for array in pixels.values())
    return {name: array.reshape(len(rows), -1, array.shape[1]) for name, array in pixels.items()}


def same_bits(a, b):
    a, b = np.asarray(a, np.float32), np.asarray(b, np.float32)
    return a.shape == b.shape and np.array_equal(a.view(np.uint32), b.view(np.uint32))


def test_every_channel_is_there_without_dots(channels, table):
    expected = set(LOBES + COORDINATES) | ({"exit_deg"} if table.stem == "decay" else set())
    assert set(channels) == expected
    assert not any("." in name for name in channels)


def test_the_attribute_is_ascii_json_and_what_info_prints(table, info):
    with OpenEXR.File(str(table), separate_channels=True) as file:
        text = file.header()["pearl"]
    assert text.isascii()
    meta = json.loads(text)
    assert meta["schema"] == "pearl-lut/1"
    for key, value in meta.items():
        assert info[key] == value, key


def test_mitsuba_sees_the_same_bits(table, channels):
    mi.set_variant("scalar_rgb")
    bitmap = mi.Bitmap(str(table))
    array = np.array(bitmap, copy=False)
    names = [field.name for field in bitmap.struct_()]
    assert sorted(names) == sorted(channels)
    for index, name in enumerate(names):
        assert same_bits(array[:, :, index].reshape(channels[name].shape), channels[name]), name
    assert json.loads(bitmap.metadata()["pearl"])["schema"] == "pearl-lut/1"


def test_slices_at_stored_directions_are_the_stored_bits(table, channels, info):
    for i, summary in enumerate(info["per_incidence"]):
        theta_i = channels["theta_i_deg"][i, 0, 0]
        assert theta_i == np.float32(summary["theta_i_deg"])
        phi = channels["phi_deg"][i]
        for azimuth in np.unique(phi):
            printed = json.loads(run("lut", "slice", table, "--theta-i", theta_i, "--phi", azimuth, "--json"))
            assert printed["stored"] is True
            here = phi == azimuth
            order = np.argsort(channels["theta_o_deg"][i][here], kind="stable")
            for name in LOBES:
                stored = channels[name][i][here][order]
                assert same_bits(printed[name], stored), (name, theta_i, azimuth)
            assert same_bits(printed["theta_o_deg"], channels["theta_o_deg"][i][here][order])


def test_values_times_weights_are_the_shares_of_light(channels, info):
    weight = channels["weight_sr"].astype(np.float64)
    for i, summary in enumerate(info["per_incidence"]):
        share = {name: float((channels[name][i].astype(np.float64) * weight[i]).sum()) for name in ("interior", "surface", "rehit")}
        # Rounding of f32 in values and weights, averaged over some hundred cells.
        assert share["surface"] == pytest.approx(summary["surface"], rel=1e-6)
        assert share["rehit"] == pytest.approx(summary["rehit"], rel=1e-6, abs=1e-12)
        assert share["interior"] + share["surface"] == pytest.approx(summary["albedo"], rel=1e-6)


def test_weights_cover_the_hemisphere(channels):
    # A lobe of 1/sr everywhere integrates to 2π, whatever the azimuth rule.
    total = channels["weight_sr"].astype(np.float64).sum(axis=(1, 2))
    np.testing.assert_allclose(total, 2 * np.pi, rtol=1e-6)


def test_counts_are_the_paths_that_were_reflected(channels, info):
    for i, summary in enumerate(info["per_incidence"]):
        counted = channels["interior_count"][i].sum() + channels["surface_count"][i].sum()
        # Without absorption every path that leaves the top is one count.
        assert counted == pytest.approx(summary["albedo"] * summary["paths"], abs=0.5)


# A reader written from docs/LUT-FORMAT.md alone, with nothing of ours.


def withdrawal(room, width):
    return np.hypot(room, width) - room


def stretched(lo, centre, hi, width, cells):
    """Position (in cells) of a coordinate on the axis of §3."""

    def position(x):
        if centre <= lo:
            return cells * np.arcsinh((x - lo) / width) / np.arcsinh((hi - lo) / width)
        room = np.where(x >= centre, hi - centre, centre - lo)
        side = np.sign(x - centre) * np.arcsinh(np.abs(x - centre) / width) / np.arcsinh(room / width)
        return 0.5 * cells * (1 + side)

    return position


def linear(values, position):
    """Step 1 of §4 along one axis."""
    return np.interp(position - 0.5, np.arange(len(values)), values)


def by_documentation(meta, channels, component, theta_i, theta_o, phi):
    """Steps 1 to 3 of §4 at a stored incidence; angles in degrees."""
    axis = meta["exit_axis"]
    i = [s["theta_i_deg"] for s in meta["per_incidence"]].index(theta_i)
    values = channels[component][i].astype(np.float64)
    w = axis["width"]
    ti, to, phi = np.radians([theta_i, theta_o, phi])
    half = np.pi / 2
    if axis["kind"] == "plane":
        position = stretched(-half, ti - withdrawal(half - ti, w) + withdrawal(half + ti, w), half, w, axis["cells"])
        width = np.radians(meta["per_incidence"][i]["azimuth_width_deg"])
        x = np.sin(ti) * np.sin(to) / width**2
        e = lambda phi: np.exp((np.cos(phi) - 1) * x)
        d = (e(phi) - e(np.pi)) / (1 - e(np.pi)) if x > 1e-6 else 0.5 * (1 + np.cos(phi))
        return linear(values[0], position(to)) * d + linear(values[0], position(-to)) * (1 - d)
    centre = ti - withdrawal(half - ti, w) + withdrawal(ti, w)
    column = stretched(0, centre, half, w, axis["theta_cells"])(to)
    row = stretched(0, 0, np.pi, w / np.tan(centre), axis["phi_cells"])(phi)
    return linear([linear(cells, column) for cells in values], row)


def test_a_reader_written_from_the_documentation_agrees(table, channels, info):
    for summary in info["per_incidence"]:
        theta_i = summary["theta_i_deg"]
        for phi in (3.0, 17.0, 64.0, 130.0):
            printed = json.loads(run("lut", "slice", table, "--theta-i", theta_i, "--phi", phi, "--json"))
            for component in ("interior", "surface"):
                read = [by_documentation(info, channels, component, theta_i, theta_o, phi) for theta_o in printed["theta_o_deg"]]
                peak = max(printed[component])
                # The correction at stored incidences is the rounding of f32.
                np.testing.assert_allclose(read, printed[component], rtol=1e-5, atol=1e-6 * peak)
