"""Plans: which effects a recipe or the pearls of a scene call for, why, and what their tables cost."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from os import PathLike, fspath
from typing import Any

from ._nacre import InputError, Recipe, plan_pearls


def plan(
    source: Recipe | str | PathLike[str] | dict[str, Any],
    *,
    variant: str | None = None,
    defaults: Mapping[str, Any] | None = None,
    why_not: bool = False,
) -> dict[str, Any]:
    """Which effects are called for, why, and what the tables that hold them cost: by a recipe's look, or by a Mitsuba scene (a path that
    ends in .xml), whose pearls the plugin bakes by itself when the scene is loaded.

    Scenes are read by Mitsuba's parser, and nothing of them is made. `variant` is that of the renderer (a variant of Mitsuba, or mono,
    rgb, spectral, polarised), without it what the integrator and the film hint at, else rgb; `defaults` are values of the scene's `$names`.
    With `why_not` each pearl is also baked with every effect switched the other way, which says what that changes in a picture.

    `pearls` has of each pearl `id`, `used` (whether a shape shows it), `place` (file:line), `shapes`, `recipe`, `recipe_from`, `table` (an
    index of `tables`) and `effects`: of each by its name `on`, `why`, `seconds` and `bytes`. `why_not` has of each the mean ΔE00
    (`delta_e`) and the `relative_rmse` of the picture of a sphere with the effect and without, or `not_shown`.

    Raises `InputError` for what Mitsuba or the plugin would refuse, and `ImportError` for a scene where there is no Mitsuba.
    """
    if isinstance(source, (str, PathLike)) and fspath(source).lower().endswith(".xml"):
        try:
            scene = importlib.import_module(".mitsuba.scene", __package__)
        except ModuleNotFoundError as error:
            raise ImportError(f"scenes are read by Mitsuba, which is not here ({error}); pip install 'nacre[mitsuba]'") from None
        planned: dict[str, Any] = scene.plan(source, variant, defaults, why_not)
        return planned
    if variant or defaults:
        raise InputError(f"{'variant' if variant else 'defaults'}: belongs to a scene (.xml), and the plan is that of a recipe")
    recipe = Recipe(source)
    pearl = {"id": recipe.name, "place": recipe.name, "shapes": [], "used": True, "recipe": recipe, "look": {}, "places": {}}
    return plan_pearls([pearl], why_not=why_not)
