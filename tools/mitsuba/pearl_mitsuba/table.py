"""A pearl table (docs/LUT-FORMAT.md), read and made ready for evaluation, in NumPy.

All angles are radians. Lobes come in the order interior, rehit: what is tabulated. The single reflection at the first
interface is a closed form (`facets`).
"""

import json
import zlib
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from . import check, compact, curves
from .axes import HALF_PI, ExitAxis, concentration, neighbours, reading_weights, sampling_measure
from .facets import Facets

#: How far within a span of θi its ends are where what is read over the albedo is asked for, in lengths of it; and the most that is
#: read for an albedo.
_INSIDE = 1e-6
_DARKEST = 1e30
#: Grid on which hemispherical integrals are known at least (as in the crate lut-io): largest step, and step as a
#: share of hypot(w, distance of θi to 0 or 90°).
_LARGEST_STEP = np.radians(0.5)
_RELATIVE_STEP = 0.02
_MIN_STEPS = 4
#: In integrals over the lobes a point for so much of a smooth piece, radians, and the most points a piece.
_REACH = np.radians(1.0)
_MOST_POINTS = 4
#: Incidences at which the half-vector angles of the lobes are tallied: every eighth node of `curves`, at most a degree apart.
_STEPS_PER_TALLY = 8
_TALLIES = curves.STEPS // _STEPS_PER_TALLY + 1

BAKE = "bake-brdf RECIPE -o pearl.exr"


class PearlError(ValueError):
    """A table or a parameter that makes no BSDF; the message names it, and what would be right."""


@dataclass(frozen=True)
class Spectra:
    """Interference colours over θ (radians) and wavelength (nm): modulation M of the lobes, emission Ê of the base.

    Each of the two is None where the table has none, else a pair (θ, values[θ, channel]) per kind of channel.
    """

    wavelength_nm: np.ndarray
    modulation: dict | None
    emission: dict | None

    @classmethod
    def of(cls, section):
        """From the section `spectra` of the metadata."""

        def part(name, key):
            found = section.get(name)
            if found is None:
                return None
            theta = np.radians(found["theta_deg"])
            return {
                "bands": (theta, np.array(found[key], float)),
                "rgb": (theta, np.array(found[f"{key}_rgb"], float)),
            }

        nm = np.array(section["wavelength_nm"], float)
        return cls(nm, part("coherent", "modulation"), part("emission", "radiance"))


