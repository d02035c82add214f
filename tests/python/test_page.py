"""The page of `pearl studio` in a real browser: its pearl is Rust's, its samples follow their density, and it behaves.

All of it runs from a file without a network, by SwiftShader, in chromium.
"""

import json
import pathlib
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
from built import BIN, ROOT, run

sys.path.insert(0, str(ROOT / "tools" / "compare"))

import browser as chromium
import colour

MISSING = chromium.reason() and f"the page is NOT TESTED: {chromium.reason()}"
PAGE = chromium.PAGE
COMPONENTS = ["diffuse", "incoherent", "mirror", "blur"]
#: Recipe, what is changed of it, and how it is baked.
TABLES = {
    "decay": ("paper", {}, ["--azimuth", "decay", "--incident-deg", "0:90:9"]),
    "space": ("paper", {"normals": "visible"}, ["--azimuth", "space", "--incident-deg", "5:85:8"]),
    "limited": ("cosmetic-flake", {}, ["--azimuth", "decay", "--incident-deg", "0:90:9"]),
    "reciprocal-limited": ("cosmetic-flake", {}, ["--reciprocal", "--azimuth", "decay", "--incident-deg", "0:90:6"]),
    "reciprocal-space": ("paper", {}, ["--reciprocal", "--azimuth", "space", "--incident-deg", "0:90:9"]),
    "dispersed": ("golden", {}, ["--azimuth", "decay", "--incident-deg", "0:90:6"]),
    "dispersed-odd": ("golden", {}, ["--azimuth", "decay", "--incident-deg", "0:90:6", "--accuracy", 3]),
}
LOOKS = {
    "recipe": {},
    "painted": {"depth": 0.7, "brightness": 0.6, "coherence": 0.9, "body_rgb": [0.95, 0.6, 0.2], "tint_rgb": [0.6, 1.0, 0.8]},
}
PAIRS = 2000
EVALUATE = """async ([wi, wo]) => {
  const { evaluate } = await import("nacre/probe.js");
  const found = await evaluate(nacre.page.pearls.of.a, unpack(wi), unpack(wo));
  const components = ["diffuse", "incoherent", "mirror", "blur"].map((name) => found[name].flat());
  return [found.pdf, ...components].map((numbers) => pack(Float32Array.from(numbers)));
}"""
SAMPLE = """async ([wi, side, seed]) => {
  const { sample } = await import("nacre/probe.js");
  const { exits, values } = await sample(nacre.page.pearls.of.a, wi, side, seed);
  return [pack(exits), pack(values)];
}"""


@pytest.fixture(scope="module")
def browser():
    if MISSING:
        print(f"\n{MISSING}", file=sys.__stderr__)
        pytest.skip(MISSING)
    with chromium.browser() as made:
        yield made


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """Baked tables by name: the file, and its prepared arrays."""
    made = {}

    def table(name):
        if name not in made:
            folder = tmp_path_factory.mktemp(name)
            recipe, facets, how = TABLES[name]
            recipe = json.loads((ROOT / "data" / "recipes" / f"{recipe}.json").read_text())
            recipe.setdefault("facets", {}).update(facets)
            (folder / "recipe.json").write_text(json.dumps(recipe))
            path, arrays = folder / "table.exr", folder / "table.npz"
            accuracy = [] if "--accuracy" in how else ["--accuracy", 2]
            run("bake-brdf", folder / "recipe.json", "--solver", "doubling", *accuracy, *how, "-q", "-o", path)
            run("lut", "export", path, "--to", "arrays", "-q", "-o", arrays)
            made[name] = path, arrays.read_bytes()
        return made[name]

    return table


@pytest.fixture(scope="module")
def open_page(browser, tables):
    """Opens a page with a table in it, once it is ready; its canvas rests where it is not asked for."""

    def opened(name="decay", canvas=False, **options):
        page = browser.open(tables(name)[1], **options)
        page.evaluate(f"nacre.ready.then(() => {{ nacre.page.renderer.paused = {json.dumps(not canvas)}; }})")
        return page

    return opened


