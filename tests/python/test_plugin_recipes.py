"""Mitsuba scenes that name a recipe: what is baked, what is kept, and what happens where it cannot be kept."""

import json
import os
import pathlib
import re
import subprocess
import sys
import time

import numpy as np
import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]
mi = pytest.importorskip("mitsuba")
import llvm  # noqa: E402  (it needs drjit)

import nacre  # noqa: E402
import nacre.cache  # noqa: E402
import nacre.mitsuba  # noqa: E402

LLVM_MISSING = llvm.missing("the page's script is")
#: Bakes in a tenth of a second.
THIN = {"name": "thin", "stack": {"layers": 6}, "facets": {"slope_sd_deg": 8}, "look": {"depth": 0.0, "coherence": 0.0, "body_rgb": [0.5, 0.5, 0.5]}}
RENDER = """
import sys, mitsuba as mi, numpy as np, nacre.mitsuba
mi.set_variant("scalar_rgb")
scene = mi.load_dict({
    "type": "scene", "integrator": {"type": "path", "max_depth": 3}, "light": {"type": "constant"},
    "sensor": {"type": "perspective", "to_world": mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0]),
               "film": {"type": "hdrfilm", "width": 8, "height": 8}, "sampler": {"type": "independent", "sample_count": 4}},
    "pearl": {"type": "sphere", "bsdf": {"type": "pearl", "recipe": sys.argv[1]}},
})
np.save(sys.argv[2], np.array(mi.render(scene, seed=1)))
"""


@pytest.fixture
def cache(tmp_path, monkeypatch):
    folder = tmp_path / "cache"
    monkeypatch.setenv("NACRE_CACHE_DIR", str(folder))
    monkeypatch.setattr(nacre.cache, "_in_memory", {})
    return folder


@pytest.fixture
def recipe(tmp_path):
    path = tmp_path / "thin.json"
    path.write_text(json.dumps(THIN))
    return path


def pearl(recipe, **parameters):
    mi.set_variant("scalar_rgb")
    return mi.load_dict({"type": "pearl", "recipe": str(recipe), **parameters})


def effects_of(bsdf):
    return set(bsdf.table.meta["effects"])


@pytest.mark.skipif(bool(LLVM_MISSING), reason=LLVM_MISSING or "")
def test_the_script_of_the_page_renders_a_pearl(cache, tmp_path):
    page = (ROOT / "docs" / "PLUGIN.md").read_text()
    script = re.search(r"^```python\n(.*?)^```", page, re.S | re.M)[1]
    # Fewer samples: what is on the picture is the same.
    script = script.replace("spp=128", "spp=8")
    env = {**os.environ, "NACRE_CACHE_DIR": str(cache)}
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    picture = np.array(mi.Bitmap(str(tmp_path / "pearl.png")))
    assert picture.shape[:2] == (256, 256) and picture.std() > 10
    assert [path.name.split("-")[0] for path in cache.iterdir()] == ["akoya"]


