"""A reader written from docs/LUT-FORMAT.md alone says what `pearl eval` says; all kinds of tables in `cargo xtask long`."""

import pytest
import table_truth


@pytest.mark.parametrize("kind", ["decay"])
def test_the_format_page_is_enough(kind, tmp_path):
    table_truth.judge(tmp_path, kind)
