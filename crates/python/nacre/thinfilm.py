"""Waves in stacks of thin films: reflectance, amplitudes, fields, irregular stacks, colours.

A stack is `n` and `d_nm`: complex indices n + ik (k > 0 absorbs) of the ambient, the layers from there down, and the substrate, and the
thicknesses of the layers in nm. `n` has shape (layers + 2,), or (layers + 2, wavelengths) with an index at each wavelength. A leading
index of either makes a batch of stacks: `n` (stacks, layers + 2) or (stacks, layers + 2, wavelengths), `d_nm` (stacks, layers), one of
them without it to be the same for all. (Two indices of `n` are media and wavelengths where they could be.)

Results have an array for each polarisation, `s` and `p`, of [stack, angle, wavelength]; without the index of the stack where neither `n`
nor `d_nm` has one. Stacks are solved on all cores; `RAYON_NUM_THREADS` in the environment bounds them. R and T are within 1e-12 of the
exact solution of what is given, but where the condition of the problem itself forbids it.

    import nacre
    s = nacre.thinfilm.spectrum([1, 1.53, 1.43, 1.53], [450, 25], [500, 550, 600], [0, 30, 60])
    s.R.s          # (3 angles, 3 wavelengths)
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _nacre
from ._nacre import InputError

__all__ = [
    "Amplitudes",
    "Colour",
    "Ensemble",
    "Field",
    "Polarised",
    "PolarisedAmplitude",
    "Spectrum",
    "amplitudes",
    "colour",
    "ensemble",
    "field",
    "intensity",
    "spectrum",
]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
Number = TypeVar("Number", np.float64, np.complex128)


class Polarised(NamedTuple):
    """Values for light with E across (s) and in (p) the plane of incidence."""

    s: Real
    p: Real

    @property
    def mean(self) -> Real:
        """Of s and p: unpolarised light."""
        return 0.5 * (self.s + self.p)


class PolarisedAmplitude(NamedTuple):
    """Complex amplitudes for light with E across (s) and in (p) the plane of incidence."""

    s: Complex
    p: Complex


class Spectrum(NamedTuple):
    """Shares of the light: reflected, transmitted, absorbed in layers (exactly 0 without absorption)."""

    R: Polarised
    T: Polarised
    A: Polarised


class Amplitudes(NamedTuple):
    """Amplitudes of E, relative to the incident wave at the first interface: reflected there, transmitted behind the last."""

    r: PolarisedAmplitude
    t: PolarisedAmplitude


class Field(NamedTuple):
    """By layer, [stack, layer, angle, wavelength]: ∫|E|² dz in nm of a unit incident wave, and the share of the light that it absorbs."""

    integral: Polarised
    absorptance: Polarised


class Ensemble(NamedTuple):
    """Means over stacks drawn with irregular thicknesses, [angle, wavelength]; standard errors are None where one member leaves them open."""

    R: Real
    T: Real
    A: Real
    R_error: Real | None
    T_error: Real | None
    members: int
    converged: bool


class Colour(NamedTuple):
    """Colours in reflection under D65, [angle, channel]; ΔE00 by angle: against half as many wavelengths, and standard error of an
    ensemble (0 for a regular stack, NaN where one member leaves it open)."""

    xyz: Real
    linear_srgb: Real
    lab: Real
    change: Real
    ensemble_error: Real


def spectrum(n: ArrayLike, d_nm: ArrayLike, wavelengths_nm: ArrayLike, angles_deg: ArrayLike, *, gain: bool = False) -> Spectrum:
    """R, T and A of stacks at every angle of incidence and vacuum wavelength; with `gain`, layers of k < 0 amplify."""
    stacks, batched = _stacks(n, d_nm, wavelengths_nm)
    return Spectrum(*(Polarised(*_pair(each, batched)) for each in _nacre.film_spectrum(*stacks, wavelengths_nm, angles_deg, gain)))


def amplitudes(n: ArrayLike, d_nm: ArrayLike, wavelengths_nm: ArrayLike, angles_deg: ArrayLike, *, gain: bool = False) -> Amplitudes:
    """Complex r and t, as `spectrum` has R and T."""
    stacks, batched = _stacks(n, d_nm, wavelengths_nm)
    return Amplitudes(*(PolarisedAmplitude(*_pair(each, batched)) for each in _nacre.film_amplitudes(*stacks, wavelengths_nm, angles_deg, gain)))


def field(n: ArrayLike, d_nm: ArrayLike, wavelengths_nm: ArrayLike, angles_deg: ArrayLike, *, gain: bool = False) -> Field:
    """Where the light is and where it is absorbed, layer by layer."""
    stacks, batched = _stacks(n, d_nm, wavelengths_nm)
    return Field(*(Polarised(*_pair(each, batched)) for each in _nacre.film_field(*stacks, wavelengths_nm, angles_deg, gain)))


def intensity(
    n: ArrayLike, d_nm: ArrayLike, wavelengths_nm: ArrayLike, angles_deg: ArrayLike, depths_nm: ArrayLike, *, gain: bool = False
) -> Polarised:
    """|E|² of a unit incident wave in one stack, at depths below its first interface: [angle, wavelength, depth]."""
    stacks = _one_stack(n, d_nm, wavelengths_nm)
    return Polarised(*_nacre.film_intensity(*stacks, wavelengths_nm, angles_deg, depths_nm, gain))


def ensemble(
    n: ArrayLike,
    d_nm: ArrayLike,
    sd_nm: ArrayLike,
    wavelengths_nm: ArrayLike,
    angles_deg: ArrayLike,
    *,
    members: int | None = None,
    accuracy: float | None = None,
    pol: str | None = None,
    seed: int = 1,
) -> Ensemble:
    """Mean over stacks whose thicknesses are drawn from normal distributions (negative ones drawn again), `sd_nm` one number or one a layer.

    `members` stacks, or as many as bring the root mean square standard error of R to `accuracy` (1e-3 if neither is given; 65,536 at
    most). `pol` is "s", "p" or None for unpolarised light. The same seed draws the same stacks.
    """
    stacks = _one_stack(n, d_nm, wavelengths_nm)
    if members is None and accuracy is None:
        accuracy = 1e-3
    shares, errors, count, converged = _nacre.film_ensemble(
        *stacks, _spreads(sd_nm, stacks[1]), wavelengths_nm, angles_deg, pol, members, accuracy, seed
    )
    return Ensemble(*shares, *errors, count, converged)


def colour(
    n: ArrayLike,
    d_nm: ArrayLike,
    angles_deg: ArrayLike,
    *,
    wavelengths_nm: ArrayLike = (380.0, 780.0),
    sd_nm: ArrayLike = 0.0,
    members: int = 64,
    accuracy: float = 0.1,
    seed: int = 1,
) -> Colour:
    """Colour of one stack, of as many wavelengths as bring ΔE00 to `accuracy`; with `sd_nm`, of the mean of `members` drawn stacks.

    Where `n` is given by wavelength, `wavelengths_nm` are those of its columns (ascending, from 380 or less to 780 or more); between them
    it is read linearly.
    """
    stacks = _one_stack(n, d_nm, wavelengths_nm)
    triples, errors = _nacre.film_colours(*stacks, _spreads(sd_nm, stacks[1]), wavelengths_nm, angles_deg, members, accuracy, seed)
    return Colour(*triples, *errors)


def _pair(both: tuple[NDArray[Number], NDArray[Number]], batched: bool) -> tuple[NDArray[Number], NDArray[Number]]:
    s, p = both
    return (s, p) if batched else (s[0], p[0])


def _one_stack(n: ArrayLike, d_nm: ArrayLike, wavelengths_nm: ArrayLike) -> tuple[Complex, Real]:
    stacks, batched = _stacks(n, d_nm, wavelengths_nm)
    if batched:
        raise InputError("n, d_nm: are a batch of stacks, expected one")
    return stacks


def _stacks(n: ArrayLike, d_nm: ArrayLike, wavelengths_nm: ArrayLike) -> tuple[tuple[Complex, Real], bool]:
    """`n` as [stack, layers + 2, wavelength], `d_nm` as [stack, layer], and whether there is a batch."""
    indices, d = _array("n", n, np.complex128), _array("d_nm", d_nm, np.float64)
    if d.ndim not in (1, 2) or indices.ndim not in (1, 2, 3):
        shapes = f"{indices.shape} and {d.shape}"
        raise InputError(f"n, d_nm: have shapes {shapes}, expected (layers + 2,) and (layers,), with stacks first and wavelengths last if wanted")
    waves, media = np.size(wavelengths_nm), d.shape[-1] + 2
    by_wavelength = indices.ndim == 2 and len(indices) == media and indices.shape[1] in (1, waves)
    if indices.ndim == 2 and indices.shape[1] == media and not by_wavelength:
        indices = indices[:, :, None]
    batched = d.ndim == 2 or indices.ndim == 3
    indices = indices[None, :, None] if indices.ndim == 1 else indices[None] if indices.ndim == 2 else indices
    d = d[None] if d.ndim == 1 else d
    if indices.shape[1] != media:
        raise InputError(f"n: has {indices.shape[1]} media, expected {media}: the ambient, {media - 2} layers of d_nm, the substrate")
    if indices.shape[2] not in (1, waves):
        raise InputError(f"n: has {indices.shape[2]} wavelengths, expected {waves} as in wavelengths_nm")
    if 1 not in (len(indices), len(d)) and len(indices) != len(d):
        raise InputError(f"n: has {len(indices)} stacks and d_nm {len(d)}, expected as many")
    return (indices, d), batched


def _spreads(sd_nm: ArrayLike, d: Real) -> Real:
    spreads = _array("sd_nm", sd_nm, np.float64)
    if spreads.ndim > 1 or spreads.size not in (1, d.shape[1]):
        raise InputError(f"sd_nm: has shape {spreads.shape}, expected one number or {d.shape[1]}")
    return np.ascontiguousarray(np.broadcast_to(spreads, d.shape))


def _array(name: str, values: ArrayLike, kind: type[Number]) -> NDArray[Number]:
    try:
        return np.asarray(values, dtype=kind, order="C")
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: {error}") from None
