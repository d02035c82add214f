"""The lobes of one band of a table, and what the controls make of its colours."""

from copy import copy
from functools import partial

import drjit as dr

from .colours import Deriver, NumPy, Palette, reflectances
from .lobes import Facets, Tabulated, at_least
from .paint import Bands, Channels, Scaled


class Layer:
    """One band: its lobes as they are read, and its colours once `paint` has the controls."""

    def __init__(self, types, table, sampled):
        self.types, self.reciprocal = types, table.reciprocal
        self.tabulated = Tabulated(types, table, sampled)
        self.facets = Facets(table.arrays)
        self.mirror_scale = types.store(table.mirror_scale, 1)
        # Of several bands the channels of sRGB have different shares: they are mixed before luminance is taken.
        several = len(table.arrays["rgb_weights"]) > 1
        kind = "bands" if types.spectral else "mono" if types.mono and not several else "rgb"
        palette = Palette.of(table, kind)
        self.channel_nm = table.arrays["channel_nm"] if kind == "bands" and palette.channels > 1 else None
        self.means, self.painter = None, Channels if self.channel_nm is None else Bands
        if table.scales is not None:
            if kind == "bands":
                self.means = table.arrays["emission_mean_scaled"]
            else:
                palette, self.painter = Palette.scaled(table, kind), partial(Scaled, scales=len(table.scales))
        self.derive = Deriver(palette, types if types.jit else NumPy)
        self.colours = None

    @classmethod
    def of(cls, types, table, sampled):
        """A layer of one pearl: what it has of the table alone it shares with those of all pearls of the variant."""
        if types.variant not in table.layers:
            table.layers[types.variant] = cls(types, table, sampled)
        return copy(table.layers[types.variant])

    def derived(self, controls, thickness):
        """What follows from depth, brightness, coherence and tint, and from the thickness, if it is one number."""
        return self.derive(*controls, self._tint_weights(thickness))

    def is_limited(self, controls, thickness):
        """Whether the first term has to be limited anywhere, of plain numbers."""
        return self.derive.is_limited(*controls, self._tint_weights(thickness))

    def _tint_weights(self, thickness):
        # At another thickness a channel stands for another wavelength.
        moved = self.means is not None and thickness is not None
        return reflectances(thickness * self.channel_nm) if moved else None

    def paint(self, derived, limited):
        """Takes what was derived, evaluated."""
        self.colours = self.painter(self.types, derived, limited, self.channel_nm, self.means)

    def seen(self, pair):
        """Where a pair lies in the table: what `lobes` asks for."""
        at = self.tabulated.incidence(pair.incidence)
        exit = self.tabulated.exit(at, pair.exit, pair.y2)
        return at, exit, self.tabulated.read(at, exit)

    def lobes(self, pair, seen, places):
        """f·cos θo of mirror and blur short of their colour."""
        interior, rehit = self.tabulated.eval(*seen)
        scale = self.mirror_scale.between(*places[0])[0]
        if self.reciprocal:
            scale = scale * self.mirror_scale.between(*places[1])[0] * pair.exit.cos
            interior, rehit = self._at_larger_angle(pair, (interior, rehit))
        return rehit + self.facets.eval(pair.half) * scale, interior

    def _at_larger_angle(self, pair, light):
        """Interior and rehit of a reciprocal table, given as they are read at the incidence."""
        larger = self.tabulated.incidence(pair.exit)
        exit = self.tabulated.exit(larger, pair.incidence, pair.y2)
        back = self.tabulated.eval(larger, exit, self.tabulated.read(larger, exit))
        taken_over = pair.exit.cos / at_least(pair.incidence.cos, 1e-12)
        swap = pair.exit.cos < pair.incidence.cos
        return [dr.select(swap, b * taken_over, a) for a, b in zip(light, back)]


def hats(wavelengths_nm):
    """Of each band the share in what is seen at a wavelength: linear between the bands, constant beyond the ends."""
    order = sorted(range(len(wavelengths_nm)), key=lambda k: wavelengths_nm[k])
    nodes = [float(wavelengths_nm[k]) for k in order]

    def hat(j):
        def share(nm):
            rise = 1.0 if j == 0 else dr.clip((nm - nodes[j - 1]) / (nodes[j] - nodes[j - 1]), 0.0, 1.0)
            fall = 1.0 if j == len(nodes) - 1 else dr.clip((nodes[j + 1] - nm) / (nodes[j + 1] - nodes[j]), 0.0, 1.0)
            return rise * fall

        return share

    return [hat(order.index(k)) for k in range(len(nodes))]