def test_the_dictionary_of_the_page_is_that_of_its_scene(cache, recipe, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    nacre.bake(recipe, solver="auto", effects="all").save("pearl.exr")
    mi.set_variant("scalar_rgb")
    mi.util.write_bitmap("grain.png", mi.Bitmap(np.full((4, 4), 0.5, np.float32)))
    page = (ROOT / "docs" / "PLUGIN.md").read_text()
    dictionary = re.findall(r"^```python\n(texture = .*?)^```", page, re.S | re.M)[0]
    scene = re.search(r"^```xml\n(.*?)^```", page, re.S | re.M)[1]
    names: dict[str, object] = {}
    exec(dictionary, names)
    wanted = mi.load_string(scene.replace('<bsdf type="bumpmap">', '<bsdf version="3.0.0" type="bumpmap">', 1))
    assert str(mi.load_dict(names["grained"])) == str(wanted)


def test_a_recipe_gives_what_its_table_gives(cache, recipe, tmp_path):
    bsdf = pearl(recipe)
    nacre.bake(recipe, solver="auto").save(tmp_path / "table.exr")
    mi.set_variant("scalar_rgb")
    table = mi.load_dict({"type": "pearl", "filename": str(tmp_path / "table.exr")})
    si = mi.SurfaceInteraction3f()
    for wi, wo in (([0.6, 0, 0.8], [-0.5, 0.1, 0.86]), ([0, 0, 1], [0.1, 0, 0.995])):
        si.wi = wi
        np.testing.assert_array_equal(bsdf.eval(mi.BSDFContext(), si, wo), table.eval(mi.BSDFContext(), si, wo))
    assert "recipe thin" in str(bsdf)
    # A file beside the scene is found as its other files are.
    scene = tmp_path / "scene.xml"
    scene.write_text(
        '<scene version="3.0.0"><bsdf type="pearl" id="p"><string name="recipe" value="thin.json"/></bsdf>'
        '<shape type="sphere"><ref id="p"/></shape></scene>'
    )
    assert "recipe thin" in str(mi.load_file(str(scene)).shapes()[0].bsdf())


def test_what_is_baked_follows_controls_components_and_variant(cache, recipe):
    assert effects_of(pearl(recipe)) == {"surface", "blur", "azimuth", "body"}
    assert "coherent" in effects_of(pearl(recipe, coherence=0.5))
    assert "emission" in effects_of(pearl(recipe, depth=0.5)) and "coherent" not in effects_of(pearl(recipe, depth=0.5))
    assert "blur" not in effects_of(pearl(recipe, components="mirror"))
    decided = nacre.effects(recipe, {"components": ["mirror"], "variant": "scalar_rgb"})
    assert not decided["blur"]["on"] and "look" in decided["blur"]["why"]
    assert nacre.effects("golden", {"variant": "llvm_ad_spectral"})["dispersion"]["on"]


LOOKS = [
    {},
    {"depth": 0.7, "brightness": 0.0},
    {"coherence": 1.0, "components": "mirror,blur"},
    {"components": "mirror"},
    {"components": "diffuse"},
    {"depth": 0.5, "coherence": 0.5, "body_color": {"type": "rgb", "value": [0.0, 0.0, 0.0]}},
]


@pytest.fixture(scope="module")
def everything(tmp_path_factory):
    """A table of all effects."""
    path = tmp_path_factory.mktemp("everything") / "all.exr"
    nacre.bake(THIN, solver="auto", effects="all").save(path)
    return path


@pytest.mark.parametrize("look", LOOKS, ids=str)
def test_what_is_left_out_does_not_show(cache, recipe, everything, look):
    """The plugin on what is baked for a look is the plugin on a table of every effect: but for rounding where the lobes are the same, but
    for what reading may miss where one is left out, as rows and cells are placed for what is there."""
    pruned = pearl(recipe, **look)
    whole = mi.load_dict({"type": "pearl", "filename": str(everything), **look})
    assert effects_of(pruned) < effects_of(whole)
    si = mi.SurfaceInteraction3f()
    for wi, wo in (([0.6, 0, 0.8], [-0.5, 0.1, 0.86]), ([0, 0, 1], [0.1, 0, 0.995]), ([0.9, 0, 0.436], [-0.89, 0.02, 0.456])):
        si.wi = wi
        values = [np.array(bsdf.eval(mi.BSDFContext(), si, wo)).ravel() for bsdf in (pruned, whole)]
        assert values[1].max() > 0
        np.testing.assert_allclose(*values, rtol=1e-5 if "blur" in effects_of(pruned) or not pruned.shown[2] else 1e-2)


def test_a_pearl_that_names_nothing_is_the_papers(cache):
    mi.set_variant("scalar_rgb")
    bsdf = mi.load_dict({"type": "pearl", "brightness": 0.0, "depth": 0.0})
    assert "recipe paper" in str(bsdf) and effects_of(bsdf) == {"body"}


def test_a_control_that_needs_more_bakes_it_then(cache, recipe):
    bsdf = pearl(recipe)
    assert "coherent" not in effects_of(bsdf)
    parameters = mi.traverse(bsdf)
    parameters["coherence"] = 0.8
    parameters.update()
    assert "coherent" in effects_of(bsdf)
    si = mi.SurfaceInteraction3f()
    si.wi = [0.6, 0, 0.8]
    expected = pearl(recipe, coherence=0.8).eval(mi.BSDFContext(), si, [-0.5, 0.1, 0.86])
    np.testing.assert_allclose(bsdf.eval(mi.BSDFContext(), si, [-0.5, 0.1, 0.86]), expected, rtol=1e-6)


def color(value):
    return {"type": "rgb", "value": [value] * 3}


@pytest.mark.parametrize("first, name, value, whole", [
    ({"brightness": 0.0}, "brightness", 1.0, {"brightness": 1.0}),
    ({"body_color": color(0.0), "components": "diffuse"}, "body_color.value", [0.5] * 3, {"body_color": color(0.5), "components": "diffuse"}),
])  # fmt: skip
def test_lobes_that_a_moved_control_calls_for_are_baked_then(cache, recipe, first, name, value, whole):
    bsdf = pearl(recipe, **first)
    assert "blur" not in effects_of(bsdf)
    parameters = mi.traverse(bsdf)
    parameters[name] = mi.Color3f(value) if isinstance(value, list) else value
    parameters.update()
    si = mi.SurfaceInteraction3f()
    si.wi = [0.6, 0, 0.8]
    expected = pearl(recipe, **whole).eval(mi.BSDFContext(), si, [-0.5, 0.1, 0.86])
    np.testing.assert_allclose(bsdf.eval(mi.BSDFContext(), si, [-0.5, 0.1, 0.86]), expected, rtol=1e-6)


def test_a_lut_that_was_set_outlives_a_later_bake(cache, recipe):
    bsdf = pearl(recipe)
    parameters = mi.traverse(bsdf)
    darker = 0.5 * np.array(parameters["lut"])
    parameters["lut"] = mi.TensorXf(darker)
    parameters.update()
    parameters["coherence"] = 1.0
    parameters.update()
    assert "coherent" in effects_of(bsdf)
    np.testing.assert_array_equal(np.array(mi.traverse(bsdf)["lut"]), darker)
    other = pearl(recipe, coherence=1.0, components="blur")
    si = mi.SurfaceInteraction3f()
    si.wi = [0.6, 0, 0.8]
    blur = mi.BSDFContext()
    blur.component = 3
    value = lambda bsdf: np.array(bsdf.eval(blur, si, [-0.5, 0.1, 0.86])).ravel()
    np.testing.assert_allclose(value(bsdf), 0.5 * value(other), rtol=1e-5)


def test_any_thickness_of_the_range_will_do_where_no_interference_is_shown(cache, recipe):
    bsdf = pearl(recipe, thickness=1.2)
    assert bsdf.table.scales is None
    pearl(recipe, thickness={"type": "checkerboard", "color0": 0.9, "color1": 1.1})
    parameters = mi.traverse(bsdf)
    parameters["thickness"] = 0.9
    parameters.update()
    for scale in (0.5, 1.5, float("nan")):
        with pytest.raises(RuntimeError, match=f"thickness: is {scale:g}; expected a number from 0.7 to 1.4"):
            pearl(recipe, thickness=scale)
    parameters["coherence"] = 1.0
    parameters.update()
    assert bsdf.table.scales is not None


def test_tables_are_kept_and_found_again(cache, recipe, monkeypatch):
    first = nacre.cache.table(nacre.Recipe(recipe))
    [entry] = cache.iterdir()
    nacre.cache._in_memory.clear()
    monkeypatch.setattr(nacre.cache, "bake", lambda *_, **__: pytest.fail("baked again"))
    assert nacre.cache.table(nacre.Recipe(recipe)) == first
    # Another recipe, look or build is another entry.
    monkeypatch.undo()
    monkeypatch.setenv("NACRE_CACHE_DIR", str(cache))
    nacre.cache._in_memory.clear()
    nacre.cache.table(nacre.Recipe({**THIN, "stack": {"layers": 8}}))
    nacre.cache.table(nacre.Recipe(recipe), {"coherence": 1.0})
    assert len(list(cache.iterdir())) == 3 and entry.exists()


@pytest.mark.parametrize("damage", [
    lambda data: b"", lambda data: data[:2000], lambda data: data[:3000] + bytes(400) + data[3400:],
    # A table still, of another body colour.
    lambda data: data.replace(b"[0.5,0.5,0.5]", b"[0.9,0.5,0.5]"),
])  # fmt: skip
def test_a_damaged_entry_is_baked_again(cache, recipe, damage):
    table = nacre.cache.table(nacre.Recipe(recipe)).to_bytes()
    [entry] = cache.iterdir()
    whole = entry.read_bytes()
    assert whole.startswith(table) and damage(whole) != whole
    entry.write_bytes(damage(whole))
    nacre.cache._in_memory.clear()
    assert nacre.cache.table(nacre.Recipe(recipe)).to_bytes() == table
    assert entry.read_bytes() == whole


@pytest.mark.parametrize("most", ["much", "-1", "nan"])
def test_a_bound_of_the_folder_that_is_none_is_refused(cache, recipe, monkeypatch, most):
    monkeypatch.setenv("NACRE_CACHE_MB", most)
    with pytest.raises(nacre.InputError, match=f"NACRE_CACHE_MB: '{most}' is not valid, expected megabytes"):
        nacre.cache.table(nacre.Recipe(recipe))


def test_the_folder_is_bounded(cache, recipe, monkeypatch):
    size = len(nacre.cache.table(nacre.Recipe(recipe)).to_bytes())
    monkeypatch.setenv("NACRE_CACHE_MB", str(2.5 * size / 1e6))
    # Of a process that was killed while it wrote.
    part = cache / ".nacre-x1y2z3.part"
    part.write_bytes(bytes(size))
    for layers in (8, 10, 12):
        os.utime(next(cache.glob("thin-*")), None)
        time.sleep(0.02)
        nacre.cache.table(nacre.Recipe({**THIN, "stack": {"layers": layers}}))
    assert sum(path.stat().st_size for path in cache.iterdir()) <= 2.6 * size and len(list(cache.iterdir())) == 2


def test_a_folder_that_cannot_be_written_costs_a_line(tmp_path, recipe, monkeypatch, capfd):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("NACRE_CACHE_DIR", str(tmp_path / "file" / "cache"))
    monkeypatch.setattr(nacre.cache, "_in_memory", {})
    assert "Pearl[" in str(pearl(recipe))
    [line] = capfd.readouterr().err.strip().splitlines()
    assert line.startswith("nacre: ") and "cannot keep the table of thin" in line


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of file sizes")
def test_a_full_disk_costs_a_line(cache, recipe):
    """Files end at a kilobyte: what a disk without room does to a table."""
    code = (
        "import resource, sys, nacre; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000)); "
        "table = nacre.cache.table(nacre.Recipe(sys.argv[1])); print(table.meta['recipe']['name'])"
    )
    env = {**os.environ, "NACRE_CACHE_DIR": str(cache)}
    done = subprocess.run([sys.executable, "-c", code, recipe], env=env, capture_output=True, text=True)
    assert done.stdout == "thin\n", done.stderr
    assert "cannot keep the table of thin" in done.stderr.splitlines()[-1] and list(cache.iterdir()) == []


def test_processes_share_the_folder(cache, recipe, tmp_path):
    """Two that bake the same recipe at once, one that is killed on the way, and one after them: the same picture."""
    command = lambda name: [sys.executable, "-c", RENDER, recipe, tmp_path / f"{name}.npy"]
    env = {**os.environ, "NACRE_CACHE_DIR": str(cache)}
    killed = subprocess.Popen(command("killed"), env=env)
    time.sleep(1.0)
    killed.kill()
    killed.wait()
    both = [subprocess.Popen(command(name), env=env) for name in ("one", "two")]
    assert [process.wait() for process in both] == [0, 0]
    subprocess.run(command("after"), env=env, check=True)
    pictures = [np.load(tmp_path / f"{name}.npy") for name in ("one", "two", "after")]
    # Threads add to the film in any order.
    np.testing.assert_allclose(pictures[0], pictures[1], rtol=1e-5)
    np.testing.assert_allclose(pictures[0], pictures[2], rtol=1e-5)
    assert pictures[0].mean() > 0.1
    assert [path.suffix for path in cache.iterdir()] == [".exr"]
