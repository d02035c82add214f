"""Whether Mitsuba's LLVM variants can run here."""

import drjit as dr


def missing(what):
    """Why they cannot, saying what goes untested; None where they can."""
    try:
        dr.eval(dr.llvm.Float(1.0) + 1.0)
    except Exception as error:  # whatever Dr.Jit raises, its text is the reason
        return f"{what} NOT TESTED: {str(error).strip()}"
    return None
