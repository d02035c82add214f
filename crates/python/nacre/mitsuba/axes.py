"""Exit-angle axes that follow a lobe (docs/LUT-FORMAT.md §3) and the sampling densities of values that a user changes (§5), in NumPy.

Angles are radians. A *position* counts cells from the lower end of an axis; the centre of cell k is at k + ½.
"""

from dataclasses import dataclass

import numpy as np

HALF_PI = 0.5 * np.pi


@dataclass(frozen=True)
class Stretched:
    """x = c ± w·sinh(t·asinh(room/w)): `cells` cells between lo and hi, finest around the centre.

    With centre ≤ lo the axis is one-sided. The width may be an array: one axis an element.
    """

    lo: float
    centre: float
    hi: float
    width: float
    cells: int

    @property
    def _one_sided(self):
        return np.all(self.centre <= self.lo)

    def position(self, x):
        """Position of x, clamped to the axis."""
        x = np.clip(x, self.lo, self.hi)
        if self._one_sided:
            return self.cells * np.arcsinh((x - self.lo) / self.width) / np.arcsinh((self.hi - self.lo) / self.width)
        room = np.where(x >= self.centre, self.hi - self.centre, self.centre - self.lo)
        share = np.arcsinh(np.abs(x - self.centre) / self.width) / np.arcsinh(room / self.width)
        return 0.5 * self.cells * (1.0 + np.where(x >= self.centre, share, -share))

    def _side(self, position):
        """Share t of a side, its sign, and its stretched length asinh(room/w)."""
        if self._one_sided:
            return position / self.cells, 1.0, np.arcsinh((self.hi - self.lo) / self.width)
        t = position / (0.5 * self.cells) - 1.0
        room = np.where(t >= 0.0, self.hi - self.centre, self.centre - self.lo)
        return np.abs(t), np.where(t >= 0.0, 1.0, -1.0), np.arcsinh(room / self.width)

    def at(self, position):
        """The coordinate at a position."""
        t, sign, length = self._side(np.asarray(position, float))
        start = self.lo if self._one_sided else self.centre
        return np.clip(start + sign * self.width * np.sinh(t * length), self.lo, self.hi)

    def slope(self, position):
        """dx/dposition."""
        t, _, length = self._side(np.asarray(position, float))
        cells = self.cells if self._one_sided else 0.5 * self.cells
        return self.width * length * np.cosh(t * length) / cells


@dataclass(frozen=True)
class ExitAxis:
    """The exit cells of a table: `columns` over the exit angle, `rows` over φ (1 in decay tables)."""

    plane: bool
    columns: int
    rows: int
    width: float

    @property
    def lo(self):
        """Lower end of the columns: −π/2 in the plane, 0 in space."""
        return -HALF_PI if self.plane else 0.0

    def columns_at(self, theta_i):
        """Columns of the row at θi: signed exit angle s (decay tables) or θo (space tables)."""

        def withdrawal(room):
            return np.hypot(room, self.width) - room

        centre = theta_i - withdrawal(HALF_PI - theta_i) + withdrawal(theta_i - self.lo)
        return Stretched(self.lo, centre, HALF_PI, self.width, self.columns)

    def phi_at(self, theta_i):
        """The φ axis at θi; None in decay tables."""
        if self.plane:
            return None
        return Stretched(0.0, 0.0, np.pi, self.width / np.tan(self.columns_at(theta_i).centre), self.rows)


def scaled_bessel_i0(x):
    """e^(−x)·I₀(x) for x ≥ 0."""
    x = np.asarray(x, float)
    near = np.minimum(x, 600.0)
    y = 1.0 / np.maximum(x, 600.0)
    # Asymptotic series (Abramowitz & Stegun 9.7.1); its fourth term is below 1e-12 from 600 on.
    far = np.sqrt(y / (2 * np.pi)) * (1 + y / 8 * (1 + 9 * y / 16 * (1 + 25 * y / 24)))
    return np.where(x < 600.0, np.i0(near) * np.exp(-near), far)


def mean_decay(x):
    """Mean of the decay D over all azimuths at concentration x (docs/LUT-FORMAT.md §5)."""
    x = np.asarray(x, float)
    small = np.minimum(x, 0.1)
    # e^x·I₀(x) − 1 by the generating function of the central binomials: the closed form cancels for small x.
    term, series = np.ones_like(small), np.zeros_like(small)
    for n in range(1, 24):
        term = term * small * (2 * n - 1) / (n * n)
        series = series + term
    floor = np.maximum(x, 1e-9)
    e2 = np.exp(-2 * floor)
    gap = -np.expm1(-2 * floor)
    large = (scaled_bessel_i0(np.maximum(x, 0.1)) - e2) / gap
    return np.where(x < 1e-9, 0.5, np.where(x < 0.1, e2 * series / gap, large))


def concentration(theta_i, theta_o, width):
    """x = sin θi·sin θo / w² of the decay."""
    return np.sin(theta_i) * np.abs(np.sin(theta_o)) / (width * width)


def plane_measure(theta_i, s, width):
    """dω/ds of a decay table, integrated over the azimuth: 2π|sin s|·D̄ forward, 2π|sin s|·(1 − D̄) backward."""
    mean = mean_decay(concentration(theta_i, s, width))
    return 2 * np.pi * np.abs(np.sin(s)) * np.where(s >= 0.0, mean, 1.0 - mean)


def sampling_measure(axis, theta_i, azimuth_width):
    """dω/dposition at every cell centre of one incidence; decay tables: integrated over the azimuth."""
    columns = axis.columns_at(theta_i)
    middle = np.arange(axis.columns) + 0.5
    centres, slopes = columns.at(middle), columns.slope(middle)
    if axis.plane:
        return plane_measure(theta_i, centres, azimuth_width) * slopes
    phi = axis.phi_at(theta_i)
    return np.outer(phi.slope(np.arange(axis.rows) + 0.5), np.sin(centres) * slopes).ravel()
