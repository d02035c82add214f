"""Which pearls a scene shows, and how: read by Mitsuba's own parser, without an object, a picture or a table made of it."""

import contextlib
import re
from pathlib import Path

import mitsuba as mi

from .. import cache
from .._nacre import InputError, Recipe, plan_pearls
from .._nacre import Table as Stored
from . import controls as parameters
from .table import PearlError, Table

#: Textures that are one colour all over.
_PLAIN = ("blackbody", "d65", "discrete", "irregular", "rawconstant", "regular", "srgb", "uniform")


def plan(path, variant=None, defaults=None, why_not=False):
    """The plan of a scene: `nacre.plan`."""
    with _read(str(path), defaults or {}) as scene:
        asked = (variant, "as given") if variant else scene.variant()
        pearls = scene.pearls(*asked)
    return plan_pearls(pearls, solver="auto", accuracy=cache.ACCURACY, why_not=why_not)


@contextlib.contextmanager
def _read(path, defaults):
    """The scene of a file; while it is read, files are looked for where Mitsuba looks for them."""
    if not Path(path).is_file():
        raise InputError(f"{path}: there is no such file")
    for name in ("config", "filename"):
        if name in defaults:
            raise InputError(f"{path}: ${name}: Mitsuba's parser takes no value for a parameter of this name")
    if mi.variant() is None:
        # Any will do: Mitsuba has no colours without one.
        mi.set_variant("scalar_rgb")
    around, here = mi.file_resolver(), mi.FileResolver(mi.file_resolver())
    here.prepend(str(Path(path).parent))
    mi.set_file_resolver(here)
    try:
        yield _Scene(path, defaults)
    except RuntimeError as error:
        raise InputError(_line(path, str(error))) from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: a text in it is not encoded in UTF-8") from None
    finally:
        mi.set_file_resolver(around)


def _line(path, said):
    """What Mitsuba says of a scene as one line that starts with the place; of includes in includes, what is wrong with the innermost."""
    place = path
    for part in re.split(r"^\[\w+\.cpp:\d+\] ", said, flags=re.M):
        found = re.match(r"Error while loading (.*?) \(line (\d+), col \d+\): (.*)", part, re.S)
        if found:
            place, part = f"{found[1]}:{found[2]}", found[3]
        elif found := re.match(r'Parsing of XML file "(.*)" failed: (.*) \(line (\d+), col \d+\)', part, re.S):
            place, part = f"{found[1]}:{found[3]}", f"not XML: {found[2]}"
    return f"{place}: {' '.join(part.split())}"


