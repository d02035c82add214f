"""What is compiled; `nacre` and `nacre.thinfilm` show it."""

from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any, ClassVar, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str

_Real: TypeAlias = NDArray[np.float64]
_Complex: TypeAlias = NDArray[np.complex128]
_Single: TypeAlias = NDArray[np.float32]
_Path: TypeAlias = str | PathLike[str]
_Recipe: TypeAlias = Recipe | _Path | dict[str, Any]
_Table: TypeAlias = Table | _Path

class InputError(ValueError):
    """Input that cannot be used: one line that names the field, the value and what would be right."""

@final
class Recipe:
    """A recipe: layers, facets, azimuth mode and look of a pearl. Of a built-in name (`recipes()`), a path or a dict."""

    def __new__(cls, source: _Recipe) -> Recipe: ...
    @property
    def name(self) -> str:
        """Its name."""
    def to_dict(self) -> dict[str, Any]:
        """All of it, with every default written out."""
    def films(self, wavelengths_nm: ArrayLike) -> tuple[_Complex, _Real, _Real]:
        """Its stack for `nacre.thinfilm`: n (layers + 2, wavelengths), d_nm (layers,) and sd_nm (layers,)."""

def recipes() -> list[str]:
    """Names of the built-in recipes."""

def bake(
    recipe: _Recipe,
    *,
    solver: str | None = None,
    accuracy: float | None = None,
    paths: int | None = None,
    time_budget: float | None = None,
    incident_deg: ArrayLike | None = None,
    cells: tuple[int, int] | None = None,
    effects: str | Sequence[str] | None = None,
    azimuth: str | None = None,
    seed: int = 1,
    both_sides: bool = False,
    reciprocal: bool = False,
    look: dict[str, Any] | None = None,
    threads: int | None = None,
    progress: Callable[[float, float], Any] | None = None,
) -> Table:
    """Bakes a table; the file of `save` is, byte for byte, that of the tool `bake-brdf` with the same options.

    One of three says when it is finished: `accuracy`, the total variation of the lobe as it is read at any pair of angles, per cent of the
    reflected light (1 if nothing is given); `paths` per incidence; `time_budget`, seconds. `solver` is "walk", "doubling" or "auto" (the
    recipe's choice if it is not given). Without `incident_deg` (degrees) and `cells` (columns, rows) there are as few as the accuracy
    takes. `effects` are those that the recipe's look calls for (`look` in its place: see `effects`), or "all", or a list. `threads` are
    all cores.

    `progress` is called with the share of the work that is done and the seconds it took, up to twenty times a second. Ctrl-C stops a
    bake at once; so does an exception in `progress`.
    """

def walk_shard(
    recipe: _Recipe,
    index: int,
    count: int,
    *,
    paths: int,
    incident_deg: ArrayLike | None = None,
    cells: tuple[int, int] | None = None,
    effects: str | Sequence[str] | None = None,
    azimuth: str | None = None,
    seed: int = 1,
    look: dict[str, Any] | None = None,
    threads: int | None = None,
) -> bytes:
    """Walks share `index` (from 1) of `count` of the paths of a bake, anywhere and in any order, and gives what `merge` makes a table of.

    The arguments are those of `bake`, with paths per incidence of the whole bake; stops on Ctrl-C.
    """

def merge(shards: Sequence[bytes]) -> Table:
    """The table of all shards of one bake, in any order: the bytes of a bake in one piece. Raises `InputError` where one is missing,
    damaged, twice there or of another bake."""

@final
class Table:
    """A table of the lobe over angles of incidence and exit cells, of a file: f·cos θo by component, with errors and metadata."""

    def __new__(cls, path: _Path) -> Table: ...
    @staticmethod
    def from_bytes(data: bytes) -> Table:
        """The table of a file's bytes."""
    def to_bytes(self) -> bytes:
        """The bytes of its file."""
    def save(self, path: _Path) -> None:
        """Writes its file, whole or not at all."""
    @property
    def meta(self) -> dict[str, Any]:
        """All metadata, as in the file (docs/LUT-FORMAT.md)."""
    @property
    def theta_i(self) -> _Real:
        """Angles of incidence, radians, ascending."""
    @property
    def channels(self) -> list[str]:
        """Names of all channels: `interior`, `surface`, `rehit`, each with `_std_error` and `_count`, and those of further bands and sides."""
    def channel(self, name: str) -> _Single:
        """A channel as a view that cannot be written to: [incidence, column], in space [incidence, azimuth, column]. 1/sr, counts in paths."""
    def edges(self, incidence: int) -> tuple[_Real, _Real | None]:
        """Edges of the exit cells at an incidence, radians: of columns (signed exit angle in decay tables, polar angle in space), and in
        space of azimuths."""

