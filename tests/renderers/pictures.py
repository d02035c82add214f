"""Pictures of docs/HOSTS.md: a pearl under the same sky in the programs that `lut export` writes for.

    target/renderers-venv/bin/python tests/renderers/pictures.py pearl.exr -o docs/images

The table and what it is exported to are those of the recipe's look; the programs are those that `cargo xtask renderers` installs.
"""

import argparse
import functools
import http.server
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import threading

import numpy as np
from PIL import Image

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE), str(ROOT / "tests"), str(ROOT / "tools" / "compare")]

import browser as chromium  # noqa: E402
import test_three  # noqa: E402
from built import run  # noqa: E402

SIZE = 320
#: The pearl's brightest light is white.
WHITE = 99.5
SCENE = """
async ([name, size, sky]) => {
  const THREE = await import("three");
  const renderer = new THREE.WebGLRenderer({ canvas: document.createElement("canvas") });
  const scene = new THREE.Scene();
  if (name === "three") {
    const { pearlMaterial } = await import("/pearl.js");
    const material = await pearlMaterial();
    material.samples = 768;
    scene.add(new THREE.Mesh(new THREE.SphereGeometry(1, 256, 128), material));
  } else {
    const { GLTFLoader } = await import("three/addons/loaders/GLTFLoader.js");
    scene.add((await new GLTFLoader().loadAsync("/pearl.glb")).scene);
  }
  const camera = new THREE.PerspectiveCamera((2 * Math.atan(0.185) * 180) / Math.PI, 1, 0.1, 100);
  camera.up.set(0, 0, 1);
  camera.position.set(0, -6, 1.5);
  camera.lookAt(0, 0, 0);
  const map = new THREE.DataTexture(unpack(sky), 1024, 512, THREE.RGBAFormat, THREE.FloatType, THREE.EquirectangularReflectionMapping);
  map.minFilter = map.magFilter = THREE.LinearFilter;
  map.needsUpdate = true;
  scene.environment = map;
  const target = new THREE.WebGLRenderTarget(size, size, { type: THREE.FloatType });
  const pixels = new Float32Array(4 * size * size);
  // In tiles: a processor that draws by itself gives up on long draws.
  for (let y = 0; y < size; y += 4) {
    target.scissorTest = true;
    target.scissor.set(0, y, size, 4);
    renderer.setRenderTarget(target);
    renderer.render(scene, camera);
    await new Promise((resolve) => setTimeout(resolve, 0));
  }
  renderer.readRenderTargetPixels(target, 0, 0, size, size, pixels);
  return pack(pixels);
}"""
#: The same sky as tests/renderers/test_three.py has.
SKY = """{ sky and lamps }
bright = .35 + .25*Dz
  + 5*exp(30*((-Dx-Dy+Dz)/sqrt(3) - 1))
  + 2*exp(60*((1.5*Dx-.5*Dy+.6*Dz)/sqrt(2.86) - 1));
"""
RADIANCE = """void brightfunc sky
2 bright sky.cal
0
0

sky glow light
0
0
4 1 1 1 0

light source around
0
0
4 0 0 1 360

void BSDF pearl
6 0 pearl.xml if(Nz*Nz-.5,1,0) 0 if(Nz*Nz-.5,0,1) .
0
0

pearl sphere ball
0
0
4 0 0 0 1
"""


def in_browser(folder, name):
    """A picture by three.js, linear, top row first."""

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=folder))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    with chromium.browser() as browser:
        page = browser.visit(f"http://127.0.0.1:{server.server_port}/", offline=False)
        page.set_default_timeout(3_600_000)
        pixels = chromium.unpack(page.evaluate(SCENE, [name, SIZE, test_three.equirectangular()]))
    server.shutdown()
    return pixels.reshape(SIZE, SIZE, 4)[::-1, :, :3]


def by_radiance(folder):
    """A picture by Radiance's rpict."""
    import pyradiance

    home = pathlib.Path(pyradiance.__file__).parent
    environment = os.environ | {"RAYPATH": f".:{home / 'lib'}", "PATH": f"{home / 'bin'}:{os.environ['PATH']}"}
    (folder / "sky.cal").write_text(SKY)
    (folder / "scene.rad").write_text(RADIANCE)
    tool = lambda name, *args: (
        subprocess.run([home / "bin" / name, *map(str, args)], cwd=folder, env=environment, capture_output=True, check=True).stdout
    )
    (folder / "scene.oct").write_bytes(tool("oconv", "scene.rad"))
    degrees = 2 * np.degrees(np.arctan(0.185))
    view = ["-vp", 0, -6, 1.5, "-vd", 0, 6, -1.5, "-vu", 0, 0, 1, "-vh", degrees, "-vv", degrees, "-x", SIZE, "-y", SIZE]
    (folder / "pearl.hdr").write_bytes(tool("rpict", *view, "-ps", 1, "-ab", 0, "-ss", 400, "-st", 0, "scene.oct"))
    return np.array(tool("pvalue", "-h", "-H", "-d", "pearl.hdr").split(), float).reshape(SIZE, SIZE, 3)


def save(light, path):
    """As sRGB, over the dark: whatever is not the pearl is black."""
    y, x = np.mgrid[0:SIZE, 0:SIZE]
    at = (np.stack([x, y]) + 0.5) / SIZE * 2 - 1
    d = np.stack([0.185 * at[0], np.ones_like(at[0]), -0.185 * at[1]], axis=-1)
    # Of the camera's ray and the unit sphere.
    length2, along, far2 = (d * d).sum(-1), np.hypot(6.0, 1.5), 6.0**2 + 1.5**2
    ball = along**2 / length2 - far2 + 1 > 0
    light = np.where(ball[..., None], light, 0.0)
    light = np.clip(light / np.percentile(light[ball], WHITE), 0, 1)
    srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    Image.fromarray((255 * srgb + 0.5).astype(np.uint8)).save(path, optimize=True)
    print(path)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("table", type=pathlib.Path)
    parser.add_argument("-o", "--output", type=pathlib.Path, default=ROOT / "docs" / "images")
    parser.add_argument("--only", choices=["three", "gltf", "radiance"])
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        shutil.copytree(test_three.THREE, folder / "three", ignore=shutil.ignore_patterns("src"))
        (folder / "index.html").write_text(test_three.PAGE)
        for host, file in [("three", "pearl.js"), ("gltf", "pearl.glb"), ("radiance", "pearl.xml")]:
            if asked.only in (None, host):
                run("lut", "export", asked.table, "--to", host, "-q", "-o", folder / file)
                light = by_radiance(folder) if host == "radiance" else in_browser(folder, host)
                save(light, asked.output / f"host-{host}.png")


if __name__ == "__main__":
    main()
