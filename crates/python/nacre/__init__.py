"""Pearl: multilayer interference of nacre, from a recipe to a BSDF.

    import nacre

    table = nacre.bake("akoya")                  # a built-in name, a path, a dict or a nacre.Recipe
    table.save("akoya.exr")
    pearl = nacre.Pearl(table, depth=0.5)
    value = pearl.eval([0.5, 0, 0.866], [-0.5, 0, 0.866])

What is where:

    recipes, Recipe              what a pearl is made of
    plan, effects                what a look or a scene calls for, why, and what that costs
    bake, walk_shard, merge      tables, whole or in shards
    Table, check, diff           a table's arrays, metadata and errors
    Pearl                        the BSDF with an artist's controls
    arrays, export               for renderers of your own, and for other programs
    nacre.thinfilm               waves in stacks of thin films
    nacre.mitsuba                the BSDF plugin `pearl` (needs Mitsuba; imported by itself)
    nacre.cache                  tables of recipes that the plugin keeps
    python -m nacre plan         plans in the terminal

Directions are unit vectors in the local shading frame, z the outward normal, both pointing away from the surface (Mitsuba's
convention): wi looks at the surface, light arrives from wo. Lengths are in nm and angles in degrees where a name says so, else angles
are in radians. Wrong input raises `InputError` with one line that says what would be right.
"""

from . import cache, thinfilm
from ._nacre import (
    InputError,
    Pearl,
    Recipe,
    Table,
    __version__,
    arrays,
    bake,
    check,
    diff,
    effects,
    export,
    merge,
    recipes,
    walk_shard,
)
from .plans import plan

__all__ = [
    "InputError",
    "Pearl",
    "Recipe",
    "Table",
    "__version__",
    "arrays",
    "bake",
    "cache",
    "check",
    "diff",
    "effects",
    "export",
    "merge",
    "plan",
    "recipes",
    "thinfilm",
    "walk_shard",
]
