#!/usr/bin/env python3
"""The walk as array operations of NumPy, f64: all rays move on by one event at a time; those that end are replaced."""

import math

import numpy as np
from peer import Result, arguments, cpu_seconds, report


def walk(o):
    rng = np.random.default_rng(o.seed)
    sigma, theta, space = math.radians(o.sigma_deg), math.radians(o.theta), o.dim == 3
    index = np.array([1.0] + [1.53 if m % 2 else 1.43 for m in range(1, o.layers + 2)])
    lanes = min(o.paths, 8192)
    waiting, crossings, bins = o.paths - lanes, 0, np.zeros(180, np.int64)
    x, y, z = np.full(lanes, math.sin(theta)), np.zeros(lanes), np.full(lanes, math.cos(theta))
    medium, step = np.zeros(lanes, np.int64), np.ones(lanes, np.int64)
    while x.size:
        tilt = sigma * rng.standard_normal(x.size)
        if space:
            nx, ny, nz = tilt, sigma * rng.standard_normal(x.size), 1.0
            length2 = 1 + nx * nx + ny * ny
        else:
            nx, ny, nz, length2 = np.sin(tilt), 0.0, np.cos(tilt), 1.0
        a = z * nz - x * nx - y * ny
        faces = a > 0
        crossings += int(faces.sum())
        ratio = index[medium] / index[medium + step]
        b = np.sqrt(np.maximum((a * ratio) ** 2 + length2 * (1 - ratio * ratio), 0))
        sd, pd = a * ratio + b, a + ratio * b
        both = sd * pd
        s, p = (a * ratio - b) * pd, (a - ratio * b) * sd
        reflects = (2 * rng.random(x.size) * both * both < s * s + p * p) | ~faces
        along = np.where(reflects, 1.0, ratio)
        normal = np.where(faces, np.where(reflects, 2 * a, a * ratio - b) / length2, 0.0)
        x, y, z = along * x + normal * nx, along * y + normal * ny, along * z - normal * nz
        medium = np.where(reflects, medium, medium + step)
        step = np.where(z < 0, -step, step)
        z = np.abs(z)
        out = (medium == 0) & (step < 0)
        ended = np.flatnonzero(out | ((medium == o.layers + 1) & (step > 0)))
        if not ended.size:
            continue
        top = np.flatnonzero(out)
        angle = np.degrees(np.arctan2(np.hypot(x[top], y[top]) if space else x[top], z[top]))
        np.add.at(bins, np.minimum(179, (angle + 90).astype(int)), 1)
        fresh = ended[:waiting]
        waiting -= fresh.size
        x[fresh], y[fresh], z[fresh], medium[fresh], step[fresh] = math.sin(theta), 0, math.cos(theta), 0, 1
        if fresh.size < ended.size:
            keep = np.ones(x.size, bool)
            keep[ended[fresh.size :]] = False
            x, y, z, medium, step = x[keep], y[keep], z[keep], medium[keep], step[keep]
    return bins, crossings


def main():
    o = arguments(__doc__)
    assert o.layers % 2 == 0, "an even number of layers, so that the substrate continues the alternation"
    before = cpu_seconds()
    bins, crossings = walk(o)
    report(Result("numpy", o, [int(n) for n in bins], crossings, cpu_seconds() - before))


main()
