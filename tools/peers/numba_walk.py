#!/usr/bin/env python3
"""The walk as one numba function, scalar f64: the loop that one writes down first, compiled."""

import math

import numba
import numpy as np
from numba import njit, prange
from peer import Result, arguments, cpu_seconds, report


@njit(fastmath=True)
def path(space, layers, sigma, sin_i, cos_i):
    """(signed exit angle in degrees, or 1000 if transmitted; crossings). z points to the interface ahead."""
    x, y, z, up, medium, crossings = sin_i, 0.0, cos_i, False, 0, 0
    while True:
        if space:
            nx, ny, nz = sigma * np.random.normal(), sigma * np.random.normal(), 1.0
        else:
            tilt = sigma * np.random.normal()
            nx, ny, nz = math.sin(tilt), 0.0, math.cos(tilt)
        length2 = nx * nx + ny * ny + nz * nz
        a = z * nz - x * nx - y * ny
        if a <= 0.0:
            continue
        crossings += 1
        if medium == 0:
            ratio = 1 / 1.53
        elif medium == 1 and up:
            ratio = 1.53
        else:
            ratio = 1.53 / 1.43 if medium % 2 == 1 else 1.43 / 1.53
        b = math.sqrt(max(0.0, (a * ratio) ** 2 + length2 * (1 - ratio * ratio)))
        rs = (a * ratio - b) / (a * ratio + b)
        rp = (a - ratio * b) / (a + ratio * b)
        if 2 * np.random.random() < rs * rs + rp * rp:
            along, normal = 1.0, 2 * a / length2
        else:
            along, normal = ratio, (a * ratio - b) / length2
            medium += -1 if up else 1
        x, y, z = along * x + normal * nx, along * y + normal * ny, along * z - normal * nz
        if z < 0:
            z, up = -z, not up
        if up and medium == 0:
            side = math.sqrt(x * x + y * y) if space else x
            return math.degrees(math.atan2(side, z)), crossings
        if not up and medium == layers + 1:
            return 1000.0, crossings


@njit(parallel=True)
def walk(space, layers, sigma, theta, paths, seed):
    chunks = 64
    bins, crossings = np.zeros((chunks, 180), np.int64), np.zeros(chunks, np.int64)
    for chunk in prange(chunks):
        np.random.seed(seed * chunks + chunk)
        for _ in range(paths // chunks + (chunk < paths % chunks)):
            angle, met = path(space, layers, sigma, math.sin(theta), math.cos(theta))
            crossings[chunk] += met
            if angle < 999:
                bins[chunk, min(179, int(angle + 90))] += 1
    return bins.sum(0), crossings.sum()


def main():
    o = arguments(__doc__)
    assert o.layers % 2 == 0, "an even number of layers, so that the substrate continues the alternation"
    numba.set_num_threads(o.threads)
    case = (o.dim == 3, o.layers, math.radians(o.sigma_deg), math.radians(o.theta))
    walk(*case, 64, 99)  # compiles
    before = cpu_seconds()
    bins, crossings = walk(*case, o.paths, o.seed)
    report(Result("numba", o, [int(n) for n in bins], int(crossings), cpu_seconds() - before))


main()
