#!/usr/bin/env python3
"""Draws the pictures of docs/GALLERY.md and docs/PLUGIN.md: gallery.py TABLE -o docs/images [--spp N]

TABLE has the colours of interference; docs/GALLERY.md says which recipe each picture shows.
Needs a Mitsuba variant that runs here: llvm_ad_rgb, else scalar_rgb.
"""

import argparse
import pathlib

import mitsuba as mi
import numpy as np
import pearls  # noqa: E402

import nacre.mitsuba  # noqa: E402, F401

SWEEPS = {
    "depth": [0.0, 0.25, 0.5, 0.75, 1.0],
    "brightness": [0.0, 0.25, 0.5, 0.75, 1.0],
    "coherence": [0.0, 0.25, 0.5, 0.75, 1.0],
    "grain": [0.0, 0.5, 1.0, 2.0, 4.0],
    "body_color": [[0.8, 0.78, 0.75], [0.85, 0.6, 0.55], [0.75, 0.6, 0.25], [0.2, 0.3, 0.28], [0.03, 0.03, 0.035]],
    "tint": [[1, 1, 1], [1, 0.75, 0.75], [1, 0.9, 0.6], [0.7, 1, 0.8], [0.7, 0.8, 1]],
}


def pearl(table, grain=0.0, **parameters):
    """The BSDF; grain > 0 nests it in a bump map."""
    made = {"type": "pearl", "filename": table}
    for name, value in parameters.items():
        made[name] = {"type": "rgb", "value": value} if isinstance(value, list) else value
    if grain == 0.0:
        return made
    noise = np.random.default_rng(4).normal(0.5, 0.15, (160, 320, 1))
    smooth = sum(np.roll(noise, (a, b), (0, 1)) for a in (-1, 0, 1) for b in (-1, 0, 1)) / 9
    bitmap = mi.Bitmap(smooth.astype(np.float32))
    texture = {"type": "bitmap", "bitmap": bitmap, "raw": True}
    return {"type": "bumpmap", "arbitrary": texture, "scale": 0.02 * grain, "nested": made}


def save(folder, name, images):
    """One PNG of pictures side by side."""
    row = np.concatenate(images, axis=1)
    bitmap = mi.Bitmap(np.ascontiguousarray(row.astype(np.float32)))
    path = folder / f"{name}.png"
    bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, srgb_gamma=True).write(str(path))
    print(path)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table")
    parser.add_argument("-o", "--output", type=pathlib.Path, required=True)
    parser.add_argument("--spp", type=int, default=256)
    parser.add_argument("--variant", default="llvm_ad_rgb")
    parser.add_argument("--only", help="comma-separated names: components, sphere, sheet, plugin, sweep-NAME")
    options = parser.parse_args()
    mi.set_variant(options.variant)
    options.output.mkdir(parents=True, exist_ok=True)
    wanted = lambda name: options.only is None or name in options.only.split(",")  # noqa: E731
    ball = lambda size=160, **p: pearls.render(  # noqa: E731
        pearls.sphere(pearl(options.table, **p)), options.spp, size=size
    )
    if wanted("components"):
        rich = {"depth": 0.7, "coherence": 0.7}
        names = ("diffuse", "incoherent", "mirror", "blur", "all")
        save(options.output, "gallery-components", [ball(components=name, **rich) for name in names])
    if wanted("sphere"):
        save(options.output, "gallery-sphere", [ball(size=384, depth=0.7, coherence=0.7)])
    if wanted("sheet"):
        # On a darker body, so that the lobes show, as in the shells that such sheets are cut from.
        bsdf = pearl(options.table, depth=0.7, coherence=0.9, body_color=[0.35, 0.34, 0.33])
        save(options.output, "gallery-sheet", [pearls.render(pearls.sheet(bsdf), options.spp, size=512)])
    if wanted("plugin"):
        save(options.output, "plugin", [ball(size=320), ball(size=320, coherence=1.0, depth=1.0, body_color=[0.05] * 3)])
    if wanted("sweep-light"):
        look = {"depth": 0.6, "coherence": 0.6}
        lit = lambda place: pearls.environment(places=[(place, 0.6, 7.0)])  # noqa: E731
        shape = pearls.sphere(pearl(options.table, **look))
        places = (-2.4, -1.2, 0.0, 1.2, 2.4)
        pictures = [pearls.render(shape, options.spp, size=160, light=lit(place)) for place in places]
        save(options.output, "gallery-light", pictures)
    for name, values in SWEEPS.items():
        if wanted(f"sweep-{name}"):
            base = {"depth": 0.6, "coherence": 0.6}
            if name == "depth":
                base["brightness"] = 0.3  # it is the body's light that changes
            save(options.output, f"gallery-{name}", [ball(**{**base, name: value}) for value in values])


if __name__ == "__main__":
    main()
