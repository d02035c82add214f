"""Every command in the README is executed, in order, in one empty folder."""

import os
import pathlib
import re
import subprocess

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]
BIN = pathlib.Path(os.environ.get("NACRE_BIN", ROOT / "target/release"))


def commands():
    text = (ROOT / "README.md").read_text()
    for block in re.findall(r"```sh\n(.*?)```", text, re.S):
        for line in block.splitlines():
            command = line.split("  #")[0].strip()
            if command:
                yield command


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("readme")


@pytest.mark.parametrize("command", list(commands()))
def test_readme_command_runs(command, folder):
    if command == "cargo xtask test":
        pytest.skip("this very test runs inside it")
    env = {**os.environ, "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}"}
    cwd = folder
    if command.startswith("cargo"):
        cwd = ROOT
    done = subprocess.run(command, shell=True, cwd=cwd, env=env, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    if command == "cargo run --release -p bake-brdf":
        assert (ROOT / "pearl.exr").stat().st_size > 100_000 and "total variation" in done.stdout


def test_readme_pictures_exist():
    for picture in re.findall(r"!\[.*?\]\((.*?)\)", (ROOT / "README.md").read_text()):
        assert (ROOT / picture).stat().st_size > 10_000, picture
