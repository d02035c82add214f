"""Blender's Cycles renders what `lut export --to blender` writes as Mitsuba renders the table with the plugin.

Part of `cargo xtask renderers`, which installs Blender as a module and says in NACRE_BLENDERS which Python has which:
VERSION=PYTHON, with commas between. The tools are found through NACRE_BIN, else in target/release.
"""

import json
import os
import pathlib
import subprocess
import sys
import zipfile

import numpy as np
import pytest
import scenes_for_both
from built import ROOT, run

sys.path.insert(0, str(ROOT / "tools" / "compare"))
import colour

FOLDER = pathlib.Path(__file__).parent
BLENDERS = dict(entry.split("=", 1) for entry in os.environ["NACRE_BLENDERS"].split(","))
RECIPES = ["paper", "akoya", "mother-of-pearl"]
SCENES = [(shape, light) for shape in scenes_for_both.SHAPES for light in ("area", "environment")]
# Pictures are compared in blocks of pixels: noise adds to ΔE, and at these samples a block has a tenth of the limit of it.
SIZE, BLOCK, SAMPLES = 40, 2, 256
MEAN, MOST, ENERGY = 1.0, 3.0, 0.01


def blender(version, jobs, folder):
    """What Blender prints of jobs for in_blender.py."""
    file = folder / f"jobs-{version}.json"
    file.write_text(json.dumps(jobs, default=str))
    # Its own folders of settings and add-ons, not those of whoever runs this.
    environment = os.environ | {"BLENDER_USER_RESOURCES": str(folder / f"user-{version}"), "PYTHONPATH": ""}
    done = subprocess.run([BLENDERS[version], FOLDER / "in_blender.py", file], capture_output=True, text=True, env=environment)
    assert done.returncode == 0 and "done " in done.stdout, done.stdout[-2000:] + done.stderr[-4000:]
    return done.stdout


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A table and its file, by recipe: made once."""
    folder, made = tmp_path_factory.mktemp("blender"), {}

    def of(recipe):
        if recipe not in made:
            source = recipe
            if recipe == "thickness":
                akoya = json.loads((ROOT / "crates/bake-brdf/recipes/akoya.json").read_text())
                akoya["look"]["thickness"] = {}
                source = folder / "thickness.json"
                source.write_text(json.dumps(akoya))
            table, script = folder / f"{recipe}.exr", folder / f"{recipe}.py"
            run("bake-brdf", source, "--solver", "doubling", "--accuracy", 1, "-q", "-o", table)
            made[recipe] = table, script, json.loads(run("lut", "export", table, "--to", "blender", "--json", "-o", script))
        return made[recipe]

    return of


@pytest.fixture(scope="module")
def plugin(exported):
    """The picture of the plugin, in blocks; made once."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    import nacre.mitsuba  # noqa: F401

    made = {}

    def of(recipe, shape, light, **controls):
        key = json.dumps([recipe, shape, light, controls])
        if key not in made:
            rgb = lambda value: {"type": "rgb", "value": value} if isinstance(value, list) else value
            parameters = {name: rgb(value) for name, value in controls.items()}
            bsdf = mi.load_dict({"type": "pearl", "filename": str(exported(recipe)[0]), **parameters})
            made[key] = np.array(mi.render(mi.load_dict(scenes_for_both.for_mitsuba(shape, light, bsdf, SIZE, 2 * SAMPLES)), seed=3))
        return made[key]

    return of


def scene(tmp_path, shape, light):
    path = tmp_path / f"{shape}-{light}.npz"
    scenes_for_both.for_blender(shape, light, path)
    return path


