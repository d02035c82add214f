"""What tests of several folders share."""

import pathlib
import re

import pytest

PAGE = pathlib.Path(__file__).resolve().parents[1] / "docs" / "ARRAYS.md"


@pytest.fixture(scope="session")
def evaluator():
    """The functions printed in docs/ARRAYS.md, by name."""
    names = {}
    exec("\n".join(re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.S | re.M)), names)
    return names
