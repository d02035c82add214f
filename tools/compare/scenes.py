"""What is rendered: shapes, lights, and the samples of light paths that all ways share.

Light is direct and without shadows; a scene is a list of (pixel, wi, wo, radiance over density) in local frames, so that
ways differ by nothing but the BSDF.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np


@dataclass
class Samples:
    """Light paths of one scene: wi and wo local, the light along wo divided by the density of wo, pixel and validity."""

    pixel: mi.UInt32
    wi: mi.Vector3f
    wo: mi.Vector3f
    light: mi.Color3f
    valid: mi.Bool
    #: World frame of each sample, and the light as a function of world direction (None where it has no area).
    frame: object
    radiance: object
    position: mi.Point3f


@dataclass(frozen=True)
class Scene:
    name: str
    shape: str  # sphere, sheet
    light: str  # environment, area, point

    @property
    def samplable(self):
        """Whether a direction can hit the light by chance, as a walk needs."""
        return self.light != "point"


SCENES = [Scene("sphere-environment", "sphere", "environment"), Scene("sheet-environment", "sheet", "environment"),
          Scene("sphere-area", "sphere", "area"), Scene("sphere-point", "sphere", "point")]  # fmt: skip

_CORNER, _EDGE_U, _EDGE_V = np.array([-2.6, -3.0, 2.2]), np.array([1.6, 0.0, 0.0]), np.array([0.0, 1.1, 1.1])
_AREA_RADIANCE = 9.0
_POINT, _POINT_INTENSITY = np.array([-2.0, -4.0, 3.0]), 45.0


def environment(d):
    """Radiance of the sky in a direction: a soft gradient and two lamps, smooth enough for every way to resolve."""
    lamp = lambda at, sharp: dr.exp(sharp * (dr.dot(d, dr.normalize(mi.Vector3f(*at))) - 1))
    sky = 0.35 + 0.25 * d.z
    return mi.Color3f(sky + 5 * lamp((-1, -1, 1), 30.0) + 2 * lamp((1.5, -0.5, 0.6), 60.0))


def _area_hit(origin, d):
    """Radiance of the area light seen from a point in a direction."""
    u, v = mi.Vector3f(*_EDGE_U.tolist()), mi.Vector3f(*_EDGE_V.tolist())
    normal = dr.cross(u, v)
    to_plane = dr.dot(mi.Point3f(*_CORNER.tolist()) - origin, normal)
    along = dr.dot(d, normal)
    t = to_plane / dr.select(dr.abs(along) > 1e-6, along, 1)
    p = origin + t * d - mi.Point3f(*_CORNER.tolist())
    a, b = dr.dot(p, u) / dr.squared_norm(u), dr.dot(p, v) / dr.squared_norm(v)
    hit = (dr.abs(along) > 1e-6) & (t > 1e-4) & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)
    return mi.Color3f(dr.select(hit, mi.Float(_AREA_RADIANCE), 0))


def _camera(size, spp, rng):
    """Rays of an image of size², orthographic enough: a pinhole at (0, −6, 1.5) that looks at the origin."""
    count = size * size * spp
    pixel = dr.arange(mi.UInt32, count) // spp
    jitter = mi.Point2f(rng.next_float32(), rng.next_float32())
    x = 2 * (mi.Float(pixel % size) + jitter.x) / size - 1
    y = 1 - 2 * (mi.Float(pixel // size) + jitter.y) / size
    origin = np.array([0.0, -6.0, 1.5])
    forward = -origin / np.linalg.norm(origin)
    right = np.array([1.0, 0.0, 0.0])
    up = np.cross(right, forward)
    spread = 0.185
    d = mi.Vector3f(*forward.tolist()) + spread * (x * mi.Vector3f(*right.tolist()) + y * mi.Vector3f(*up.tolist()))
    return pixel, mi.Point3f(*origin.tolist()), dr.normalize(d)


def _sphere(origin, d):
    """Hit of the unit sphere: mask, point, normal."""
    b = dr.dot(origin, d)
    disc = b * b - dr.squared_norm(origin) + 1
    hit = disc > 0
    t = -b - dr.sqrt(dr.maximum(disc, 0))
    point = origin + t * d
    return hit, point, dr.normalize(mi.Normal3f(point))


def _sheet(origin, d):
    """Hit of a folded sheet with grain: a plane hit, then the normal of its height field and of a bump texture."""
    tilt = 0.5
    plane = dr.normalize(mi.Vector3f(0, -tilt, 1))
    t = -dr.dot(origin, plane) / dr.dot(d, plane)
    p = origin + t * d
    hit = (t > 0) & (dr.abs(p.x) < 1) & (dr.abs(p.y) < 1)
    fold_x = 0.57 * dr.cos(2.6 * p.x + 0.8 * dr.sin(2.1 * p.y)) - 0.16 * dr.sin(3.4 * p.y - 1.3 * p.x)
    fold_y = 0.4 * dr.cos(2.1 * p.y) - 0.4 * dr.sin(3.4 * p.y - 1.3 * p.x)
    bump_x = 0.06 * dr.sin(61 * p.x + 3 * dr.sin(17 * p.y))
    bump_y = 0.06 * dr.cos(53 * p.y + 3 * dr.sin(19 * p.x))
    return hit, p, dr.normalize(mi.Normal3f(-fold_x - bump_x, -tilt - fold_y - bump_y, 1))


def generators(count, seed):
    """Random number generators, each with a state of its own: streams of PCG32 that share one are correlated."""
    states = np.random.default_rng(seed).integers(2**63, size=count, dtype=np.uint64)
    return mi.PCG32(count, initstate=mi.UInt64(states))


class Even:
    """Numbers that fill each pixel's square, and its lights and lobes, more evenly than random ones (Roberts, The unreasonable
    effectiveness of quasirandom sequences): what `samples` takes for a generator where a picture is to converge. Another seed
    shifts them."""

    def __init__(self, size, spp, seed):
        index = dr.arange(mi.UInt32, size * size * spp)
        self.number, self.pixel = index % spp, index // spp
        # Powers of the root of x⁶ = x + 1, as many as `samples` draws.
        self.steps = [int(2**32 / 1.1347241384015194**k) for k in range(1, 6)]
        self.shifts = [mi.UInt32(row) for row in np.random.default_rng(seed).integers(2**32, size=(5, size * size), dtype=np.uint32)]

    def next_float32(self):
        x = dr.gather(mi.UInt32, self.shifts.pop(0), self.pixel) + self.number * mi.UInt32(self.steps.pop(0))
        return mi.Float(x >> 8) * 2**-24


def samples(scene, sampler, size, spp, seed, even=False):
    """Light paths of a scene; `sampler(wi, u1, u2)` gives exit directions and their densities."""
    rng = Even(size, spp, seed) if even else generators(size * size * spp, seed)
    pixel, origin, d = _camera(size, spp, rng)
    hit, point, normal = (_sphere if scene.shape == "sphere" else _sheet)(origin, d)
    frame = mi.Frame3f(dr.select(hit, mi.Vector3f(normal), mi.Vector3f(0, 0, 1)))
    wi = frame.to_local(-d)
    valid = hit & (wi.z > 0)
    wi = dr.select(valid, wi, mi.Vector3f(0, 0, 1))
    u, uv = rng.next_float32(), mi.Point2f(rng.next_float32(), rng.next_float32())
    radiance = environment if scene.light == "environment" else lambda w: _area_hit(point, w)
    if scene.light == "environment":
        wo, pdf = sampler(wi, u, uv)
        light = radiance(frame.to_world(wo)) * dr.select(pdf > 0, 1 / dr.select(pdf > 0, pdf, 1), 0)
    else:
        if scene.light == "area":
            target = mi.Point3f(*_CORNER.tolist()) + uv.x * mi.Vector3f(*_EDGE_U.tolist()) + uv.y * mi.Vector3f(*_EDGE_V.tolist())
            normal = np.cross(_EDGE_U, _EDGE_V)
            strength = _AREA_RADIANCE * dr.abs(dr.dot(dr.normalize(target - point), mi.Vector3f(*normal.tolist())))
        else:
            target, radiance = mi.Point3f(*_POINT.tolist()) + 0 * point, None
            strength = mi.Float(_POINT_INTENSITY)
        to_light = target - point
        wo = frame.to_local(dr.normalize(to_light))
        light = mi.Color3f(strength / dr.squared_norm(to_light))
    # A direction that was not found, or below the horizon, is a path without light; the camera's part of it stays valid.
    lit = valid & (wo.z > 0)
    wo = dr.select(lit, wo, mi.Vector3f(0, 0, 1))
    light = dr.select(lit, light, 0)
    dr.eval(pixel, wi, wo, light, valid, frame, point)
    return Samples(pixel, wi, wo, light, valid, frame, radiance, point)


def image(values, pixel, size, spp):
    """Means and their variances over the samples of each pixel, [pixel, channel]."""
    values = np.asarray(values, float).reshape(size * size, spp, -1)
    return values.mean(axis=1), values.var(axis=1) / spp
