"""Tables of recipes, kept in the user's cache folder by what they hold.

The folder is `NACRE_CACHE_DIR` if that is set, else the platform's: `~/.cache/nacre` (or `$XDG_CACHE_HOME/nacre`) on Linux,
`~/Library/Caches/nacre` on macOS, `%LOCALAPPDATA%\\nacre\\Cache` on Windows. It holds at most `NACRE_CACHE_MB` megabytes (1,000): the
tables that were used longest ago go first. Entries appear whole or not at all, so that any number of processes may share the folder; one that
is damaged is baked again (behind the table each has its SHA-256). A folder that cannot be written to costs a bake each time, and one line.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from . import _nacre
from ._nacre import InputError, Recipe, Table, bake, effects

__all__ = ["folder", "table"]

#: Of a table's lobe, per cent.
ACCURACY = 1.0
#: Bytes of a SHA-256.
_DIGEST = 32
#: Seconds after which a bake is spoken of, and between two lines.
_PATIENCE = 2.0

_in_memory: dict[str, Table] = {}


def folder() -> Path:
    """Where tables are kept."""
    if given := os.environ.get("NACRE_CACHE_DIR"):
        return Path(given)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local") / "nacre" / "Cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "nacre"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "nacre"


def table(recipe: Recipe, look: dict[str, Any] | None = None) -> Table:
    """The table of a recipe with the effects that a look calls for (`nacre.effects`), to 1 %: from memory, from the folder, or baked."""
    name = _name(recipe, look)
    if name not in _in_memory:
        path = folder() / name
        _in_memory[name] = _stored(path) or _baked(recipe, look, path)
    return _in_memory[name]


def effects_of(recipe: Recipe, look: dict[str, Any] | None) -> set[str]:
    """Names of the effects that a look calls for."""
    return {name for name, effect in effects(recipe, look).items() if effect["on"]}


def _name(recipe: Recipe, look: dict[str, Any] | None) -> str:
    """Of the file: equal for equal tables of one build of the package."""
    content = json.dumps([_build(), recipe.to_dict(), sorted(effects_of(recipe, look)), ACCURACY], sort_keys=True)
    return f"{recipe.name[:40] if recipe.name.isidentifier() else 'pearl'}-{hashlib.sha256(content.encode()).hexdigest()[:32]}.exr"


@functools.cache
def _build() -> str:
    """Of the compiled module: another build may bake other bits."""
    return hashlib.sha256(Path(str(_nacre.__file__)).read_bytes()).hexdigest()


def _stored(path: Path) -> Table | None:
    try:
        # A pipe or a device never ends.
        data = path.read_bytes() if path.is_file() else b""
        content, digest = data[:-_DIGEST], data[-_DIGEST:]
        if hashlib.sha256(content).digest() != digest:
            return None
        found = Table.from_bytes(content)
    except (InputError, OSError):
        return None
    with contextlib.suppress(OSError):
        os.utime(path)
    return found


def _baked(recipe: Recipe, look: dict[str, Any] | None, path: Path) -> Table:
    most = _most_bytes()
    told = started = time.monotonic()

    def progress(share: float, seconds: float) -> None:
        nonlocal told
        if share < 1.0 and time.monotonic() - told > _PATIENCE:
            told = time.monotonic()
            rest = f", about {seconds / share - seconds:.0f} s to go" if share > 0.02 else ""
            _say(f"baking {recipe.name}: {100 * share:.0f} % after {seconds:.0f} s{rest}")

    made = bake(recipe, solver="auto", accuracy=ACCURACY, look=look, progress=progress)
    if told > started:
        _say(f"baked {recipe.name} in {time.monotonic() - started:.0f} s")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _keep(made, path)
        _make_room(path, most)
    except OSError as error:
        _say(f"{path.parent}: cannot keep the table of {recipe.name}: {error.strerror or error}; it is baked again next time")
    return made


def _keep(made: Table, path: Path) -> None:
    """Writes an entry, whole or not at all."""
    data = made.to_bytes()
    handle, part = tempfile.mkstemp(".part", ".nacre-", path.parent)
    try:
        with open(handle, "wb") as file:
            file.write(data + hashlib.sha256(data).digest())
        os.replace(part, path)
    except OSError:
        os.unlink(part)
        raise


def _most_bytes() -> float:
    """What the folder may hold."""
    given = os.environ.get("NACRE_CACHE_MB") or "1000"
    try:
        most = float(given)
    except ValueError:
        most = -1.0
    if not most >= 0.0:
        raise InputError(f"NACRE_CACHE_MB: {given!r} is not valid, expected megabytes, 0 or more")
    return most * 1e6


def _make_room(newest: Path, most: float) -> None:
    """Removes tables that were used longest ago where the folder holds too much."""
    entries = []
    # The second are what processes left that were killed while they wrote.
    for path in [*newest.parent.glob("*.exr"), *newest.parent.glob(".nacre-*.part")]:
        try:
            stat = path.stat()
        except FileNotFoundError:
            continue  # another process was faster
        entries.append((path != newest, -stat.st_mtime, stat.st_size, path))
    held = 0
    for _, _, size, path in sorted(entries):
        held += size
        if held > most and path != newest:
            path.unlink(missing_ok=True)


def _say(line: str) -> None:
    print(f"nacre: {line}", file=sys.stderr, flush=True)
