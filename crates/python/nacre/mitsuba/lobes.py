"""Evaluation, density and sampling of the lobes of a table, in Dr.Jit.

Directions are unit vectors in the shading frame; what is computed mirrors the Rust crate pearl-bsdf step by step, in
single precision. So that grazing directions keep their digits, angles near the horizon are carried as elevations
(π/2 − θ), and the half vector follows from differences that do not cancel.
"""

from copy import copy
from dataclasses import dataclass

import drjit as dr
import numpy as np

from .store import Search

_PI = float(np.pi)
_HALF_PI = 0.5 * _PI
_TINY = 1e-30
#: sin θo is floored here where a density is divided by it.
_POLE = 1e-7
#: Largest cap around the normal that is sampled evenly, radians.
_LARGEST_CAP = 0.1
#: Nearest single-precision number below 1.
_BELOW_ONE = 1.0 - 6e-8


# Of what is no number these make the limit. Dr.Jit's own let it pass, and mind the signs of zeros, at several instructions more.


def at_least(x, least):
    return dr.select(x > least, x, least)


def at_most(x, most):
    return dr.select(x < most, x, most)


def clip(x, least, most):
    return at_most(at_least(x, least), most)


def _sqrt(x):
    return dr.sqrt(at_least(x, 0.0))


def _difference_of_products(a, b, c, d):
    """a·b − c·d to within one rounding (Kahan)."""
    cd = c * d
    return dr.fma(a, b, -cd) - dr.fma(c, d, -cd)


@dataclass
class Polar:
    """A direction by its angle from the normal."""

    cos: object
    sin: object
    theta: object
    #: π/2 − θ, with its own digits.
    elevation: object
    #: x and y, (1, 0) at the pole, and the reciprocal of their length.
    plane: tuple
    inverse_radius: object

    @classmethod
    def of(cls, w):
        radius = dr.sqrt(w.x * w.x + w.y * w.y)
        steep = w.z > 0.7
        sin = dr.select(steep, at_most(radius, 1.0), _sqrt(dr.fma(-w.z, w.z, 1.0)))
        small = dr.asin(at_most(dr.select(steep, sin, w.z), 1.0))
        pole = radius < 1e-20
        plane = dr.select(pole, 1.0, w.x), dr.select(pole, 0.0, w.y)
        theta = dr.select(steep, small, _HALF_PI - small)
        elevation = dr.select(steep, _HALF_PI - small, small)
        return cls(w.z, sin, theta, elevation, plane, 1.0 / dr.select(pole, 1.0, radius))

    @property
    def azimuth(self):
        """cos and sin of the azimuth."""
        return self.plane[0] * self.inverse_radius, self.plane[1] * self.inverse_radius


@dataclass
class Half:
    """What the closed-form lobe needs of two directions."""

    #: Squared slopes along and across wi's azimuth.
    p2: object
    q2: object
    #: z of the half vector, and cos θd.
    z: object
    cos: object


@dataclass
class Pair:
    """Two directions above the horizon."""

    incidence: Polar
    exit: Polar
    #: sin²(φ/2), φ from the mirror direction of wi.
    y2: object
    half: Half

    @classmethod
    def of(cls, i, o):
        """Of two polar directions, wi and wo."""
        # From the vectors themselves: at grazing incidence the rounding of unit azimuths would tilt the half vector.
        (ix, iy), (ox, oy), scale = i.plane, o.plane, i.inverse_radius * o.inverse_radius
        sin_phi = scale * _difference_of_products(ix, oy, iy, ox)
        cos_phi = -scale * dr.fma(ix, ox, iy * oy)
        near = dr.square(sin_phi) / (2.0 * (1.0 + at_least(cos_phi, 0.0)))
        y2 = at_most(dr.select(cos_phi > 0.0, near, 0.5 * (1.0 - cos_phi)), 1.0)
        # sin θi − sin θo from whichever keeps its digits.
        by_cos = (o.cos - i.cos) * (o.cos + i.cos) / at_least(i.sin + o.sin, 0.1)
        gap = dr.select(at_most(i.cos, o.cos) > 0.7, i.sin - o.sin, by_cos)
        along = dr.fma(2.0 * o.sin, y2, gap)
        across = o.sin * sin_phi
        up = i.cos + o.cos
        plane2 = dr.fma(along, along, across * across)
        length = dr.sqrt(dr.fma(up, up, plane2))
        inverse_up = 1.0 / at_least(up, _TINY)
        half = Half(
            dr.square(along * inverse_up),
            dr.square(across * inverse_up),
            at_most(up / at_least(length, _TINY), 1.0),
            at_most(0.5 * length, 1.0),
        )
        return cls(i, o, y2, half)


