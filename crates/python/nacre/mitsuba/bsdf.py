"""The BSDF plugin `pearl`; docs/PLUGIN.md is its documentation."""

import threading
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

from .. import cache
from .._nacre import InputError
from . import controls as parameters
from . import curves, table
from .colours import LUMINANCE, Palette, chances
from .layer import Layer, hats
from .lobes import Pair, Polar, at_least, clip
from .paint import Light, Thickness
from .store import Types, reachable
from .table import PearlError, Table

_PI = float(np.pi)
_INTERIOR, _REHIT, _SURFACE, _BASE = range(4)
_DIFFUSE, _INCOHERENT, _MIRROR, _BLUR = range(4)

#: By thread, how many pearls wait within each other, and the ends of those that are loaded within so many.
_waiting = threading.local()
_DEEPEST = 20

_tables: dict = {}
#: What `cache.table` gave and its Table, by the identity of the first (which the second keeps alive).
_baked: dict = {}


def _above(direction):
    """Whether a direction points above the surface: false where a component is infinite or not a number."""
    return (direction.z > 0.0) & (dr.squared_norm(direction) < dr.inf)


def load_table(filename):
    """The table of a file, read once as long as the file stays as it is."""
    path = mi.file_resolver().resolve(str(filename))
    key = str(path)
    try:
        stat = Path(key).stat()
        stamp = (stat.st_mtime_ns, stat.st_size)
    except OSError:
        stamp = None
    known = _tables.get(key)
    if known is None or known[0] != stamp or stamp is None:
        _tables[key] = known = (stamp, table.read(key))
    return known[1]


def bake_table(recipe, look):
    """The table of a recipe, with what its look calls for: of this process, of the user's cache, or baked now."""
    try:
        stored = cache.table(recipe, look)
    except InputError as error:
        raise PearlError(f"pearl: recipe: {error}") from None
    if id(stored) not in _baked:
        _baked[id(stored)] = stored, Table.of(stored, f"recipe {recipe.name}")
    return _baked[id(stored)][1]


def _finish(pearl, finish):
    """Finishes a pearl by reading its textures; a pearl that is loaded deep within others is finished by the innermost that waits.

    Who asks Dr.Jit for numbers waits for them, and meanwhile Mitsuba, which loads many objects at once, loads the next one within this one.
    If every one of a few hundred pearls waited, they would go deeper than Python goes.
    """
    depth = getattr(_waiting, "depth", 0)
    if depth == _DEEPEST:
        _waiting.others.append((pearl, finish))
        return
    _waiting.depth, _waiting.others = depth + 1, []
    try:
        finish()
        while _waiting.others:
            other, finish = _waiting.others.pop()
            # Its variables are younger than those of the pearl that waited.
            dr.detail.new_scope(dr.backend_v(pearl.types.Float))
            try:
                finish()
            except PearlError as error:
                raise PearlError(f"{error}; of {other.id()!r}, loaded within the pearl that is named: parallel=False names it") from None
    finally:
        _waiting.depth = depth


def bsdf_class():
    """The BSDF class of the variant that is active now."""
    types = Types(mi)
    flags = mi.BSDFFlags
    return type("Pearl", (_pearl(mi.BSDF),), {"types": types, "flags_enum": flags})


def _numbers(value):
    """The floating-point numbers of a parameter, or None."""
    try:
        numbers = np.asarray(dr.detach(value))
    except (TypeError, RuntimeError):
        return None
    return numbers if numbers.dtype.kind == "f" else None


