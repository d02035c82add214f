"""The parameters of the plugin: what is given, its defaults from the table, and what is refused. Plans of scenes read them here, too."""

from dataclasses import dataclass
from difflib import get_close_matches
from numbers import Real

import mitsuba as mi

from .._nacre import InputError, Recipe, recipes
from .table import BAKE, PearlError

COMPONENTS = ("diffuse", "incoherent", "mirror", "blur")
PARAMETERS = ("filename", "recipe", "depth", "brightness", "coherence", "body_color", "tint", "thickness", "components")
#: The effect of a bake that a control needs, and the part of the section `spectra` that holds it.
_NEEDS = {"depth": "emission", "coherence": "coherent"}
#: The built-in recipe of a pearl that names neither a table nor a recipe.
RECIPE = "paper"

_DEFAULT_BODY = (0.8, 0.78, 0.75)


@dataclass
class Controls:
    """What an artist sets; colours are linear sRGB. Body colour is a texture, held by the BSDF."""

    depth: float
    brightness: float
    coherence: float
    tint: list
    shown: tuple


def check_names(props):
    """Refuses parameters that the plugin does not have, and a table together with a recipe."""
    for name in props.keys():
        if name not in PARAMETERS:
            near = "".join(f" (did you mean {near!r}?)" for near in get_close_matches(name, PARAMETERS, 1, 0.8))
            raise PearlError(f"pearl: {name}: no such parameter{near}; expected one of {', '.join(PARAMETERS)}")
    if "filename" in props and "recipe" in props:
        raise PearlError(f"pearl: filename, recipe: both are given; expected a table, which `{BAKE}` bakes, or a recipe, which is baked now")


def recipe(source):
    """A recipe of a built-in name or a file, which is looked for where the scene's other files are."""
    source = str(source)
    if source not in recipes():
        source = str(mi.file_resolver().resolve(source))
    try:
        return Recipe(source)
    except (InputError, OSError) as error:
        raise PearlError(f"pearl: recipe: {error}") from None


def given_look(props):
    """What is given in place of the recipe's look, as `nacre.effects` takes it."""
    look = {name: number(name, props[name]) for name in ("depth", "brightness", "coherence") if name in props}
    if "body_color" in props:
        look["body_color"] = plain_colour(props, "body_color")
    if "thickness" in props:
        scale = plain_thickness(props)
        if scale != 1.0:
            look["thickness"] = "thickness is a texture" if scale is None else f"thickness {scale:g}"
    if "components" in props:
        look["components"] = [name for name, show in zip(COMPONENTS, components(props["components"]), strict=True) if show]
    return look


def plain_colour(props, name):
    """A colour that is given as numbers; None for a texture."""
    kind = mi.Properties.Type
    plain = props.type(name) in (kind.Color, kind.Float, kind.Integer, kind.Vector)
    return colour(name, props[name]) if plain else None


def tint(props):
    """The factor of the interference colours; white where none is given."""
    return colour("tint", props["tint"]) if "tint" in props else [1.0] * 3


def plain_thickness(props):
    """The scale of the thicknesses that is given as a number; None for a texture."""
    kind = mi.Properties.Type
    if props.type("thickness") in (kind.Bool, kind.String):
        raise PearlError("pearl: thickness: is no number or texture")
    if props.type("thickness") not in (kind.Float, kind.Integer):
        return None
    return float(props["thickness"])


def _range_of(recipe):
    """The scales that a table of a recipe has colours of, if any are shown."""
    look = recipe.to_dict()["look"]
    found = look.get("thickness") or Recipe({"look": {"thickness": {}}}).to_dict()["look"]["thickness"]
    return found["min"], found["max"]


def check_given_thickness(props, table, recipe):
    """`check_thickness` of what is given as a number."""
    scale = plain_thickness(props) if "thickness" in props else None
    if scale is not None:
        check_thickness([scale], table, recipe)


