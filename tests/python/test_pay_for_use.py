"""Effects that are off cost nothing: instructions per crossing of the walk against a kernel written without them."""

import json
import shutil
import subprocess
import sys

import pytest
from built import BIN, ROOT

EXAMPLE = BIN / "examples" / "pay_for_use"


@pytest.fixture(scope="module")
def example():
    if not EXAMPLE.is_file():
        pytest.skip(f"{EXAMPLE} is not built (cargo build --release -p transport --example pay_for_use)")
    return EXAMPLE


def test_the_kernel_written_without_effects_walks_the_same_paths(example):
    done = subprocess.run([example, "--compare"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "plane, no effect: same bits\n")


def test_effects_that_are_off_add_no_instruction_to_a_crossing(example):
    if not shutil.which("valgrind"):
        pytest.skip("no valgrind here (apt-get install valgrind), which counts the instructions")
    script = [sys.executable, ROOT / "tools" / "pay_for_use.py", "--example", example]
    done = subprocess.run([*map(str, script), "--only-lean", "--paths", "1000", "--json"], capture_output=True, text=True)
    assert done.returncode in (0, 3), done.stderr
    counted = json.loads(done.stdout)
    assert counted["same_bits"] and counted["apart"] <= 0.01, counted
