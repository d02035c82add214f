"""Arrays that are read at computed places, in JIT variants (Dr.Jit gathers) and in scalar ones (plain Python)."""

import drjit as dr
import numpy as np

from .table import Table

#: So many numbers of a row are compared one by one.
_FEW = 128


def reachable(part):
    """The arrays of Dr.Jit in an object of ours and in what it holds: those that `dr.freeze` must know."""
    if part is None:
        return
    if dr.is_jit_v(part):
        yield part
    elif isinstance(part, (list, tuple)):
        for each in part:
            yield from reachable(each)
    elif type(part).__module__.startswith(__package__) and not isinstance(part, (Types, Table)):
        yield from reachable(list(vars(part).values()))


class JitStore:
    """Records of `width` floats, read together; differentiable in `data`. Reads need no mask: whoever reads makes every index a valid one,
    and what depends on no mask Dr.Jit computes once, however often it is asked for."""

    def __init__(self, types, data, width, first=0):
        """first: how many records of the data come before the store's own."""
        self.record = {1: types.Float, 2: types.Vector2f, 4: types.Vector4f}[width]
        self.width, self.data, self.first = width, data, first

    def read(self, index):
        """The record at an index: a list of floats."""
        found = dr.gather(self.record, self.data, index + self.first)
        return [found] if self.width == 1 else [found[k] for k in range(self.width)]

    def between(self, index, fraction):
        """The record between an index and the next, read linearly."""
        a, b = self.read(index), self.read(index + 1)
        return [dr.fma(fraction, y - x, x) for x, y in zip(a, b)]


class ScalarStore:
    """The same in plain Python floats."""

    def __init__(self, types, data, width, first=0):
        self.records = np.asarray(data, np.float64).reshape(-1, width)[first:]

    def read(self, index):
        return self.records[index].tolist()

    def between(self, index, fraction):
        return [x + fraction * (y - x) for x, y in zip(self.read(index), self.read(index + 1))]


class Search:
    """Rows of ascending numbers, searched five ways at a step, and a store of records of four beside them: one array holds all."""

    def __init__(self, types, rows, records):
        self.types, count = types, rows.shape[1]
        # A lone row of few numbers is compared sooner than it is searched.
        self.known = rows[0].tolist() if len(rows) == 1 and count <= _FEW else None
        steps, span = [], 1
        while self.known is None and span <= count:
            # Of every five spans of numbers the four bounds between them.
            bounds = np.full((len(rows), -(-(count + 1) // (5 * span)), 5, span), np.inf)
            bounds.reshape(len(rows), -1)[:, :count] = rows
            steps.insert(0, bounds[:, :, :4, -1])
            span *= 5
        # What belongs to a row lies together.
        *self.starts, self.stride = np.cumsum([0, *(step.shape[1] for step in steps)]).tolist()
        data = types.array(np.concatenate([np.concatenate(steps, axis=1).reshape(-1, 4) if steps else records[:0], records]))
        self.bounds, self.records = (types.Store(types, data, 4, first) for first in (0, len(rows) * self.stride))

    def count(self, x, row=0):
        """How many of a row's numbers are not above x."""
        one, none = self.types.UInt32(1), self.types.UInt32(0)
        passed = lambda bounds: sum((dr.select(bound <= x, one, none) for bound in bounds), none)
        if self.known is not None:
            return passed(self.known)
        node = none
        for start in self.starts:
            node = 5 * node + passed(self.bounds.read(row * self.stride + start + node))
        return node


class Types:
    """The types of one Mitsuba variant: objects of it keep working after `mi.set_variant` chose another."""

    def __init__(self, mi):
        self.mi = mi
        self.variant = mi.variant()
        self.jit = self.variant.startswith(("llvm", "cuda"))
        for name in ("Float", "UInt32", "Bool", "Vector2f", "Vector3f", "Vector4f", "Color3f", "TensorXf", "Spectrum",
                     "UnpolarizedSpectrum", "BSDFSample3f"):  # fmt: skip
            setattr(self, name, getattr(mi, name))
        self.spectral = "spectral" in self.variant
        self.mono = "mono" in self.variant
        self.Store = JitStore if self.jit else ScalarStore

    def array(self, values):
        """A flat array of numbers: of Dr.Jit, or NumPy's in scalar variants."""
        if self.jit:
            # A copy in Dr.Jit's own memory: it borrows NumPy's, and whether that is aligned well enough to gather whole
            # records at once is luck.
            copied = self.Float(np.ascontiguousarray(values, np.float32).ravel()) * dr.opaque(self.Float, 1.0)
            dr.eval(copied)
            return copied
        return np.asarray(values, float).ravel()

    def store(self, values, width):
        """A store of records."""
        return self.Store(self, self.array(values), width)

    def indices(self, places):
        """Places of an array, for `rearranged`."""
        return self.UInt32(np.ravel(places).astype(np.uint32)) if self.jit else np.ravel(places)

    def rearranged(self, flat, places, width):
        """A store of records whose numbers are those of a flat array (of Dr.Jit, differentiable, or NumPy's) at `indices`."""
        if not self.jit:
            return self.Store(self, flat[places], width)
        return self.Store(self, dr.gather(self.Float, flat, places), width)

    def numbers(self, flat):
        """The numbers of a flat array, one by one."""
        return [dr.gather(self.Float, flat, self.UInt32(k)) for k in range(len(flat))] if self.jit else flat.tolist()

    def floor(self, x):
        """x ≥ 0 as an index."""
        return self.UInt32(x) if self.jit else int(x)

    # The counterpart of colours.NumPy.
    @staticmethod
    def repeat(values, count):
        return dr.repeat(values, count)

    @staticmethod
    def maximum(a, b):
        return dr.maximum(a, b)

    @staticmethod
    def select(mask, a, b):
        return dr.select(mask, a, b)

    @staticmethod
    def block_sum(values, size):
        return dr.block_sum(values, size)

    @staticmethod
    def block_max(values, size):
        return dr.block_reduce(dr.ReduceOp.Max, values, size)