def pairs():
    """Half at random, half around the mirror direction; a fifth near the horizon. Shape (pairs, 3), in single precision."""
    random = np.random.default_rng(11)
    z = random.uniform(1e-3, 1.0, (2, PAIRS)) * np.where(random.uniform(size=(2, PAIRS)) < 0.2, 0.05, 1.0)
    phi, sin = random.uniform(0.0, 2.0 * np.pi, (2, PAIRS)), np.sqrt(1.0 - z * z)
    wi, wo = np.stack([sin * np.cos(phi), sin * np.sin(phi), z], axis=2)
    near = wi * [-1.0, -1.0, 1.0] + random.normal(0.0, 0.05, wi.shape)
    near[:, 2] = np.maximum(np.abs(near[:, 2]), 1e-3)
    wo[1::2] = (near / np.linalg.norm(near, axis=1, keepdims=True))[1::2]
    # The pole, where there is no azimuth.
    wi[0], wo[2] = [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]
    return wi.astype(np.float32).astype(float), wo.astype(np.float32).astype(float)


def by_rust(path, look, wi, wo):
    """Density and components [component, pair, channel] as `pearl eval` says them."""
    lines = "\n".join(json.dumps({"wi": a, "wo": b}) for a, b in zip(wi.tolist(), wo.tolist()))
    written = [[f"--{name.replace('_', '-')}", ",".join(map(str, np.atleast_1d(value)))] for name, value in look.items()]
    found = [json.loads(line) for line in run("pearl", "eval", path, "--input", "-", *sum(written, []), input=lines).splitlines()]
    return np.array([line["pdf"] for line in found]), np.array([[line["components"][name] for line in found] for name in COMPONENTS])


@pytest.mark.parametrize("name", TABLES)
def test_the_shaders_evaluate_what_rust_does(open_page, tables, name):
    page, (wi, wo) = open_page(name), pairs()
    for look, values in LOOKS.items():
        page.evaluate("(look) => nacre.set(look)", values)
        density, *components = map(chromium.unpack, page.evaluate(EVALUATE, [chromium.pack(wi), chromium.pack(wo)]))
        rust_density, rust = by_rust(tables(name)[0], values, wi, wo)
        found = {"density": (density, rust_density)}
        found |= {component: (values.reshape(-1, 3), rust[k]) for k, (component, values) in enumerate(zip(COMPONENTS, components))}
        for what, (shader, expected) in found.items():
            assert expected.max() > 1e-3, f"{what} has light"
            apart = np.abs(shader - expected) / np.maximum(expected, 1e-3 * expected.max())
            print(f"{name}, {look}, {what}: at most {apart.max():.1e}, 99 of 100 below {np.quantile(apart, 0.99):.1e}")
            # Single precision: positions in cells are known to some parts in 1e6.
            assert apart.max() < 1e-4, what
    page.context.close()


