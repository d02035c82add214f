#!/usr/bin/env python3
"""Runs a script of cells and writes it as an executed notebook: tools/notebook.py SCRIPT -o NOTEBOOK

A cell starts at a line `# %%`, text at `# %% [markdown]`. What a cell prints, and the figures that it makes, are its outputs.
"""

import argparse
import base64
import contextlib
import io
import json
import pathlib
import re

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt


def cells(script):
    """(kind, text) of each cell."""
    found = []
    for kind, text in re.findall(r"^# %%( \[markdown\])?\n(.*?)(?=^# %%|\Z)", script, re.S | re.M):
        lines = text.strip().splitlines()
        found.append(("markdown", "\n".join(line[2:] for line in lines)) if kind else ("code", "\n".join(lines)))
    return found


def outputs(text, names):
    """Runs a cell: what it printed, and its figures as PNG."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(text, "cell", "exec"), names)
    figures = []
    for number in plt.get_fignums():
        data = io.BytesIO()
        plt.figure(number).savefig(data, format="png", dpi=80, metadata={"Software": None})
        figures.append(data.getvalue())
    plt.close("all")
    return printed.getvalue(), figures


def lines(text):
    return text.splitlines(keepends=True)


def notebook(script):
    """The executed notebook, as JSON."""
    names, made = {"__name__": "__main__"}, []
    for number, (kind, text) in enumerate(cells(script)):
        cell = {"cell_type": kind, "id": f"cell-{number}", "metadata": {}, "source": lines(text)}
        if kind == "code":
            printed, figures = outputs(text, names)
            shown = [{"output_type": "stream", "name": "stdout", "text": lines(printed)}] if printed else []
            for png in figures:
                data = {"image/png": base64.b64encode(png).decode(), "text/plain": ["<figure>"]}
                shown.append({"output_type": "display_data", "metadata": {}, "data": data})
            cell |= {"execution_count": sum(c["cell_type"] == "code" for c in made) + 1, "outputs": shown}
        made.append(cell)
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    return {"cells": made, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("script", type=pathlib.Path)
    parser.add_argument("-o", "--output", type=pathlib.Path, required=True)
    options = parser.parse_args()
    made = notebook(options.script.read_text(encoding="utf-8"))
    options.output.write_text(json.dumps(made, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
