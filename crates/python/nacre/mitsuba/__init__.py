"""Mitsuba 3 plugin `pearl`: importing this module makes the BSDF known to `mi.load_dict` and to XML scenes.

    import mitsuba as mi
    import nacre.mitsuba

    mi.set_variant("llvm_ad_rgb")
    pearl = mi.load_dict({"type": "pearl", "recipe": "akoya"})       # baked now, or taken from the user's cache

It stays known in every variant that `mi.set_variant` chooses, before or after the import.
"""

import mitsuba as mi

from .bsdf import bsdf_class
from .table import PearlError

__all__ = ["PearlError"]

_registered: set = set()


def _register(_old=None, variant=None):
    """Registers the plugin for the active variant: a BSDF class belongs to the variant it was made in."""
    variant = mi.variant()
    if variant is None or variant in _registered:
        return
    made = bsdf_class()
    mi.register_bsdf("pearl", lambda props: made(props))
    _registered.add(variant)


mi.detail.add_variant_callback(_register)
_register()
