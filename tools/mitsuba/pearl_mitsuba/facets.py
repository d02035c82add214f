"""The single reflection at interface 0 in closed form, integrated over the exit hemisphere, in NumPy.

A facet of slopes (p, q) ~ N(0, σ²) has the normal m ∝ (−p, −q, 1) where wi = (sin θi, 0, cos θi).
"""

from dataclasses import dataclass

import numpy as np

#: Narrowest facets that are evaluated, radians.
MIN_SLOPE_SD = 1e-4
#: Beyond this many σ the normal distribution has no mass that sums would see.
FAR = 8.0

_ALONG = np.polynomial.legendre.leggauss(128)
_ACROSS = np.polynomial.legendre.leggauss(32)


@dataclass(frozen=True)
class Facets:
    """Slope standard deviation (radians), index of the first layer over the ambient's, and how facets are met."""

    sigma: float
    index_ratio: float
    visible: bool

    @classmethod
    def of(cls, model):
        """From `surface_model` of a table's metadata."""
        ratio = model["n_first"] / model["n_ambient"]
        return cls(max(model["slope_sd"], MIN_SLOPE_SD), ratio, model["normals"] == "visible")

    def slope_density(self, slope):
        """Density of one slope."""
        x = slope / self.sigma
        return np.exp(-0.5 * x * x) / (np.sqrt(2 * np.pi) * self.sigma)

    def fresnel(self, cos):
        """Unpolarised reflectance at the cosine of the local angle of incidence."""
        ratio = self.index_ratio
        cos_t2 = 1.0 - (1.0 - cos * cos) / (ratio * ratio)
        cos_t = np.sqrt(np.maximum(cos_t2, 0.0))
        s = (cos - ratio * cos_t) / np.maximum(cos + ratio * cos_t, 1e-300)
        p = (ratio * cos - cos_t) / np.maximum(ratio * cos + cos_t, 1e-300)
        return np.where(cos_t2 <= 0.0, 1.0, 0.5 * (s * s + p * p))

    def integrate(self, cos_i):
        """Pieces (mass, cos θd) of ∫ reflection dωo at one incidence; their masses add up to the integral."""
        return self.integrate_exits(cos_i)[:2]

    def integrate_exits(self, cos_i):
        """The same with cos θo."""
        sin_i = np.sqrt(max(0.0, 1.0 - cos_i * cos_i))
        far = FAR * self.sigma
        q_end = min(far, 1.0 / max(cos_i, 1e-300))
        q = (0.5 * q_end * (1.0 + _ACROSS[0]))[:, None]
        across = _ACROSS[1][:, None] * q_end * self.slope_density(q)
        chord = np.sqrt(np.maximum(0.0, 1.0 - q * q * cos_i * cos_i))
        with np.errstate(divide="ignore", over="ignore"):
            lo = np.maximum(np.divide(-(sin_i + chord), cos_i), -far)
        hi = np.minimum(cos_i * (1.0 - q * q) / np.maximum(sin_i + chord, 1e-300), far)
        p, along = self._along(cos_i, sin_i, q, lo, np.maximum(hi, lo))
        projected = cos_i - p * sin_i
        cos = np.clip(projected / np.sqrt(1.0 + p * p + q * q), 0.0, 1.0)
        mass = along * across * self.slope_density(p) * (projected if self.visible else 1.0)
        exits = np.maximum(2.0 * projected / (1.0 + p * p + q * q) - cos_i, 0.0)
        return (mass * self.fresnel(cos)).ravel(), cos.ravel(), exits.ravel()

    def _along(self, cos_i, sin_i, q, lo, hi):
        """Points p with weights along each q. Where light may be reflected totally, the reflectance has the slope of a root beside
        the critical angle: pieces end there, and points crowd towards it as their squares."""
        critical2 = 1.0 - self.index_ratio**2
        if critical2 <= 0.0:
            return lo + 0.5 * (hi - lo) * (1.0 + _ALONG[0]), 0.5 * (hi - lo) * _ALONG[1]
        # (cos θi − p sin θi)² = critical2·(1 + p² + q²), both roots; none of them within is as well as at an end.
        a, b, c = sin_i * sin_i - critical2, -cos_i * sin_i, cos_i * cos_i - critical2 * (1.0 + q * q)
        with np.errstate(invalid="ignore", divide="ignore"):
            turned = -(b + np.copysign(np.sqrt(b * b - a * c), b))
            roots = [np.where(np.isfinite(root), np.clip(root, lo, hi), lo) for root in (turned / a, c / turned)]
        first, second = np.minimum(*roots), np.maximum(*roots)
        middle = 0.5 * (first + second)
        t = 0.5 * (1.0 + _ALONG[0])
        pieces = [(first, lo), (first, middle), (second, middle), (second, hi)]
        points = [start + (end - start) * t * t for start, end in pieces]
        return np.hstack(points), np.hstack([np.abs(end - start) * t * _ALONG[1] for start, end in pieces])
