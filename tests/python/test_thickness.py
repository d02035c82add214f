"""Thickness as a control: pearls against bakes of such thicknesses, and the plugin against the package."""

import functools
import json
import sys

import numpy as np
import pytest
from built import ROOT

sys.path.insert(0, str(ROOT / "tools" / "compare"))

dr = pytest.importorskip("drjit")
mi = pytest.importorskip("mitsuba")
import colour  # noqa: E402  (the comparison's)
import llvm  # noqa: E402  (it needs drjit)

import nacre  # noqa: E402
import nacre.mitsuba  # noqa: E402

PAIRS = 2000
#: A thin pearl, whose fringes are resolved by either bake.
STACK = {"layers": 40, "aragonite": {"thickness_nm": 450.0}, "conchiolin": {"thickness_nm": 25.0}}
GLASSY = {**STACK, "aragonite": {"thickness_nm": 450.0, "n": {"cauchy": [1.52, 0.008]}}}
INCIDENT_DEG = [0, 15, 30, 45, 60, 70, 80, 88]
NM = [420.0, 510.0, 570.0, 650.0]


def grey(value):
    return {"type": "rgb", "value": [value] * 3}


def interaction(wi):
    si = dr.zeros(mi.SurfaceInteraction3f, len(wi))
    si.wi = mi.Vector3f(wi.T)
    if "spectral" in mi.variant():
        si.wavelengths = NM
    return si


def evaluated(bsdf, wi, wo):
    """Values [pair, channel] and densities of the plugin."""
    ctx = mi.BSDFContext()
    if mi.variant().startswith("llvm"):
        value, pdf = bsdf.eval_pdf(ctx, interaction(wi), mi.Vector3f(wo.T))
        return np.array(value).reshape(-1, len(wi)).T, np.array(pdf)
    found = []
    si = mi.SurfaceInteraction3f()
    if "spectral" in mi.variant():
        si.wavelengths = NM
    for a, b in zip(wi.astype(float).tolist(), wo.astype(float).tolist(), strict=True):
        si.wi = a
        value, pdf = bsdf.eval_pdf(ctx, si, b)
        found.append((np.ravel(value), pdf))
    return np.array([value for value, _ in found]), np.array([pdf for _, pdf in found])


def baked(stack, scale=1.0, **look):
    """A table of a stack, all of its thicknesses times a scale."""
    stack = {key: value if key == "layers" else value | {"thickness_nm": scale * value["thickness_nm"]} for key, value in stack.items()}
    recipe = {"schema": "pearl-recipe/1", "stack": stack, "look": look}
    return nacre.bake(recipe, solver="doubling", accuracy=1.0, incident_deg=INCIDENT_DEG)


@pytest.fixture(scope="module")
def thick():
    return baked(STACK, thickness={})


@pytest.fixture(scope="module")
def thin():
    """Tables of one thickness, by its scale."""
    return functools.cache(lambda scale: baked(STACK, scale))


@pytest.fixture(scope="module")
def dispersed():
    return baked(GLASSY, thickness={"min": 0.8, "max": 1.2})


@pytest.fixture(scope="module")
def narrow():
    """Few scales: scalar variants keep every number in Python."""
    return baked(STACK, thickness={"min": 0.95, "max": 1.05})


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("thickness")


def pairs():
    random = np.random.default_rng(5)
    z = random.uniform(0.02, 1.0, PAIRS)
    phi = random.uniform(0.0, 2.0 * np.pi, PAIRS)
    sin = np.sqrt(1.0 - z * z)
    wi = np.stack([sin * np.cos(phi), sin * np.sin(phi), z], axis=1)
    wo = wi * [-1.0, -1.0, 1.0] + random.normal(0.0, 0.15, wi.shape)
    wo[:, 2] = np.maximum(np.abs(wo[:, 2]), 0.02)
    return wi, wo / np.linalg.norm(wo, axis=1, keepdims=True)