@dataclass(frozen=True, eq=False)
class Table:
    """A table with all that evaluating it needs."""

    name: str
    meta: dict
    axis: ExitAxis
    facets: Facets
    #: Incidences, and w of the decay postulate at each.
    theta: np.ndarray
    azimuth_width: np.ndarray
    #: f·cos θo in 1/sr, [incidence, φ row, column, lobe], float32.
    values: np.ndarray
    #: Albedo over θi of interior, surface (single reflection) and rehit: functions of θ.
    albedo: tuple
    spectra: Spectra | None

    @cached_property
    def spans(self):
        """Ends of the ranges of θi that one pair of rows serves: the incidences, 0 and π/2."""
        ends = list(self.theta)
        if ends[0] > 0.0:
            ends.insert(0, 0.0)
        if ends[-1] < HALF_PI:
            ends.append(HALF_PI)
        return np.array(ends)

    @cached_property
    def rows_of_spans(self):
        """The two incidences that each span mixes (the same one outside the table's incidences)."""
        last = len(self.theta) - 1
        before = np.searchsorted(self.theta, self.spans[:-1], side="right") - 1
        after = np.searchsorted(self.theta, self.spans[1:], side="left")
        before = np.where(before < 0, 0, before)
        return before, np.where(after > last, last, after)

    @cached_property
    def span_steps(self):
        """Steps of every span of θi at which what is read over the albedo is known: more where rows are many widths apart."""
        longest = np.diff(self.spans).max()
        return 128 << int(np.clip(np.ceil(np.log2(np.sqrt(longest / self.axis.width)) - 1e-6), 0, 4))

    def width_at(self, theta_i):
        """w of the decay postulate, linear between incidences."""
        return np.interp(theta_i, self.theta, self.azimuth_width)

    @cached_property
    def read_over_albedo(self):
        """What is read over the albedo, which restores it, [span, step, lobe], at equal steps of each span. A mixture's light is
        nearly linear along a span; one over it is not where a row adds many times its share."""
        steps = _integral_steps(self.axis.width)
        before, after = self.rows_of_spans
        cells = self.values.reshape(len(self.theta), -1, 2).astype(float)
        ratios = np.empty((len(before), self.span_steps + 1, 2))
        # Where a lobe goes out at an end, what it tends to counts, not 0/0.
        t = np.clip(np.arange(self.span_steps + 1) / self.span_steps, _INSIDE, 1.0 - _INSIDE)
        for span, (lo, hi) in enumerate(zip(self.spans, self.spans[1:])):
            inner = steps[(lo < steps) & (steps < hi)]
            at = np.unique(np.concatenate([inner, lo + (hi - lo) * np.arange(_MIN_STEPS) / _MIN_STEPS, [hi]]))
            weights = np.array([reading_weights(self.axis, theta, self.width_at(theta)) for theta in at])
            asked = lo + (hi - lo) * t
            for lobe in range(2):
                read = [np.interp(asked, at, weights @ cells[row, :, lobe]) for row in (before[span], after[span])]
                integral = read[0] * (1.0 - t) + read[1] * t
                share = self.albedo[2 * lobe](asked)
                ratio = np.divide(integral, share, out=np.full_like(share, _DARKEST), where=share > 0.0)
                ratios[span, :, lobe] = np.where(integral > 0.0, np.minimum(ratio, _DARKEST), 1.0)
        return ratios

    @cached_property
    def measure(self):
        """dω/dposition at every cell centre at its own incidence, [incidence, φ row, column]."""
        widths = self.azimuth_width
        rows = [sampling_measure(self.axis, theta, width) for theta, width in zip(self.theta, widths)]
        return np.array(rows).reshape(self.values.shape[:3])

    @cached_property
    def mirror_scale(self):
        """Over the nodes of `curves`: factor of the closed-form reflection that gives it its share of the light."""
        integral = np.array([self.facets.integrate(cos)[0].sum() for cos in curves.COS])
        share = self.albedo[1](curves.THETA)
        return np.where(integral > 0.0, share / np.where(integral > 0.0, integral, 1.0), 0.0)

    @cached_property
    def reciprocal(self):
        """Whether the table is read at the larger of both angles (docs/LUT-FORMAT.md §13)."""
        return "reciprocal" in self.meta

    @cached_property
    def mirror_ends(self):
        """Over the nodes of `curves`, of reciprocal tables: r for which the closed-form reflection times r(θi)·r(θo)·cos θo has its
        share of the light at every θi (symmetric scaling)."""
        share = self.albedo[1](curves.THETA)
        masses, index, fraction = [], [], []
        for cos in curves.COS:
            mass, _, cos_o = self.facets.integrate_exits(cos)
            masses.append(mass * cos_o)
            at, t = curves.place(cos_o)
            index.append(at.astype(np.int32))
            fraction.append(t)
        masses, index, fraction = np.array(masses), np.array(index), np.array(fraction)
        ends = np.ones(curves.NODES)
        for _ in range(200):
            read = ends[index] + fraction * (ends[index + 1] - ends[index])
            light = ends * (masses * read).sum(axis=1)
            lit = (light > 0.0) & (share > 0.0)
            ratio = np.where(lit, share / np.where(lit, light, 1.0), 0.0)
            ends *= np.sqrt(ratio)
            if np.abs(ratio[lit] - 1.0).max(initial=0.0) < 1e-9:
                break
        return ends

    @cached_property
    def albedos(self):
        """Albedo at the nodes of `curves` of interior, surface and rehit, brightness 1 and no interference."""
        albedos = np.array([albedo(curves.THETA) for albedo in self.albedo])
        if self.reciprocal:
            # Read at the larger angle the lobes send back a little more or less than their albedo.
            section = self.meta["reciprocal"]
            for lobe, key in ((0, "interior_gain"), (2, "rehit_gain")):
                gain = np.array(section[key], float)
                albedos[lobe] += np.interp(curves.THETA, np.linspace(0.0, HALF_PI, len(gain)), gain)
            albedos = np.maximum(albedos, 0.0)
        return albedos

    def coloured_albedos(self, factor):
        """The same where the light at half-vector angle θd is multiplied by factor[node, channel]."""
        read = curves.spline_matrix(_TALLIES, np.arange(curves.NODES) / _STEPS_PER_TALLY)
        means = [read @ (tally @ factor) for tally in self._half_angles]
        return np.array([np.maximum(mean, 0.0) * share[:, None] for mean, share in zip(means, self.albedos)])

    @cached_property
    def _half_angles(self):
        """Where the lobes' light has its half-vector angles: for interior, surface, rehit a histogram over the nodes
        of `curves` for each tallied incidence, of sum 1 (0 without light)."""
        tallies = np.zeros((3, _TALLIES, curves.NODES))
        for incidence in range(_TALLIES):
            # At 90° no light arrives; its limit is what counts.
            theta_i = min(curves.THETA[incidence * _STEPS_PER_TALLY], HALF_PI - 1e-6)
            cos_d, light = self._tabulated_light(theta_i)
            mass, cos, cos_o = self.facets.integrate_exits(np.cos(theta_i))
            if self.reciprocal:
                mass = mass * cos_o * np.interp(np.arccos(cos_o), curves.THETA, self.mirror_ends)
            for tally, masses, at in zip(tallies, (light[0], mass, light[1]), (cos_d, cos, cos_d)):
                index, fraction = curves.place(at)
                tally[incidence] += np.bincount(index, (1.0 - fraction) * masses, curves.NODES)
                tally[incidence] += np.bincount(index + 1, fraction * masses, curves.NODES)
        total = tallies.sum(axis=2, keepdims=True)
        return np.divide(tallies, total, out=np.zeros_like(tallies), where=total > 0.0)

    def _tabulated_light(self, theta_i):
        """Light of the tabulated lobes piece by piece: cos θd, and the masses of interior and rehit."""
        exits = np.sort(np.append(np.abs(self.axis.columns_at(theta_i).kinks()), 0.0))
        theta_o, weight_o, _ = _rule_between(exits[None, :])
        if self.axis.plane:
            x = concentration(theta_i, HALF_PI, self.width_at(theta_i)) * np.sin(theta_o)
            width = np.clip(0.5 / np.sqrt(np.maximum(x, 1e-300)), 1e-7, 1.0)
            ends = width[:, None] * np.sinh(np.arange(29) / 28.0 * np.arcsinh(np.pi / width)[:, None])
            phi, weight_phi, exit = _rule_between(ends)
        else:
            phi, weight_phi, _ = _rule_between(np.sort(self.axis.phi_at(theta_i).kinks())[None, :])
            exit = np.repeat(np.arange(len(theta_o)), len(phi))
            phi, weight_phi = np.tile(phi, len(theta_o)), np.tile(weight_phi, len(theta_o))
        theta_o, weight_o = theta_o[exit], weight_o[exit]
        y2 = np.sin(0.5 * phi) ** 2
        light = self._read(theta_i, theta_o, y2)
        if self.reciprocal:
            # Read at the larger angle, where the correction is another one.
            light = light * self._correction_at(theta_i)
            swap = theta_o > theta_i
            back = self._read(theta_o[swap], theta_i, y2[swap]) * self._correction_at(theta_o[swap])
            light[swap] = back * (np.cos(theta_o[swap]) / np.cos(theta_i))[:, None]
        weight = 2.0 * weight_o * weight_phi * np.sin(theta_o)
        dot = np.cos(theta_i) * np.cos(theta_o) - np.sin(theta_i) * np.sin(theta_o) * (1 - 2 * y2)
        cos_d = np.sqrt(np.maximum(0.5 * (1.0 + dot), 0.0))
        return cos_d, [lobe * weight for lobe in np.moveaxis(light, -1, 0)]

    def _correction_at(self, theta_i):
        """Factors that restore the albedos of both lobes (last axis)."""
        span = np.clip(np.searchsorted(self.spans, theta_i, side="right") - 1, 0, len(self.spans) - 2)
        lo, hi = self.spans[span], self.spans[span + 1]
        step = np.clip((theta_i - lo) / (hi - lo), 0.0, 1.0) * self.span_steps
        k = np.minimum(np.asarray(step).astype(int), self.span_steps - 1)
        t = (step - k)[..., None]
        return 1.0 / (self.read_over_albedo[span, k] * (1.0 - t) + t * self.read_over_albedo[span, k + 1])

    @cached_property
    def _cells(self):
        """The values in double precision, [cell of all rows, lobe]."""
        return self.values.reshape(-1, 2).astype(float)

    def _read(self, theta_i, theta_o, y2):
        """f·cos θo of both lobes (last axis) at pairs of angles; y2 = sin²(φ/2). Short of the correction."""
        columns = self.axis.columns_at(theta_i)
        last = len(self.theta) - 1
        node = np.clip(np.searchsorted(self.theta, theta_i, side="right") - 1, 0, max(last - 1, 0))
        following = np.minimum(node + 1, last)
        distance = np.where(following > node, self.theta[following] - self.theta[node], 1.0)
        t = np.clip((theta_i - self.theta[node]) / distance, 0.0, 1.0)[..., None]
        rows = self.values.shape[1]

        def along(row, x):
            cell, fraction = neighbours(columns.position(x), columns.cells)
            fraction = fraction[..., None]
            first = ((i * rows + row) * columns.cells + cell for i in (node, following))
            before, after = (
                self._cells.take(at, axis=0) * (1.0 - fraction) + fraction * self._cells.take(at + 1, axis=0) for at in first
            )
            return (1.0 - t) * before + t * after

        if self.axis.plane:
            x = concentration(theta_i, theta_o, self.width_at(theta_i))
            d = _decay(x, y2)[..., None]
            return along(0, theta_o) * d + along(0, -theta_o) * (1.0 - d)
        phi = self.axis.phi_at(theta_i)
        row, fraction = neighbours(phi.position(2.0 * np.arcsin(np.sqrt(y2))), phi.cells)
        fraction = fraction[..., None]
        return along(row, theta_o) * (1.0 - fraction) + fraction * along(row + 1, theta_o)


