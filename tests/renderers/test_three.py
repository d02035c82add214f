"""three.js in a browser shows with `lut export --to three` what the Mitsuba plugin says; what a frame of it and of our page takes.

Part of `cargo xtask renderers`, which installs three.js and the plugin. All of it runs by SwiftShader, in chromium.
"""

import functools
import http.server
import sys
import threading

import numpy as np
import pytest
from built import ROOT, run

sys.path.insert(0, str(ROOT / "tools" / "compare"))

import browser as chromium

mi = pytest.importorskip("mitsuba")
mi.set_variant("llvm_ad_rgb")
import nacre.mitsuba  # noqa: E402, F401

THREE = ROOT / "target" / "renderers-node" / "node_modules" / "three"
SIZE = 30
EYE = np.array([0.0, -6.0, 1.5])
CORNER, ACROSS, ALONG, RADIANCE = np.array([-2.6, -3.0, 2.2]), np.array([1.6, 0.0, 0.0]), np.array([0.0, 1.1, 1.1]), 9.0
POINT, INTENSITY = np.array([-2.0, -4.0, 3.0]), 45.0
LAMPS = [((-1.0, -1.0, 1.0), 30.0, 5.0), ((1.5, -0.5, 0.6), 60.0, 2.0)]
LOOKS = {"recipe": {}, "painted": {"depth": 0.7, "brightness": 0.6, "coherence": 0.9, "body_rgb": [0.95, 0.6, 0.2]}}
#: Recipe, and how it is baked.
TABLES = {"paper": [], "akoya": [], "golden": ["--azimuth", "space", "--incident-deg", "0:90:6"]}
PAGE = """<!doctype html><link rel="icon" href="data:," />
<script type="importmap">
  {"imports": {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}
</script>"""
SCENE = """
async ([light, look, size, samples, sky]) => {
  const THREE = await import("three"), { pearlMaterial } = await import("/pearl.js");
  const renderer = new THREE.WebGLRenderer({ canvas: document.createElement("canvas") });
  const material = await pearlMaterial(look ?? {});
  material.samples = samples;
  const scene = new THREE.Scene();
  const ball = new THREE.Mesh(new THREE.SphereGeometry(1, 256, 128), material);
  scene.add(ball);
  const camera = new THREE.PerspectiveCamera((2 * Math.atan(0.185) * 180) / Math.PI, 1, 0.1, 100);
  camera.up.set(0, 0, 1);
  camera.position.set(0, -6, 1.5);
  camera.lookAt(0, 0, 0);
  if (light === "point") {
    const lamp = new THREE.PointLight(0xffffff, 45, 0, 2);
    lamp.position.set(-2, -4, 3);
    scene.add(lamp);
  } else if (light === "area") {
    const lamp = new THREE.RectAreaLight(0xffffff, 9, 1.6, Math.hypot(1.1, 1.1)), a = Math.SQRT1_2;
    lamp.position.set(-1.8, -2.45, 2.75);
    const axes = [new THREE.Vector3(1, 0, 0), new THREE.Vector3(0, a, a), new THREE.Vector3(0, -a, a)];
    lamp.quaternion.setFromRotationMatrix(new THREE.Matrix4().makeBasis(...axes));
    scene.add(lamp);
  } else if (light === "ambient") {
    scene.add(new THREE.AmbientLight(0xffffff, Math.PI));
  } else if (light === "environment") {
    const map = new THREE.DataTexture(unpack(sky), 1024, 512, THREE.RGBAFormat, THREE.FloatType, THREE.EquirectangularReflectionMapping);
    map.minFilter = map.magFilter = THREE.LinearFilter;
    map.needsUpdate = true;
    scene.environment = map;
  } else {
    // Where the processor's own rounding puts points and normals.
    ball.material = new THREE.ShaderMaterial({
      vertexShader: `varying vec3 v; void main() { v = ${light}; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }`,
      fragmentShader: "varying vec3 v; void main() { gl_FragColor = vec4(v, 1.0); }",
    });
  }
  const target = new THREE.WebGLRenderTarget(size, size, { type: THREE.FloatType });
  renderer.setRenderTarget(target);
  renderer.render(scene, camera);
  const pixels = new Float32Array(4 * size * size);
  renderer.readRenderTargetPixels(target, 0, 0, size, size, pixels);
  renderer.dispose();
  return pack(pixels);
}"""