def _pearl(base):
    class Pearl(base):
        def __init__(self, props):
            base.__init__(self, props)
            parameters.check_names(props)
            self.recipe = None
            if "filename" in props:
                self.table = load_table(props["filename"])
            else:
                self.recipe = parameters.recipe(props.get("recipe", parameters.RECIPE))
                parameters.check_given_thickness(props, None, self.recipe)
                self.look = parameters.given_look(props) | {"variant": self.types.variant}
                self.table = bake_table(self.recipe, self.look)
            controls = parameters.read(props, self.table)
            self.shown = controls.shown
            self._set_body(props)
            types = self.types
            number = types.Float if types.jit else dr.scalar.Array1f
            scales = self._set_thickness(props, number)
            self._components()
            self.depth, self.brightness = number(controls.depth), number(controls.brightness)
            self.coherence, self.tint = number(controls.coherence), types.Color3f(controls.tint)
            self._take()
            plain = controls.depth, controls.brightness, controls.coherence, controls.tint

            def finish():
                if self.body_rgb is None:
                    self._check_body()
                # From what is known already.
                self._derive(plain, scales)

            if self.body_rgb is None or self.thickness_varies:
                _finish(self, finish)
            else:
                finish()

        def _take(self):
            """What of the table alone is evaluated."""
            types = self.types
            # A copy: Dr.Jit lends NumPy's memory, and this one belongs to every pearl of the table.
            self.lut = types.TensorXf(self.table.values.copy())
            # The lobes at the table's own wavelength are what is sampled.
            self.layers = [Layer.of(types, band, sampled=band is self.table) for band in self.table.bands]
            self.tabulated, self.facets = self.layers[0].tabulated, self.layers[0].facets
            self.rgb_palette = Palette.of(self.table, "rgb")

        def _bake_what_is_called_for(self):
            """A control that needs an effect which was not baked bakes it now. Whether a `lut` that was set is to be taken again."""
            depth, brightness, coherence, _ = self._values()
            for name, value in (("depth", depth), ("brightness", brightness), ("coherence", coherence)):
                parameters.number(name, value)
            self.look |= {"depth": depth, "brightness": brightness, "coherence": coherence, "body_color": self.body_rgb}
            if not self.thickness_varies and dr.any(dr.detach(self.thickness) != 1.0):
                self.look |= {"thickness": "thickness was moved"}
            if cache.effects_of(self.recipe, self.look) <= {*self.table.meta["effects"], "texture"}:
                return False
            found = bake_table(self.recipe, self.look)
            if found is self.table:
                return False
            lut, was_set = self.lut, not np.array_equal(np.array(dr.detach(self.lut)), self.table.values)
            self.table = found
            self._take()
            if was_set:
                self.lut = lut
            return was_set

        def _set_body(self, props):
            self.body_rgb = None
            name = "body_color"
            if name not in props:
                self.body_rgb = parameters.body(self.table)
                self.body = mi.load_dict({"type": "rgb", "value": self.body_rgb}, parallel=False)
                return
            self.body_rgb = parameters.plain_colour(props, name)
            try:
                self.body = props.get_texture(name, 0.5)
            except RuntimeError:
                raise PearlError(f"pearl: {name}: is no colour, spectrum or texture") from None

        def _set_thickness(self, props, number):
            """A number, or a texture; gives what `_scales` does."""
            scale = parameters.plain_thickness(props) if "thickness" in props else 1.0
            self.thickness_varies = scale is None
            if scale is not None:
                self.thickness = number(scale)
                return [scale]
            try:
                self.thickness = props.get_texture("thickness", 1.0)
            except RuntimeError:
                raise PearlError("pearl: thickness: is no number or texture") from None
            return None

        def _check_thickness(self, scales):
            if scales is not None:
                if len(scales) != 1:
                    raise PearlError(f"pearl: thickness: {scales} is not valid; expected one number")
                return parameters.check_thickness(scales, self.table, self.recipe)
            for key, value in mi.traverse(self.thickness).items():
                numbers = _numbers(value) if key.split(".")[-1] in ("data", "value", "values") else None
                if numbers is not None:
                    parameters.check_thickness([numbers.min(), numbers.max()], self.table, self.recipe, of=f"{key} ")

        def _thickness_at(self, si, active):
            """The thickness where a ray meets the surface; None of a table of one thickness."""
            if self.table.scales is None:
                return None
            given = self.thickness.eval_1(si, active) if self.thickness_varies else self.used_thickness
            return Thickness.of(self.types, self.table.scales, given)

        def _check_body(self):
            """Refuses what is no reflectance, as far as a texture tells."""
            mean = self._body_mean()
            if mean is not None and not 0.0 <= mean <= 1.0 + 1e-6:
                raise PearlError(f"pearl: body_color: its mean is {mean:g}; expected reflectances from 0 to 1")
            for key, value in mi.traverse(self.body).items():
                # In spectral variants colours are stored as coefficients of any sign.
                least = -np.inf if self.types.spectral else 0.0
                numbers = _numbers(value) if key.split(".")[-1] in ("data", "value", "values") else None
                if numbers is not None and not (np.isfinite(numbers).all() and (numbers >= least).all()):
                    raise PearlError(f"pearl: body_color: {key} has a value that is negative or not finite; expected reflectances")

        def _body_mean(self):
            """The mean of the body colour; None for a texture that does not know its own."""
            try:
                return float(np.ravel(np.array(dr.detach(self.body.mean())))[0])
            except RuntimeError:
                return None

        def _components(self):
            enum = self.flags_enum
            diffuse = enum.DiffuseReflection | enum.FrontSide
            glossy = enum.GlossyReflection | enum.FrontSide
            if self.thickness_varies:
                glossy = glossy | enum.SpatiallyVarying
            if self.thickness_varies or self.body.is_spatially_varying():
                diffuse = diffuse | enum.SpatiallyVarying
            self.m_components = [diffuse, diffuse, glossy, glossy]
            self.m_flags = diffuse | glossy

        def traverse(self, callback):
            differentiable = mi.ParamFlags.Differentiable
            callback.put("body_color", self.body, differentiable)
            for name in ("depth", "brightness", "coherence", "tint", "thickness", "lut"):
                callback.put(name, getattr(self, name), differentiable)

        def parameters_changed(self, keys=()):
            keys = set(keys)
            if not keys or any(key.split(".")[0] == "body_color" for key in keys):
                self._check_body()
                if keys:
                    self.body_rgb = None
            taken_again = self.recipe is not None and self._bake_what_is_called_for()
            if not keys or "lut" in keys or taken_again:
                values, shape = np.array(dr.detach(self.lut)), self.table.values.shape
                if values.shape != shape:
                    raise PearlError(f"pearl: lut: has the shape {values.shape}; expected that of the table, {shape}")
                if not (np.isfinite(values).all() and (values >= 0.0).all()):
                    raise PearlError("pearl: lut: has a value that is negative or not finite")
                self.tabulated = self.tabulated.with_values(values, self.lut.array if self.types.jit else values)
                self.layers[0].tabulated = self.tabulated
            self._derive(self._values(), self._scales())

        def _values(self):
            """Depth, brightness, coherence and tint as plain numbers."""
            plain = lambda name: np.ravel(np.array(dr.detach(getattr(self, name)))).tolist()
            controls = []
            for name in ("depth", "brightness", "coherence"):
                values = plain(name)
                controls.append(values[0] if len(values) == 1 else values)
            return *controls, plain("tint")

        def _scales(self):
            """The thickness as plain numbers, of which there should be one; None of a texture."""
            return None if self.thickness_varies else np.ravel(np.array(dr.detach(self.thickness))).tolist()

        def _fresh(self):
            """The controls for arithmetic: Dr.Jit 1.5 widens a literal 0 in place where it multiplies a longer array, and the
            artist's own parameters must stay single numbers."""
            zero = dr.opaque(self.types.Float, 0.0)
            fresh = (value + zero for value in (self.depth, self.brightness, self.coherence))
            return *fresh, [channel + zero for channel in self.tint]

        def _derive(self, plain, scales):
            """Everything that follows from the controls: `_values` and `_scales`."""
            types = self.types
            for name, value in zip(("depth", "brightness", "coherence"), plain):
                parameters.number(name, value)
            parameters.colour("tint", plain[3])
            self._check_thickness(scales)
            self._check_tint(plain[3])
            if self.recipe is None:
                # Of a recipe nothing is missing that would show.
                parameters.check_parts(self.table, plain[0], plain[2])
            given = self._fresh() if types.jit else plain
            thickness = scales[0] if scales else None
            derived = [layer.derived(given, thickness) for layer in self.layers]
            # Once for all layers, and once more what they gather from it.
            dr.eval(derived)
            for layer, of_layer in zip(self.layers, derived):
                layer.paint(of_layer, layer.is_limited(plain, thickness))
            self.used_depth = given[0]
            if not self.thickness_varies:
                zero = dr.opaque(types.Float, 0.0)
                self.used_thickness = self.thickness + zero if types.jit else float(self.thickness[0])
            self.chances = types.store(chances(self.rgb_palette, plain, self._body_for_sampling(), self.shown), 4)
            # What Dr.Jit finds by itself of an object is what lies in its own attributes, lists among them.
            parts = (self.layers, self.chances, self.used_depth, None if self.thickness_varies else self.used_thickness)
            self.reachable = list(reachable(parts)) if types.jit else []
            dr.eval(self.reachable)

        def _check_tint(self, tint):
            """In spectral variants a tint belongs to wavelengths, and those of a channel move with the thickness."""
            if self.types.spectral and self.thickness_varies and tint != [1.0] * 3:
                raise PearlError(f"pearl: tint: is {tint}, expected white: in spectral variants a texture of thickness takes no tint")

        def _body_for_sampling(self):
            """The body colour by which the base is sampled, by RGB channel: exact for an RGB value, else its mean."""
            if self.body_rgb is not None:
                return np.array(self.body_rgb)
            types, mean = self.types, self._body_mean()
            if mean is None:
                # Attributes of a mesh: Mitsuba does not say that they vary, and without a shape they have no value.
                return np.full(3, 0.5)
            if not (types.spectral or types.mono or self.body.is_spatially_varying()):
                value = self.body.eval(dr.zeros(mi.SurfaceInteraction3f))
                return np.clip(np.array(dr.detach(value)).reshape(3), 0.0, 1.0)
            return np.full(3, min(max(mean, 0.0), 1.0))

        # What Mitsuba calls.

        def eval(self, ctx, si, wo, active=True):
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx, si, wo, active=True):
            return self._eval_pdf(ctx, si, wo, active, want_value=False)[1]

        def eval_pdf(self, ctx, si, wo, active=True):
            value, pdf = self._eval_pdf(ctx, si, wo, active)
            return mi.depolarizer(value), pdf

        def eval_diffuse_reflectance(self, si, active=True):
            return self.body.eval(si, active)

        def sample(self, ctx, si, sample1, sample2, active=True):
            types = self.types
            record = dr.zeros(types.BSDFSample3f)
            lit = active & _above(si.wi)
            if not types.jit and not lit:
                return record, mi.depolarizer(types.UnpolarizedSpectrum(0.0))
            wi = dr.select(lit, si.wi, types.Vector3f(0.0, 0.0, 1.0))
            polar = Polar.of(wi)
            at = self.tabulated.incidence(polar)
            chance = self._chances(ctx, polar, at)
            total = chance[0] + chance[1] + chance[2] + chance[3]
            active = lit & (total > 0.0)
            part, select = self._choose(chance, sample1 * total)
            sin, cos, phi = self.tabulated.sample(part == _REHIT, at, select, sample2.x, sample2.y)
            wo = self._direction(polar, sin, cos, phi)
            reflected, upward = self.facets.sample(wi, polar, sample2.x, sample2.y)
            wo = dr.select(part == _SURFACE, reflected, wo)
            active = active & ((part != _SURFACE) | upward)
            wo = dr.select(part == _BASE, self._cosine_hemisphere(sample2), wo)
            wo = dr.normalize(wo)
            active = active & (wo.z > 0.0)
            wo = dr.select(active, wo, types.Vector3f(0.0, 0.0, 1.0))
            pair = Pair.of(polar, Polar.of(wo))
            value, pdf = self._value_and_density(ctx, si, pair, at, chance, lit, active)
            active = active & (pdf > 0.0)
            record.wo, record.pdf, record.eta = wo, dr.select(active, pdf, 0.0), 1.0
            base = _DIFFUSE if self._enabled(ctx)[_DIFFUSE] else _INCOHERENT
            component = dr.select(part == _BASE, types.UInt32(base), types.UInt32(_MIRROR))
            record.sampled_component = dr.select(part == _INTERIOR, types.UInt32(_BLUR), component)
            diffuse, glossy = (types.UInt32(int(+kind)) for kind in (
                self.flags_enum.DiffuseReflection, self.flags_enum.GlossyReflection))  # fmt: skip
            record.sampled_type = dr.select(part == _BASE, diffuse, glossy)
            weight = value * dr.select(active, 1.0 / dr.select(active, pdf, 1.0), 0.0)
            return record, mi.depolarizer(weight)

        def to_string(self):
            *numbers, tint = self._values()
            depth, brightness, coherence = (f"{value:g}" if isinstance(value, float) else value for value in numbers)
            shown = ",".join(name for name, show in zip(parameters.COMPONENTS, self.shown) if show)
            return (
                f"Pearl[\n  table = {self.table.name},\n  depth = {depth},\n  brightness = {brightness},\n"
                f"  coherence = {coherence},\n  tint = {tint},\n  components = {shown}\n]"
            )

        # Its parts.

        def _enabled(self, ctx):
            """Which of the components are asked for, at this BSDF and by the context."""
            wanted = lambda k: ctx.is_enabled(mi.BSDFFlags(int(self.m_components[k]) & 0x1FF), k)
            return [show and wanted(k) for k, show in enumerate(self.shown)]

        def _eval_pdf(self, ctx, si, wo, active, want_value=True):
            types = self.types
            wi, wo = si.wi, types.Vector3f(wo)
            # What depends on wi alone is computed under the mask of wi alone, here and in `sample`: where an integrator asks
            # for both, Dr.Jit then computes it once.
            lit = active & _above(wi)
            active = lit & _above(wo)
            if not types.jit and not active:
                return types.UnpolarizedSpectrum(0.0), types.Float(0.0)
            normal = types.Vector3f(0.0, 0.0, 1.0)
            wi, wo = dr.select(lit, wi, normal), dr.select(active, wo, normal)
            pair = Pair.of(Polar.of(wi), Polar.of(wo))
            at = self.tabulated.incidence(pair.incidence)
            chance = self._chances(ctx, pair.incidence, at)
            return self._value_and_density(ctx, si, pair, at, chance, lit, active, want_value)

        def _value_and_density(self, ctx, si, pair, at, chance, lit, active, want_value=True):
            exit = self.tabulated.exit(at, pair.exit, pair.y2)
            seen = at, exit, self.tabulated.read(at, exit)
            pdf = dr.select(active, self._density(chance, pair, *seen), 0.0)
            if not want_value:
                return None, pdf
            if ctx.mode == mi.TransportMode.Radiance:
                value = self._shade(ctx, si, pair, seen, lit)
            else:
                # Light is traced the other way through the same surface: f is that of the viewer at wo.
                back = Pair.of(pair.exit, pair.incidence)
                value = self._shade(ctx, si, back, self.layers[0].seen(back), lit)
                value = value * (pair.exit.cos / at_least(pair.incidence.cos, 1e-12))
            return dr.select(active, value, self.types.UnpolarizedSpectrum(0.0)), pdf

        def _density(self, chance, pair, at, exit, cells):
            interior, rehit = self.tabulated.pdf(at, exit, cells)
            surface = self.facets.pdf(pair.incidence, pair.half)
            total = chance[0] + chance[1] + chance[2] + chance[3]
            # Of the incidence alone: computed once for all directions.
            scale = dr.select(total > 0.0, 1.0 / at_least(total, 1e-12), 0.0)
            pdf = chance[_INTERIOR] * interior + chance[_REHIT] * rehit + chance[_SURFACE] * surface
            return scale * (pdf + chance[_BASE] * pair.exit.cos * (1.0 / _PI))

        def _chances(self, ctx, polar, at):
            """Weights of interior, rehit, surface, base; components that the context hides have none, nor have lobes without light."""
            index, fraction = self._place(polar.cos, polar.sin)
            chance = self.chances.between(index, fraction)
            diffuse, incoherent, mirror, blur = self._enabled(ctx)
            kept = [blur, mirror, mirror, diffuse or incoherent]
            chance = [weight * float(keep) for weight, keep in zip(chance, kept)]
            for lobe, lit in zip((_INTERIOR, _REHIT), self.tabulated.lit(at)):
                chance[lobe] = dr.select(lit, chance[lobe], 0.0)
            return chance

        def _choose(self, chance, rest):
            """The part that a share of the weights' sum falls on, and what is left of the random number."""
            types = self.types
            part, left = types.UInt32(_BASE), types.Float(0.0)
            below = types.Float(0.0)
            chosen = types.Bool(False)
            of = types.Float(1.0)
            for k, weight in enumerate(chance):
                here = (rest < below + weight) & (weight > 0.0) & (chosen == False)  # noqa: E712 (scalar masks are bool)
                part = dr.select(here, types.UInt32(k), part)
                left, of = dr.select(here, rest - below, left), dr.select(here, weight, of)
                chosen = chosen | here
                below = below + weight
            # A random number so near to 1 that rounding passed the last part falls on the likeliest.
            likeliest, most = types.UInt32(0), chance[0]
            for k in (1, 2, 3):
                likeliest = dr.select(chance[k] > most, types.UInt32(k), likeliest)
                most = at_least(most, chance[k])
            return dr.select(chosen, part, likeliest), clip(dr.select(chosen, left / of, 1.0), 0.0, 1.0 - 6e-8)

        def _direction(self, polar, sin, cos, phi):
            """The direction at θo and at azimuth φ from the mirror direction of wi."""
            along, across = polar.azimuth
            sin_phi, cos_phi = dr.sincos(phi)
            return self.types.Vector3f(sin * (-cos_phi * along - sin_phi * across), sin * (-cos_phi * across + sin_phi * along), cos)

        def _cosine_hemisphere(self, sample):
            sin_phi, cos_phi = dr.sincos(2.0 * _PI * sample.y)
            sin = dr.sqrt(sample.x)
            return self.types.Vector3f(sin * cos_phi, sin * sin_phi, dr.sqrt(at_least(1.0 - sample.x, 0.0)))

        def _place(self, cos, sin=None):
            """The place of an angle on the grid of `curves`: node, and how far it is towards the next."""
            cos = clip(cos, 0.0, 1.0)
            # 1 − √cos in the form that does not cancel where the sine is known.
            gap = 1.0 - cos if sin is None else sin * sin / (1.0 + cos)
            u = dr.sqrt(at_least(gap, 0.0) / (1.0 + dr.sqrt(cos))) * float(curves.STEPS)
            index = dr.minimum(self.types.floor(u), curves.STEPS - 1)
            return index, u - self.types.Float(index)

        def _shade(self, ctx, si, pair, seen, active):
            """f·cos θo of all that is shown; seen: of the first layer."""
            types = self.types
            places = [
                self._place(pair.incidence.cos, pair.incidence.sin),
                self._place(pair.exit.cos, pair.exit.sin),
                self._place(pair.half.cos),
            ]
            diffuse, incoherent, show_mirror, show_blur = (float(shown) for shown in self._enabled(ctx))
            depth = self.used_depth
            light = Light(pair.exit.cos, depth, (1.0 - depth) * diffuse, depth * incoherent)
            wavelengths = si.wavelengths if types.spectral else None
            body = self.body.eval(si, active)
            thickness = self._thickness_at(si, active)
            several = len(self.layers) > 1
            if types.mono and several:
                body = [body[0]] * 3

            def parts(layer, seen):
                mirror, blur = layer.lobes(pair, seen, places)
                mirror, blur = mirror * show_mirror, blur * show_blur
                coloured = layer.colours.shade(light, places, body, wavelengths, thickness)
                return [(factor * mirror, factor * blur, *base) for factor, *base in coloured]

            found = parts(self.layers[0], seen)
            if several:
                further = (parts(layer, layer.seen(pair)) for layer in self.layers[1:])
                found = self._mixed([found, *further], wavelengths)
            values = [mirror + blur + base + coloured for mirror, blur, base, coloured in found]
            if types.mono and several:
                values = [sum(weight * value for weight, value in zip(LUMINANCE, values))]
            return types.UnpolarizedSpectrum(*values)

        def _mixed(self, bands, wavelengths):
            """The parts of every channel from those in all bands."""
            arrays = self.table.arrays
            if wavelengths is None:
                # The shares of sRGB's channels may be negative; light may not.
                share = lambda k, channel: float(arrays["rgb_weights"][k][channel])
                least = 0.0
            else:
                hat = hats(arrays["wavelength_nm"])
                share = lambda k, channel: hat[k](wavelengths[channel])
                least = -dr.inf

            def channel(c):
                shares = [share(k, c) for k in range(len(bands))]
                mixed = (sum(weight * band[c][part] for weight, band in zip(shares, bands)) for part in range(4))
                return [dr.maximum(part, least) for part in mixed]

            return [channel(c) for c in range(len(bands[0]))]

    return Pearl
