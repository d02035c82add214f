"""Whether Mitsuba's LLVM variants can run here. As a program: exit status 0 where they can, else 1 and the reason."""

import functools
import subprocess
import sys

PROBE = "import drjit as dr, drjit.llvm; dr.eval(dr.maximum(drjit.llvm.Float(1.0, 2.0), 1.5))"


@functools.cache
def reason():
    """Why they cannot; None where they can. Asked in a process of its own: a libLLVM that finds no instruction for an
    operation ends its process (that of `maximum`, for LLVM 15 on some processors)."""
    probe = subprocess.run([sys.executable, "-c", PROBE], capture_output=True, text=True, timeout=300)
    if probe.returncode == 0:
        return None
    said = probe.stderr.strip().splitlines() or [f"the probe ended with status {probe.returncode}"]
    return next((line for line in said if "LLVM ERROR" in line), said[-1])


def missing(what):
    """Why they cannot, saying what goes untested; None where they can."""
    return f"{what} NOT TESTED: {reason()}" if reason() else None


def use(variant):
    """Sets a variant of Mitsuba; skips the test, saying why, where it cannot run."""
    import mitsuba
    import pytest

    why = variant.startswith("llvm") and missing("LLVM variants of Mitsuba are")
    if why:
        print(f"\n{why}", file=sys.__stderr__)
        pytest.skip(why)
    mitsuba.set_variant(variant)


if __name__ == "__main__":
    sys.exit(reason())
