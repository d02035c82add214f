"""The page of `pearl studio` in a headless chromium, as one file with arrays in it, without a network.

As a program: exit status 0 where that can run, else 1 and the reason.
"""

import base64
import contextlib
import functools
import importlib.util
import json
import os
import pathlib
import shutil
import sys
import tempfile

CRATES = pathlib.Path(__file__).resolve().parents[2] / "crates"
PAGE = CRATES / "studio" / "page"
#: Where its modules are.
FOLDERS = [PAGE, CRATES / "pearl-bsdf" / "web"]
#: WebGL by the processor alone, where there is no graphics processor.
FLAGS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
#: Scripts hand floats over as text of their bytes: lists of numbers take longer than what is measured.
PACK = """window.pack = (floats) => {
  const bytes = new Uint8Array(floats.buffer, floats.byteOffset, floats.byteLength);
  let text = "";
  for (let i = 0; i < bytes.length; i += 32768) text += String.fromCharCode(...bytes.subarray(i, i + 32768));
  return btoa(text);
};
window.unpack = (text) => new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);"""


def program():
    """Where chromium is."""
    return os.environ.get("NACRE_CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")


@functools.cache
def reason():
    """Why the page cannot run here; None where it can."""
    if importlib.util.find_spec("playwright") is None:
        return "playwright is not installed"
    if program() is None:
        return "there is no chromium (NACRE_CHROMIUM names one)"
    return None


def alone(arrays):
    """The page as one file with the bytes of prepared arrays (.npz) in it."""
    modules = {
        f"nacre/{path.relative_to(folder).as_posix()}": "data:text/javascript;base64," + base64.b64encode(path.read_bytes()).decode()
        for folder in FOLDERS
        for path in sorted(folder.rglob("*.js"))
    }
    data = f'<script id="nacre-data" type="application/octet-stream;base64">{base64.b64encode(arrays).decode()}</script>'
    return (
        (PAGE / "index.html").read_text(encoding="utf-8")
        .replace("<!-- importmap -->", f'<script type="importmap">{json.dumps({"imports": modules})}</script>')
        .replace("<!-- style -->", f"<style>{(PAGE / 'style.css').read_text(encoding='utf-8')}</style>")
        .replace("</body>", data + "</body>")
    )  # fmt: skip


def pack(values):
    """Numbers as the scripts' `unpack` takes them."""
    import numpy as np

    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode()


def unpack(text):
    """Numbers of the scripts' `pack`."""
    import numpy as np

    return np.frombuffer(base64.b64decode(text), "<f4").astype(float)


class Browser:
    """A chromium, and pages in it."""

    def __init__(self, playwright):
        self.chromium = playwright.chromium.launch(executable_path=program(), headless=True, args=FLAGS)
        self.folder = tempfile.TemporaryDirectory()
        self.count = 0

    def open(self, arrays, script="", hash="", **context):
        """A page with arrays, from a file, offline; what its console says is kept in `messages`."""
        self.count += 1
        file = pathlib.Path(self.folder.name) / f"page-{self.count}.html"
        file.write_text(alone(arrays), encoding="utf-8")
        return self.visit(file.as_uri() + hash, script, **context)

    def visit(self, url, script="", offline=True, **context):
        opened = self.chromium.new_context(offline=offline, **context)
        opened.add_init_script(PACK + script)
        page = opened.new_page()
        page.set_default_timeout(300_000)
        page.messages = []
        page.on("console", lambda message: page.messages.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: page.messages.append(f"error: {error}"))
        page.goto(url)
        return page

    def close(self):
        self.chromium.close()
        self.folder.cleanup()


@contextlib.contextmanager
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        made = Browser(playwright)
        try:
            yield made
        finally:
            made.close()


def render(page, scene, size, samples, seed=1):
    """A scene of the harness as the page renders it, [pixel, rgb], top row first."""
    text = page.evaluate(
        "async (asked) => pack((await nacre.render(asked)).pixels)",
        {"scene": scene, "width": size, "height": size, "samples": samples, "seed": seed},
    )
    return unpack(text).reshape(size * size, 4)[:, :3]


if __name__ == "__main__":
    sys.exit(reason())
