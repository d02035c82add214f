"""A pearl table as the plugin reads it: its prepared arrays (docs/ARRAYS.md)."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from .._nacre import InputError, arrays
from .._nacre import Table as Stored
from .axes import HALF_PI, ExitAxis, sampling_measure

BAKE = "bake-brdf RECIPE -o pearl.exr"

#: Arrays whose first axis is the band.
_BY_BAND = (
    "wavelength_nm", "slope_sd", "index_ratio", "azimuth_width", "span_curves", "cells", "mirror", "albedo_plain",
    "modulation_rgb", "modulation_spectral", "albedo_rgb", "albedo_spectral",
)  # fmt: skip
#: Those whose second is.
_BY_SCALE_AND_BAND = ("modulation_rgb_scaled", "rest_rgb_scaled")


class PearlError(InputError):
    """A table or a parameter that makes no BSDF; the message names it, and what would be right."""


class Doubles(dict):
    """Arrays in double precision, each made where it is first asked for."""

    def __init__(self, stored):
        super().__init__()
        self.stored = stored

    def __missing__(self, name):
        self[name] = doubles = self.stored[name].astype(float)
        return doubles

    def of_band(self, band):
        """Those of one band alone."""
        own = slice(band, band + 1)
        of = lambda name, array: array[own] if name in _BY_BAND else array[:, own] if name in _BY_SCALE_AND_BAND else array
        return Doubles({name: of(name, array) for name, array in self.stored.items()})


@dataclass(frozen=True, eq=False)
class Table:
    """The lobes of a table at one wavelength, with all that evaluating them needs; angles are radians. Lobes come in the order
    interior, rehit: what is tabulated."""

    name: str
    meta: dict = field(repr=False)
    arrays: Doubles = field(repr=False)
    #: What `colours` makes of it, by kind.
    palettes: dict = field(default_factory=dict, repr=False)
    #: What `layer` makes of it, by variant.
    layers: dict = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, stored, name):
        """Of a `nacre.Table`."""
        return cls(name, stored.meta, Doubles(arrays(stored)))

    @cached_property
    def bands(self):
        """The table at each of its wavelengths, its own first."""
        further = range(1, len(self.arrays["wavelength_nm"]))
        return [self, *(replace(self, arrays=self.arrays.of_band(k), palettes={}, layers={}) for k in further)]

    @cached_property
    def axis(self):
        """The exit cells."""
        _, _, rows, columns, _ = self.arrays["cells"].shape
        return ExitAxis(not self.arrays["space"], columns, rows, self.meta["exit_axis"]["width"])

    @cached_property
    def theta(self):
        """Angles of incidence, ascending."""
        return np.radians([summary["theta_i_deg"] for summary in self.meta["per_incidence"]])

    @cached_property
    def spans(self):
        """Ends of the ranges of θi that one pair of rows serves: the incidences, 0 and π/2. With more digits than the array has."""
        theta = self.theta
        return np.concatenate([[0.0] if theta[0] > 0.0 else [], theta, [HALF_PI] if theta[-1] < HALF_PI else []])

    @cached_property
    def rows_of_spans(self):
        """The two incidences that each span mixes (the same one outside the table's incidences)."""
        before, after = self.arrays["span_node"].T.astype(int)
        return before, after

    @property
    def span_curves(self):
        """At equal steps of each span, [span, step, 4]: what is read over the albedo of interior and rehit; share of the sampled light
        of either around the normal."""
        return self.arrays["span_curves"][0]

    @property
    def widths_of_spans(self):
        """w of the decay postulate at both ends of each span, [span, 2]."""
        return self.arrays["azimuth_width"][0]

    @cached_property
    def values(self):
        """f·cos θo in 1/sr, [incidence, φ row, column, lobe], float32."""
        return np.ascontiguousarray(self.arrays["cells"][0, ..., :2], np.float32)

    @property
    def densities(self):
        """What is sampled of each cell, as `values`."""
        return self.arrays["cells"][0, ..., 2:]

    @cached_property
    def measure(self):
        """dω/dposition at every cell centre at its own incidence, [incidence, φ row, column]: densities of values that a user sets."""
        widths = np.radians([summary["azimuth_width_deg"] for summary in self.meta["per_incidence"]])
        rows = [sampling_measure(self.axis, theta, width) for theta, width in zip(self.theta, widths, strict=True)]
        return np.array(rows).reshape(self.values.shape[:3])

    @property
    def mirror_scale(self):
        """Over the nodes of `curves`: factor of the single reflection over θi (reciprocal tables: over θi, and over θo)."""
        return self.arrays["mirror"][0]

    @property
    def reciprocal(self):
        """Whether the table is read at the larger of both angles (docs/LUT-FORMAT.md §13)."""
        return bool(self.arrays["reciprocal"])

    @cached_property
    def scales(self):
        """Scales of the thicknesses that the table has colours of, ascending, 1 among them; None of a table of one thickness."""
        section = (self.meta.get("spectra") or {}).get("thickness")
        return None if section is None else np.array(section["scale"])

    def has(self, effect):
        """Whether the table has the interference colours of an effect, `coherent` or `emission`."""
        return (self.meta.get("spectra") or {}).get(effect) is not None


def read(path):
    """Reads a table. Raises PearlError where there is no file, or one that is not a table."""
    try:
        return Table.of(Stored(Path(path)), str(path))
    except InputError as error:
        raise PearlError(f"pearl: filename: {error}; `{BAKE}` bakes a table") from None
