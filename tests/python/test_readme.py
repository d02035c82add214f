"""The commands of the README run as printed."""

import pathlib
import re
import shutil
import subprocess

import printed
import pytest
from built import ROOT

README = (ROOT / "README.md").read_text()
# This very test runs inside it.
NOT_RUN = "cargo xtask test"
BLOCKS = printed.blocks("README.md")
# What installs the package: these tests run beside the same wheel, and test_package.py installs it in a fresh environment.
INSTALLS = "pip install"


def test_the_two_commands_and_the_build_run_in_the_checkout():
    checkout = [block for block in BLOCKS if "cargo" in block]
    assert len(checkout) == 2
    lines = [line for line in "\n".join(checkout).splitlines() if line.split("#")[0].strip() != NOT_RUN]
    assert len(lines) == len("\n".join(checkout).splitlines()) - 1
    (ROOT / "pearl.exr").unlink(missing_ok=True)
    cargo = pathlib.Path(shutil.which("cargo")).parent
    said = printed.run("\n".join([*lines, "pearl --version"]), ROOT, printed.environment(cargo), 1200)
    assert (ROOT / "pearl.exr").stat().st_size > 100_000 and "total variation" in said
    # What to look at next runs, too.
    after = [line.split("  ")[-1] for line in said.splitlines() if line.endswith("pearl.exr") and line.startswith("  ")]
    assert "lut info pearl.exr" in after and "pearl studio pearl.exr" in after


@pytest.mark.parametrize("door", ["artists", "opticians", "developers"])
def test_a_door_is_five_lines_that_run_in_an_empty_folder(door, tmp_path):
    section = re.search(rf"^## For {door}\n(.*?)^## ", README, re.S | re.M)[1]
    (block,) = re.findall(r"^```sh\n(.*?)^```", section, re.S | re.M)
    assert len(block.splitlines()) == 5
    said = printed.run(block, tmp_path, printed.installed())
    # The last line of a door, and what its fourth left behind.
    assert {"artists": "http://127.0.0.1:", "opticians": "figures/", "developers": "]"}[door] in said.splitlines()[-1], said
    assert printed.files(tmp_path)[{"artists": "akoya.html", "opticians": "fine.exr", "developers": "lobe.csv"}[door]] > 1_000


def test_every_block_is_run():
    doors = [block for block in BLOCKS if "cargo" not in block and INSTALLS not in block]
    assert len(doors) == 3 and len(BLOCKS) == 6


def test_commands_package_and_tests_share_what_is_compiled():
    def built(*of):
        # Packages with their features; macros run while compiling, and count.
        tree = ["cargo", "tree", "--offline", "--locked", "-f", "{p} {f}", "--prefix", "none", *of]
        text = subprocess.run(tree, cwd=ROOT, capture_output=True, text=True, check=True).stdout
        return {line.removesuffix(" (*)") for line in text.splitlines()}

    all_of_it = built("--workspace", "-e", "normal,build,dev")
    for some in (["-p", "bake-brdf"], [], ["-p", "nacre-python"]):
        alone = built(*some, "-e", "normal,build")
        # The package takes no command line with `bake-brdf`.
        alone = {line for line in alone if some != ["-p", "nacre-python"] or not line.startswith("bake-brdf ")}
        assert len(alone) > 80 and alone <= all_of_it, (some, alone - all_of_it)


def test_readme_pictures_exist():
    for picture in re.findall(r"!\[.*?\]\((.*?)\)", README):
        assert (ROOT / picture).stat().st_size > 10_000, picture