_leggauss = cache(np.polynomial.legendre.leggauss)


def _rule_between(ends):
    """Gauss–Legendre points, weights and row of all pieces between the ascending ends in each row.

    Long pieces get more points: within them θd runs through waves of the interference.
    """
    points, weights, rows = [], [], []
    middle, half = 0.5 * (ends[:, 1:] + ends[:, :-1]), 0.5 * np.diff(ends, axis=1)
    count = np.clip(np.ceil(2.0 * half / _REACH), 1, _MOST_POINTS).astype(int)
    for n in range(1, _MOST_POINTS + 1):
        row, piece = np.nonzero((count == n) & (half > 0.0))
        x, w = _leggauss(n)
        points.append((middle[row, piece][:, None] + half[row, piece][:, None] * x).ravel())
        weights.append((half[row, piece][:, None] * w).ravel())
        rows.append(np.repeat(row, n))
    return tuple(np.concatenate(parts) for parts in (points, weights, rows))


def _decay(x, y2):
    """D of docs/LUT-FORMAT.md §4 from y2 = sin²(φ/2)."""
    floor = np.maximum(x, 1e-9)
    decayed = np.exp(-2.0 * floor * y2) * np.expm1(-2.0 * floor * (1.0 - y2)) / np.expm1(-2.0 * floor)
    return np.where(x < 1e-9, 1.0 - y2, decayed)


