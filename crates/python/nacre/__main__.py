"""The package as a command: `python -m nacre plan SCENE`."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator
from typing import Any, NoReturn

from . import InputError, __version__, plan

EXAMPLES = """examples:
  python -m nacre plan scene.xml                       which effects the pearls of a Mitsuba scene call for, why, and what they cost
  python -m nacre plan scene.xml --variant llvm_ad_mono -D depth=0.3
  python -m nacre plan akoya --why-not                 a recipe, and what each effect changes in a picture"""


class Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise InputError(message)


def definition(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=VALUE")
    return name, value


def parse(argv: list[str]) -> argparse.Namespace:
    plain = argparse.RawDescriptionHelpFormatter
    parser = Parser(prog="python -m nacre", description="What the package nacre does by itself.", epilog=EXAMPLES, formatter_class=plain)
    parser.add_argument("--version", action="version", version=f"nacre {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, parser_class=Parser)
    about = "Say which effects a scene or a recipe calls for, why, and what each costs. Nothing is baked, and nothing needs to be baked by hand."
    add = commands.add_parser("plan", help="which effects a scene or a recipe calls for", description=about, epilog=EXAMPLES, formatter_class=plain)
    add.add_argument("source", metavar="SCENE", help="Mitsuba scene (.xml), or a recipe: a file or the name of a built-in one")
    add.add_argument("--variant", help="of the renderer: a variant of Mitsuba, or mono, rgb, spectral, polarised [what the scene hints at, else rgb]")
    add.add_argument("-D", "--define", metavar="NAME=VALUE", type=definition, action="append", default=[], help="value of the scene's $NAME")
    add.add_argument("--why-not", action="store_true", help="also bake with every effect switched the other way: what does that change in a picture?")
    add.add_argument("--json", action="store_true", help="print one JSON object")
    return parser.parse_args(argv)


def duration(seconds: float) -> str:
    return f"{1000 * seconds:.0f} ms" if seconds < 1 else f"{seconds:.1f} s"


def text(report: dict[str, Any]) -> Iterator[str]:
    """The plan for people."""
    for pearl in report["pearls"]:
        yield f"{pearl['id']} ({pearl['place']}): {pearl['recipe']['name']} from {pearl['recipe_from']}"
        if not pearl["used"]:
            yield "  unused: no shape shows this pearl; nothing is baked for it\n"
            continue
        if pearl["shapes"]:
            yield f"  shown by {', '.join(pearl['shapes'])}"
        yield "  effect           on   seconds      bytes  why"
        for name, effect in sorted(pearl["effects"].items(), key=lambda item: not item[1]["on"]):
            costs = f"{effect['seconds']:8.3f} {effect['bytes']:10}" if effect["on"] else " " * 19
            yield f"  {name:<15}  {'on' if effect['on'] else '–':<3} {costs}  {effect['why']}"
        yield ""
    for pearl in report.get("why_not", []):
        yield f"{pearl['id']}: what each effect changes in a picture of a sphere"
        yield "  effect           plan  mean ΔE00  relative RMSE  seconds      bytes"
        for name, effect in pearl["effects"].items():
            numbers = "{delta_e:9.3f}  {relative_rmse:13.2e}  {seconds:7.3f} {bytes:10}"
            said = effect["not_shown"] or numbers.format_map(effect)
            yield f"  {name:<15}  {'on' if effect['on'] else 'off':<4}  {said}"
        yield ""
    for table in report["tables"]:
        effects = ", ".join(table["effects"])
        yield f"table of {table['recipe']}: {effects} by {table['solver']}, about {duration(table['seconds'])}, {table['bytes'] / 1e3:.0f} kB"
    if not report["tables"]:
        yield "no pearl is shown: nothing to bake"
    elif any(pearl["shapes"] for pearl in report["pearls"]):
        yield "the plugin bakes what a recipe calls for when the scene is loaded"


def main(argv: list[str]) -> int:
    try:
        asked = parse(argv)
        report = plan(asked.source, variant=asked.variant, defaults=dict(asked.define), why_not=asked.why_not)
        print(json.dumps(report) if asked.json else "\n".join(text(report)), flush=True)
    except BrokenPipeError:
        # Who read has enough; Python's own flush at the end must not complain.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (InputError, ImportError, OSError, KeyboardInterrupt) as error:
        print(f"nacre: {' '.join(str(error).split()) or 'interrupted'}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