def cells(page, wi, exits):
    """Numbers of exits in cells of the hemisphere of about as many, and the share that the density expects."""
    exits = exits[:, :3] / np.linalg.norm(exits[:, :3], axis=1, keepdims=True)
    theta, phi = np.arccos(np.clip(exits[:, 2], -1, 1)), np.arctan2(exits[:, 1], -exits[:, 0])
    rings, sectors, nodes = 20, 12, 10
    edges = np.concatenate([[0.0], np.quantile(theta, np.arange(1, rings) / rings), [np.pi / 2]])
    # The density jumps at the edge of the cap around the normal: no cell lies on both sides.
    cap = page.evaluate("nacre.page.pearls.of.a.table.capRadius")
    if (theta < cap).sum() > 500:
        edges = np.sort(np.append(edges[np.abs(edges - cap) > 2e-3], cap))
    g, weight = np.polynomial.legendre.leggauss(nodes)
    counted, asked, areas = [], [], []
    for low, high in zip(edges, edges[1:]):
        own = np.sort(phi[(theta >= low) & (theta < high)])
        # Sectors of the ring with as many exits each, and pieces of them that are integrated one by one.
        around = np.concatenate([[-np.pi], np.quantile(own, np.arange(1, sectors) / sectors), [np.pi]])
        counted.append(np.histogram(own, around)[0])
        t = (low + high) / 2 + (high - low) / 2 * g
        p = (around[:-1, None] + around[1:, None]) / 2 + (around[1:] - around[:-1])[:, None] / 2 * g
        t, p = np.broadcast_arrays(t[None, :, None], p[:, None, :])
        asked.append(np.stack([-np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1))
        areas.append((high - low) / 2 * ((around[1:] - around[:-1]) / 2)[:, None, None] * weight[:, None] * weight * np.sin(t))
    asked, areas = np.array(asked).reshape(-1, 3), np.array(areas)
    density, *_ = page.evaluate(EVALUATE, [chromium.pack(np.tile(wi, (len(asked), 1))), chromium.pack(asked)])
    expected = (chromium.unpack(density).reshape(areas.shape) * areas).sum(axis=(2, 3))
    return np.array(counted), expected


@pytest.mark.parametrize("name", ["decay", "space", "dispersed"])
def test_samples_follow_their_density(open_page, name):
    from scipy.stats import chi2

    page, side = open_page(name), 220
    page.evaluate("nacre.set({ coherence: 1, brightness: 0.8 })")
    for degrees in (0.0, 50.0):
        theta = np.radians(degrees)
        wi = [float(np.sin(theta)), 0.0, float(np.cos(theta))]
        exits, values = (chromium.unpack(text).reshape(-1, 4) for text in page.evaluate(SAMPLE, [wi, side, 7]))
        found = exits[:, 2] > 0
        counted, expected = cells(page, np.array(wi), exits[found])
        expected = expected * side * side
        assert found.mean() > 0.999 and abs(expected.sum() / found.sum() - 1) < 2e-3
        statistic, degrees_of_freedom = ((counted - expected) ** 2 / expected).sum(), counted.size - 1
        p = chi2.sf(statistic, degrees_of_freedom)
        print(f"{name} at {degrees:.0f}°: χ² {statistic:.0f} of {degrees_of_freedom}, p {p:.3f}")
        # One draw with a fixed seed; azimuths that are drawn a tenth too wide make p vanish.
        assert p > 1e-4
        # The furnace: what is reflected, by the samples' weights.
        albedo = (values[found, :3] / exits[found, 3:]).sum(axis=0) / side**2
        assert (albedo < 1 + 2e-2).all() and (albedo > 0.3).all()
    page.context.close()


def test_a_white_furnace_loses_and_gains_nothing(open_page):
    page, side = open_page("decay"), 256
    page.evaluate("nacre.set({ coherence: 0, depth: 0, body_rgb: [1, 1, 1] })")
    for degrees in (10.0, 60.0):
        theta = np.radians(degrees)
        wi = [float(np.sin(theta)), 0.0, float(np.cos(theta))]
        exits, values = (chromium.unpack(text).reshape(-1, 4) for text in page.evaluate(SAMPLE, [wi, side, 3]))
        found = exits[:, 2] > 0
        weights = np.where(found[:, None], values[:, :3] / np.where(found, exits[:, 3], 1)[:, None], 0)
        error = weights.std(axis=0).max() / side
        print(f"furnace at {degrees:.0f}°: {weights.mean(axis=0)} ± {error:.1e}")
        assert np.abs(weights.mean(axis=0) - 1).max() < 2e-3 + 4 * error
    page.context.close()


def test_pictures_are_the_same_for_the_same_seed(open_page):
    page = open_page()
    one, again, other = (chromium.render(page, "sphere-environment", 16, 8, seed) for seed in (1, 1, 2))
    assert np.array_equal(one, again) and not np.array_equal(one, other)
    assert abs(one.mean() / other.mean() - 1) < 0.1 and one.max() > 0
    with pytest.raises(Exception, match="scene: cube is not known; expected one of sphere-environment"):
        chromium.render(page, "cube", 16, 1)
    for size, samples, why in ((0, 1, "width: 0 is not valid"), (16, 0.5, "samples: 0.5 is not valid; expected a whole number from 1")):
        with pytest.raises(Exception, match=why):
            chromium.render(page, "sphere-point", size, samples)
    page.context.close()


def test_the_page_keeps_its_state_and_says_nothing(open_page):
    page = open_page(canvas=True, viewport={"width": 800, "height": 500})
    page.evaluate("nacre.set({ depth: 0.25, light: 'lamp', a: { body_rgb: [1, 0.5, 0.25] } })")
    state = page.evaluate("nacre.state()")
    assert state["a"]["depth"] == 0.25 and state["light"] == "lamp" and state["a"]["body_rgb"] == [1, 0.5, 0.25]
    assert page.get_by_label("Depth, 0 to 1").input_value() == "0.25"
    # Typed, stepped by an arrow key, undone and done again.
    depth = page.get_by_label("Depth, 0 to 1")
    depth.fill("0.6")
    depth.press("Enter")
    depth.press("ArrowUp")
    assert page.evaluate("nacre.state().a.depth") == pytest.approx(0.61)
    page.get_by_role("button", name="Undo").click()
    assert page.evaluate("nacre.state().a.depth") == pytest.approx(0.25)
    page.get_by_role("button", name="Redo").click()
    assert page.evaluate("nacre.state().a.depth") == pytest.approx(0.61)
    # What was set is what another page is set to, and the address holds it.
    page.wait_for_function("decodeURIComponent(location.hash).includes('0.61')")
    copy = open_page(hash=page.evaluate("location.hash"))
    assert copy.evaluate("nacre.state()") == page.evaluate("nacre.state()")
    for wrong, why in ((
        ("{ depth: 2 }", "depth: 2 is not valid; expected a number from 0 to 1"),
        ("{ depth: null }", "depth: null is not valid; expected a number from 0 to 1"),
        ("{ body_rgb: [1, 2, 0] }", r"body_rgb: \[1,2,0\] is not valid; expected three numbers from 0 to 1"),
        ("{ colour: 1 }", "colour is not known"),
        ("{ light: 'moon' }", "light: moon is not known"),
    )):  # fmt: skip
        with pytest.raises(Exception, match=why):
            page.evaluate(f"nacre.set({wrong})")
    # An address that was cut short says so.
    cut = open_page(hash="#s=%7B%22depth%22%3A0.")
    assert "The address holds a state that is not valid" in cut.locator("#notice").text_content()
    cut.context.close()
    # Side by side, then everything that a picture takes.
    page.evaluate("nacre.set({ view: 'split', scene: 'strand' })")
    page.wait_for_function("nacre.page.renderer.pictures.length === 2 && nacre.page.renderer.pictures[1].film.samples > 0")
    assert page.messages == [] and copy.messages == []
    page.context.close()
    copy.context.close()


def test_bright_light_is_shown_without_a_change_of_hue_and_other_light_as_it_is(open_page):
    page = open_page()
    light = np.array([[0.3, 0.2, 0.1, 1.0], [0.6, 0.0, 0.3, 1.0], [2.0, 1.0, 0.5, 1.0], [8.0, 4.0, 2.0, 2.0]])
    shown = page.evaluate(
        """async (light) => {
          const { Program, Target, texture } = await import("nacre/gl.js");
          const { SHOW } = await import("nacre/glsl/trace.js");
          const { gl } = nacre.page;
          const film = texture(gl, 4, light.length, 1, Float32Array.from(light.flat()));
          const target = new Target(gl, light.length, 1);
          target.bind();
          new Program(gl, SHOW).draw({ uExposure: 1, uBackground: [0, 0, 0] }, { uFilm: film });
          return [...await target.read()];
        }""",
        light.tolist(),
    )
    srgb = np.array(shown).reshape(-1, 4)[:, :3]
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    light = light[:, :3] / light[:, 3:]
    assert np.abs(linear[:2] - light[:2]).max() < 1e-5
    assert np.abs(linear / linear.max(axis=1, keepdims=True) - light / light.max(axis=1, keepdims=True)).max() < 1e-4
    assert 0.6 < linear[2].max() < linear[3].max() < 1.0
    page.context.close()


def test_what_is_read_under_the_pointer_follows_the_picture(open_page):
    page = open_page(canvas=True, viewport={"width": 800, "height": 500})
    lightness = "Number(document.querySelector('#readout span:nth-of-type(2)')?.textContent.trim().split(/\\s+/)[0] ?? NaN)"
    box = page.locator("#view").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.wait_for_function(f"{lightness} > 0")
    before = page.evaluate(lightness)
    # The pointer rests.
    page.evaluate("nacre.set({ exposure_ev: -3 })")
    page.wait_for_function(f"{lightness} < {before - 20}")
    # Nor does a reading come late.
    page.mouse.move(5, 5)
    page.evaluate("nacre.set({ exposure_ev: 0 })")
    page.wait_for_timeout(300)
    assert page.locator("#readout").is_hidden()
    page.context.close()


def test_a_sheet_wastes_little_of_the_stage(open_page):
    page = open_page(viewport={"width": 1024, "height": 768})
    for count in (1, 2, 3, 4, 5, 7):
        tiles = np.array(page.evaluate("(count) => nacre.page.tiles(count)", count))
        width, height = page.evaluate("[nacre.page.canvas.width, nacre.page.canvas.height]")
        assert (tiles[:, :2] >= 0).all() and (tiles[:, 0] + tiles[:, 2] <= width).all() and (tiles[:, 1] + tiles[:, 3] <= height).all()
        assert tiles[:, 2:].prod(axis=1).sum() > 0.7 * width * height, count
        # None lies on another.
        for k, (x, y, w, h) in enumerate(tiles):
            apart = (tiles[:, 0] >= x + w) | (tiles[:, 0] + tiles[:, 2] <= x) | (tiles[:, 1] >= y + h) | (tiles[:, 1] + tiles[:, 3] <= y)
            assert np.delete(apart, k).all(), count
    # Names on it tell its pearls apart.
    page.evaluate("[0, 1, 2].forEach(() => nacre.page.keep())")
    assert page.evaluate("nacre.page.pearls.tray.map(({ name }) => name)") == ["pearl", "pearl 2", "pearl 3"]
    # A pearl that is replaced while the plots look at it is not asked for.
    page.evaluate("""async () => {
      const { page } = nacre;
      nacre.set({ view: "split" });
      const plotted = () => new Promise((resolve) => {
        const ledger = document.getElementById("ledger");
        new MutationObserver((_, observer) => { observer.disconnect(); resolve(); }).observe(ledger, { childList: true });
      });
      for (let k = 0; k < 3; k++) {
        page.onupdate();
        await plotted();
        page.onupdate();
        await new Promise((resolve) => setTimeout(resolve, 62));
        page.pearls.take("b", page.pearls.of.a.table);
        await plotted();
      }
    }""")
    assert page.messages == []
    # A table of one thickness says so.
    assert page.get_by_text("fixed in this table").is_visible()
    page.context.close()


def test_a_lost_context_comes_back(open_page):
    page = open_page(canvas=True, viewport={"width": 400, "height": 300})
    before = chromium.render(page, "sphere-point", 12, 4)
    page.evaluate("""async () => {
      const lose = nacre.page.gl.getExtension("WEBGL_lose_context");
      const event = (name) => new Promise((resolve) => nacre.page.canvas.addEventListener(name, resolve, { once: true }));
      const lost = event("webglcontextlost");
      lose.loseContext();
      await lost;
      await new Promise((resolve) => setTimeout(resolve, 50));
      const back = event("webglcontextrestored");
      lose.restoreContext();
      await back;
    }""")
    assert np.array_equal(chromium.render(page, "sphere-point", 12, 4), before)
    page.wait_for_function("nacre.page.renderer.pictures[0]?.film.samples > 0")
    page.context.close()


@pytest.mark.parametrize(("script", "sentence"), [
    ("HTMLCanvasElement.prototype.getContext = () => null;", "This browser has no WebGL 2"),
    ("WebGL2RenderingContext.prototype.getExtension = () => null;", "cannot draw into single-precision textures"),
])  # fmt: skip
def test_a_machine_without_what_it_takes_is_told_so(browser, tables, script, sentence):
    page = browser.open(tables("decay")[1], script=script)
    assert sentence in page.get_by_role("paragraph").inner_text()
    assert page.messages == []
    page.context.close()


def test_files_are_read_and_written(open_page, tmp_path):
    import OpenEXR

    page = open_page()
    # A picture that another program reads, and reads back.
    text = page.evaluate("""async () => {
      const { writeExr, readExr } = await import("nacre/exr.js");
      const pixels = Float32Array.from({ length: 4 * 5 * 3 }, (_, k) => (k % 4 === 3 ? 1 : 0.25 * k));
      const file = writeExr(pixels, 5, 3);
      const { width, height, rgb } = await readExr(file.buffer);
      return [btoa(String.fromCharCode(...file)), width, height, pack(rgb)];
    }""")
    import base64

    path = tmp_path / "picture.exr"
    path.write_bytes(base64.b64decode(text[0]))
    expected = (0.25 * np.arange(60.0)).reshape(3, 5, 4)[:, :, :3]
    with OpenEXR.File(str(path)) as file:
        assert np.array_equal(file.channels()["RGB"].pixels, expected)
    assert text[1:3] == [5, 3] and np.array_equal(chromium.unpack(text[3]).reshape(3, 5, 3), expected)
    # Surroundings of another program: halves, compressed.
    sky = np.random.default_rng(2).uniform(0, 4, (32, 64, 3)).astype(np.float16)
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, {"RGB": sky}).write(str(path))
    read = page.evaluate(
        """async (text) => { const { readExr } = await import("nacre/exr.js");
        return pack((await readExr(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer)).rgb); }""",
        base64.b64encode(path.read_bytes()).decode(),
    )
    assert np.array_equal(chromium.unpack(read).reshape(sky.shape), sky.astype(float))
    # A shape, and what is wrong with another.
    said = page.evaluate("""async () => {
      const { readObj } = await import("nacre/mesh.js");
      const mesh = readObj("v 0 0 0\\nv 1 0 0\\nv 1 1 0\\nv 0 1 0\\nf 1 2 3 4\\n");
      try { readObj("v 0 0 0\\nf 1 2 3\\n"); } catch (error) { return [mesh.corners.length, error.message]; }
    }""")
    assert said == [18, "line 2: a face names a vertex that is not there"]
    page.context.close()


