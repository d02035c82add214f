"""Scenes: the picture of the tables that a scene calls for is the picture of tables with every effect.

The copies that `bake-brdf --scene` writes are loaded by Mitsuba as they are.
"""

import json
import os
import pathlib
import subprocess

import numpy as np
import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]
BIN = pathlib.Path(os.environ.get("NACRE_BIN", ROOT / "target" / "release"))
SCENES = ROOT / "data" / "scenes"
PLANS = json.loads((SCENES / "plans.json").read_text())

pytest.importorskip("drjit")
mi = pytest.importorskip("mitsuba")
import llvm  # noqa: E402
import nacre.mitsuba  # noqa: E402, F401  (it registers the plugin when a variant is set)

VARIANT = {
    "grey-pearl": "llvm_ad_mono",
    "golden-spectral": "llvm_ad_spectral",
    "everything": "llvm_ad_spectral_polarized",
}


def use(variant):
    """The LLVM variant, or the scalar one where there is no LLVM."""
    if llvm.reason():
        variant = variant.replace("llvm_ad", "scalar")
    if variant not in mi.variants():
        pytest.skip(f"this Mitsuba has no {variant}")
    mi.set_variant(variant)


def bake(scene, folder, *flags):
    # Few incidences: what is compared is the same in both.
    terms = ["--solver", "auto", "--accuracy", "10", "--incident-deg", "0:90:10"]
    args = ["--scene", SCENES / f"{scene}.xml", "-o", folder, *terms, *flags, "--json", "-q"]
    done = subprocess.run([BIN / "bake-brdf", *map(str, args)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def picture(path):
    scene = mi.load_file(str(path), size=24, spp=16)
    return np.array(mi.render(scene, seed=7)).astype(float)


@pytest.mark.parametrize("scene", [name for name, pearls in PLANS.items() if pearls])
def test_the_pruned_bake_renders_the_picture_of_all_effects(scene, tmp_path):
    use(VARIANT.get(scene, "llvm_ad_rgb"))
    pictures = []
    for name, flags in {"pruned": [], "all": ["--effects", "all"]}.items():
        folder = tmp_path / name
        folder.mkdir()
        report = bake(scene, folder, *flags)
        tables = {table["file"]: set(table["effects"]) for table in report["baked"]}
        pictures.append((picture(folder / f"{scene}-baked.xml"), tables))
    (pruned, few), (full, many) = pictures
    assert np.isfinite(full).all() and full.max() > 0.05
    assert sum(map(len, few.values())) <= sum(map(len, many.values()))
    # Relative to the picture's mean, the mean absolute value of its channels (Stokes components may be negative).
    error = np.abs(pruned - full).max() / np.abs(full).mean()
    print(f"{scene}: pruned and full pictures differ by {error:.1e} of their mean at most")
    assert error < 1e-5, f"{scene}: {error}"


def test_leaving_out_what_is_seen_changes_the_picture(tmp_path):
    """The comparison above can fail."""
    use("llvm_ad_rgb")
    pictures = []
    for name, flags in {"whole": [], "less": ["--effects", "surface,blur,azimuth,body"]}.items():
        folder = tmp_path / name
        folder.mkdir()
        bake("paper-pearl", folder, *flags)
        pictures.append(picture(folder / "paper-pearl-baked.xml"))
    assert np.abs(pictures[0] - pictures[1]).max() / pictures[0].mean() > 1e-3