def blocks(picture):
    """Means of blocks of pixels [block, channel], of those that the shape fills."""
    return picture.reshape(SIZE // BLOCK, BLOCK, SIZE // BLOCK, BLOCK, 4).mean(axis=(1, 3)).reshape(-1, 4)


def apart(found, truth):
    """ΔE00 of blocks, mean and 95 %, with the brightest hundredth at white; surplus of light."""
    found, truth = blocks(found), blocks(truth)
    full = (found[:, 3] > 0.9999) & (truth[:, 3] > 0.9999)
    assert full.sum() > 100
    found, truth = found[full, :3], truth[full, :3]
    white = np.quantile(truth, 0.99)
    difference = colour.delta_e(found / white, truth / white)
    return difference.mean(), np.quantile(difference, 0.95), found.sum() / truth.sum() - 1


@pytest.mark.parametrize("recipe", RECIPES)
@pytest.mark.parametrize("version", BLENDERS)
def test_pictures_are_those_of_the_plugin(version, recipe, exported, plugin, tmp_path):
    jobs = [{"open": exported(recipe)[1]}]
    for shape, light in SCENES:
        target = tmp_path / f"{shape}-{light}.npy"
        jobs.append({"render": target, "scene": scene(tmp_path, shape, light), "size": SIZE, "samples": SAMPLES, "seed": 1})
    blender(version, jobs, tmp_path)
    failed = []
    for shape, light in SCENES:
        mean, most, energy = apart(np.load(tmp_path / f"{shape}-{light}.npy"), plugin(recipe, shape, light))
        print(f"{version} {recipe} {shape} {light}: ΔE00 mean {mean:.2f}, 95 % {most:.2f}, light {100 * energy:+.2f} %")
        if mean > MEAN or most > MOST or abs(energy) > ENERGY:
            failed.append((shape, light, mean, most, energy))
    assert not failed, failed


# Blender's sockets; the plugin's parameters, and what they are before the control is moved.
MOVED = {
    "depth": ({"Depth": 1.0, "Brightness": 0.0}, {"depth": 1.0, "brightness": 0.0}, {"depth": 0.0, "brightness": 0.0}),
    "brightness": ({"Brightness": 0.4}, {"brightness": 0.4}, {}),
    "coherence": ({"Coherence": 1.0}, {"coherence": 1.0}, {}),
    "body": ({"Body Color": [0.3, 0.1, 0.5, 1.0]}, {"body_color": [0.3, 0.1, 0.5]}, {}),
    "tint": ({"Interference Tint": [1.0, 0.4, 0.2, 1.0]}, {"tint": [1.0, 0.4, 0.2]}, {}),
    "thickness": ({"Thickness": 0.9}, {"thickness": 0.9}, {}),
}


@pytest.mark.parametrize("version", BLENDERS)
def test_controls_do_what_they_do_in_the_plugin(version, exported, plugin, tmp_path):
    jobs, shot = [], scene(tmp_path, "sphere", "environment")
    for name, (sockets, _, _) in MOVED.items():
        jobs.append({"open": exported("thickness")[1]})
        jobs.append({"render": tmp_path / f"{name}.npy", "scene": shot, "size": SIZE, "samples": SAMPLES, "seed": 2, "controls": sockets})
    blender(version, jobs, tmp_path)
    for name, (_, parameters, before) in MOVED.items():
        truth = plugin("thickness", "sphere", "environment", **parameters)
        mean, most, energy = apart(np.load(tmp_path / f"{name}.npy"), truth)
        moved = apart(truth, plugin("thickness", "sphere", "environment", **before))[0]
        print(f"{version} {name}: ΔE00 mean {mean:.2f}, 95 % {most:.2f}, light {100 * energy:+.2f} %; the control moves it by {moved:.1f}")
        assert mean <= MEAN and most <= MOST and abs(energy) <= ENERGY, (name, mean, most, energy)
        # A socket that does nothing would be seen.
        assert mean < 0.5 * moved, (name, moved)


@pytest.mark.parametrize("version", BLENDERS)
def test_grain_roughens_what_is_smooth(version, exported, tmp_path):
    shot = scene(tmp_path, "sphere", "area")
    jobs = [{"open": exported("paper")[1]}]
    for grain in (0.0, 1.0):
        controls = {"Grain": grain, "Grain Scale": 8.0}
        jobs.append({"render": tmp_path / f"{grain}.npy", "scene": shot, "size": SIZE, "samples": 64, "seed": 2, "controls": controls})
    blender(version, jobs, tmp_path)
    smooth, grained = (np.load(tmp_path / f"{grain}.npy")[..., :3] for grain in (0.0, 1.0))
    assert np.abs(grained - smooth).mean() > 0.1 * smooth.mean()


@pytest.mark.parametrize("version", BLENDERS)
def test_a_white_surrounding_is_never_brighter(version, exported, tmp_path):
    jobs, shot = [], scene(tmp_path, "sphere", "white")
    for recipe in RECIPES:
        jobs.append({"open": exported(recipe)[1]})
        controls = {"Body Color": [1.0, 1.0, 1.0, 1.0], "Coherence": 1.0}
        jobs.append({"render": tmp_path / f"{recipe}.npy", "scene": shot, "size": SIZE, "samples": SAMPLES, "seed": 2, "controls": controls})
    blender(version, jobs, tmp_path)
    for recipe in RECIPES:
        seen = blocks(np.load(tmp_path / f"{recipe}.npy"))
        seen = seen[seen[:, 3] > 0.9999, :3]
        print(f"{version} {recipe}: from {seen.min():.3f} to {seen.max():.3f}, mean {seen.mean():.3f}")
        # All light comes back of a white body, to the error of the albedo; the brightest of some hundred blocks has noise on top.
        assert seen.mean() <= 1.0 and seen.max() < 1.02, (recipe, seen.mean(), seen.max())
        assert seen.mean() > 0.9, (recipe, seen.mean())


@pytest.mark.parametrize("version", BLENDERS)
def test_a_saved_material_opens_as_it_was(version, exported, tmp_path):
    shot = {"scene": scene(tmp_path, "sphere", "environment"), "size": SIZE, "samples": 16, "seed": 5}
    jobs = [{"run": exported("akoya")[1]}, {"render": tmp_path / "before.npy", **shot}]
    jobs += [{"save": tmp_path / "pearl.blend"}, {"render": tmp_path / "after.npy", **shot}]
    # The picture is packed: nothing else is needed.
    blender(version, jobs, tmp_path)
    before, after = (np.load(tmp_path / f"{name}.npy") for name in ("before", "after"))
    assert before[..., :3].max() > 0.1 and np.array_equal(before, after)


@pytest.mark.parametrize("version", BLENDERS)
def test_the_add_on_imports_and_refuses_what_is_no_pearl(version, exported, tmp_path):
    table, script, _ = exported("akoya")
    add_on = tmp_path / "pearl.zip"
    run("lut", "export", table, "--to", "blender-add-on", "-q", "-o", add_on)
    with zipfile.ZipFile(add_on) as archive:
        assert archive.read("__init__.py") == script.read_bytes()
    other = tmp_path / "other.py"
    other.write_text("raise SystemExit('was run')\n")
    shot = {"scene": scene(tmp_path, "sphere", "environment"), "size": SIZE, "samples": 16, "seed": 5}
    jobs = [{"add_on": add_on, "import": script}, {"render": tmp_path / "imported.npy", **shot}]
    jobs += [{"run": script}, {"render": tmp_path / "run.npy", **shot}, {"add_on": add_on, "import": other}, {"run": script}]
    said = blender(version, jobs, tmp_path)
    assert np.array_equal(*(np.load(tmp_path / f"{name}.npy") for name in ("imported", "run")))
    assert "refused" in said and "other.py: not a pearl: expected a file of schema pearl-blender/1" in said, said
