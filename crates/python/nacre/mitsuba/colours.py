"""What the controls make of a table's albedos and interference colours, channel by channel.

    f = brightness·lobe·[(1 − γ) + γ·tint·M(θd)]·limit(θi)
        + ρ·(1 − A(θi))·(1 − A(θo)) / (π(1 − A_avg)) · [(1 − depth) + depth·tint·Ê(view)]·limit

A is the directional albedo of the first term, linear in its colour factor: so all that a control changes follows from
curves over one angle (`curves`) that are prepared once per table. `derive` is written for NumPy arrays and for Dr.Jit's
differentiable ones alike.
"""

from dataclasses import dataclass, replace

import numpy as np

from . import curves

#: Below this the light left for the base is rounding.
_NOTHING_LEFT = 1e-12
#: Of linear sRGB.
LUMINANCE = (0.212671, 0.715160, 0.072169)


@dataclass(frozen=True, eq=False)
class Palette:
    """Channels of one kind, over the nodes of `curves`; arrays are [channel, node]."""

    #: tint of a channel = weights [channel, rgb] · tint.
    tint_weights: np.ndarray
    modulation: np.ndarray
    emission: np.ndarray
    #: Albedo of interior, surface, rehit where the factor is 1 ([lobe, node]) and where it is M ([lobe, channel, node]).
    plain: np.ndarray
    modulated: np.ndarray
    #: Σ curve·weight is the cosine-weighted mean over the hemisphere of a curve read linearly between its nodes.
    hemispherical: np.ndarray
    #: Whether the first term has one limit for all incidences: what is the same both ways must stay so.
    one_limit: bool

    @property
    def channels(self):
        return len(self.tint_weights)

    @classmethod
    def of(cls, table, kind):
        """Channels of kind `rgb`, `mono` (luminance) or `bands` (one channel at all wavelengths for a plain table), once a table."""
        if kind not in table.palettes:
            table.palettes[kind] = cls._of(table, kind)
        return table.palettes[kind]

    @classmethod
    def _of(cls, table, kind):
        stored = "spectral" if kind == "bands" else "rgb"
        # Everything is linear in the channels.
        mixed = (lambda rows: np.tensordot([LUMINANCE], rows, 1)) if kind == "mono" else (lambda rows: rows)
        channels = lambda name: mixed(table.arrays[f"{name}_{stored}"])
        of_band = lambda name: mixed(table.arrays[f"{name}_{stored}"][0])
        # Interior, single, rehit; the arrays have the single reflection last.
        order = [0, 2, 1]
        plain, modulated = table.arrays["albedo_plain"][0][order], np.moveaxis(of_band("albedo")[:, order], 1, 0)
        weights = channels("reflectance")
        return cls(weights, of_band("modulation"), channels("emission"), plain, modulated, table.arrays["mean_weight"], table.reciprocal)

    @classmethod
    def scaled(cls, table, kind):
        """The channels of `rgb` or `mono` at every scale of the thicknesses, those of the first scale first."""
        own = cls.of(table, kind)
        mix = np.array([LUMINANCE]) if kind == "mono" else np.eye(3)
        flat = lambda rows: np.einsum("kc,scn->skn", mix, rows).reshape(-1, curves.NODES)
        modulation, rest = (flat(table.arrays[f"{name}_rgb_scaled"][:, 0]) for name in ("modulation", "rest"))
        emission, weights = flat(table.arrays["emission_rgb_scaled"]), np.tile(own.tint_weights, (len(table.scales), 1))
        return replace(own, tint_weights=weights, modulation=modulation, emission=emission, modulated=1.0 - rest[None])


def reflectances(nm):
    """What makes the reflectance at wavelengths of a colour in linear sRGB (docs/ARRAYS.md §4), [wavelength, 3]."""
    green_on, red_on = (np.clip((nm - centre) / 30.0 + 0.5, 0.0, 1.0) for centre in (490.0, 580.0))
    return np.stack([red_on, green_on - red_on, 1.0 - green_on], axis=1)


class NumPy:
    """The few array functions of `derive`, in NumPy."""

    repeat = staticmethod(np.repeat)
    maximum = staticmethod(np.maximum)
    select = staticmethod(np.where)

    @staticmethod
    def block_sum(values, size):
        return values.reshape(-1, size).sum(axis=1)

    @staticmethod
    def block_max(values, size):
        return values.reshape(-1, size).max(axis=1)

    @staticmethod
    def array(values):
        return np.asarray(values, float)