class Facets:
    """The single reflection at interface 0: facet density × Fresnel."""

    def __init__(self, arrays):
        self.sigma, self.ratio, self.visible = (float(arrays[name].flat[0]) for name in ("slope_sd", "index_ratio", "visible"))
        # In single precision no slope is drawn beyond 5.5σ: of narrow facets the only limit within that is the upper one along p.
        self.narrow = self.sigma <= 0.1

    def _slopes(self, half):
        x = (half.p2 + half.q2) * (0.5 / self.sigma**2)
        return dr.exp(-at_most(x, 80.0)) * (1.0 / (2.0 * _PI * self.sigma**2))

    def fresnel(self, cos):
        """Unpolarised reflectance at the cosine of the local angle of incidence."""
        ratio = self.ratio
        cos_t2 = 1.0 - (1.0 - cos * cos) * (1.0 / (ratio * ratio))
        cos_t = dr.sqrt(at_least(cos_t2, 1e-12))
        s, p = cos + ratio * cos_t, ratio * cos + cos_t
        both = 1.0 / (s * p)
        s, p = (cos - ratio * cos_t) * p * both, (ratio * cos - cos_t) * s * both
        return dr.select(cos_t2 <= 0.0, 1.0, 0.5 * (s * s + p * p))

    def _density(self, half):
        """Per steradian, as if no facet reflected downward."""
        z = at_least(half.z, 1e-6)
        return 0.25 * self._slopes(half) / (z * z * z * at_least(half.cos, 1e-6))

    def eval(self, half):
        """f·cos θo short of the factor that depends on θi alone."""
        light = self._density(half) * self.fresnel(half.cos)
        return light * (at_least(half.cos, 1e-6) / at_least(half.z, 1e-6)) if self.visible else light

    def pdf(self, incidence, half):
        """Density per steradian with which `sample` finds the direction."""
        kept = self._kept(*self._across(incidence)) * self._kept(*self._along(incidence, half.q2))
        return dr.select(kept > 1e-12, self._density(half) / at_least(kept, 1e-12), 0.0)

    def sample(self, wi, incidence, u, v):
        """A direction and whether it is one: slopes from the normal distribution cut to where they reflect upward."""
        q = self._truncated_normal(*self._across(incidence), u)
        lo, hi = self._along(incidence, q * q)
        p = self._truncated_normal(lo, hi, v)
        z = 1.0 / dr.sqrt(1.0 + p * p + q * q)
        along, across = incidence.azimuth
        m = type(wi)(z * (q * across - p * along), -z * (p * across + q * along), z)
        wo = dr.fma(2.0 * dr.dot(wi, m), m, -wi)
        return wo, (wo.z > 0.0) & (True if lo is None else hi > lo)

    # Limits of a slope: None where none is felt.

    def _across(self, incidence):
        """Where along q facets can reflect above the horizon."""
        reach = 1.0 / at_least(incidence.cos, _TINY)
        return (None, None) if self.narrow else (-reach, reach)

    def _along(self, incidence, q2):
        """Where along p they do, at one q."""
        cos, sin = incidence.cos, incidence.sin
        chord = _sqrt(1.0 - q2 * cos * cos)
        lo = None if self.narrow else -(sin + chord) / at_least(cos, _TINY)
        return lo, cos * (1.0 - q2) / at_least(sin + chord, _TINY)

    def _integrals(self, lo, hi):
        """Twice the integral of the normal distribution from the middle to both limits."""
        scale = 1.0 / (self.sigma * float(np.sqrt(2.0)))
        return -1.0 if lo is None else dr.erf(lo * scale), 1.0 if hi is None else dr.erf(hi * scale)

    def _kept(self, lo, hi):
        """Probability that a slope lies between the limits."""
        below, above = self._integrals(lo, hi)
        return 0.5 * (above - below)

    def _truncated_normal(self, lo, hi, u):
        below, above = self._integrals(lo, hi)
        x = dr.erfinv(clip(below + u * (above - below), -_BELOW_ONE, _BELOW_ONE)) * (self.sigma * float(np.sqrt(2.0)))
        x = x if lo is None else at_least(x, lo)
        return x if hi is None else at_most(x, hi)


