"""The commands that pages print, run as printed: one plain shell, an empty folder, what the README told the reader to install."""

import os
import pathlib
import re
import subprocess

from built import BIN, ROOT

# What a login shell of a machine with Rust has; what these variables say differs from machine to machine.
PLAIN = {"HOME", "CARGO_HOME", "RUSTUP_HOME", "RUSTUP_TOOLCHAIN", "SSL_CERT_FILE", "LANG", "DRJIT_LIBLLVM_PATH"}
#: The simulator runs until Ctrl-C, which comes after some seconds.
CTRL_C = 'pearl() { case "$1" in studio) timeout --preserve-status -s INT 8 "$(type -P pearl)" "$@" --no-browser;; *) command pearl "$@";; esac; }'


def blocks(page, language="sh"):
    """The fenced blocks of a page in this language."""
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.S | re.M)


def environment(*path):
    """A plain shell's variables, with these folders first on the path."""
    variables = {name: value for name, value in os.environ.items() if name in PLAIN}
    return variables | {"PATH": ":".join([*map(str, path), "/usr/local/bin:/usr/bin:/bin"])}


def installed():
    """The same once the reader has done what the README says: tools and package on the path."""
    return environment(BIN, ROOT / ".venv" / "bin") | {"NACRE": str(ROOT)}


def run(script, folder, env, seconds=600):
    """What a script prints to stdout; it has to end well, and the last line that the shell echoes is the one that failed."""
    shell = ["bash", "--noprofile", "--norc", "-e", "-o", "pipefail", "-c", f"{CTRL_C}\nset -x\n{script}"]
    done = subprocess.run(shell, cwd=folder, env=env, capture_output=True, text=True, timeout=seconds)
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


def files(folder):
    """What a script left behind, by name."""
    return {str(path.relative_to(folder)): path.stat().st_size for path in pathlib.Path(folder).rglob("*") if path.is_file()}
