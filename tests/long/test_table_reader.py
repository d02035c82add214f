"""The independent reader says what `pearl eval` says, for every kind of table: part of `cargo xtask long`."""

import pytest
import table_truth


@pytest.mark.parametrize("kind", table_truth.TABLES)
def test_the_format_page_is_enough(kind, tmp_path):
    table_truth.judge(tmp_path, kind)
