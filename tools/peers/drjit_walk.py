#!/usr/bin/env python3
"""The walk in Dr.Jit (LLVM backend, f32), as a user of Mitsuba would write it: one kernel, a symbolic loop over
persistent lanes, each of which walks its share of the paths one after the other. Public Python interface only.

Facet normals stay unnormalised, so an event is one square root and one division; reflection and refraction are selects;
a facet that faces away is an event without effect.
"""

import math

import drjit as dr
import numpy as np
from drjit.llvm import PCG32, Bool, Float, Int, UInt, UInt64
from peer import Result, arguments, cpu_seconds, report


def launch(o, paths, seed):
    lanes = min(4096, paths)
    # A state of its own for each lane: streams of PCG32 that share one are correlated.
    states = np.random.default_rng(seed).integers(2**63, size=lanes, dtype=np.uint64)
    rng = PCG32(size=lanes, initstate=UInt64(states))
    space = o.dim == 3
    sigma, theta = math.radians(o.sigma_deg), math.radians(o.theta)
    start = (Float(math.sin(theta)), Float(0), Float(math.cos(theta)))
    bins = dr.zeros(UInt, 180)
    share = dr.opaque(UInt, paths // lanes)
    left = share + dr.select(dr.arange(UInt, lanes) < paths % lanes, UInt(1), UInt(0))

    def normals(rng):
        radius = dr.sqrt(-2 * dr.log(1 - rng.next_float32())) * sigma
        s, c = dr.sincos(2 * math.pi * rng.next_float32())
        return radius * c, radius * s

    def body(rng, x, y, z, up, medium, left, crossings):
        p, q = normals(rng)
        nx, ny, nz = (p, q, Float(1)) if space else (dr.sin(p), Float(0), dr.cos(p))
        length2 = dr.fma(nx, nx, dr.fma(ny, ny, 1)) if space else Float(1)
        ratio = dr.select((medium & 1) != 0, Float(1.53 / 1.43), Float(1.43 / 1.53))
        ratio = dr.select(medium == 0, Float(1 / 1.53), ratio)
        ratio = dr.select((medium == 1) & up, Float(1.53), ratio)
        a = z * nz - x * nx - y * ny
        faces = a > 0
        b = dr.sqrt(dr.maximum(dr.square(a * ratio) + length2 * (1 - ratio * ratio), 0))
        rs = (a * ratio - b) / (a * ratio + b)
        rp = (a - ratio * b) / (a + ratio * b)
        reflects = (2 * rng.next_float32() < rs * rs + rp * rp) | ~faces
        along = dr.select(reflects, Float(1), ratio)
        normal = dr.select(faces, dr.select(reflects, 2 * a, a * ratio - b) / length2, 0)
        z = along * z - normal * nz
        x, y = dr.fma(along, x, normal * nx), dr.fma(along, y, normal * ny)
        medium = dr.select(reflects, medium, dr.select(up, medium - 1, medium + 1))
        up = up ^ (z < 0)
        z = dr.abs(z)
        out = (medium == 0) & up
        ends = out | ((medium == o.layers + 1) & ~up)

        def finish(x, y, z, up, medium, left):
            angle = dr.atan2(dr.sqrt(x * x + y * y) if space else x, z) * (180 / math.pi)
            dr.scatter_inc(bins, UInt(dr.clip(angle + 90, 0, 179)), out)
            pick = lambda new, old: dr.select(ends, new, old)
            return pick(start[0], x), pick(start[1], y), pick(start[2], z), up & ~ends, pick(Int(0), medium), pick(left - 1, left)

        x, y, z, up, medium, left = dr.if_stmt((x, y, z, up, medium, left), ends, finish, lambda *state: state)
        return rng, x, y, z, up, medium, left, crossings + dr.select(faces, UInt(1), UInt(0))

    state = (rng, *start, Bool(False), Int(0), left, dr.zeros(UInt, lanes))
    state = dr.while_loop(state, lambda *s: s[6] > 0, body, mode="symbolic")
    dr.eval(bins, state[7])
    dr.sync_thread()
    return [int(n) for n in bins], int(dr.sum(UInt64(state[7]))[0])


def main():
    o = arguments(__doc__)
    assert o.layers % 2 == 0, "an even number of layers, so that the substrate continues the alternation"
    dr.set_thread_count(o.threads)
    launch(o, 5000, 99)  # compiles
    before = cpu_seconds()
    bins, crossings = launch(o, o.paths, o.seed)
    report(Result("drjit", o, bins, crossings, cpu_seconds() - before))


main()
