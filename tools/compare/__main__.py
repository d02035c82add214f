#!/usr/bin/env python3
"""Renders the same scenes five ways and says by how much the pictures differ.

    python tools/compare --quick -o compare      under three minutes; what CI runs
    python tools/compare -o compare              the full comparison, for releases

  a  Mitsuba's stock `measured` on the file that `lut export` writes
  b  the plugin `pearl`
  c  a stochastic walk through the stack, written in Dr.Jit, with no table at all
  d  the evaluator of the tool `pearl`
  e  the page of `pearl studio`, in chromium: only where it is asked for, as it takes minutes

Writes DIR/index.html (pictures, differences, a verdict a line) and DIR/compare.json, and prints the lines. The tools are
found through NACRE_BIN, else in target/release. Exit codes: 0 all limits kept, 1 runtime failure, 2 wrong usage, or a way
that was asked for cannot answer at all, 3 a limit is passed.
"""

import argparse
import json
import pathlib
import subprocess
import sys
import tempfile
import time
from typing import Any

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

from tables import CASES, Bad, Tools  # noqa: E402

SCHEMA = "pearl-compare/1"
#: Wavelengths of spectral pictures, nm: where the body's spectrum is flat over neighbouring bands.
BANDS = [450.0, 520.0, 550.0, 640.0]
#: Relative RMSE and mean of (a) against (b): the interpolation of another program's 64² warped nodes.
LIMIT_MEASURED = {"relative RMSE": 5e-3, "mean ratio − 1": 1e-3}
#: (d) against (b): the same formulas in double and in single precision.
LIMIT_RUST = {"relative RMSE": 1e-4, "mean ratio − 1": 1e-5}
#: Samples a pixel that (d) is asked for.
THINNED = 16
#: (c) against (b): probability of a χ² over tiles as large as seen, if both estimate the same picture.
SMALLEST_P = 1e-3
#: Walks that found light, as expected in a patch of tiles, from which a sum counts as normal.
HITS = 100


def line(scene, ways, figure, value, limit, kept, **more):
    return {"scene": scene, "ways": ways, "figure": figure, "value": value, "limit": limit,
            "verdict": {True: "pass", False: "fail", None: "refused"}[kept], **more}  # fmt: skip


def against(key, way, image, reference, limits):
    """Lines of one picture against that of the plugin."""
    import colour
    import numpy as np

    lit = reference.sum(axis=1) > 0
    rmse = float(np.sqrt(((image - reference)[lit] ** 2).mean()) / reference[lit].mean())
    mean = float(image.mean() / reference.mean() - 1)
    lines = [
        line(key, f"{way}|b", "relative RMSE", rmse, limits["relative RMSE"], rmse <= limits["relative RMSE"]),
        line(key, f"{way}|b", "mean ratio − 1", mean, limits["mean ratio − 1"], abs(mean) <= limits["mean ratio − 1"]),
    ]
    if image.shape[1] == 3:
        # Exposed so that the brightest hundredth reaches white.
        white = max(float(np.quantile(reference[lit], 0.99)), 1e-9)
        worst = float(np.quantile(colour.delta_e(image[lit] / white, reference[lit] / white), 0.99))
        lines.append(line(key, f"{way}|b", "ΔE00, 99 % of pixels below", worst, None, True))
    return lines


def patches(expected_hits, tiles):
    """Numbers of patches of neighbouring tiles, one a tile: each expects at least HITS walks that found light.

    Tiles are taken along Morton's curve, so that a patch hangs together. A sum of fewer hits is far from normal, and its variance
    as seen goes with it: where none was found, nothing is said of how many there could have been.
    """
    import numpy as np

    spread = lambda v: sum(((v >> bit) & 1) << (2 * bit) for bit in range(10))
    y, x = np.divmod(np.arange(tiles * tiles), tiles)
    patch = np.zeros(tiles * tiles, int)
    number, hits = 0, 0.0
    for tile in np.argsort(spread(x) + 2 * spread(y)):
        if hits >= HITS:
            number, hits = number + 1, 0.0
        patch[tile] = number
        hits += expected_hits[tile]
    if hits < HITS and number > 0:
        # What is left over joins the patch before it.
        patch[patch == number] = number - 1
    return patch