def _integral_steps(width):
    """Incidences at which integrals are known at least, beside those of the table."""
    near = [0.0]
    while near[-1] < 0.25 * np.pi:
        near.append(min(width * np.sinh(_RELATIVE_STEP * len(near)), near[-1] + _LARGEST_STEP))
    near = np.array(near)
    return np.sort(np.concatenate([near, HALF_PI - near, [width, HALF_PI - width]]))


def read(path, bitmap):
    """Reads a table; `bitmap` is Mitsuba's Bitmap class.

    Raises PearlError where there is no file, or one that is not a table.
    """
    path = Path(path)
    if not path.is_file():
        raise PearlError(f"pearl: filename: {path} is not a file; `{BAKE}` bakes one")
    try:
        image = bitmap(str(path))
    except RuntimeError as error:
        reason = str(error).strip().splitlines()[-1]
        raise PearlError(f"pearl: {path}: cannot be read as OpenEXR ({reason}); `{BAKE}` bakes a table") from None
    text = image.metadata()["pearl"] if "pearl" in image.metadata() else None
    if not isinstance(text, str):
        raise PearlError(f"pearl: {path}: has no attribute `pearl`, so it is no pearl table; `{BAKE}` bakes one")
    try:
        meta = json.loads(text)
        check.schema(meta)
        return _table(path, compact.unpacked(meta), image)
    except PearlError:
        raise
    except check.Flaw as flaw:
        raise PearlError(f"pearl: {path}: {flaw}; bake it again: `{BAKE}`") from None
    except (KeyError, TypeError, IndexError, ValueError, zlib.error) as error:
        problem = f"{type(error).__name__}: {error}"
        raise PearlError(f"pearl: {path}: metadata is damaged ({problem}); bake it again: `{BAKE}`") from None