def test_colour_differences_are_those_of_the_harness(open_page):
    page = open_page()
    random = np.random.default_rng(5)
    one, other = random.uniform(0, 1, (2, 500, 3)) ** 3
    found = page.evaluate(
        """async ([one, other]) => { const { deltaE, lab } = await import("nacre/colour.js");
        return one.map((rgb, k) => deltaE(lab(rgb), lab(other[k]))); }""",
        [one.tolist(), other.tolist()],
    )
    assert np.abs(np.array(found) - colour.delta_e(one, other)).max() < 2e-2
    page.context.close()


def test_the_scripts_keep_their_types():
    """TypeScript reads the types that the comments state; nothing is built."""
    npx = shutil.which("npx")
    if npx is None:
        pytest.skip("the page's types are NOT CHECKED: there is no node")
    try:
        asked = [npx, "--yes", "-p", "typescript@5.9.3", "tsc"]
        if subprocess.run([*asked, "--version"], capture_output=True, timeout=120).returncode != 0:
            pytest.skip("the page's types are NOT CHECKED: npx finds no TypeScript")
        done = subprocess.run([*asked, "-p", PAGE], capture_output=True, text=True, timeout=120)
    except subprocess.TimeoutExpired:
        pytest.skip("the page's types are NOT CHECKED: npx takes too long")
    assert done.returncode == 0, done.stdout