class Warp:
    """An axis x = c ± w·sinh(·) at one incidence; coordinates are given relative to the centre."""

    def __init__(self, width, room_lo, room_hi, cells):
        """room_lo: room below the centre, or None on a one-sided axis."""
        self.width = width
        self.inverse_width = 1.0 / width
        half = 0.5 * cells
        if room_lo is None:
            self.middle, self.gain_lo, self.gain_hi = 0.0, None, cells / self._asinh(room_hi * self.inverse_width)
        else:
            self.middle = half
            self.gain_lo = half / self._asinh(room_lo * self.inverse_width)
            self.gain_hi = half / self._asinh(room_hi * self.inverse_width)

    @staticmethod
    def _asinh(x):
        return dr.log(x + dr.sqrt(dr.fma(x, x, 1.0)))

    def _gain(self, positive):
        return self.gain_hi if self.gain_lo is None else dr.select(positive, self.gain_hi, self.gain_lo)

    def position(self, offset):
        """Position in cells of centre + offset; and of dposition/dx there, numerator and denominator."""
        size = dr.abs(offset) * self.inverse_width
        root = dr.sqrt(dr.fma(size, size, 1.0))
        gain = self._gain(offset >= 0.0)
        stretched = gain * dr.log(size + root)
        position = self.middle + dr.select(offset >= 0.0, stretched, -stretched)
        return position, gain * self.inverse_width, root

    def offset(self, position):
        """The coordinate at a position, relative to the centre."""
        d = position - self.middle
        return self.width * dr.sinh(d / self._gain(d >= 0.0))


@dataclass
class Incidence:
    """The table at one angle of incidence."""

    polar: Polar
    #: The two incidences that are mixed, and how far (0..1) θi is towards the second.
    node: object
    following: object
    fraction: object
    correction: list
    #: Σ of the sampling densities: interior, rehit; its reciprocal, 0 where it is dark; and the share of each in the cap around the normal.
    total: list
    inverse_total: list
    cap: list
    columns: Warp
    #: Room above the columns' centre: the elevation of the centre.
    room: object
    #: sin θi/w² (decay tables), or the φ axis (space tables).
    concentration: object
    phi: Warp | None


