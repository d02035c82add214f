"""The built programs, as tests run them."""

import os
import pathlib
import subprocess

ROOT = pathlib.Path(__file__).resolve().parents[1]
BIN = pathlib.Path(os.environ.get("NACRE_BIN", ROOT / "target" / "release"))


def run(tool, *args, codes=(0,), **keywords):
    """What a tool prints, which has to end with one of the exit codes."""
    done = subprocess.run([BIN / tool, *map(str, args)], capture_output=True, text=True, **keywords)
    assert done.returncode in codes, done.stderr
    return done.stdout