def test_every_module_is_small_and_says_what_it_is():
    for path in (path for folder in chromium.FOLDERS for path in folder.rglob("*.js")):
        text = path.read_text(encoding="utf-8")
        assert text.startswith("/**"), f"{path.name} opens with what it is"
        # three.js reads one of them.
        outside = 'from "three"' if path.name == "three.js" else 'from "nacre/'
        imported = [line for line in text.splitlines() if line.startswith("import ")]
        assert all('from "nacre/' in line or outside in line for line in imported), path.name


def test_the_studio_bakes_what_its_page_asks_for(browser):
    built = subprocess.run([BIN / "pearl", "studio", "--help"], capture_output=True, text=True)
    if built.returncode != 0:
        pytest.skip("the page with its server is NOT TESTED: this `pearl` has no studio")
    studio = subprocess.Popen([BIN / "pearl", "studio", "paper", "--no-browser"], stdout=subprocess.PIPE, text=True)
    try:
        page = browser.visit(studio.stdout.readline().strip(), offline=False, viewport={"width": 400, "height": 300})
        page.evaluate("nacre.ready.then(() => { nacre.page.renderer.paused = true; })")
        assert page.evaluate("nacre.state().a.name") == "paper" and "token" not in page.evaluate("location.href")
        # Thinner layers: another colour, by a first table and a last one; the one that is overtaken says nothing.
        before = page.evaluate("[...nacre.page.pearls.of.a.table.arrays.modulation_rgb.data.slice(0, 3)]")
        page.evaluate("""async () => {
          const thinner = (nm) => { const recipe = nacre.state().a.recipe; recipe.stack.aragonite.thickness_nm = nm; return recipe; };
          const overtaken = nacre.setRecipe(thinner(380));
          await Promise.all([overtaken, nacre.setRecipe(thinner(400))]);
        }""")
        assert page.evaluate("nacre.state().a.recipe.stack.aragonite.thickness_nm") == 400
        assert page.evaluate("nacre.page.pearls.of.a.table.spectral") is True
        assert page.evaluate("[...nacre.page.pearls.of.a.table.arrays.modulation_rgb.data.slice(0, 3)]") != before
        page.evaluate("nacre.page.travel(-1)")
        page.evaluate("nacre.page.pearls.baking")
        assert page.evaluate("nacre.state().a.recipe.stack.aragonite.thickness_nm") != 400
        before = page.evaluate("nacre.state()")
        said = page.evaluate("(async () => { try { await nacre.setRecipe({ stack: { layers: -1 } }); } catch (error) { return error.message; } })()")
        assert "layers" in said and page.evaluate("nacre.state()") == before
        assert "layers" in page.get_by_role("alert").filter(visible=True).inner_text()
        # A material of the library, with its source; and back to a number.
        material = page.get_by_label("Material of substrate")
        material.select_option("n-bk7")
        page.evaluate("nacre.page.pearls.baking")
        assert page.evaluate("nacre.state().a.recipe.stack.substrate.n") == {"material": "n-bk7"}
        assert page.get_by_text("SCHOTT optical glass").is_visible()
        material.select_option("")
        assert page.evaluate("nacre.state().a.recipe.stack.substrate.n") == pytest.approx(1.5185, abs=1e-3)
        # Thickness as a control, and the errors of the lobe.
        page.get_by_role("button", name="Make it a control").click()
        page.evaluate("nacre.page.pearls.baking")
        low, high = page.evaluate("nacre.page.pearls.of.a.table.scales")
        assert (low, high) == pytest.approx((0.7, 1.4))
        page.evaluate("nacre.set({ thickness: 1.2 })")
        assert page.get_by_label("Thickness, ×, 0.7 to 1.4").input_value() == "1.200"
        incidences, exits = page.evaluate("nacre.page.pearls.of.a.table.arrays.error_lobe.shape")
        assert incidences == page.evaluate("nacre.page.pearls.of.a.table.incidences") and exits == 37
        error = page.evaluate("""(async () => {
          const { factsOf } = await import("nacre/plots.js");
          return (await factsOf(nacre.page.pearls.of.a, 30)).lobe.error(30);
        })()""")
        assert 0 < error < 0.02
        # All that is exported, and the recipe with the thicknesses that are shown.
        page.get_by_role("button", name="Save").click()
        formats = page.evaluate("nacre.page.formats")
        assert {"arrays", "bsdf-rgb", "merl"} <= {known["name"] for known in formats}
        for known in formats:
            assert page.locator(f"[title='lut export --to {known['name']}']").is_visible(), known
        with page.expect_download() as download:
            page.get_by_role("menuitem", name="Recipe").click()
        saved = json.loads(pathlib.Path(download.value.path()).read_text())
        nm = page.evaluate("nacre.state().a.recipe.stack.aragonite.thickness_nm")
        assert saved["stack"]["aragonite"]["thickness_nm"] == pytest.approx(1.2 * nm)
        # What a browser says of a refused request is its own.
        assert [message for message in page.messages if "400" not in message] == []
        page.context.close()
    finally:
        studio.send_signal(signal.SIGINT)
        assert studio.wait(20) == 0
