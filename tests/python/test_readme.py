"""The commands of the README run as printed, one after another in one plain shell that starts in the checkout."""

import os
import pathlib
import re
import shutil
import subprocess

ROOT = pathlib.Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()
# This very test runs inside it.
NOT_RUN = "cargo xtask test"
# What a login shell of a machine with Rust has; what these variables say differs from machine to machine.
PLAIN = {"HOME", "CARGO_HOME", "RUSTUP_HOME", "RUSTUP_TOOLCHAIN", "SSL_CERT_FILE", "LANG"}


def test_the_commands_of_the_readme_run_as_printed():
    script = "\n".join(re.findall(r"```sh\n(.*?)```", README, re.S))
    lines = [line for line in script.splitlines() if line.split("#")[0].strip() != NOT_RUN]
    assert len(lines) == len(script.splitlines()) - 1
    pearls = ROOT / "pearls"
    shutil.rmtree(pearls, ignore_errors=True)
    (ROOT / "pearl.exr").unlink(missing_ok=True)
    cargo = pathlib.Path(shutil.which("cargo")).parent
    env = {name: value for name, value in os.environ.items() if name in PLAIN} | {"PATH": f"{cargo}:/usr/local/bin:/usr/bin:/bin"}
    shell = ["bash", "--noprofile", "--norc", "-e", "-x", "-o", "pipefail", "-c", "\n".join(lines)]
    done = subprocess.run(shell, cwd=ROOT, env=env, capture_output=True, text=True, timeout=1200)
    # The last line that the shell echoes is the one that failed.
    assert done.returncode == 0, done.stderr[-3000:]
    assert (ROOT / "pearl.exr").stat().st_size > 100_000 and "total variation" in done.stdout
    assert (pearls / "merged.exr").is_file()
    shutil.rmtree(pearls)


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
