"""The page of `pearl studio` renders what the plugin renders: part of `cargo xtask long`, up to half an hour on two cores.

Sphere and sheet, environment, area and point light, coherence and depth 0 and 1, the
paper's pearl, Akoya, and a space table.
"""

import pathlib
import sys

import pytest
from built import ROOT, run

sys.path.insert(0, str(ROOT / "tools" / "compare"))

mi = pytest.importorskip("mitsuba")
import browser  # noqa: E402

MISSING = browser.reason() and f"the page's pictures are NOT TESTED: {browser.reason()}"
BODY = [0.8, 0.78, 0.75]
#: Recipe, how it is baked, and looks: depth, coherence.
CASES = {
    "paper": ("paper", ["--azimuth", "decay"], [(0.0, 1.0), (1.0, 0.0)]),
    "akoya": ("akoya", ["--azimuth", "decay"], [(0.5, 0.4)]),
    "space": ("paper", ["--azimuth", "space"], [(0.0, 0.0)]),
}


@pytest.mark.skipif(bool(MISSING), reason=str(MISSING))
def test_the_page_renders_what_the_plugin_does(tmp_path):
    mi.set_variant("llvm_ad_rgb")
    import converged
    import scenes
    import ways
    from tables import Tools

    import nacre.mitsuba  # noqa: F401

    worst = []
    with Tools(tmp_path) as tools:
        for name, (recipe, how, looks) in CASES.items():
            table = pathlib.Path(tmp_path) / f"{name}.exr"
            run("bake-brdf", ROOT / "data" / "recipes" / f"{recipe}.json", "--solver", "doubling", "--accuracy", 1, *how, "-q", "-o", table)
            page = converged.Page(table, {"depth": 0, "brightness": 1, "coherence": 0, "body": BODY}, tools)
            for depth, coherence in looks:
                parameters = {"depth": depth, "brightness": 1.0, "coherence": coherence, "body": BODY}
                page.paint(parameters)
                plugin = ways.Plugin(table, parameters, tools)
                for scene in scenes.SCENES:
                    found = converged.figures(page, plugin, scene)
                    said = ", ".join(f"{what} {100 * value:.3f} %" for what, value in found.items())
                    print(f"{name}, depth {depth:g}, coherence {coherence:g}, {scene.name}: {said}", flush=True)
                    if any(abs(found[figure]) > limit for figure, limit in converged.LIMIT.items()):
                        worst.append((name, depth, coherence, scene.name, found))
            page.close()
    assert not worst, worst