#: Milliseconds of frames of the page and of three's iridescent material, in turn.
COST = """
async ([size, times]) => {
  const THREE = await import("three"), { harnessScene } = await import("nacre/scenes.js"), { Target } = await import("nacre/gl.js");
  const { SHOW } = await import("nacre/glsl/trace.js");
  const scene = new THREE.Scene();
  const iridescence = { iridescence: 1, iridescenceIOR: 1.53, iridescenceThicknessMaximum: 450 };
  scene.add(new THREE.Mesh(new THREE.SphereGeometry(1, 96, 64), new THREE.MeshPhysicalMaterial({ color: 0xcfcdc8, roughness: 0.2, ...iridescence })));
  const lamp = new THREE.PointLight(0xffffff, 45, 0, 2);
  lamp.position.set(-2, -4, 3);
  scene.add(lamp);
  const camera = new THREE.PerspectiveCamera((2 * Math.atan(0.185) * 180) / Math.PI, 1, 0.1, 100);
  camera.up.set(0, 0, 1);
  camera.position.set(0, -6, 1.5);
  camera.lookAt(0, 0, 0);
  const three = new THREE.WebGLRenderer({ antialias: false });
  three.setSize(size, size, false);
  const { renderer, pearls } = nacre.page, { gl } = renderer;
  const world = { ...harnessScene("sphere-point"), grain: 0, floor: [0, 0, 0], vertices: 1 };
  const film = { width: size, height: size, front: new Target(gl, size, size), back: new Target(gl, size, size), passes: 0, rows: 0, samples: 0 };
  const shown = new Target(gl, size, size, 1, true);
  const seen = (gl, picture) => {
    const pixels = new Uint8Array(4 * size * size);
    gl.readPixels(0, 0, size, size, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    if (!pixels.some((value, k) => k % 4 < 3 && value > 100)) throw new Error(`${picture} shows nothing`);
  };
  const theirs = () => { three.render(scene, camera); seen(three.getContext(), "three.js"); };
  const ours = () => {
    film.front.clear();
    do renderer.trace(film, pearls.of.a, world, size, 1, 1); while (film.rows);
    shown.bind();
    renderer.program(SHOW).draw({ uExposure: 1, uBackground: [0, 0, 0] }, { uFilm: film.front.textures[0] });
    seen(gl, "the page");
  };
  const time = (frame) => { const begun = performance.now(); frame(); return performance.now() - begun; };
  const found = [[], []];
  for (let k = -2; k < times; k++) [ours, theirs].forEach((frame, way) => { const took = time(frame); if (k >= 0) found[way].push(took); });
  return found;
}"""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder with three.js that a server shows, and its address."""
    folder = tmp_path_factory.mktemp("site")
    (folder / "three").symlink_to(THREE)
    (folder / "index.html").write_text(PAGE)

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=folder))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield folder, f"http://127.0.0.1:{server.server_port}/"
    server.shutdown()


@pytest.fixture(scope="module")
def browser():
    assert chromium.reason() is None, chromium.reason()
    with chromium.browser() as made:
        yield made


@pytest.fixture(scope="module", params=TABLES)
def exported(request, site, browser, tmp_path_factory):
    """A table, and a page that has its module."""
    folder, url = site
    table = tmp_path_factory.mktemp(request.param) / "pearl.exr"
    run("bake-brdf", request.param, "--solver", "doubling", "--accuracy", 2, *TABLES[request.param], "-q", "-o", table)
    run("lut", "export", table, "--to", "three", "-q", "-o", folder / "pearl.js")
    page = browser.visit(url, offline=False)
    yield request.param, table, page
    page.context.close()


def sky(d):
    """Radiance of the surroundings, smooth enough for three's maps of half precision."""
    light = 0.35 + 0.25 * d[..., 2]
    for towards, sharp, strength in LAMPS:
        light = light + strength * np.exp(sharp * (d @ (np.array(towards) / np.linalg.norm(towards)) - 1.0))
    return light


