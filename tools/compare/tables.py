"""The tables that are compared, and the project's tools that bake and export them."""

import contextlib
import json
import os
import pathlib
import subprocess

ROOT = pathlib.Path(__file__).resolve().parents[2]
#: The tables that are compared: what is baked, and the look of the recipe. The second has no interference colours, for
#: the walk; its body is dark, so that the lobes show, and grey, as the tools see such a table in grey at single wavelengths.
CASES = {
    "pearl": ([], {"depth": 0.5, "coherence": 0.5, "body_rgb": [0.8, 0.78, 0.75]}),
    "lobes": (["--azimuth", "space"], {"depth": 0.0, "coherence": 0.0, "body_rgb": [0.1, 0.1, 0.1]}),
}


class Bad(Exception):
    """Wrong usage."""


class Tools:
    """The project's tools."""

    def __init__(self, folder):
        self.folder = folder
        self.folder_path = pathlib.Path(folder)
        self.stack = contextlib.ExitStack()
        self._browser = None
        self.bin = pathlib.Path(os.environ.get("NACRE_BIN", ROOT / "target" / "release")).resolve()

    def __enter__(self):
        return self

    def __exit__(self, *why):
        self.stack.close()

    @property
    def browser(self):
        """A chromium, started when the first page is asked for."""
        if self._browser is None:
            import browser

            self._browser = self.stack.enter_context(browser.browser())
        return self._browser

    def path(self, name):
        path = self.bin / name
        if not path.is_file():
            raise Bad(f"{path} is not there: `cargo build --release` makes it, or set NACRE_BIN")
        return str(path)

    def run(self, name, *args):
        import ways

        done = subprocess.run([self.path(name), *map(str, args)], capture_output=True, text=True)
        if done.returncode != 0:
            raise ways.Refused(f"{name} {args[0]}: {done.stderr.strip()}")
        return done.stdout

    def meta(self, table):
        return json.loads(self.run("lut", "info", table, "--json"))

    def bake(self, name, accuracy):
        extra, look = CASES[name]
        recipe = pathlib.Path(self.folder) / f"{name}.json"
        full = {"schema": "pearl-recipe/1", "name": name, "look": {"brightness": 1.0, **look}}
        recipe.write_text(json.dumps(full))
        table = recipe.with_suffix(".exr")
        self.run("bake-brdf", recipe, "--solver", "doubling", "--accuracy", accuracy, "-q", "-o", table, *extra)
        return table
