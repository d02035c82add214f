#!/usr/bin/env python3
"""Recovers depth, brightness and coherence of a pearl from a rendered picture: inverse.py TABLE [--steps N] [--json]

Renders a sphere with hidden values, starts from others, and follows the gradient (Adam) of the relative difference of the
pictures. TABLE has interference colours. Exit 3 if a value is missed by more than 0.02.
"""

import argparse
import json
import sys

import drjit as dr
import mitsuba as mi

mi.set_variant("llvm_ad_rgb")
import pearls  # noqa: E402

import nacre.mitsuba  # noqa: E402, F401

HIDDEN = {"depth": 0.8, "brightness": 0.55, "coherence": 0.3}
START = {"depth": 0.3, "brightness": 0.9, "coherence": 0.7}
TOLERANCE = 0.02


def sphere(table, look):
    bsdf = {"type": "pearl", "filename": table, **look}
    scene = mi.load_dict(pearls.scene(pearls.sphere(bsdf), size=48))
    parameters = mi.traverse(scene)
    names = {name: next(key for key in parameters.keys() if key.endswith(f"bsdf.{name}")) for name in HIDDEN}
    return scene, parameters, names


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table")
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    integrator = mi.load_dict({"type": "direct", "hide_emitters": True})
    target = mi.render(sphere(options.table, HIDDEN)[0], integrator=integrator, spp=1024, seed=1)
    scene, parameters, names = sphere(options.table, START)
    optimiser = mi.ad.Adam(lr=0.02)
    for name, value in START.items():
        optimiser[name] = mi.Float(value)
    for step in range(options.steps):
        for name, key in names.items():
            optimiser[name] = dr.clip(optimiser[name], 0.0, 1.0)
            parameters[key] = optimiser[name]
        parameters.update()
        # The product of two pictures with independent noise: a square would add its variance, which depends on the look.
        pictures = [mi.render(scene, parameters, integrator=integrator, spp=16, seed=2 * step + k) for k in (2, 3)]
        gaps = [(picture - target) / (target + 0.05) for picture in pictures]
        dr.backward(dr.mean(dr.detach(gaps[0]) * gaps[1] + gaps[0] * dr.detach(gaps[1]), axis=None))
        optimiser.step()
        if step == options.steps // 2:
            optimiser.set_learning_rate(0.005)
    found = {name: float(dr.clip(optimiser[name], 0.0, 1.0)[0]) for name in HIDDEN}
    recovered = all(abs(found[name] - HIDDEN[name]) <= TOLERANCE for name in HIDDEN)
    if options.json:
        print(json.dumps({"schema": "pearl-inverse/1", "hidden": HIDDEN, "start": START, "found": found, "pass": recovered}))
    else:
        for name, value in found.items():
            print(f"{name:11} hidden {HIDDEN[name]:.2f}  start {START[name]:.2f}  found {value:.3f}")
    return 0 if recovered else 3


if __name__ == "__main__":
    sys.exit(main())
