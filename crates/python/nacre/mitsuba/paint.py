"""What the derived curves make of the lobes and of the body, channel by channel.

All curves of one place are read together: a record holds all channels at a node, or two neighbouring bands at two
neighbouring nodes.
"""

from dataclasses import dataclass
from functools import cache

import drjit as dr
import numpy as np

from . import curves
from .lobes import at_least, clip

_PI = float(np.pi)
_NODES = np.arange(curves.NODES)


@dataclass
class Light:
    """What the base reflects, short of all colour: cos θo, its depth, and what is shown of its parts."""

    cos_o: object
    depth: object
    diffuse: object
    incoherent: object

    def coloured(self, body, scale, rest_i, rest_o, limit, factor, emission):
        """In one channel: what multiplies f·cos θo of the lobes, and f·cos θo of the diffuse and the incoherent base; scale: that of
        the base (`_base`)."""
        # At no viewing angle does the base send out more than it receives.
        sent = body * dr.fma(self.depth, emission - 1.0, 1.0)
        matte = body * scale / at_least(sent, 1.0) * rest_i * rest_o * self.cos_o
        return factor * limit, matte * self.diffuse, matte * (self.incoherent * emission)


def _base(types, derived):
    """Per channel 1/(π(1 − A_avg)), 0 where nothing is left for the base."""
    if types.jit:
        return dr.select(derived.left > 1e-12, 1.0 / (_PI * dr.maximum(derived.left, 1e-12)), 0.0)
    return np.where(derived.left > 1e-12, 1.0 / (_PI * np.maximum(derived.left, 1e-12)), 0.0)


@cache
def _channel_places(types, count, scales=1):
    """Width of the records of so many channels, and where their numbers lie: at nodes, and by channel."""
    width = 1 if count == 1 else 4
    # A fourth channel fills the record: it repeats the third.
    channel = np.arange(scales)[:, None] * count + np.minimum(np.arange(width), count - 1)
    return width, types.indices(channel[:, None] * curves.NODES + _NODES[:, None]), types.indices(channel)


@cache
def _band_places(types, last):
    """Where the numbers lie of records of one place: a band at a node and at the next, then the band above; and of bands and the next."""
    node = np.minimum(_NODES[:, None] + np.array([0, 1, 0, 1]), curves.STEPS)
    band = np.arange(last)[:, None, None] + np.array([0, 0, 1, 1])
    return types.indices(band * curves.NODES + node), types.indices(np.arange(last)[:, None] + np.array([0, 1]))


@dataclass
class Thickness:
    """A scale s of all thicknesses: s, the scale of the table before it, and how far (0..1) it is towards the next."""

    s: object
    before: object
    fraction: object

    @classmethod
    def of(cls, types, scales, s):
        """Of scales with equal ratios below 1 and above it; s is clipped to them."""
        one = int(np.flatnonzero(scales == 1.0)[0])
        first, last = float(scales[0]), float(scales[-1])
        s = dr.clip(s, first, last)
        ln = dr.log(s)
        # No ratios where 1 is an end.
        below = ln * (one / -np.log(first)) if one > 0 else 0.0 * ln
        above = ln * ((len(scales) - 1 - one) / np.log(last)) if one < len(scales) - 1 else 0.0 * ln
        x = one + dr.select(ln < 0.0, below, above)
        before = dr.clip(types.floor(dr.maximum(dr.detach(x), 0.0)), 0, len(scales) - 2)
        return cls(s, before, x - types.Float(before))

    def between(self, read):
        """What `read` finds at both scales, read linearly between them."""
        return [dr.fma(self.fraction, b - a, a) for a, b in zip(read(self.before), read(self.before + 1))]


def _shaded(channels, read, scale, light, places, body, wavelengths):
    """`Light.coloured` of all channels, of what `read` finds in a store at a place."""
    at_i, at_o, at_d = places
    limit = read(channels.limit, at_i) if channels.limit else [1.0] * channels.count
    records = (
        read(channels.rest, at_i), read(channels.rest, at_o), limit, read(channels.factor, at_d),
        read(channels.emission, at_i),
    )  # fmt: skip
    asked = range(channels.count) if wavelengths is None else [0] * len(wavelengths)
    return [light.coloured(body[k], scale[c], *(record[c] for record in records)) for k, c in enumerate(asked)]