def noise(key, walked, plugin, size, weight):
    """Whether two noisy pictures estimate the same: χ² over tiles of 8 × 8 pixels of the mean of the channels.

    `weight` is what a walk that finds light adds to a picture: neighbouring tiles are merged until the plugin's picture expects
    [`HITS`] such walks in each ([`patches`]).
    """
    import numpy as np
    from scipy.stats import chi2

    (image, variance), (reference, reference_variance) = walked, plugin

    def tiles(values):
        return values.reshape(size // 8, 8, size // 8, 8).sum(axis=(1, 3)).ravel()

    # Which tiles are merged must not depend on the draws of the walk but through its one mean weight.
    patch = patches(tiles(reference.mean(axis=1)) / weight, size // 8)
    merged = lambda values: np.bincount(patch, tiles(values))

    # Channels of one path are one draw: only their mean is tested, with the variance of that mean.
    gap = merged(image.mean(axis=1) - reference.mean(axis=1))
    spread = merged(variance + reference_variance)
    used = spread > 0
    statistic, count = float((gap[used] ** 2 / spread[used]).sum()), int(used.sum())
    p = float(chi2.sf(statistic, count))
    total = float(image.mean() / reference.mean() - 1)
    error = float(np.sqrt((variance + reference_variance).sum()) / reference.mean(axis=1).sum())
    tile_noise = float(np.sqrt(np.median(spread[used])) / np.median(merged(reference.mean(axis=1))[used]))
    return [
        line(key, "c|b", f"p of χ², {count} patches at {100 * tile_noise:.1f} % noise", p, SMALLEST_P, p >= SMALLEST_P),
        line(key, "c|b", "mean ratio − 1", total, 4 * error, abs(total) <= 4 * error, standard_error=error),
    ]


def compare(options, tools):
    import converged
    import mitsuba as mi
    import numpy as np
    import scenes
    import ways

    size, spp = (48, 32) if options.quick else (96, 320)
    chosen = scenes.SCENES[:1] + scenes.SCENES[1:2] + scenes.SCENES[3:] if options.quick else scenes.SCENES
    variants = ["llvm_ad_rgb", "llvm_ad_spectral"]
    lines, pictures = [], {}
    for case in CASES:
        table = tools.bake(case, 0.5 if options.quick else 0.1)
        look = CASES[case][1]
        parameters = {"brightness": 1.0, "body": look["body_rgb"], **look}
        for variant in variants:
            mi.set_variant(variant)
            import nacre.mitsuba  # noqa: F401

            wavelengths = BANDS if "spectral" in variant else None
            asked = [key for key in "abcde" if key in options.ways]
            made: dict[str, Any] = {}
            refusals = {}
            for key in dict.fromkeys(["b", *asked]):
                if key == "c" and wavelengths:
                    refusals[key] = "the walk knows one wavelength: compared in rgb"
                    continue
                if key == "e" and wavelengths:
                    refusals[key] = "the page shows rgb: compared in rgb"
                    continue
                try:
                    made[key] = (converged.Page if key == "e" else ways.WAYS[key])(table, parameters, tools)
                except ways.Refused as why:
                    refusals[key] = str(why)
            for number, scene in enumerate(chosen[:1] if wavelengths and options.quick else chosen):
                name = f"{case} · {scene.name} · {variant}"
                lines += [line(name, f"{key}|b", "", None, None, None, why=why) for key, why in refusals.items()]
                shown = {}
                samples = scenes.samples(scene, made["b"].sampler, size, spp, seed=7 + number)
                light = np.array(samples.light).T.astype(float)
                if wavelengths:
                    light = light[:, :1]
                # (d) reads its samples as text, and has no noise of its own: it answers for the first few of each pixel.
                thinned = min(spp, THINNED)
                thin = np.arange(size * size * spp) % spp < thinned
                raw = {}
                for key in (key for key in "badc" if key in made):
                    try:
                        if key == "c":
                            values = made[key].light(samples, seed=101 + number)
                        elif key == "d":
                            values = made[key](samples, wavelengths, thin) * light * (spp / thinned)
                        else:
                            values = made[key](samples, wavelengths) * light
                    except ways.Refused as why:
                        lines.append(line(name, f"{key}|b", "", None, None, None, why=str(why)))
                        continue
                    raw[key] = values
                    shown[key] = scenes.image(values, samples.pixel, size, spp)[0]
                if "a" in raw:
                    lines += against(name, "a", shown["a"], shown["b"], LIMIT_MEASURED)
                if "d" in raw:
                    thinner = raw["b"] * thin[:, None] * (spp / thinned)
                    reference, _ = scenes.image(thinner, samples.pixel, size, spp)
                    lines += against(name, "d", shown["d"], reference, LIMIT_RUST)
                    # The page shows its difference on top of (b), not the noise of fewer samples.
                    shown["d"] = shown["b"] + shown["d"] - reference
                if "c" in raw:
                    grey = [scenes.image(raw[key].mean(axis=1), samples.pixel, size, spp) for key in "cb"]
                    walks = raw["c"].mean(axis=1)
                    # By its size, as a sum's variance counts it; a pixel is the mean of its samples.
                    weight = float((walks**2).sum() / max(walks.sum(), 1e-300)) / spp
                    walked, plugin = [(shown[key], variance[:, 0]) for key, (_, variance) in zip("cb", grey)]
                    lines += noise(name, walked, plugin, size, weight)
                if "e" in made:
                    found = converged.figures(made["e"], made["b"], scene)
                    for figure, limit in converged.LIMIT.items():
                        said = f"{figure} (noise {100 * found['noise']:.2f} %)" if figure == "relative RMSE" else figure
                        lines.append(line(name, "e|b", said, found[figure], limit, abs(found[figure]) <= limit))
                    shown["e"] = made["e"](scene, size, 64, seed=1)
                pictures[name] = shown
    return lines, pictures, size


def arguments():
    parser = argparse.ArgumentParser(prog="compare", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=pathlib.Path, required=True, metavar="DIR", help="folder for the page")
    parser.add_argument("--quick", action="store_true", help="small pictures: under three minutes")
    parser.add_argument("--ways", default="abcd", metavar="LETTERS", help="which ways, of abcde [abcd]; b is always there")
    parser.add_argument("--json", action="store_true", help="print the JSON object instead of lines")
    return parser.parse_args()


def main():
    options = arguments()
    if not options.ways or set(options.ways) - set("abcde"):
        raise Bad(f"--ways: {options.ways!r} is not a choice of the letters abcde")
    started = time.time()
    import ways  # after the arguments: Mitsuba takes a second to load

    with tempfile.TemporaryDirectory() as folder, Tools(folder) as tools:
        try:
            lines, pictures, size = compare(options, tools)
        except ways.Refused as why:
            raise Bad(str(why)) from None
    for way in set(options.ways):
        own = [entry["verdict"] for entry in lines if entry["ways"].startswith(way)]
        if way != "b" and own and set(own) == {"refused"}:
            why = next(entry["why"] for entry in lines if entry["ways"].startswith(way))
            raise Bad(f"way {way} cannot answer any scene: {why}")
    failed = sum(entry["verdict"] == "fail" for entry in lines)
    report = {"schema": SCHEMA, "quick": options.quick, "pass": failed == 0, "lines": lines}
    options.output.mkdir(parents=True, exist_ok=True)
    import page

    page.write(options.output / "index.html", report, pictures, size)
    whole = options.output / "compare.json.tmp"
    whole.write_text(json.dumps(report, ensure_ascii=False, indent=1))
    whole.replace(options.output / "compare.json")
    if options.json:
        print(json.dumps(report, ensure_ascii=False))
    else:
        for entry in lines:
            value = "" if entry["value"] is None else f"{entry['value']:.3g}"
            limit = "" if entry["limit"] is None else f"(limit {entry['limit']:.3g})"
            print(f"{entry['verdict']:8}{entry['scene']:48}{entry['ways']:5}{entry['figure']} {value} {limit} {entry.get('why', '')}")
    print(f"{len(lines)} lines, {failed} failed, {time.time() - started:.0f} s", file=sys.stderr)
    return 3 if failed else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except Bad as why:
        print(f"compare: {why}", file=sys.stderr)
        sys.exit(2)
    except (OSError, subprocess.SubprocessError) as why:
        print(f"compare: {why}", file=sys.stderr)
        sys.exit(1)
