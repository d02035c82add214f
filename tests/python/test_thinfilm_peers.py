"""`thinfilm spectrum` against two independent Python packages on benign stacks: tmm (Byrnes) and PyMoosh (Moreau).

Benign: at most 24 layers, no resonance of high quality, 0 to 80 degrees; there both peers keep 12 digits. On hard stacks they do not
(tests/data/hard_cases.json), so they are no reference there.
"""

import json
import random
import subprocess

import numpy as np
import PyMoosh
import pytest
import tmm
from built import BIN

ANGLES = [0.0, 17.0, 45.0, 62.5, 80.0]
WAVELENGTHS = np.linspace(400, 740, 5)
AGREEMENT = 1e-11


def stack(seed):
    """Indices [ambient, layers..., substrate] and thicknesses in nm."""
    draw = random.Random(seed)
    k = lambda: 0.0 if seed % 2 else draw.choice([0.0, 10 ** draw.uniform(-5, -1)])
    count = draw.randint(1, 24)
    layers = [complex(draw.uniform(1.3, 2.5), k()) for _ in range(count)]
    substrate = complex(draw.uniform(1.3, 2.0), draw.choice([0.0, 0.0, 2.5]))
    return [complex(1.0), *layers, substrate], [draw.uniform(5, 400) for _ in range(count)]


def recipe(folder, indices, thicknesses):
    medium = lambda n: {"n": n.real, "k": n.imag}
    layers = [{**medium(n), "thickness_nm": d} for n, d in zip(indices[1:-1], thicknesses)]
    path = folder / "recipe.json"
    path.write_text(
        json.dumps(
            {
                "schema": "pearl-recipe/1",
                "stack": {"ambient": {"n": 1.0}, "explicit": layers, "substrate": medium(indices[-1])},
            }
        )
    )
    return path


def ours(path, pol, *flags):
    """[R, T] x angle x wavelength."""
    command = [
        BIN / "thinfilm",
        "spectrum",
        path,
        "--angles-deg",
        ",".join(map(str, ANGLES)),
        "--wavelengths-nm",
        f"{WAVELENGTHS[0]}:{WAVELENGTHS[-1]}:{len(WAVELENGTHS)}",
        "--pol",
        pol,
        "--json",
        *flags,
    ]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    spectrum = json.loads(done.stdout)
    return np.array([spectrum["R"], spectrum["T"]])


def table(value):
    rows = [[value(np.radians(angle), nm) for nm in WAVELENGTHS] for angle in ANGLES]
    return np.moveaxis(np.array(rows), 2, 0)


@pytest.mark.parametrize("pol", ["s", "p"])
@pytest.mark.parametrize("seed", range(12))
def test_agrees_with_tmm(tmp_path, seed, pol):
    indices, thicknesses = stack(seed)

    def theirs(angle, nm):
        found = tmm.coh_tmm(pol, indices, [np.inf, *thicknesses, np.inf], angle, nm)
        return found["R"], found["T"]

    found = ours(recipe(tmp_path, indices, thicknesses), pol)
    np.testing.assert_allclose(found, table(theirs), rtol=0, atol=AGREEMENT)


@pytest.mark.parametrize("pol", ["s", "p"])
@pytest.mark.parametrize("seed", range(12))
def test_agrees_with_pymoosh(tmp_path, seed, pol):
    indices, thicknesses = stack(seed)
    structure = PyMoosh.Structure([n**2 for n in indices], list(range(len(indices))), [0.0, *thicknesses, 0.0], verbose=False)

    def theirs(angle, nm):
        _, _, reflected, transmitted = PyMoosh.coefficient_S(structure, nm, angle, "sp".index(pol))
        return reflected, transmitted

    found = ours(recipe(tmp_path, indices, thicknesses), pol)
    np.testing.assert_allclose(found, table(theirs), rtol=0, atol=AGREEMENT)


@pytest.mark.parametrize("pol", ["s", "p"])
def test_agrees_with_tmm_where_a_thick_layer_is_incoherent(tmp_path, pol):
    # A coated window: amplitudes add in the coatings, intensities across the glass.
    indices = [1, 2.3, 1.45, 1.52, 1.38, 1]
    thicknesses = [60.0, 95.0, 1e6, 100.0]

    def theirs(angle, nm):
        found = tmm.inc_tmm(pol, indices, [np.inf, *thicknesses, np.inf], list("iccici"), angle, nm)
        return found["R"], found["T"]

    path = recipe(tmp_path, [complex(n) for n in indices], thicknesses)
    found = ours(path, pol, "--incoherent-above-nm", "1000")
    np.testing.assert_allclose(found, table(theirs), rtol=0, atol=AGREEMENT)