class Tabulated:
    """The lobes interior and rehit, read by the rule of docs/LUT-FORMAT.md §4 and, if that is wanted, sampled."""

    def __init__(self, types, table, sampled):
        self.types, self.sampled = types, sampled
        self.axis = table.axis
        self.columns, self.rows, self.incidences = table.axis.columns, table.axis.rows, len(table.theta)
        self.rows_of_spans, self.spans = table.rows_of_spans, table.spans
        (before, after), spans = self.rows_of_spans, self.spans
        # A density that is linear in position does not vanish with sin θo at the normal: within a cap as narrow as a
        # facet's tilt, where lobes do not vary much, what falls there is spread evenly over the solid angle.
        self.cap = min(table.axis.width, _LARGEST_CAP)
        self.cap_sin = float(np.sin(self.cap))
        self.cap_density = float(0.25 / (np.pi * np.sin(0.5 * self.cap) ** 2))
        self.span_count = len(spans) - 1
        # One step for all spans where the incidences are equidistant from 0 to 90°.
        steps = np.diff(spans)
        regular = np.allclose(steps, steps[0], rtol=1e-9) and np.array_equal(after, before + 1)
        self.regular_step = float(steps[0]) if regular else None
        self.span_steps = table.span_curves.shape[1] - 1
        along, (first, last) = np.arange(self.span_steps + 1) / self.span_steps, table.widths_of_spans.T[..., None]
        widths = (first + (last - first) * along)[..., None]
        # By incidence: what is read over the albedos, and w of the azimuth.
        self.along = types.store(np.concatenate([table.span_curves[..., :2], widths, np.zeros_like(widths)], axis=2), 4)
        if not regular:
            self.search = Search(types, spans[None, 1:-1], np.stack([spans[:-1], 1.0 / steps, before, after], axis=1))
        self.table = table
        self._set(table.values, table.densities, table.span_curves[..., 2:])

    def with_values(self, values, data):
        """The same with other values, [incidence, row, column, lobe], and the (differentiable) array to read them from."""
        other = copy(self)
        other._set(values, values * self.table.measure[..., None], None, data)
        return other

    def _set(self, values, density, caps, data=None):
        """Values and what is sampled of each; shares of that around the normal at the steps of spans, where they are known."""
        types = self.types
        values, density = np.asarray(values, float), np.asarray(density, float)
        # Only their proportions matter within a lobe: near 1, whatever the values are.
        largest = density.sum(axis=(1, 2)).max(axis=0)
        density = density / np.where(largest > 0.0, largest, 1.0)
        rows = density.sum(axis=2)
        total = rows.sum(axis=1)
        # Values and densities side by side: one record holds what both lobes have in a cell.
        if data is None or not types.jit:
            self.cells = types.store(np.concatenate([values, density], axis=3), 4)
        else:
            value, sampled = (dr.unravel(types.Vector2f, array) for array in (data, types.array(density)))
            self.cells = types.Store(types, dr.ravel(types.Vector4f(value.x, value.y, sampled.x, sampled.y)), 4)
        if not self.sampled:
            return
        self.total = types.store(total, 2)
        scale = lambda sums: np.divide(1.0, sums, out=np.zeros_like(sums), where=sums > 0.0)
        # Distribution functions of each row, and of the φ rows of an incidence, normalised; lobe-major.
        # By incidence, as `along`: shares in the cap around the normal, and sums of the densities.
        steps = np.arange(self.span_steps + 1)[:, None] / self.span_steps
        before, after = (total[rows][:, None] for rows in self.rows_of_spans)
        if caps is None:
            caps = self._cap_shares(density.sum(axis=1) * scale(total)[:, None], total)
        self.shares = types.store(np.concatenate([caps, before + steps * (after - before)], axis=2), 4)
        of_rows = lambda density: Distribution(types, np.moveaxis(density, -1, 0).reshape(-1, density.shape[-2]))
        self.along_row = of_rows(density * scale(rows)[:, :, None])
        self.among_rows = None if self.axis.plane else of_rows(rows * scale(total)[:, None])

    def _cap_shares(self, density, total):
        """Share of what `sample` draws within the cap around the normal before it spreads it there, at the steps of
        `along`: [step, lobe]. density: [incidence, column, lobe], of sum 1 over the columns where there is light."""
        spans, (before, after) = self.spans, self.rows_of_spans
        steps = np.arange(self.span_steps + 1) / self.span_steps
        # Integral of the density as it is read, up to every half cell; within halves it is quadratic.
        edge = np.concatenate([density[:, :1], 0.5 * (density[:, 1:] + density[:, :-1]), density[:, -1:]], axis=1)
        halves = 0.25 * np.stack([edge[:, :-1] + density, density + edge[:, 1:]], axis=2)
        halves = halves.reshape(len(density), -1, density.shape[2])
        shares = np.zeros((len(before), self.span_steps + 1, density.shape[2]))
        knots = np.arange(2 * self.columns + 1)
        nodes = np.stack([edge[:, :-1], density], axis=2).reshape(len(density), -1, density.shape[2])
        nodes = np.concatenate([nodes, edge[:, -1:]], axis=1)
        cumulated = np.concatenate([np.zeros_like(halves[:, :1]), halves.cumsum(axis=1)], axis=1)

        def integral(row, position):
            x = 2.0 * position
            k = np.clip(x.astype(int), 0, 2 * self.columns - 1)
            t = (x - knots[k])[:, None]
            a, b = nodes[row][k], nodes[row][k + 1]
            return cumulated[row][k] + 0.5 * t * (a + 0.5 * t * (b - a))

        for span, (lo, hi) in enumerate(zip(spans, spans[1:])):
            columns = self.axis.columns_at(lo + (hi - lo) * steps)
            ends = [columns.position(np.full_like(steps, s)) for s in (-self.cap, self.cap)]
            weights = np.stack([(1.0 - steps)[:, None] * total[before[span]], steps[:, None] * total[after[span]]])
            for row, weight in zip((before[span], after[span]), weights):
                inside = integral(row, ends[1]) - (integral(row, ends[0]) if self.axis.plane else 0.0)
                shares[span] += weight * inside
            sums = weights.sum(axis=0)
            shares[span] = np.divide(shares[span], sums, out=np.zeros_like(sums), where=sums > 0.0)
        return shares

    def incidence(self, polar):
        """The table at θi."""
        types = self.types
        if self.regular_step is not None:
            x = polar.theta * (1.0 / self.regular_step)
            span = dr.minimum(types.floor(x), self.span_count - 1)
            fraction = clip(x - types.Float(span), 0.0, 1.0)
            node, following = span, span + 1
        else:
            span = self.search.count(polar.theta)
            start, inverse, before, after = self.search.records.read(span)
            fraction = clip((polar.theta - start) * inverse, 0.0, 1.0)
            node, following = types.floor(before), types.floor(after)
        step = fraction * self.span_steps
        index = dr.minimum(types.floor(step), self.span_steps - 1)
        record = span * (self.span_steps + 1) + index
        interior, rehit, width, _ = self.along.between(record, step - types.Float(index))
        shares = self.shares.between(record, step - types.Float(index)) if self.sampled else []
        cap, total = shares[:2], shares[2:]
        inverse_total = [dr.select(t > _TINY, 1.0 / at_least(t, _TINY), 0.0) for t in total]

        w2 = self.axis.width**2
        withdrawal = lambda room: w2 / (dr.sqrt(dr.fma(room, room, w2)) + room)
        above_lo = polar.theta - self.axis.lo
        shift = withdrawal(above_lo) - withdrawal(polar.elevation)
        room = polar.elevation - shift
        columns = Warp(self.axis.width, above_lo + shift, room, self.columns)
        self_phi, concentration = None, None
        if self.axis.plane:
            concentration = polar.sin / (width * width)
        else:
            # tan of the centre = 1/tan of its elevation.
            self_phi = Warp(self.axis.width * dr.tan(at_least(room, 1e-7)), None, _PI, self.rows)
        return Incidence(
            polar, node, following, fraction, [dr.rcp(interior), dr.rcp(rehit)], total, inverse_total, cap, columns, room, concentration, self_phi
        )

    @staticmethod
    def lit(at):
        """Whether there is anything to sample of interior and rehit."""
        return [total > _TINY for total in at.total]

    def exit(self, at, polar, y2):
        """Where an exit direction lies in the table."""
        steep = at_most(at.polar.cos, polar.cos) > 0.7
        gap = dr.select(steep, polar.theta - at.polar.theta, at.polar.elevation - polar.elevation)
        # θo − centre; the centre is θi + (elevation of θi − room).
        forward = gap - (at.polar.elevation - at.room)
        position, rate, root = at.columns.position(forward)
        cell = self._cell(position, self.columns)
        if not self.axis.plane:
            phi, phi_rate, phi_root = at.phi.position(2.0 * dr.asin(at_most(dr.sqrt(y2), 1.0)))
            # Half of it on either side of the plane of incidence.
            rates = [0.5 * rate * phi_rate / at_least(root * phi_root * polar.sin, _POLE**2)]
            return Exit([cell], rates, self._cell(phi, self.rows), None, polar.sin, y2)
        position, retro_rate, retro_root = at.columns.position(-polar.theta - (_HALF_PI - at.room))
        inverse = 1.0 / (root * retro_root * at_least(polar.sin, _POLE))
        rates = [rate * retro_root * inverse, retro_rate * root * inverse]
        return Exit([cell, self._cell(position, self.columns)], rates, None, at.concentration * polar.sin, polar.sin, y2)

    def _cell(self, position, cells):
        from_first = clip(position - 0.5, 0.0, cells - 1.0)
        index = dr.minimum(self.types.floor(from_first), cells - 2)
        return index, from_first - self.types.Float(index)

    def _read(self, store, at, row, cell):
        index, fraction = cell
        start = row + index
        stride = self.rows * self.columns
        near = store.between(at.node * stride + start, fraction)
        far = store.between(at.following * stride + start, fraction)
        return [dr.fma(at.fraction, b - a, a) for a, b in zip(near, far)]

    def read(self, at, exit):
        """What `eval` and `pdf` need of the cells around an exit: two records of values and densities, ahead and back
        (decay tables), or of the two φ rows (space tables)."""
        if self.axis.plane:
            return [self._read(self.cells, at, 0, cell) for cell in exit.cells]
        row = exit.row[0] * self.columns
        return [self._read(self.cells, at, row + step, exit.cells[0]) for step in (0, self.columns)]

    def eval(self, at, exit, cells):
        """f·cos θo in 1/sr of interior and rehit, the albedo restored."""
        first, second = (record[:2] for record in cells)
        if self.axis.plane:
            d = _decay(exit.concentration, exit.y2)
            return [c * dr.fma(d, a, (1.0 - d) * b) for a, b, c in zip(first, second, at.correction)]
        return [c * dr.fma(exit.row[1], b - a, a) for a, b, c in zip(first, second, at.correction)]

    def pdf(self, at, exit, cells):
        """Densities per steradian with which `sample` finds the direction: interior, rehit."""
        first, second = (record[2:] for record in cells)
        if self.axis.plane:
            ahead, back = Forward(exit.concentration).pdf(exit.y2) * exit.rates[0], (0.5 / _PI) * exit.rates[1]
            density = [a * ahead + b * back for a, b in zip(first, second)]
        else:
            density = [exit.rates[0] * dr.fma(exit.row[1], b - a, a) for a, b in zip(first, second)]
        density = [d * inverse for d, inverse in zip(density, at.inverse_total)]
        in_cap = exit.sin < self.cap_sin
        return [dr.select(in_cap, share * self.cap_density, d) for share, d in zip(at.cap, density)]

    def sample(self, rehit, at, select, u, v):
        """θo's sine and cosine, and φ, of the lobe interior or (mask) rehit."""
        types = self.types
        pick = lambda record: dr.select(rehit, record[1], record[0])
        near = (1.0 - at.fraction) * pick(self.total.read(at.node))
        second, select = _split(select, near / at_least(pick(at.total), _TINY))
        incidence = dr.select(second, at.following, at.node) + dr.select(rehit, types.UInt32(self.incidences), 0)
        phi, row = None, incidence * self.rows
        if not self.axis.plane:
            mirrored = v >= 0.5
            v = dr.select(mirrored, 2.0 * v - 1.0, 2.0 * v)
            position = self.among_rows.invert(incidence, v)
            index, fraction = self._cell(position, self.rows)
            a, b, _ = self.among_rows.at(incidence, index)
            near, far = (1.0 - fraction) * a, fraction * b
            second, select = _split(select, near / at_least(near + far, _TINY))
            row = row + index + dr.select(second, types.UInt32(1), 0)
            phi = at_most(at.phi.offset(position), _PI)
            phi = dr.select(mirrored, -phi, phi)
        position = self.along_row.invert(row, u)
        # Elevation of the signed exit angle: from 0 at the forward horizon to π at the retro one.
        elevation = clip(at.room - at.columns.offset(position), 0.0, _PI if self.axis.plane else _HALF_PI)
        cos, sin = dr.sincos(elevation)
        if self.axis.plane:
            forward = Forward(at.concentration * at_least(sin, 0.0)).sample(v)
            phi = dr.select(sin >= 0.0, forward, _PI * (2.0 * v - 1.0))
        sin = dr.abs(sin)
        in_cap = (sin < self.cap_sin) & (cos > 0.0)
        # Two numbers that say nothing about falling into the cap: what is left of the one that chose the rows, and
        # either v, on which only φ depended, or u as a share of the row's part within the cap.
        area, turn = select, v
        if not self.axis.plane:
            edge, *_ = at.columns.position(self.cap - _HALF_PI + at.room)
            within = self.along_row.cumulated(row, edge, *self._cell(edge, self.columns))
            area, turn = clip(u / at_least(within, _TINY), 0.0, 1.0), select
        chord2 = float(np.sin(0.5 * self.cap) ** 2) * area
        cap_sin = 2.0 * dr.sqrt(chord2 * (1.0 - chord2))
        sin, cos = dr.select(in_cap, cap_sin, sin), dr.select(in_cap, 1.0 - 2.0 * chord2, cos)
        return sin, cos, dr.select(in_cap, _PI * (2.0 * turn - 1.0), phi)


