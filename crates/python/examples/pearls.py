"""A sphere in a small studio, for the example `inverse` and for `tools/compare/speed.py`."""

import mitsuba as mi
import numpy as np

#: Windows: azimuth from behind the camera, elevation, radiance.
WINDOWS = ((-1.1, 0.75, 7.0), (1.6, 0.5, 2.5))


def studio(width=512):
    """An environment: a soft gradient, a darker floor, and windows."""
    v, u = np.mgrid[0.5 : width // 2, 0.5:width]
    elevation = np.pi / 2 - v / (width // 2) * np.pi
    azimuth = u / width * 2 * np.pi - np.pi

    def window(at, height, wide, tall, soft=0.06):
        edge = lambda x, half: 1 / (1 + np.exp((np.abs(x) - half) / soft))
        around = np.angle(np.exp(1j * (azimuth - at)))
        return edge(around, wide) * edge(elevation - height, tall)

    sky = 0.25 + 0.35 * np.clip(np.sin(elevation), -0.5, 1)
    light = sky + sum(radiance * window(at, height, 0.45, 0.35) for at, height, radiance in WINDOWS)
    image = 0.55 * light[..., None] * np.array([1.0, 0.99, 0.97])
    return mi.Bitmap(image.astype(np.float32))


def environment():
    """The studio as an emitter, z up."""
    turn = mi.ScalarTransform4f().rotate([1, 0, 0], 90)
    return {"type": "envmap", "bitmap": studio(), "to_world": turn}


def scene(shape, size):
    """A shape (a dictionary) in front of the camera."""
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4, "hide_emitters": True},
        "sensor": {
            "type": "perspective",
            "fov": 24,
            "to_world": mi.ScalarTransform4f().look_at([0, -5.4, 1.6], [0, 0, 0], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "gaussian"}},
        },
        "light": environment(),
        "shape": shape,
    }


def sphere(bsdf):
    """A sphere of radius 1."""
    return {"type": "sphere", "bsdf": bsdf}