@pytest.mark.parametrize("scale", [0.7, 0.83, 1.4])
@pytest.mark.parametrize("look", [{}, {"coherence": 1.0, "depth": 0.0}, {"coherence": 0.0, "depth": 1.0}, {"tint": [0.6, 1.0, 0.8]}])
def test_a_pearl_at_another_thickness_is_that_of_a_bake_of_it(thick, thin, scale, look):
    wi, wo = pairs()
    found, truth = nacre.Pearl(thick, thickness=scale, **look), nacre.Pearl(thin(scale), **look)
    assert found.controls["thickness"] == scale
    expected = truth.eval(wi, wo)
    # As colours of one luminance.
    unit = 0.5 / (expected @ [0.2126, 0.7152, 0.0722])[:, None]
    apart = colour.delta_e(found.eval(wi, wo) * unit, expected * unit).max()
    own = colour.delta_e(nacre.Pearl(thick, **look).eval(wi, wo) * unit, expected * unit).max()
    print(f"{scale} {look}: {apart:.3f}, of {own:.1f} from the recipe's own thickness")
    assert apart < 0.1 and own > 1.0


def test_samples_fit_their_density_at_any_thickness(thick):
    """The furnace by samples: the mean of value over density is the albedo. Five standard errors of 200,000."""
    theta_deg = 40.0
    wi = [np.sin(np.radians(theta_deg)), 0.0, np.cos(np.radians(theta_deg))]
    u = np.random.default_rng(1).uniform(size=(200_000, 3))
    lobes = nacre.Pearl(thick, thickness=1.35, coherence=1.0, depth=0.0)
    _, density, value = lobes.sample(np.broadcast_to(wi, u.shape), u)
    weight = np.divide(value, density[:, None], out=np.zeros_like(value), where=density[:, None] > 0.0)
    albedo = lobes.albedo([theta_deg])[0].sum(axis=0)
    assert (np.abs(weight.mean(axis=0) - albedo) < 5.0 * weight.std(axis=0) / np.sqrt(len(u)) + 1e-4).all()


@pytest.mark.parametrize(("scale", "range_"), [(0.6, "a number from 0.7 to 1.4"), (float("nan"), "a number from 0.7 to 1.4")])
def test_a_thickness_out_of_range_is_refused(thick, scale, range_):
    with pytest.raises(nacre.InputError, match=f"thickness: is {scale:g}|thickness: is NaN") as error:
        nacre.Pearl(thick, thickness=scale)
    assert range_ in str(error.value)


def test_a_table_of_one_thickness_says_how_to_bake_more(thin):
    with pytest.raises(nacre.InputError, match="thickness") as error:
        nacre.Pearl(thin(0.7), thickness=1.1)
    assert '"look": {"thickness": {}}' in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("variant", "kind"),
    [
        ("llvm_ad_rgb", "thick"), ("llvm_ad_mono", "thick"), ("scalar_rgb", "narrow"), ("llvm_ad_rgb", "dispersed"),
        ("llvm_ad_spectral", "dispersed"),
    ],
)  # fmt: skip
def test_the_plugin_says_what_the_package_does(request, folder, variant, kind):
    llvm.use(variant)
    path = folder / f"{kind}.exr"
    request.getfixturevalue(kind).save(path)
    wi, wo = (v[:: 1 if variant.startswith("llvm") else 50].astype(np.float32) for v in pairs())
    # The luminance of a product is not the product of luminances: the plugin's mono variants are compared by their lobes, without tint.
    tint, body = ([1.0] * 3, 0.0) if "mono" in variant else ([0.6, 1.0, 0.8], 0.7)
    look = {"type": "pearl", "filename": str(path), "body_color": grey(body), "tint": {"type": "rgb", "value": tint}}
    scales = (0.96, 1.0, 1.04) if kind == "narrow" else (0.83, 1.0, 1.19)
    # All are loaded before one is asked: they share the table, and nothing else.
    for scale, bsdf in [(scale, mi.load_dict(look | {"thickness": scale})) for scale in scales]:
        pearl = nacre.Pearl(str(path), thickness=scale, body_color=body, tint=tint)
        expected = pearl.eval_spectrum(wi, wo, NM) if "spectral" in variant else pearl.eval(wi, wo)
        if "mono" in variant:
            expected = expected @ np.array([[0.212671], [0.715160], [0.072169]])
        found, density = evaluated(bsdf, wi, wo)
        above = expected > 1e-3 * expected.max()
        apart = np.abs(found[:, : expected.shape[1]][above] / expected[above] - 1.0).max()
        print(f"{variant} {kind} {scale}: {apart:.1e}")
        assert apart < 1e-4
        expected = pearl.pdf(wi, wo)
        assert np.abs(density - expected)[expected > 1e-3 * expected.max()].max() < 1e-4 * expected.max()