class Distribution:
    """Rows of densities over equal cells, linear between the middles of two and constant beyond the outermost: each of sum 1, or dark."""

    def __init__(self, types, density):
        """density: [row, cell]."""
        self.types, self.count = types, density.shape[1]
        below = density.cumsum(axis=1) - 0.5 * density
        following = np.concatenate([density[:, 1:], density[:, -1:]], axis=1)
        records = np.stack([density, following, below, np.zeros_like(below)], axis=2)
        self.search = Search(types, below, records.reshape(-1, 4))

    def at(self, row, index):
        """Densities in a cell and in the next, and the integral up to the middle of the first."""
        return self.search.records.read(row * self.count + index)[:3]

    def cumulated(self, row, position, index, fraction):
        """Integral of a row up to a position, which lies in a cell so far towards the next."""
        a, b, below = self.at(row, index)
        return dr.select(position < 0.5, position * a, below + fraction * dr.fma(0.5 * fraction, b - a, a))

    def invert(self, row, share):
        """Position where the integral of a row reaches a share."""
        types = self.types
        above = self.search.count(share, row)
        k = dr.maximum(above, types.UInt32(1)) - 1
        a, b, below = self.at(row, k)
        rest = share - below
        # a·t + (b − a)·t²/2 = rest, in the form that does not cancel; before the first middle the density is constant.
        b = dr.select(above == 0, a, b)
        root = _sqrt(dr.fma(a, a, 2.0 * (b - a) * rest))
        t = 2.0 * rest / at_least(a + root, _TINY)
        lowest = dr.select(above == 0, -0.5, 0.0)
        highest = dr.select(k == self.count - 1, 0.5, 1.0)
        return types.Float(k) + 0.5 + clip(t, lowest, highest)


