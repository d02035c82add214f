"""Way (c): a stochastic walk through the stack, in Dr.Jit, from the model alone: no table, no code of the solvers.

A ray goes from interface to interface; at each it meets a fresh facet, is reflected or refracted by Fresnel's law, and
leaves at the top or passes the last interface. Light that passes it feeds the base, whose exit direction has the
density (1 − A(θo))·cos θo: a cosine direction is kept if a walk from *it* passes too.
"""

import drjit as dr
import mitsuba as mi
import numpy as np


class Refused(Exception):
    """What this walk cannot do."""


class Stack:
    """Indices of a recipe's media: ambient, layers from the top, substrate."""

    def __init__(self, recipe):
        stack = recipe["stack"]

        def index(name):
            medium = stack[name]
            if not isinstance(medium.get("n"), (int, float)):
                raise Refused(f"stack.{name}.n: the table-free walk takes a number, not dispersion")
            if medium.get("k", 0.0) != 0.0:
                raise Refused(f"stack.{name}.k: the table-free walk does not absorb")
            return float(medium["n"])

        if recipe["facets"].get("normals", "unweighted") != "unweighted":
            raise Refused("facets.normals: the table-free walk meets unweighted normals")
        if stack.get("explicit") or not isinstance(stack.get("layers"), int):
            raise Refused("stack.layers: the table-free walk takes a number of alternating layers")
        layers = stack["layers"] * (2 if stack.get("count") == "pairs" else 1)
        self.layers = layers
        self.ambient, self.odd = index("ambient"), index("aragonite")
        self.even, self.substrate = index("conchiolin"), index("substrate")
        self.sigma = float(np.radians(recipe["facets"]["slope_sd_deg"]))

    def n(self, medium):
        """Index of a medium by its number, 0 the ambient."""
        layer = dr.select((medium & 1) == 1, mi.Float(self.odd), mi.Float(self.even))
        inner = dr.select(medium == self.layers + 1, mi.Float(self.substrate), layer)
        return dr.select(medium == 0, mi.Float(self.ambient), inner)


def walk(stack, d, rng, active=True):
    """Walks from the ambient along d (d.z < 0); gives the last direction and whether it left at the top."""

    def event(d, medium, rng, inside):
        down = d.z < 0
        radius = stack.sigma * dr.sqrt(-2 * dr.log(1 - rng.next_float32()))
        sin, cos = dr.sincos(2 * dr.pi * rng.next_float32())
        normal = dr.normalize(mi.Vector3f(radius * cos, radius * sin, 1.0))
        # Towards the side that the ray comes from.
        normal = dr.select(down, normal, -normal)
        facing = -dr.dot(d, normal)
        other = dr.select(down, medium + 1, medium - 1)
        ratio = stack.n(medium) / stack.n(other)
        cos_t2 = 1 - ratio * ratio * (1 - facing * facing)
        cos_t = dr.sqrt(dr.maximum(cos_t2, 0))
        rs = (ratio * facing - cos_t) / (ratio * facing + cos_t)
        rp = (facing - ratio * cos_t) / (facing + ratio * cos_t)
        reflectance = dr.select(cos_t2 <= 0, 1, 0.5 * (rs * rs + rp * rp))
        reflected = rng.next_float32() < reflectance
        mirrored = d + 2 * facing * normal
        refracted = ratio * d + (ratio * facing - cos_t) * normal
        met = facing > 0  # a facet that faces away is drawn again
        turned = dr.normalize(dr.select(reflected, mirrored, refracted))
        d = dr.select(met, turned, d)
        medium = dr.select(met & ~reflected, other, medium)
        out = ((medium == 0) & (d.z > 0)) | ((medium == stack.layers + 1) & (d.z < 0))
        return d, medium, rng, inside & ~out

    state = (mi.Vector3f(d), dr.zeros(mi.Int, dr.width(d)), rng, mi.Bool(active) & dr.full(mi.Bool, True, dr.width(d)))
    d, medium, rng, _ = dr.while_loop(state, lambda d, medium, rng, inside: inside, event)
    return d, (medium == 0) & mi.Bool(active), rng


def sample(stack, wi, rng, body):
    """Exit directions for directions wi, and their weights [rgb]: the whole BSDF at depth 0 and coherence 0."""
    wo, left, rng = walk(stack, -wi, rng)
    weight = dr.select(left, mi.Float(1), mi.Float(0))

    def attempt(wo, pending, rng):
        square = mi.Point2f(rng.next_float32(), rng.next_float32())
        direction = mi.warp.square_to_cosine_hemisphere(square)
        _, back, rng = walk(stack, -direction, rng, pending)
        passed = pending & ~back
        return dr.select(passed, direction, wo), pending & ~passed, rng

    # 40 attempts leave 0.4⁴⁰ of them: none. (A loop in a loop would compile for longer than it runs.)
    pending = ~left
    tries = 0
    while dr.any(pending):
        wo, pending, rng = attempt(wo, pending, rng)
        dr.eval(wo, pending, rng)
        tries += 1
        if tries > 200:
            raise RuntimeError("the base found no exit in 200 attempts")
    colour = [dr.select(left, weight, mi.Float(channel)) for channel in body]
    return wo, mi.Color3f(*colour)
