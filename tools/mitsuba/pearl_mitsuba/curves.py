"""Curves over one angle: the common grid of everything that depends on θ alone, and interpolants, in NumPy.

The grid has equal steps in u = √(1 − √cos θ): near the normal u ≈ θ/2, near the horizon cos θ ≈ 4(1 − u)², so that
albedos that fall off within a few facet slopes are resolved too.
"""

import numpy as np

STEPS = 1024
NODES = STEPS + 1

_U = np.arange(NODES) / STEPS
#: cos θ and θ (radians) of the nodes.
COS = ((1.0 - _U) * (1.0 + _U)) ** 2
THETA = np.arccos(COS)


def place(cos):
    """Node at or before an angle, given by its cosine, and how far (0..1) it is towards the next node."""
    u = np.sqrt(1.0 - np.sqrt(np.clip(cos, 0.0, 1.0))) * STEPS
    index = np.minimum(u.astype(int), STEPS - 1)
    return index, u - index


def _hemispherical_weights():
    # 2μ dμ = 8u(1 − u²)³ du; times a linear piece that is of the eighth degree, exact with five points.
    x, w = np.polynomial.legendre.leggauss(5)
    fraction = 0.5 * (1.0 + x)
    u = (np.arange(STEPS)[:, None] + fraction) / STEPS
    mass = 0.5 * w / STEPS * 8.0 * u * (1.0 - u * u) ** 3
    weights = np.zeros(NODES)
    weights[:-1] += (mass * (1.0 - fraction)).sum(axis=1)
    weights[1:] += (mass * fraction).sum(axis=1)
    return weights


#: Σ curve·weight is the cosine-weighted mean over the hemisphere of a curve read linearly between its nodes.
HEMISPHERICAL = _hemispherical_weights()


def monotone(x, y):
    """Cubic through points that never overshoots them, constant beyond its ends, flat at x = 0; a function.

    Slopes of the parabola through three points, cut back to three times the smaller secant (de Boor & Swartz 1977;
    Hyman 1983).
    """
    x, y = np.asarray(x, float), np.asarray(y, float)
    if len(x) == 1:
        return lambda at: np.full_like(np.asarray(at, float), y[0])
    h, secant = np.diff(x), np.diff(y) / np.diff(x)
    slope = np.zeros(len(x))
    if len(x) == 2:
        slope[:] = secant[0]
    else:
        before, after, h0, h1 = secant[:-1], secant[1:], h[:-1], h[1:]
        limit = 3.0 * np.minimum(np.abs(before), np.abs(after))
        parabola = np.clip((h1 * before + h0 * after) / (h0 + h1), -limit, limit)
        slope[1:-1] = np.where(before * after > 0.0, parabola, 0.0)
        slope[0] = _end_slope(h[0], h[1], secant[0], secant[1])
        slope[-1] = _end_slope(h[-1], h[-2], secant[-1], secant[-2])
    if x[0] == 0.0:
        slope[0] = 0.0

    def read(at):
        at = np.clip(np.asarray(at, float), x[0], x[-1])
        i = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
        step = x[i + 1] - x[i]
        t = (at - x[i]) / step
        u = 1.0 - t
        return u * u * ((1.0 + 2.0 * t) * y[i] + t * step * slope[i]) + t * t * (
            (3.0 - 2.0 * t) * y[i + 1] - u * step * slope[i + 1]
        )

    return read


def _end_slope(h0, h1, secant0, secant1):
    """Three-point slope at an end, cut back where it would overshoot (Moler, Numerical Computing with MATLAB §3.6)."""
    slope = ((2.0 * h0 + h1) * secant0 - h0 * secant1) / (h0 + h1)
    if slope * secant0 <= 0.0:
        return 0.0
    limit = 3.0 * abs(secant0)
    return min(max(slope, -limit), limit)


def spline_matrix(count, at):
    """Matrix that reads the cubic spline through `count` equidistant values at positions `at` (in steps): flat at the first value
    (what it reads is even about it), natural at the last."""
    identity = np.eye(count)
    system = 4.0 * np.eye(count) + np.eye(count, k=1) + np.eye(count, k=-1)
    system[0, :2] = 2.0, 1.0
    system[-1] = identity[-1]
    right = np.zeros((count, count))
    right[0] = 6.0 * (identity[1] - identity[0])
    right[1:-1] = 6.0 * (identity[:-2] - 2.0 * identity[1:-1] + identity[2:])
    second = np.linalg.solve(system, right)
    i = np.clip(at.astype(int), 0, count - 2)
    b = np.clip(at - i, 0.0, 1.0)[:, None]
    a = 1.0 - b
    bend = (a**3 - a) * second[i] + (b**3 - b) * second[i + 1]
    return a * identity[i] + b * identity[i + 1] + bend / 6.0