@dataclass
class Exit:
    """Where an exit direction lies in the table at one incidence."""

    #: Column cells ahead and back (decay) or one (space); dposition/dx there over sin θo (decay), d(positions)/dω over 2 (space).
    cells: list
    rates: list
    #: φ cell, space tables.
    row: tuple | None
    #: Concentration of the decay, decay tables.
    concentration: object
    sin: object
    y2: object


def _split(u, first):
    """Chooses the second of two by the probability of the first, and what is left of the random number."""
    second = u >= first
    rest, share = dr.select(second, u - first, u), dr.select(second, 1.0 - first, first)
    return second, clip(rest / at_least(share, _TINY), 0.0, _BELOW_ONE)


def _one_minus_exp(z):
    series = z * (1.0 - (1 / 2) * z * (1.0 - (1 / 3) * z * (1.0 - (1 / 4) * z * (1.0 - (1 / 5) * z))))
    return dr.select(z > 0.03, 1.0 - dr.exp(-z), series)


def _decay(x, y2):
    """D(φ) at concentration x from y2 = sin²(φ/2)."""
    x2 = 2.0 * at_least(x, 1e-9)
    ratio = _one_minus_exp(x2 * (1.0 - y2)) / _one_minus_exp(x2)
    return dr.exp(-at_most(x2 * y2, 80.0)) * ratio