def check_thickness(values, table, recipe, of=""):
    """Refuses scales that a table has no colours of; that of a recipe (None: of none; its table may be yet to be baked) has all that are
    shown."""
    if table is not None and table.scales is not None:
        first, last = table.scales[0], table.scales[-1]
    else:
        first, last = (1.0, 1.0) if recipe is None else _range_of(recipe)
    # Of single precision.
    outside = [value for value in values if not first * (1.0 - 1e-6) <= value <= last * (1.0 + 1e-6)]
    if not outside:
        return
    right = f"a number from {first:g} to {last:g}" if first < last else "1"
    advice = "" if first < last else (
        f"; {table.name} has the colours of one thickness: bake it with `bake-brdf` where the recipe has \"look\": {{\"thickness\": {{}}}}"
    )  # fmt: skip
    raise PearlError(f"pearl: thickness: {of}is {outside[0]:g}; expected {right}{advice}")


def number(field, value):
    """A number from 0 to 1."""
    if isinstance(value, bool) or not isinstance(value, Real) or not 0.0 <= value <= 1.0:
        # Objects of Mitsuba take several lines to describe themselves.
        found = repr(value)
        found = f"a {type(value).__name__}" if "\n" in found else found
        raise PearlError(f"pearl: {field}: {found} is not valid; expected a number from 0 to 1")
    return float(value)


def colour(field, value):
    """Three numbers from 0 to 1, or one for a grey."""
    if isinstance(value, Real):
        return [number(field, value)] * 3
    try:
        channels = [float(channel) for channel in value]
    except (TypeError, ValueError):
        channels = []
    if len(channels) != 3:
        found = repr(value) if isinstance(value, (str, list, tuple)) else f"a {type(value).__name__}"
        raise PearlError(f"pearl: {field}: {found} is not valid; expected a colour (rgb), each channel from 0 to 1")
    return [number(f"{field}[{k}]", channel) for k, channel in enumerate(channels)]


def components(text):
    """Which components are shown, in the order of COMPONENTS."""
    names = [name.strip() for name in text.split(",")] if isinstance(text, str) else [repr(text)]
    if names == ["all"]:
        return (True,) * 4
    for name in names:
        if name not in COMPONENTS:
            raise PearlError(f"pearl: components: {name!r} is none of them; expected all alone, or a list of "
                             f"{', '.join(COMPONENTS)} separated by commas")  # fmt: skip
    return tuple(name in names for name in COMPONENTS)


def look(table):
    """The recipe's look, for what is not given: numbers only, as the tool `pearl` reads it."""
    recipe = table.meta.get("recipe")
    found = recipe.get("look") if isinstance(recipe, dict) else None
    is_number = lambda value: isinstance(value, Real) and not isinstance(value, bool)
    return {name: value for name, value in found.items() if is_number(value)} if isinstance(found, dict) else {}


def body(table):
    """The recipe's body colour."""
    channels = list(_DEFAULT_BODY)
    recipe = table.meta.get("recipe")
    found = recipe.get("look") if isinstance(recipe, dict) else None
    given = found.get("body_rgb") if isinstance(found, dict) else None
    for k, channel in enumerate(given[:3] if isinstance(given, list) else []):
        channels[k] = number(f"body_color[{k}]", channel)
    return channels


def read(props, table):
    """The controls given, else the recipe's; those that need interference colours are 0 in a table without them."""
    defaults = look(table)

    def scalar(name, default):
        if name in props:
            return number(name, props[name])
        need = _NEEDS.get(name)
        return 0.0 if need and not table.has(need) else float(defaults.get(name, default))

    return Controls(
        scalar("depth", 0.5),
        scalar("brightness", 1.0),
        scalar("coherence", 0.5),
        tint(props),
        components(props.get("components", "all")),
    )


def missing(table, depth, coherence):
    """Controls that ask for a part that the table does not have, by name."""
    given = (("depth", depth), ("coherence", coherence))
    return [name for name, value in given if value > 0.0 and not table.has(_NEEDS[name])]


def check_parts(table, depth, coherence):
    """Refuses controls that ask for a part that the table does not have."""
    for name in missing(table, depth, coherence):
        value = depth if name == "depth" else coherence
        raise PearlError(
            f"pearl: {name}: is {value:g}, but {table.name} has no interference colours for it (effect "
            f"{_NEEDS[name]!r}): set {name} to 0, or bake them with `{BAKE}` where the recipe's look.{name} > 0"
        )
