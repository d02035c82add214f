"""The commands of the pages run as printed, each page in a plain shell and an empty folder; the notebook runs as it was written."""

import json
import re
import shutil
import subprocess
import sys

import printed
import pytest
from built import ROOT, run

#: Pages whose commands start in an empty folder, and what they leave there.
PAGES = {
    "docs/FIRST-PEARL.md": ["mine.exr", "mine.png", "pictures/sphere-sky-sum.png"],
    "docs/DESIGN.md": ["swatch.png", "range.exr", "thinner/sphere-sky-sum.png"],
    "docs/CLUSTER.md": ["whole.exr", "merged.exr", "dask.exr"],
    "docs/CPP.md": ["pearl.bsdf", "eval_bsdf"],
    "docs/THINFILM.md": ["spectrum.json", "swatch.png"],
    "docs/EFFECTS.md": ["plain.exr", "p.json"],
    "docs/GALLERY.md": ["tahitian.html"],
    "crates/cli/README.md": ["p.html"],
}
#: Pages whose blocks are run elsewhere, or not: what they say takes an hour, other machines, or this very test.
ELSEWHERE = {
    "README.md": "test_readme.py",
    "crates/python/README.md": "test_package.py",
    "CONTRIBUTING.md": "cargo xtask test runs this test",
}


def form(line):
    """A line of output without its numbers, which may change, and its columns."""
    return " ".join(re.sub(r"-?\d[\d.]*", "#", line).split())


def shows_what_it_prints(page, said):
    """What a page shows of the output is in it, but for numbers; … stands for what is left out."""
    said = [form(line) for line in said.splitlines()]
    shown = [form(line) for block in printed.blocks(page, "output") for line in block.splitlines() if line.strip() != "…"]
    for line in shown:
        assert any(found == line or line.endswith("…") and found.startswith(line[:-1].strip()) for found in said), line


def test_every_page_with_commands_is_run():
    listed = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    with_commands = {page for page in listed if (ROOT / page).is_file() and printed.blocks(page)}
    assert with_commands <= PAGES.keys() | ELSEWHERE.keys(), with_commands - PAGES.keys() - ELSEWHERE.keys()


@pytest.mark.parametrize("page", [page for page in PAGES if page != "docs/CPP.md"])
def test_the_commands_of_a_page_run_as_printed(page, tmp_path):
    shows_what_it_prints(page, printed.run("\n".join(printed.blocks(page)), tmp_path, printed.installed()))
    left = printed.files(tmp_path)
    assert all(left.get(name, 0) > 500 for name in PAGES[page]), left


@pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler: the C++ reader was not tested")
def test_the_c_plus_plus_program_says_what_the_table_says(tmp_path):
    said = printed.run("\n".join(printed.blocks("docs/CPP.md")), tmp_path, printed.installed())
    shows_what_it_prints("docs/CPP.md", said)
    values = [float(x) for x in said.splitlines()[-1].split()]
    pairs = [
        ([0.5, 0, 0.866], [-0.5, 0, 0.866]),
        ([0.5, 0, 0.866], [-0.4, 0.1, 0.9]),
        ([0, 0, 1], [0.2, 0.1, 0.95]),
        ([0.9, 0.1, 0.3], [-0.8, 0.1, 0.35]),
        ([0.2, 0.3, 0.9], [0.7, 0.2, 0.5]),
    ]
    lines = "\n".join(json.dumps({"wi": wi, "wo": wo}) for wi, wo in pairs)
    table = [json.loads(line)["rgb"] for line in run("pearl", "eval", tmp_path / "pearl.exr", "--input", "-", input=lines).splitlines()]
    program = [str(tmp_path / "eval_bsdf"), str(tmp_path / "pearl.bsdf")]
    for (wi, wo), wanted in zip(pairs, table, strict=True):
        done = subprocess.run([*program, *map(str, wi + wo)], capture_output=True, text=True, check=True)
        # What the format costs: docs/HOSTS.md.
        assert [float(x) for x in done.stdout.split()] == pytest.approx(wanted, rel=0.01)
    assert values == pytest.approx(table[0], rel=0.01)
    below = subprocess.run([*program, *"0 0 1 0 0 -1".split()], capture_output=True, text=True, check=True)
    assert below.stdout == "0 0 0\n"
    wrong = subprocess.run([program[0], str(tmp_path / "pearl.exr"), *"0 0 1 0 0 1".split()], capture_output=True, text=True)
    assert wrong.returncode == 2 and "is not a tensor file" in wrong.stderr and wrong.stderr.count("\n") == 1


def test_the_notebook_says_what_it_said():
    sys.path.insert(0, str(ROOT / "tools"))
    import notebook

    stored = json.loads((ROOT / "docs" / "pearl.ipynb").read_text(encoding="utf-8"))
    now = notebook.notebook((ROOT / "docs" / "examples" / "notebook.py").read_text(encoding="utf-8"))

    def text(book):
        # Figures depend on matplotlib's version; what is printed does not.
        return [(cell["source"], [output.get("text", "a figure") for output in cell.get("outputs", [])]) for cell in book["cells"]]

    assert text(now) == text(stored), "python tools/notebook.py docs/examples/notebook.py -o docs/pearl.ipynb"


def test_the_gallery_has_every_picture():
    page = (ROOT / "docs" / "GALLERY.md").read_text(encoding="utf-8")
    script = (ROOT / "crates" / "python" / "examples" / "gallery.py").read_text(encoding="utf-8")
    shown = re.findall(r"!\[[^\]]+\]\(images/([\w-]+)\.jpg\)", page)
    assert len(shown) == len(set(shown)) >= 17
    for name in shown:
        path = ROOT / "docs" / "images" / f"{name}.jpg"
        assert 5_000 < path.stat().st_size <= 300_000, path
        assert name.removeprefix("sweep-") in script, name


@pytest.mark.parametrize("tool", ["bake-brdf", "lut", "pearl", "thinfilm"])
def test_the_short_help_fits_a_screen(tool):
    short, long = run(tool, "-h").splitlines(), run(tool, "--help").splitlines()
    assert len(short) <= 50 and max(map(len, short)) <= 101
    assert len(long) >= len(short)
