"""`thinfilm spectrum` against 40 digits and against very many waves: the same requests every time."""

import pytest
import thinfilm_truth as truth


@pytest.mark.parametrize("part", range(8))
def test_random_requests_are_answered_as_promised_or_refused(tmp_path, part):
    kinds = {truth.judge(tmp_path, seed)[0] for seed in range(12 * part, 12 * (part + 1))}
    assert len(kinds) >= 3
