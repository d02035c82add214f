#!/usr/bin/env python3
"""Times the plugin `pearl` against Mitsuba's stock `measured` at the same noise, same scene, both warm.

    python tools/compare/speed.py                 bakes the default pearl and exports it
    python tools/compare/speed.py --table T.exr   takes a table

A sphere in a studio, path tracing, rendered over and over with other seeds, the two in turn; the first pictures of both are
thrown away. What is compared is time × variance, which is the time to a given noise: the medians of the wall times, and the
variance of a pixel from the differences of pictures with other seeds. Of these times a matte sphere's is the part that no BSDF
can save; it is printed beside. Wants an idle machine. Exit codes: 0 at least twice as fast, 1 runtime failure, 2 wrong usage, 3 slower.
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "crates" / "python" / "examples"), str(pathlib.Path(__file__).parent)]

from tables import Bad, Tools  # noqa: E402

SCHEMA = "pearl-speed/1"
#: What is asked of the plugin: this many times the speed of `measured`.
ASKED = 2.0


class Way:
    """A BSDF on the sphere, and what rendering it took."""

    def __init__(self, bsdf, options):
        import mitsuba as mi
        import pearls

        self.options = options
        self.scene = mi.load_dict(pearls.scene(pearls.sphere(bsdf), size=options.size))
        self.seconds, self.pictures = [], []

    def render(self, seed):
        import drjit as dr
        import mitsuba as mi
        import numpy as np

        started = time.perf_counter()
        image = mi.render(self.scene, spp=self.options.spp, seed=seed)
        dr.eval(image)
        dr.sync_thread()
        self.seconds.append(time.perf_counter() - started)
        self.pictures.append(np.array(image)[:, :, :3].astype(float))

    def figures(self):
        """Median seconds a picture, and variance of a pixel, mean over pixels and channels."""
        import numpy as np

        pairs = zip(self.pictures[1::2], self.pictures[2::2])
        variance = float(np.mean([0.5 * ((a - b) ** 2).mean() for a, b in pairs]))
        return {"seconds": statistics.median(self.seconds[1:]), "variance": variance}


def race(variant, table, options, tools):
    """One line of figures for a variant."""
    import mitsuba as mi

    mi.set_variant(variant)
    import nacre.mitsuba  # noqa: F401

    form = "bsdf-spectral" if "spectral" in variant else "bsdf-rgb"
    exported = pathlib.Path(tools.folder) / f"{form}.bsdf"
    tools.run("lut", "export", table, "--to", form, "-o", exported)
    ways = {
        "matte": Way({"type": "diffuse"}, options),
        "pearl": Way({"type": "pearl", "filename": str(table)}, options),
        "measured": Way({"type": "measured", "filename": str(exported)}, options),
    }
    for seed in range(options.repeats + 1):
        for way in ways.values():
            way.render(seed)
    found = {name: way.figures() for name, way in ways.items()}
    cost = {name: figures["seconds"] * figures["variance"] for name, figures in found.items()}
    ratio = cost["measured"] / cost["pearl"]
    return {"variant": variant, **found, "ratio": ratio, "pass": ratio >= ASKED}


def show(line):
    """Prints a line of figures."""
    times = "   ".join(f"{way} {line[way]['seconds']:.3f} s" for way in ("matte", "pearl", "measured"))
    noise = line["pearl"]["variance"] / line["measured"]["variance"]
    print(f"{line['variant']:18}{times}   variance pearl/measured {noise:.3f}   "
          f"{line['ratio']:.2f} times as fast (asked {ASKED:g})", flush=True)  # fmt: skip


def arguments():
    parser = argparse.ArgumentParser(prog="speed", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--table", type=pathlib.Path, help="a table, instead of a fresh bake")
    parser.add_argument("--size", type=int, default=256, help="pixels a side [256]")
    parser.add_argument("--spp", type=int, default=64, help="samples a pixel [64]")
    parser.add_argument("--repeats", type=int, default=10, help="pictures of each, an even number [10]")
    parser.add_argument("--variants", default="llvm_ad_rgb,llvm_ad_spectral", metavar="LIST", help="separated by commas")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of lines")
    return parser.parse_args()


def main():
    options = arguments()
    for name in ("size", "spp", "repeats"):
        if getattr(options, name) < 1:
            raise Bad(f"--{name}: {getattr(options, name)} is not a count; expected at least 1")
    if options.repeats % 2:
        raise Bad(f"--repeats: {options.repeats} is odd; expected pairs, whose differences tell the noise")
    if options.table and not options.table.is_file():
        raise Bad(f"--table: {options.table} is not a file; `bake-brdf RECIPE -o pearl.exr` bakes one")
    import mitsuba as mi  # after the arguments: it takes a second to load
    import ways

    wanted = options.variants.split(",")
    for variant in wanted:
        if variant not in mi.variants() or not variant.endswith(("_ad_rgb", "_ad_spectral")):
            known = ", ".join(name for name in mi.variants() if name.endswith(("_ad_rgb", "_ad_spectral")))
            raise Bad(f"--variants: {variant!r} is none of {known}")
    with tempfile.TemporaryDirectory() as folder:
        tools = Tools(folder)
        try:
            table = options.table or tools.bake("pearl", 0.5)
            lines = []
            for variant in wanted:
                lines.append(race(variant, table, options, tools))
                if not options.json:
                    show(lines[-1])
        except ways.Refused as why:
            raise Bad(str(why)) from None
    passed = all(line["pass"] for line in lines)
    report = {"schema": SCHEMA, "processors": os.cpu_count(), "size": options.size, "spp": options.spp,
              "repeats": options.repeats, "asked": ASKED, "pass": passed, "lines": lines}  # fmt: skip
    if options.json:
        print(json.dumps(report))
    return 0 if passed else 3


if __name__ == "__main__":
    try:
        sys.exit(main())
    except Bad as why:
        print(f"speed: {why}", file=sys.stderr)
        sys.exit(2)
    except (OSError, RuntimeError, subprocess.SubprocessError) as why:
        print(f"speed: {str(why).strip().splitlines()[-1] if str(why) else why!r}", file=sys.stderr)
        sys.exit(1)
