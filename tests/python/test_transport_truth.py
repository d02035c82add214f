"""Both solvers on a few random recipes against an independent walk (tests/transport_truth.py); 200 of them in `cargo xtask long`."""

import pytest
import transport_truth as truth

SEEDS = range(1, 15)
# Of about two hundred comparisons one in ten thousand runs would fail by chance.
LEAST_P = 5e-7


@pytest.mark.parametrize("seed", SEEDS)
def test_both_solvers_walk_as_an_independent_program_does(seed, tmp_path):
    verdict, found, recipe = truth.judge(tmp_path, seed)
    if verdict == "judged":
        wrong = [row for row in found if row[3] < LEAST_P]
        assert not wrong, (recipe, wrong)
