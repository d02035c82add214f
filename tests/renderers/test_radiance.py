"""Radiance's own programs and its BSDF library read what `lut export --to radiance` writes.

Part of `cargo xtask renderers`, which installs pyradiance. The tools are found through NACRE_BIN, else in target/release.
"""

import json
import os
import pathlib
import subprocess

import numpy as np
import pyradiance
import pyradiance.bsdf
import pytest
from built import run

RADIANCE = pathlib.Path(pyradiance.__file__).parent
# The export's constants were chosen at 0, 30, 60 and 80°.
THETA_DEG = [0, 17.5, 30, 46.5, 60, 68.5, 73, 77.5, 80]
# Rays an angle, and paths that Radiance makes of each: it weights a path by the albedo, so that a few tell all.
RAYS, PATHS = 12, 24


def radiance(folder, program, *args, **keywords):
    environment = os.environ | {"RAYPATH": f".:{RADIANCE / 'lib'}", "PATH": f"{RADIANCE / 'bin'}:{os.environ['PATH']}"}
    done = subprocess.run([RADIANCE / "bin" / program, *map(str, args)], capture_output=True, cwd=folder, env=environment, **keywords)
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout


@pytest.fixture(scope="module", params=["paper", "akoya"])
def exported(request, tmp_path_factory):
    """A table, its file for Radiance, and what the export printed."""
    folder = tmp_path_factory.mktemp(request.param)
    run("bake-brdf", request.param, "--solver", "doubling", "--accuracy", 1, "-q", "-o", folder / "pearl.exr")
    report = json.loads(run("lut", "export", folder / "pearl.exr", "--to", "radiance", "--json", "-o", folder / "pearl.xml"))
    return folder, report


@pytest.fixture(scope="module")
def library(exported):
    """The file as Radiance's library has it, loaded once: it has crashed where it was loaded again."""
    folder, _ = exported
    return pyradiance.bsdf.load_file(str(folder / "pearl.xml"))


def seen(folder):
    """What a viewer at each angle sees of a white surrounding, linear sRGB."""
    rows = json.loads(run("pearl", "furnace", folder / "pearl.exr", "--steps", 180, "--json"))["per_incidence"]
    at = {round(row["theta_i_deg"], 3): row["albedo"] for row in rows}
    return np.array([at[theta] for theta in THETA_DEG])


def test_checkbsdf_finds_an_isotropic_tensor_tree_in_colour(exported):
    folder, _ = exported
    said = radiance(folder, "checkBSDF", "pearl.xml").decode()
    assert "Type: Isotropic_Tensor_Tree" in said and "Color: 1" in said, said
    # In front alone: what Radiance calls the interior.
    assert "Exterior Refl\t 0.0  0.0  0.0\t\t  0.0%" in said, said


def test_rtrace_sees_a_white_surrounding_as_the_table_does_to_a_hundredth(exported):
    folder, _ = exported
    (folder / "scene.rad").write_text(
        "void glow white\n0\n0\n4 1 1 1 0\n\nwhite source surrounding\n0\n0\n4 0 0 1 360\n\n"
        "void BSDF pearl\n6 0 pearl.xml 0 1 0 .\n0\n0\n\n"
        "pearl polygon sheet\n0\n0\n12 -1 -1 0  1 -1 0  1 1 0  -1 1 0\n"
    )
    (folder / "scene.oct").write_bytes(radiance(folder, "oconv", "scene.rad"))
    rays = "".join(f"{-np.sin(t):.9f} 0 {np.cos(t):.9f} {np.sin(t):.9f} 0 {-np.cos(t):.9f}\n" * RAYS for t in np.radians(THETA_DEG))
    found = radiance(folder, "rtrace", "-h", "-ab", 0, "-ss", PATHS, "-st", 0, "-lw", 1e-7, "-u+", "scene.oct", input=rays.encode())
    found = np.array(found.split(), float).reshape(len(THETA_DEG), RAYS, -1)[:, :, :3]
    error = found.std(axis=1) / np.sqrt(RAYS)
    mean, truth = found.mean(axis=1), seen(folder)
    print(np.round(100 * (mean / truth - 1), 2), np.round(100 * error / truth, 2))
    # 1 %, and three standard errors of Radiance's own paths.
    assert (error < 0.005 * truth).all(), error / truth
    assert (np.abs(mean - truth) < 0.01 * truth + 3 * error).all(), mean / truth


def test_the_mirror_direction_is_as_bright_as_the_table_says_to_3_per_cent(exported, library):
    folder, report = exported
    thetas = np.radians(THETA_DEG)
    pairs = [{"wi": [np.sin(t), 0, np.cos(t)], "wo": [-np.sin(t), 0, np.cos(t)]} for t in thetas]
    lines = run("pearl", "eval", folder / "pearl.exr", "--input", "-", input="\n".join(map(json.dumps, pairs)))
    truth = np.array([json.loads(line)["rgb"] for line in lines.splitlines()]) / np.cos(thetas)[:, None]
    # The viewer first, then the light.
    xyz = [pyradiance.bsdf.query(library, theta, 0, theta, 180) for theta in THETA_DEG]
    found = np.array([pyradiance.bsdf.xyz_rgb(*map(float, xyz)) for xyz in xyz])
    print(np.round(100 * (found / truth - 1), 2), report["bytes"], report["round_trip"]["worst_percent"])
    assert (np.abs(found - truth) < 0.03 * truth.max(axis=1, keepdims=True)).all(), found / truth


def test_radiances_library_reads_what_the_export_compared_with_the_table(exported, library):
    """The printed error, measured anew through Radiance's own reader on other directions."""
    folder, report = exported
    printed = {row["theta_i_deg"]: row["error_percent"] for row in report["round_trip"]["per_incidence"]}
    for theta_deg in [30.0, 64.7, 80.0]:
        theta = np.radians(theta_deg)
        wi = [np.sin(theta), 0.0, np.cos(theta)]
        drawn = run("pearl", "sample", folder / "pearl.exr", f"--wi={wi[0]},0,{wi[2]}", "-n", 1000, "--seed", 5)
        samples = [s for s in map(json.loads, drawn.splitlines()) if s["wo"]]
        lines = "\n".join(json.dumps({"wi": wi, "wo": s["wo"]}) for s in samples)
        values = map(json.loads, run("pearl", "eval", folder / "pearl.exr", "--input", "-", input=lines).splitlines())
        apart = light = 0.0
        for sample, value in zip(samples, values):
            x, y, z = sample["wo"]
            xyz = pyradiance.bsdf.query(library, theta_deg, 0, np.degrees(np.arccos(min(z, 1.0))), np.degrees(np.arctan2(y, x)))
            found = np.array(pyradiance.bsdf.xyz_rgb(*map(float, xyz))) * z
            apart += np.abs(found - value["rgb"]).sum() / sample["pdf"]
            light += np.sum(value["rgb"]) / sample["pdf"]
        error = 100 * apart / light
        # 1,000 directions for 4,096, and four digits of u' and v'.
        assert 0 < error < 1.25 * printed[theta_deg] + 0.3, (theta_deg, error, printed[theta_deg])