class Channels:
    """One or three channels, each read by itself (rgb, mono; tables without colour)."""

    def __init__(self, types, derived, limited, _bands, _means):
        self.types = types
        self.count = len(derived.left)
        width, places, _ = _channel_places(types, self.count)
        store = lambda flat: types.rearranged(flat, places, width)
        self.rest, self.factor, self.emission = map(store, (derived.rest, derived.factor, derived.emission))
        self.limit = store(derived.limit) if limited else None
        # Not read where it is asked for: what Dr.Jit reads at an index that it knows is another variable each time.
        self.base = types.numbers(_base(types, derived))

    def shade(self, light, places, body, wavelengths, _thickness=None):
        """`Light.coloured` of all channels. places: of the viewer, of the light, and of θd."""
        read = lambda store, place: store.between(*place)
        return _shaded(self, read, self.base, light, places, body, wavelengths)


class Scaled:
    """`Channels` of a table with scales of the thicknesses: as many places of each as there are scales."""

    def __init__(self, types, derived, limited, _bands, _means, scales):
        self.types = types
        self.count = len(derived.left) // scales
        width, places, channels = _channel_places(types, self.count, scales)
        store = lambda flat: types.rearranged(flat, places, width)
        self.rest, self.factor, self.emission = map(store, (derived.rest, derived.factor, derived.emission))
        self.limit = store(derived.limit) if limited else None
        self.base = types.rearranged(_base(types, derived), channels, width)

    def shade(self, light, places, body, wavelengths, thickness):
        """`Light.coloured` of all channels. places: of the viewer, of the light, and of θd."""

        def read(store, place):
            index, fraction = place
            return thickness.between(lambda scale: store.between(scale * curves.NODES + index, fraction))

        scale = thickness.between(lambda scale: self.base.read(scale))
        return _shaded(self, read, scale, light, places, body, wavelengths)


class Bands:
    """Many bands, read at any wavelength: mixed between the two around it, constant beyond the ends."""

    def __init__(self, types, derived, limited, bands, means):
        """means: of a table with scales of the thicknesses, [scale, node], what the emission is in units of at each."""
        self.types = types
        self.means = None if means is None else types.store(means, 1)
        self.first, self.last = float(bands[0]), len(bands) - 1
        self.per_nm = float(self.last / (bands[-1] - bands[0]))
        places, bands = _band_places(types, self.last)
        store = lambda flat: types.rearranged(flat, places, 4)
        self.rest, self.factor, self.emission = map(store, (derived.rest, derived.factor, derived.emission))
        self.limit = store(derived.limit) if limited else None
        self.base = types.rearranged(_base(types, derived), bands, 2)

    def shade(self, light, places, body, wavelengths, thickness=None):
        """`Light.coloured` at the wavelengths. places: of the viewer, of the light, and of θd."""
        mean = None
        if thickness is not None:
            # A stack s times as thick has at λ the colours of λ/s.
            wavelengths = [nm / thickness.s for nm in wavelengths]
            index, fraction = places[0]
            [mean] = thickness.between(lambda scale: self.means.between(scale * curves.NODES + index, fraction))
        return [self._at(light, places, body[k], wavelengths[k], mean) for k in range(len(wavelengths))]

    def _at(self, light, places, body, nm, mean):
        x = clip((nm - self.first) * self.per_nm, 0.0, float(self.last))
        band = dr.minimum(self.types.floor(x), self.last - 1)

        def read(store, place):
            index, fraction = place
            a, b, c, d = store.read(band * curves.NODES + index)
            return dr.fma(fraction, b - a, a), dr.fma(fraction, d - c, c)

        at_i, at_o, at_d = places
        scales = self.base.read(band)
        limit = read(self.limit, at_i) if self.limit else (1.0, 1.0)
        emission = read(self.emission, at_i)
        if mean is not None:
            emission = [band / mean for band in emission]
        records = read(self.rest, at_i), read(self.rest, at_o), limit, read(self.factor, at_d), emission
        below, above = (light.coloured(body, scale, *(record[k] for record in records)) for k, scale in enumerate(scales))
        fraction = x - self.types.Float(band)
        return tuple(dr.fma(fraction, b - a, a) for a, b in zip(below, above))