@final
class Pearl:
    """A BSDF: a table with the artist's controls. What is not given is the look of the recipe in the table.

    `depth` (share of incoherent interference in the body), `brightness` (of the lobes) and `coherence` (share of coherent colour) are 0 to
    1, `body_color` and `tint` linear sRGB (three numbers or one) within 0 to 1, `thickness` a scale of all thicknesses (1, or what a table
    baked with the recipe's `look.thickness` has colours of), `components` "all" or some of `Pearl.COMPONENTS`.
    Pearls of one `Table` share what is made of it.

    Directions have shape (…, 3) and any length but 0; one of the two may be a single one for all of the other.
    """

    COMPONENTS: ClassVar[tuple[str, str, str, str]]
    def __new__(
        cls,
        table: _Table,
        *,
        depth: float | None = None,
        brightness: float | None = None,
        coherence: float | None = None,
        body_color: ArrayLike | None = None,
        tint: ArrayLike | None = None,
        thickness: float | None = None,
        components: str | Sequence[str] | None = None,
    ) -> Pearl: ...
    @property
    def controls(self) -> dict[str, Any]:
        """The controls, by name."""
    def eval(self, wi: ArrayLike, wo: ArrayLike) -> _Real:
        """f·cos θ of the light, linear sRGB, 1/sr: (…, 3). wi looks at the surface, light arrives from wo."""
    def eval_components(self, wi: ArrayLike, wo: ArrayLike) -> _Real:
        """As `eval`, each component by itself: (…, 4, 3), in the order of `Pearl.COMPONENTS`."""
    def eval_spectrum(self, wi: ArrayLike, wo: ArrayLike, wavelengths_nm: ArrayLike) -> _Real:
        """As `eval` at wavelengths: (…, wavelengths)."""
    def pdf(self, wi: ArrayLike, wo: ArrayLike) -> _Real:
        """Density with which `sample` finds wo, 1/sr: (…)."""
    def sample(self, wi: ArrayLike, u: ArrayLike) -> tuple[_Real, _Real, _Real]:
        """Directions of light for wi from uniform random numbers u, (…, 3) in [0, 1): wo (…, 3), its density (…) and `eval` of the pair
        (…, 3). Where nothing is found (rarer than 1e-3) all three are 0."""
    def albedo(self, theta_i_deg: ArrayLike) -> _Real:
        """Share of the light that leaves of what arrives at angles of incidence, below 90°, by component: (…, 4, 3). A viewer at such an
        angle sees as much of a white surrounding, but for the hue of the body (`incoherent` has it by the view)."""

def arrays(table: _Table) -> dict[str, _Single]:
    """All that an evaluation reads, by name: docs/ARRAYS.md."""

def export(table: _Table, format: str, path: _Path) -> dict[str, Any]:
    """Writes a table, with the look of its recipe, for another program, whole or not at all; what `lut export --json` prints of it, the
    error of the round trip included.

    Formats: "arrays" (.npz of `arrays`), "bsdf-rgb" and "bsdf-spectral" (tensor files for Mitsuba's `measured`; pbrt-v4 reads the spectral
    one only), "merl" (.binary, made reciprocal); and those of docs/HOSTS.md: "radiance" (BSDF XML), "microfacet" (.json), "blender" (.py),
    "blender-add-on" (.zip), "three" (ES module), "gltf" (.glb), "openpbr" (.mtlx), "csv", "astm" and "zemax" (measured BRDFs as text).
    """

def diff(a: _Table, b: _Table) -> dict[str, Any]:
    """How two tables differ, and whether more than their errors explain (`significant`): what `lut diff --json` prints."""

def check(table: _Table) -> dict[str, Any]:
    """Whether what a table says of itself holds (`pass`): what `lut check --json` prints of it."""

def effects(recipe: _Recipe, look: dict[str, Any] | None = None) -> dict[str, dict[str, Any]]:
    """Which effects a recipe calls for as it is looked at, each with `on` and `why`.

    `look` has what differs from the recipe's own: `depth`, `brightness`, `coherence`, `body_color` (None for a texture), `components`,
    `variant` (a variant of Mitsuba, or mono, rgb, spectral, polarised), `texture` (a name for what varies over the surface), `thickness`
    (a name for what asks for other thicknesses).
    """

def plan_pearls(
    pearls: Sequence[dict[str, Any]], *, solver: str | None = None, accuracy: float | None = None, why_not: bool = False
) -> dict[str, Any]: ...

_Reals: TypeAlias = tuple[_Real, _Real]
_Complexes: TypeAlias = tuple[_Complex, _Complex]

def film_spectrum(n: _Complex, d_nm: _Real, wavelengths_nm: ArrayLike, angles_deg: ArrayLike, gain: bool) -> tuple[_Reals, _Reals, _Reals]: ...
def film_amplitudes(n: _Complex, d_nm: _Real, wavelengths_nm: ArrayLike, angles_deg: ArrayLike, gain: bool) -> tuple[_Complexes, _Complexes]: ...
def film_field(n: _Complex, d_nm: _Real, wavelengths_nm: ArrayLike, angles_deg: ArrayLike, gain: bool) -> tuple[_Reals, _Reals]: ...
def film_intensity(n: _Complex, d_nm: _Real, wavelengths_nm: ArrayLike, angles_deg: ArrayLike, depths_nm: ArrayLike, gain: bool) -> _Reals: ...
def film_ensemble(
    n: _Complex,
    d_nm: _Real,
    sd_nm: _Real,
    wavelengths_nm: ArrayLike,
    angles_deg: ArrayLike,
    pol: str | None,
    members: int | None,
    accuracy: float | None,
    seed: int,
) -> tuple[tuple[_Real, _Real, _Real], tuple[_Real | None, _Real | None], int, bool]: ...
def film_colours(
    n: _Complex,
    d_nm: _Real,
    sd_nm: _Real,
    wavelengths_nm: ArrayLike,
    angles_deg: ArrayLike,
    members: int,
    accuracy: float,
    seed: int,
) -> tuple[tuple[_Real, _Real, _Real], _Reals]: ...