class _Scene:
    """The nodes of a scene."""

    def __init__(self, path, defaults):
        config = mi.parser.ParserConfig(mi.variant())
        self.state = mi.parser.parse_file(config, path, **defaults)
        mi.parser.transform_upgrade(config, self.state)
        mi.parser.transform_resolve(config, self.state)
        self.nodes = list(self.state.nodes)

    def place(self, node):
        """Where a node stands: `file:line`."""
        return re.sub(r" \(line (\d+), col \d+\)$", r":\1", mi.parser.file_location(self.state, node))

    def held(self, node, kind):
        """Indices of the objects of a kind that a node holds, in place or by reference."""
        props = node.props
        links = (props[key] for key in props.keys() if props.type(key) == mi.Properties.Type.ResolvedReference)
        return [link.index() for link in links if self.nodes[link.index()].type.name == kind]

    def variant(self):
        """The variant that the scene hints at, and where."""
        colour, polarised, places = "rgb", "", {}
        for node in self.nodes:
            kind, plugin = node.type.name, node.props.plugin_name()
            if (kind, plugin) == ("Integrator", "stokes"):
                polarised, places["stokes"] = "_polarised", self.place(node)
            elif (kind, plugin) == ("Film", "specfilm"):
                colour, places["film"] = "spectral", self.place(node)
            elif kind == "Film" and str(node.props.get("pixel_format", "")).lower().startswith("luminance"):
                colour, places["film"] = "mono", self.place(node)
        return colour + polarised, ", ".join(places.values()) or "default"

    def pearls(self, variant, variant_place):
        """The pearls as `plan_pearls` takes them, in the order of the scene."""
        uses = self._uses()
        found = []
        for index, node in enumerate(self.nodes):
            if not _is_pearl(node):
                continue
            place = self.place(node)
            try:
                recipe, look, places = self._made_of(node, place)
            except PearlError as error:
                raise InputError(f"{place}: {error}") from None
            shapes, bump = uses.get(index, ({}, None))
            look["variant"], places["variant"] = variant, variant_place
            if bump is not None:
                look["texture"], places["texture"] = bump.props.plugin_name(), self.place(bump)
            found.append({
                "id": node.props.id() or place, "place": place, "shapes": list(shapes), "used": bool(shapes), "recipe": recipe, "look": look,
                "places": places,
            })  # fmt: skip
        return found

    def _made_of(self, node, place):
        """The recipe of a pearl, the look that is given in place of its own, and where both were found."""
        props = node.props
        parameters.check_names(props)
        parameters.tint(props)
        look = parameters.given_look(props)
        places = dict.fromkeys(look, place)
        if "body_color" in look and look["body_color"] is None:
            body = self.held(node, "Texture")
            if not body and props.type("body_color") != mi.Properties.Type.Spectrum:
                raise PearlError("pearl: body_color: is no colour, spectrum or texture")
            for texture in (self.nodes[index] for index in body):
                places["body_color"] = self.place(texture)
                if texture.props.plugin_name() not in _PLAIN:
                    look["texture"], places["texture"] = "body_color is a texture", self.place(texture)
        if look.get("thickness") == "thickness is a texture":
            look.setdefault("texture", "thickness is a texture")
            places.setdefault("texture", place)
        if "filename" not in props:
            source = props.get("recipe", parameters.RECIPE)
            places["recipe"] = source if "recipe" in props else "the paper's pearl: the scene names no recipe"
            recipe = parameters.recipe(source)
            parameters.check_given_thickness(props, None, recipe)
            return recipe, look, places
        name = str(props["filename"])
        if not name:
            raise PearlError("pearl: filename: is empty; expected the name of a table")
        path = mi.file_resolver().resolve(name)
        if not Path(str(path)).exists():
            places["recipe"] = f"the paper's pearl: there is no {name} yet"
            return parameters.recipe(parameters.RECIPE), look, places
        try:
            stored = Stored(str(path))
            recipe = Recipe(stored.meta["recipe"])
        except InputError as error:
            raise PearlError(f"pearl: filename: {error}") from None
        places["recipe"] = str(path)
        # What the table does not have is not shown.
        table = Table(str(path), stored.meta, {})
        controls = parameters.read(props, table)
        parameters.check_parts(table, controls.depth, controls.coherence)
        parameters.check_given_thickness(props, table, None)
        for control in ("depth", "brightness", "coherence"):
            look[control] = getattr(controls, control)
            places.setdefault(control, str(path))
        return recipe, look, places

    def _uses(self):
        """Of every pearl that a shape shows: the shapes that hold it, and the first bump or normal map that it is seen through."""
        uses = {}
        root = self.nodes[0]
        groups = lambda index: self.nodes[index].props.plugin_name() == "shapegroup"
        # A group is shown by its instances only.
        waiting = [0] if root.type.name == "Shape" else [index for index in self.held(root, "Shape") if not groups(index)]
        seen = set(waiting)
        for index in waiting:
            shape = self.nodes[index]
            for pearl, bump in self._seen_through(index):
                shapes, first = uses.get(pearl, ({}, None))
                shapes[f"{shape.props.plugin_name()} ({self.place(shape)})"] = None
                uses[pearl] = shapes, first or bump
            inner = [index for index in self.held(shape, "Shape") if index not in seen]
            seen.update(inner)
            waiting.extend(inner)
        return uses

    def _seen_through(self, shape):
        """Pearls of a shape, each with the outermost bump or normal map around it or None."""
        open_, seen = [(shape, None)], set()
        while open_:
            index, bump = open_.pop()
            if (index, bump) in seen:
                continue
            seen.add((index, bump))
            node = self.nodes[index]
            if _is_pearl(node):
                yield index, None if bump is None else self.nodes[bump]
                continue
            if bump is None and node.props.plugin_name() in ("bumpmap", "normalmap"):
                bump = index
            visible = [inner for number, inner in enumerate(self.held(node, "BSDF")) if not _hides(node.props, number)]
            open_.extend((inner, bump) for inner in reversed(visible))


def _is_pearl(node):
    return node.type.name == "BSDF" and node.props.plugin_name() == "pearl"


def _hides(props, number):
    """Whether an adapter never shows its BSDF of that number: a mask of opacity 0, a blend of weight 0 or 1."""
    if props.plugin_name() == "mask":
        return props.get("opacity", None) == 0.0
    return props.plugin_name() == "blendbsdf" and props.get("weight", None) == 1.0 - number