class Forward:
    """Density of φ that follows D within a bounded factor and inverts in closed form (pearl-bsdf, `azimuth`)."""

    def __init__(self, x):
        self.k = at_least(1.6 * _sqrt(x), 1e-2)
        e = dr.exp(-2.0 * self.k)
        # Numerator and denominator of tanh k.
        self.gap, self.sum = 1.0 - e, 1.0 + e
        self.narrow = x / (x + 0.25)

    def pdf(self, y2):
        """Density per radian of φ."""
        e = dr.exp(-at_most(2.0 * self.k * dr.sqrt(y2), 80.0))
        # ¼·√(1 − y²)·k·sech²(ky)/tanh k.
        narrow = _sqrt(1.0 - y2) * self.k * e * self.sum / (dr.square(1.0 + e) * self.gap)
        return (1.0 - self.narrow) * (0.5 / _PI) + self.narrow * narrow

    def sample(self, u):
        """φ ∈ [−π, π]."""
        negative = u >= 0.5
        u = dr.select(negative, 2.0 * u - 1.0, 2.0 * u)
        broad = u >= self.narrow
        v = (u - self.narrow) / at_least(1.0 - self.narrow, _TINY)
        t = at_most(u / at_least(self.narrow, _TINY), 1.0) * self.gap / self.sum
        t = clip(t, 0.0, _BELOW_ONE)
        y = at_most(0.5 * dr.log((1.0 + t) / (1.0 - t)) / self.k, 1.0)
        phi = dr.select(broad, _PI * at_most(v, 1.0), 2.0 * dr.asin(y))
        return dr.select(negative, -phi, phi)
