#!/usr/bin/env python3
"""Takes docs/images/simulator.jpg: the simulator with a pearl that has settled. tools/simulator_picture.py [-o FILE] [--samples N]

Wants chromium; without a graphics processor it takes minutes. Exit codes: 0 done, 1 runtime failure, 2 wrong usage.
"""

import argparse
import io
import pathlib
import subprocess
import sys

from PIL import Image

ROOT = pathlib.Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tools" / "compare"))

import browser as chromium  # noqa: E402
from tables import Tools  # noqa: E402

#: The fine table is there, and its picture has samples enough.
SETTLED = """(samples) => document.body.innerText.includes("Baked in")
  && nacre.page.renderer.pictures.every(({ film, next }) => !next && film.samples >= samples)"""
HOUR = 3_600_000


def main():
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--output", type=pathlib.Path, default=ROOT / "docs" / "images" / "simulator.jpg")
    parser.add_argument("--recipe", default="akoya-rg")
    parser.add_argument("--samples", type=int, default=128, help="samples a pixel of the pearl")
    options = parser.parse_args()
    server = subprocess.Popen([Tools("").path("pearl"), "studio", options.recipe, "--no-browser"], stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        url = server.stdout.readline().strip()
        with chromium.browser() as opened:
            page = opened.visit(url, offline=False, viewport={"width": 1280, "height": 800})
            page.wait_for_function(SETTLED, arg=options.samples, timeout=HOUR, polling=1000)
            shot = Image.open(io.BytesIO(page.screenshot()))
    finally:
        server.terminate()
        server.wait()
    shot.convert("RGB").save(options.output, quality=88, subsampling=0, optimize=True, progressive=True)


if __name__ == "__main__":
    main()