@dataclass(frozen=True)
class Derived:
    """What evaluation reads, flat arrays of channel · NODES + node unless said otherwise."""

    #: brightness·[(1 − γ) + γ·tint·M] over θd.
    factor: object
    #: Limit of the first term over θi.
    limit: object
    #: 1 − A, limit included.
    rest: object
    #: tint·Ê.
    emission: object
    #: Per channel: 1 − A_avg.
    left: object


class Deriver:
    """Derives curves from controls; `ops` is NumPy or a Dr.Jit counterpart."""

    def __init__(self, palette, ops):
        self.ops, self.channels, self.one_limit = ops, palette.channels, palette.one_limit
        flat = lambda rows: ops.array(np.broadcast_to(rows, (palette.channels, curves.NODES)).ravel())
        self.palette_weights = palette.tint_weights
        self.tint_weights = self._columns(palette.tint_weights)
        self.modulation, self.emission = flat(palette.modulation), flat(palette.emission)
        self.albedo = palette.plain.sum(axis=0), palette.modulated.sum(axis=0)
        self.plain, self.modulated = map(flat, self.albedo)
        self.hemispherical = flat(palette.hemispherical)

    def _columns(self, weights):
        return [self.ops.array(column) for column in weights.T]

    def tint_of(self, tint, weights=None):
        """The tint of every channel; `weights` in place of those of the palette."""
        columns = self.tint_weights if weights is None else self._columns(weights)
        return sum(weight * channel for weight, channel in zip(columns, tint))

    def is_limited(self, _depth, brightness, coherence, tint, weights=None):
        """Whether the albedo passes 1 anywhere, of plain numbers: where it does not, no limit needs to be read."""
        plain, modulated = self.albedo
        tint = (self.palette_weights if weights is None else weights) @ tint
        return bool((brightness * ((1.0 - coherence) * plain + coherence * tint[:, None] * modulated) > 1.0).any())

    def __call__(self, depth, brightness, coherence, tint, weights=None):
        ops, n = self.ops, curves.NODES
        tint = ops.repeat(self.tint_of(tint, weights), n)
        factor = brightness * ((1.0 - coherence) + coherence * tint * self.modulation)
        albedo = brightness * ((1.0 - coherence) * self.plain + coherence * tint * self.modulated)
        albedo = ops.maximum(albedo, 0.0)
        most = ops.repeat(ops.block_max(albedo, n), n) if self.one_limit else albedo
        limit = 1.0 / ops.maximum(most, 1.0)
        rest = ops.maximum(1.0 - albedo * limit, 0.0)
        emission = tint * self.emission
        left = ops.block_sum(self.hemispherical * rest, n)
        return Derived(factor, limit, rest, emission, left)


def chances(palette, controls, body, shown):
    """Probability of sampling interior, rehit, surface and base at every node, [node, 4]: albedos of what is shown.

    controls: depth, brightness, coherence, tint; body: its colour by channel; shown: diffuse, incoherent, mirror, blur.
    """
    depth, brightness, coherence, tint = controls
    deriver = Deriver(palette, NumPy)
    derived = deriver(depth, brightness, coherence, tint)
    by_channel = lambda flat: flat.reshape(palette.channels, curves.NODES)
    coloured = deriver.tint_of(tint)[:, None] * palette.modulated
    lobes = brightness * ((1.0 - coherence) * palette.plain[:, None] + coherence * coloured)
    interior, surface, rehit = (np.maximum(lobes, 0.0) * by_channel(derived.limit)).mean(axis=1)
    lit = derived.left > _NOTHING_LEFT
    # As a viewer sees it, with the limit of `_shade`.
    body, coloured = np.where(lit, body, 0.0)[:, None], depth * by_channel(derived.emission)
    base = body / np.maximum(body * ((1.0 - depth) + coloured), 1.0) * by_channel(derived.rest)
    diffuse = (base * (1.0 - depth)).mean(axis=0)
    incoherent = (base * coloured).mean(axis=0)
    show_diffuse, show_incoherent, show_mirror, show_blur = shown
    chance = np.stack(
        [
            interior * show_blur,
            rehit * show_mirror,
            surface * show_mirror,
            diffuse * show_diffuse + incoherent * show_incoherent,
        ],
        axis=1,
    )
    total = chance.sum(axis=1, keepdims=True)
    return np.divide(chance, total, out=np.zeros_like(chance), where=total > 0.0)