def test_a_texture_of_thickness_is_read_where_it_is(thick, folder):
    llvm.use("llvm_ad_rgb")
    path = folder / "texture.exr"
    thick.save(path)
    values = np.array([[0.75, 1.0], [1.1, 1.35]], np.float32)
    texture = {"type": "bitmap", "data": mi.TensorXf(values[..., None]), "raw": True, "filter_type": "nearest"}
    bsdf = mi.load_dict({"type": "pearl", "filename": str(path), "thickness": texture})
    wi, wo = (v.astype(np.float32) for v in pairs())
    si = interaction(wi)
    row, column = np.arange(PAIRS) % 2, (np.arange(PAIRS) // 2) % 2
    si.uv = mi.Point2f((column + 0.5) / 2.0, (row + 0.5) / 2.0)
    found = np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(wo.T))).T
    for i in (0, 1):
        for j in (0, 1):
            here = (row == i) & (column == j)
            expected = nacre.Pearl(thick, thickness=float(values[i, j])).eval(wi[here], wo[here])
            assert np.abs(found[here] - expected).max() < 1e-4 * expected.max()


def test_gradients_of_thickness_are_those_of_differences(thick, folder):
    llvm.use("llvm_ad_rgb")
    path = folder / "gradient.exr"
    thick.save(path)
    bsdf = mi.load_dict({"type": "pearl", "filename": str(path), "thickness": 0.9})
    wi, wo = (v[:200].astype(np.float32) for v in pairs())
    params = mi.traverse(bsdf)
    thickness = mi.Float(0.9031)
    dr.enable_grad(thickness)
    params["thickness"] = thickness
    params.update()
    value = bsdf.eval(mi.BSDFContext(), interaction(wi), mi.Vector3f(wo.T))
    dr.backward(dr.sum(value.x - 0.5 * value.z))
    at = lambda s: (nacre.Pearl(thick, thickness=s).eval(wi, wo) @ [1.0, 0.0, -0.5]).sum()
    # Both ends lie between the same two scales.
    difference = (at(0.9032) - at(0.9030)) / 2e-4
    assert abs(float(thickness.grad[0]) / difference - 1.0) < 1e-2


def test_a_recipe_in_a_scene_bakes_for_its_thickness_and_for_one_that_moves(monkeypatch, tmp_path):
    llvm.use("llvm_ad_rgb")
    monkeypatch.setenv("NACRE_CACHE_DIR", str(tmp_path))
    recipe = tmp_path / "recipe.json"
    recipe.write_text(json.dumps({"schema": "pearl-recipe/1", "stack": STACK}))
    fixed = mi.load_dict({"type": "pearl", "recipe": str(recipe)})
    assert fixed.table.scales is None
    params = mi.traverse(fixed)
    params["thickness"] = mi.Float(1.2)
    params.update()
    assert fixed.table.scales is not None
    assert mi.load_dict({"type": "pearl", "recipe": str(recipe), "thickness": 1.2}).table is fixed.table
    with pytest.raises(RuntimeError, match="thickness: is 1.6; expected a number from 0.7 to 1.4"):
        mi.load_dict({"type": "pearl", "recipe": str(recipe), "thickness": 1.6})
