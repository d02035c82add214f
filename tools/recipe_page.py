#!/usr/bin/env python3
"""Prints docs/RECIPE.md, the reference of recipes: tools/recipe_page.py > docs/RECIPE.md

It is made of the JSON Schema (`bake-brdf schema`), the default values in it, and the built-in recipes with their sources.
"""

import argparse
import json
import pathlib
import subprocess

ROOT = pathlib.Path(__file__).resolve().parents[1]

HEAD = """\
# Recipes: reference

<!-- Written by tools/recipe_page.py: edit crates/bake-brdf/src/recipe.rs or a recipe. -->

A recipe says what a pearl is made of, as JSON. Every key is optional; a key that is left out keeps
the default below. Unknown keys and values out of range are refused with one line that names the
field.

```json
{ "name": "thin", "stack": { "layers": 20 }, "look": { "coherence": 0.8 } }
```

`bake-brdf schema` prints the JSON Schema that this page is made of. Editors complete and check by
it.

## Fields

The defaults are the paper's pearl. Sources are those of the built-in recipe `paper`; the source of
a group stands in its own row.
"""

REFERENCES = """
## References

- Murr and Ramirez 2012: *The Microstructure of the Cultured Freshwater Pearl*, JOM.
- Myagkaya, Zhou and Fan 2021: nacre nanostructure by its structural color pattern, Scientific
  Reports 11.
- Ozaki et al. 2021: *Structural colors of pearls*, Scientific Reports 11, 15224.
- Pfaff and Reynders 1999: *Angle-dependent optical effects deriving from submicron structures of
  films and pigments*, Chemical Reviews 99.
- Salman et al. 2021: *Hyperspectral interference tomography of nacre*, PNAS 118.
- Zhang et al. 2009: *Unique Optical Reflection Spectra of Bivalve Nacre and Its Origin*,
  Spectroscopy and Spectral Analysis 29, 1186.
"""

UNITS = {"_nm": "nm", "_deg": "degrees"}


def wrapped(text):
    """A cell of a table: one line, no bars."""
    return " ".join(text.split()).replace("|", "\\|")


def resolve(schema, part):
    """A property with what it refers to, and whether null is allowed."""
    options = part.get("anyOf", [])
    chosen = next((option for option in options if option.get("type") != "null"), part)
    if "$ref" in chosen:
        referred = schema["$defs"][chosen["$ref"].rsplit("/", 1)[1]]
        return {**referred, **{key: part[key] for key in ("description", "default") if key in part}}
    return part


def span(part):
    """The values that a property takes."""
    if "const" in part:
        return f"`{part['const']}`"
    if "oneOf" in part:
        names = []
        for option in part["oneOf"]:
            names += [f"`{option['const']}`"] if "const" in option else [f'`{{"{key}": …}}`' for key in option.get("properties", {})]
            if option.get("type") == "number":
                names.append("a number")
        return ", ".join(names)
    kinds = part.get("type")
    kinds = kinds if isinstance(kinds, list) else [kinds]
    if "array" in kinds:
        items = part["items"]
        if "$ref" in items:
            return "a list of layers"
        return f"{part['minItems']} numbers, {span(items)}"
    low, high = part.get("minimum"), part.get("maximum")
    number = lambda value: f"{value:,.10g}" if value is not None else ""
    if low is not None and high is not None:
        return f"{number(low)} to {number(high)}"
    if low is not None:
        return f"{number(low)} or more"
    if "number" in kinds:
        return "a number"
    return {"string": "text", "boolean": "`true`, `false`", "object": "field: text"}.get(kinds[0], str(kinds[0]))


def unit(name):
    return next((text for end, text in UNITS.items() if name.endswith(end)), "")


def rows(schema, part, path=""):
    """The fields below a part of the schema, as (path, property, resolved property)."""
    for name, given in part["properties"].items():
        whole = resolve(schema, given)
        here = f"{path}.{name}" if path else name
        if "properties" in whole:
            yield here, whole, True
            yield from rows(schema, whole, here)
        else:
            yield here, whole, False


def value_at(value, path):
    for name in path.split("."):
        value = value.get(name) if isinstance(value, dict) else None
    return value


def shown(value):
    return "" if value is None else f"`{json.dumps(value)}`"


def page(schema, recipes):
    defaults = {name: resolve(schema, part).get("default") for name, part in schema["properties"].items()}
    sources = recipes["paper"]["sources"]
    text = [HEAD, "| field | meaning | unit | values | default | source of the default |", "|---|---|---|---|---|---|"]
    for path, whole, group in rows(schema, schema):
        name = path.rpartition(".")[2]
        meaning = wrapped(whole.get("description", ""))
        if group:
            text.append(f"| **`{path}`** | {meaning} | | | | {wrapped(sources.get(path, ''))} |")
            continue
        default = shown(value_at(defaults, path))
        text.append(f"| `{path}` | {meaning} | {unit(name)} | {wrapped(span(whole))} | {default} | {wrapped(sources.get(path, ''))} |")
    index = schema["$defs"]["Dispersion"]
    text += ["", "## Indices", "", wrap(index["description"]), ""]
    text += ["```json", '{ "n": 1.53 }', '{ "n": { "cauchy": [1.5, 0.01] } }', '{ "n": { "sellmeier": { "b": [1.0], "c_um2": [0.01] } } }',
             '{ "n": { "table": [[400, 1.54, 0.0], [700, 1.52, 0.0]] } }', '{ "n": { "material": "silver" } }', "```"]  # fmt: skip
    text += ["", "## Values of words", "", "| field | value | meaning |", "|---|---|---|"]
    for path, whole, group in rows(schema, schema):
        for option in [] if group else whole.get("oneOf", []):
            if "description" in option:
                value = option.get("const") or f'{{"{next(iter(option["properties"]))}": …}}'
                text.append(f"| `{path}` | `{value}` | {wrapped(option['description'])} |")
    text += ["", "## Built-in recipes", "", wrap(
        "A built-in recipe's name may stand wherever a recipe's file may: `bake-brdf akoya`. Each value has its source; "
        "what no source gives is called a guess or art direction. The files are in `data/recipes/`.")]  # fmt: skip
    for name, recipe in recipes.items():
        text += ["", f"### {name}", "", "| field | value | source |", "|---|---|---|"]
        for field, source in recipe["sources"].items():
            value = value_at(recipe, field)
            value = "" if isinstance(value, (dict, list)) else shown(value)
            text.append(f"| `{field}` | {value} | {wrapped(source)} |")
    return "\n".join(text) + "\n" + REFERENCES


def wrap(text, width=96):
    """A paragraph in lines."""
    lines, line = [], ""
    for word in text.split():
        if line and len(line) + 1 + len(word) > width:
            lines.append(line)
            line = word
        else:
            line = f"{line} {word}".strip()
    return "\n".join([*lines, line])


def current(tool):
    """The page as it should be now."""
    schema = json.loads(subprocess.run([tool, "schema"], capture_output=True, text=True, check=True).stdout)
    files = sorted((ROOT / "data" / "recipes").glob("*.json"))
    return page(schema, {file.stem: json.loads(file.read_text(encoding="utf-8")) for file in files})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tool", default=ROOT / "target" / "release" / "bake-brdf", help="the built bake-brdf")
    print(current(parser.parse_args().tool), end="")
