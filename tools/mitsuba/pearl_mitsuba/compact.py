"""Compact forms of a table (docs/LUT-FORMAT.md §11), expanded in NumPy."""

import base64
import json
import zlib

import numpy as np

SCHEMA = "pearl-lut/1.1"
#: Longest metadata that are unpacked, bytes, and most cells of an expanded table.
MAX_META_BYTES = 16 << 20
MAX_CELLS = 1 << 21


def unpacked(meta):
    """The metadata of a table: those of a compact file are packed.

    Raises KeyError, ValueError or zlib.error where they are damaged.
    """
    if not meta["schema"].startswith(SCHEMA):
        return meta
    inflate = zlib.decompressobj()
    text = inflate.decompress(base64.b64decode(meta["packed"], validate=True), MAX_META_BYTES)
    if not inflate.eof:
        raise ValueError(f"packed metadata are damaged, or longer than {MAX_META_BYTES} bytes")
    return json.loads(text)


def image_size(meta, axis):
    """Rows and columns of the image."""
    incidences = len(meta["per_incidence"])
    if meta["schema"].startswith(SCHEMA):
        if incidences * axis.rows * axis.columns > MAX_CELLS:
            raise ValueError(f"expands to more than {MAX_CELLS} cells")
        if meta["compact"]["form"]["kind"] == "analytic":
            return incidences, len(meta["compact"]["form"]["terms"])
    return incidences * axis.rows, axis.columns


def values(meta, axis, component, samples):
    """f·cos θo of one component, [incidence · φ row, column], from its image."""
    if not meta["schema"].startswith(SCHEMA):
        return samples
    form = meta["compact"]["form"]
    samples = samples.astype(float)
    if form["kind"] == "half":
        index = ("interior", "surface", "rehit").index(component)
        exponent = np.array([exponents[index] for exponents in form["exponent"]])
        return samples * np.repeat(2.0**exponent, axis.rows)[:, None]
    if form["kind"] != "analytic":
        raise ValueError(f"compact.form.kind is {form['kind']!r}, expected analytic or half")
    m, n = np.array(form["terms"]).T
    x = 2.0 * (np.arange(axis.columns) + 0.5) / axis.columns - 1.0
    y = (np.arange(axis.rows) + 0.5) / axis.rows
    along = np.polynomial.chebyshev.chebvander(x, m.max())[:, m]
    across = np.polynomial.chebyshev.chebvander(y, 2 * n.max())[:, 2 * n]
    exponent = np.einsum("ik,rk,ck->irc", samples, across, along, optimize=True)
    return np.exp(exponent).reshape(-1, axis.columns)
