"""Way (e), the page of `pearl studio`, against the plugin: pictures of their own samples, so many that noise is below what is asked."""

import pathlib

import browser
import numpy as np
import scenes
import ways

#: Relative RMSE and mean: single precision of a graphics processor, and the noise that is left.
LIMIT = {"relative RMSE": 5e-3, "mean ratio − 1": 1e-3}
#: Pixels along an edge.
SIZE = 12
#: Samples a pixel of the plugin's picture, and how many at once: as many pictures tell its noise.
PLUGIN_SAMPLES, AT_ONCE = {"environment": 393216, "area": 262144, "point": 65536}, 16384
#: Samples a pixel of each of the page's two pictures.
PAGE_SAMPLES = {"environment": 8192, "area": 32768, "point": 8192}


class Page:
    """(e) the page, in chromium."""

    key, title = "e", "page of pearl studio"

    def __init__(self, table, parameters, tools):
        if browser.reason():
            raise ways.Refused(browser.reason())
        arrays = tools.folder_path / f"{pathlib.Path(table).stem}.npz"
        tools.run("lut", "export", table, "--to", "arrays", "-q", "-o", arrays)
        self.page = tools.browser.open(arrays.read_bytes())
        self.page.evaluate("nacre.ready.then(() => { nacre.page.renderer.paused = true; })")
        self.paint(parameters)

    def paint(self, parameters):
        look = {name: parameters[name] for name in ("depth", "brightness", "coherence")}
        self.page.evaluate("(look) => nacre.set(look)", {**look, "body_rgb": list(parameters["body"])})

    def __call__(self, scene, size, samples, seed):
        return browser.render(self.page, scene.name, size, samples, seed)

    def close(self):
        self.page.context.close()


def figures(page, plugin, scene, seed=1):
    """Relative RMSE over what is lit, the part of it that is noise, the ratio of the means less 1, and its standard error."""
    pieces = []
    for piece in range(PLUGIN_SAMPLES[scene.light] // AT_ONCE):
        # Directions that the plugin samples gain nothing by even numbers, as it takes them apart to choose a lobe.
        even = scene.light != "environment"
        samples = scenes.samples(scene, plugin.sampler, SIZE, AT_ONCE, seed=1000 * seed + piece, even=even)
        values = plugin(samples, None) * np.array(samples.light).T.astype(float)
        pieces.append(scenes.image(values, samples.pixel, SIZE, AT_ONCE)[0])
    image, variance = np.mean(pieces, axis=0), np.var(pieces, axis=0, ddof=1) / len(pieces)
    pair = [page(scene, SIZE, PAGE_SAMPLES[scene.light], seed + k) for k in (0, 1)]
    shown = (pair[0] + pair[1]) / 2
    # Of the mean of two, from their difference.
    own = (pair[0] - pair[1]) ** 2 / 4
    lit = image.sum(axis=1) > 0
    scale = image[lit].mean()
    return {
        "relative RMSE": float(np.sqrt(((shown - image)[lit] ** 2).mean()) / scale),
        "noise": float(np.sqrt((variance + own)[lit].mean()) / scale),
        "the page's part": float(np.sqrt(own[lit].mean()) / scale),
        "mean ratio − 1": float(shown.mean() / image.mean() - 1),
        # Channels of a sample are one draw: errors of their mean are not independent.
        "standard error": float(np.sqrt((variance + own).mean(axis=1).sum()) / image.mean(axis=1).sum()),
    }