def equirectangular(width=1024, height=512):
    """The sky as three reads such a map, in its world: u from atan2(z, x), v from asin(y); bottom row first."""
    u, v = (np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height
    phi, elevation = (u - 0.5) * 2 * np.pi, (v - 0.5) * np.pi
    elevation, phi = np.meshgrid(elevation, phi, indexing="ij")
    d = np.stack([np.cos(elevation) * np.cos(phi), np.sin(elevation), np.cos(elevation) * np.sin(phi)], axis=-1)
    rgba = np.ones((height, width, 4), np.float32)
    rgba[..., :3] = sky(d)[..., None]
    return chromium.pack(rgba)


def picture(page, light, look=None, samples=128):
    """What three.js renders, [pixel, rgba], bottom row first."""
    return chromium.unpack(page.evaluate(SCENE, [light, look, SIZE, samples, equirectangular()])).reshape(SIZE * SIZE, 4)


def hits(page):
    """What pixels see of the sphere: which do, points, normals, directions to the viewer."""
    points, normals = (picture(page, what) for what in ("position", "normal"))
    seen = np.flatnonzero((normals[:, :3] != 0).any(axis=1))
    points, normals = points[seen, :3], normals[seen, :3]
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    views = EYE - points
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    facing = (normals * views).sum(axis=1) > 0.02
    return seen[facing], points[facing], normals[facing], views[facing]


class Truth:
    """Light of the pearl at points of a surface by the plugin."""

    def __init__(self, table, look, points, normals, views):
        body = {"body_color": {"type": "rgb", "value": look["body_rgb"]}} if "body_rgb" in look else {}
        numbers = {name: value for name, value in look.items() if name != "body_rgb"}
        self.bsdf = mi.load_dict({"type": "pearl", "filename": str(table), **numbers, **body})
        helper = np.where(np.abs(normals[:, :1]) > 0.5, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
        x = np.cross(helper, normals)
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        self.frame = np.stack([x, np.cross(normals, x), normals], axis=1)
        self.points, self.wi = points, np.einsum("nij,nj->ni", self.frame, views)

    def interaction(self, times):
        si = mi.SurfaceInteraction3f()
        si.wi = mi.Vector3f(np.repeat(self.wi, times, axis=0).T)
        return si

    def eval(self, directions):
        """f·cos θ of light from world directions [point, direction, xyz]: [point, direction, rgb]."""
        wo = np.einsum("nij,nkj->nki", self.frame, directions)
        value = self.bsdf.eval(mi.BSDFContext(), self.interaction(wo.shape[1]), mi.Vector3f(wo.reshape(-1, 3).T))
        value = np.array(value).T.reshape(*wo.shape)
        return np.where(wo[..., 2:] > 0, value, 0.0)

    def point(self):
        to = POINT - self.points
        far2 = (to * to).sum(axis=1)
        return (self.eval((to / np.sqrt(far2)[:, None])[:, None]) * (INTENSITY / far2)[:, None, None])[:, 0]

    def area(self, nodes=40):
        at, weight = np.polynomial.legendre.leggauss(nodes)
        u, v = np.meshgrid((at + 1) / 2, (at + 1) / 2)
        weight = np.outer(weight, weight).ravel() / 4
        lamp = CORNER + u.ravel()[:, None] * ACROSS + v.ravel()[:, None] * ALONG
        to = lamp - self.points[:, None]
        far = np.linalg.norm(to, axis=-1)
        facing = np.abs(to @ np.cross(ACROSS, ALONG)) / far**3 * weight
        return (self.eval(to / far[..., None]) * facing[..., None]).sum(axis=1) * RADIANCE

    def around(self, light, lamps=(), count=1024):
        """Under light from everywhere: of the plugin's own samples and of the lamps' all that any could have found, by the balance
        heuristic; and how far two halves of them are apart."""
        random, pixels = np.random.default_rng(3), len(self.points)
        spread = lambda step: (np.arange(count) * step + random.random((pixels, 1))) % 1
        u, v, w = (spread(step) for step in (0.8191725133961645, 0.6710436067037893, 0.5497004779019703))
        context, many = mi.BSDFContext(), self.interaction(count)
        sample, _ = self.bsdf.sample(context, many, mi.Float(u.ravel()), mi.Point2f(np.stack([v.ravel(), w.ravel()])))
        wo = np.array(sample.wo).T.reshape(pixels, count, 3)
        ways = [np.einsum("nij,nki->nkj", self.frame, wo)]
        for towards, sharp, _ in lamps:
            axis = np.array(towards) / np.linalg.norm(towards)
            x = np.cross(axis, [0.3, 0.5, 0.8])
            x /= np.linalg.norm(x)
            u, v = spread(0.7548776662466927), spread(0.5698402909980532)
            cos = 1 + np.log(1 - u * (1 - np.exp(-2 * sharp))) / sharp
            sin, phi = np.sqrt(np.maximum(1 - cos * cos, 0)), 2 * np.pi * v
            ways.append(cos[..., None] * axis + (sin * np.cos(phi))[..., None] * x + (sin * np.sin(phi))[..., None] * np.cross(axis, x))
        halves = np.zeros((2, pixels, 3))
        for d in ways:
            local = np.einsum("nij,nkj->nki", self.frame, d)
            pdf = np.array(self.bsdf.pdf(context, many, mi.Vector3f(local.reshape(-1, 3).T))).reshape(pixels, count)
            for towards, sharp, _ in lamps:
                cos = d @ (np.array(towards) / np.linalg.norm(towards))
                pdf = pdf + sharp / (2 * np.pi * (1 - np.exp(-2 * sharp))) * np.exp(sharp * (cos - 1))
            found = self.eval(d) * (light(d) / np.maximum(pdf, 1e-20))[..., None]
            halves += np.stack([found[:, 0::2].mean(axis=1), found[:, 1::2].mean(axis=1)])
        return halves.mean(axis=0), relative(halves[0], halves[1]) / 2


def relative(found, truth):
    """Root mean square of a difference over that of the truth, per cent."""
    return 100 * np.sqrt(((found - truth) ** 2).mean() / (truth**2).mean())


@pytest.mark.parametrize("look", LOOKS)
def test_three_shows_what_the_plugin_does_to_half_a_per_cent(exported, look):
    name, table, page = exported
    seen, points, normals, views = hits(page)
    truth = Truth(table, LOOKS[look], points, normals, views)
    white = lambda d: np.ones(d.shape[:-1])
    expected = {"point": (truth.point(), 0.0), "area": (truth.area(), 0.0),
                "environment": truth.around(sky, LAMPS), "ambient": truth.around(white)}  # fmt: skip
    for light, (values, noise) in expected.items():
        for samples in [2048, 128] if light != "point" else [128]:
            found = picture(page, light, LOOKS[look], samples)[seen, :3]
            error, mean = relative(found, values), found.mean() / values.mean() - 1
            print(f"{name}, {look}, {light}, {samples} samples: RMSE {error:.3f} % (± {noise:.2f}), energy {100 * mean:+.3f} %")
            # The sums of the material's own number of samples are seen, but not by much.
            assert error < (6.0 if samples == 128 and light != "point" else 0.5), (light, samples)
    # That pixels are read back is slow.
    assert [message for message in page.messages if "ReadPixels" not in message] == []


def test_a_look_is_changed_and_a_wrong_one_refused(exported):
    _, _, page = exported
    said = page.evaluate("""async () => {
      const { pearlMaterial } = await import("/pearl.js");
      const material = await pearlMaterial({ depth: 0.25 });
      material.setLook({ brightness: 0.5 });
      const copy = material.clone();
      try { material.setLook({ colour: 1 }); } catch (error) { return [copy.look, error.message]; }
    }""")
    assert said[0]["depth"] == 0.25 and said[0]["brightness"] == 0.5
    assert said[1].startswith("look: colour is not known; expected one of depth, brightness")


@pytest.mark.parametrize("recipe", ["paper", "akoya", "golden"])
def test_a_frame_of_the_page_takes_at_most_three_of_threes_iridescent_material(recipe, site, browser):
    """The same sphere under the same lamp, in turn; a frame is what is shown, and its pixels are waited for. The last has lobes at
    six wavelengths."""
    folder, url = site
    run("bake-brdf", recipe, "--solver", "doubling", "--accuracy", 2, "-q", "-o", folder / "pearl.exr")
    run("lut", "export", folder / "pearl.exr", "--to", "arrays", "-q", "-o", folder / "pearl.npz")
    html = chromium.alone((folder / "pearl.npz").read_bytes())
    (folder / "page.html").write_text(html.replace('{"imports": {', '{"imports": {"three": "/three/build/three.module.js", ', 1))
    page = browser.visit(url + "page.html", offline=False, viewport={"width": 400, "height": 300})
    page.evaluate("nacre.ready.then(() => { nacre.page.renderer.paused = true; })")
    ours, theirs = (np.median(times) for times in page.evaluate(COST, [512, 15]))
    print(f"{recipe}: {ours:.1f} ms, MeshPhysicalMaterial {theirs:.1f} ms, {ours / theirs:.2f} times")
    page.context.close()
    assert ours <= 3 * theirs