def _table(path, meta, image):
    schema = meta["schema"]
    if not schema.startswith("pearl-lut/1"):
        raise PearlError(f"pearl: {path}: schema is {schema!r}, this plugin reads pearl-lut/1: install its newer version")
    check.metadata(meta)
    kind = meta["exit_axis"]
    plane = kind["kind"] == "plane"
    axis = ExitAxis(
        plane, kind["cells"] if plane else kind["theta_cells"], 1 if plane else kind["phi_cells"], kind["width"]
    )
    summaries = meta["per_incidence"]
    names = [field.name for field in image.struct_()]
    pixels = np.array(image, copy=False)
    expected = compact.image_size(meta, axis)
    if pixels.shape[:2] != expected:
        raise PearlError(f"pearl: {path}: is {pixels.shape[1]} × {pixels.shape[0]} pixels, its metadata say "
                         f"{expected[1]} × {expected[0]}")  # fmt: skip
    lobes = []
    for name in ("interior", "rehit"):
        if name not in names:
            raise PearlError(f"pearl: {path}: has no channel {name!r}; bake it again: `{BAKE}`")
        lobe = compact.values(meta, axis, name, pixels[:, :, names.index(name)])
        if not (np.isfinite(lobe).all() and (lobe >= 0).all()):
            raise PearlError(f"pearl: {path}: channel {name!r} has a value that is not finite or negative")
        lobes.append(lobe)
    values = np.stack(lobes, axis=-1).astype(np.float32).reshape(len(summaries), axis.rows, axis.columns, 2)

    def column(key):
        return np.array([summary[key] for summary in summaries], float)

    theta = np.radians(column("theta_i_deg"))
    interior, surface, rehit = (
        curves.monotone(theta, share)
        for share in (np.maximum(column("albedo") - column("surface"), 0.0), column("surface"), column("rehit"))
    )
    single = lambda at: np.maximum(surface(at) - rehit(at), 0.0)  # noqa: E731
    spectra = Spectra.of(meta["spectra"]) if "spectra" in meta else None
    return Table(
        str(path), meta, axis, Facets.of(meta["surface_model"]), theta, np.radians(column("azimuth_width_deg")), values,
        (interior, single, rehit), spectra,
    )  # fmt: skip
