#!/usr/bin/env python3
"""The picture of docs/hosts/blender.md: pearls in Blender above, in Mitsuba by the plugin below.

    NACRE_BLENDERS=5.0=PYTHON python tests/renderers/picture_blender.py -o docs/images/blender.png

PYTHON is one that has `bpy` (cargo xtask renderers makes target/renderers/blender-5.0/bin/python).
"""

import argparse
import pathlib
import sys
import tempfile

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

import scenes_for_both  # noqa: E402
from built import run  # noqa: E402
from test_blender import BLENDERS, blender  # noqa: E402

RECIPES = ["akoya", "mother-of-pearl", "golden"]
SIZE, SAMPLES = 160, 64


def main():
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    import nacre.mitsuba  # noqa: F401

    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("-o", "--output", type=pathlib.Path, required=True)
    output = options.parse_args().output
    with tempfile.TemporaryDirectory() as name:
        folder, columns = pathlib.Path(name), []
        scenes_for_both.for_blender("sphere", "environment", folder / "scene.npz")
        for recipe in RECIPES:
            table, script, made = (folder / f"{recipe}{end}" for end in (".exr", ".py", "-seen.npy"))
            run("bake-brdf", recipe, "--solver", "doubling", "--accuracy", 1, "-q", "-o", table)
            run("lut", "export", table, "--to", "blender", "-q", "-o", script)
            shot = {"render": made, "scene": folder / "scene.npz", "size": SIZE, "samples": SAMPLES, "seed": 1}
            blender(next(iter(BLENDERS)), [{"open": script}, shot], folder)
            bsdf = mi.load_dict({"type": "pearl", "filename": str(table)})
            scene = mi.load_dict(scenes_for_both.for_mitsuba("sphere", "environment", bsdf, SIZE, 2 * SAMPLES))
            above, below = np.load(made), np.array(mi.render(scene, seed=2))
            columns.append(np.concatenate([above, below])[..., :3] / np.quantile(below[..., :3], 0.99))
    mi.util.write_bitmap(str(output), mi.Bitmap(np.concatenate(columns, axis=1).astype(np.float32)), write_async=False)


if __name__ == "__main__":
    main()
