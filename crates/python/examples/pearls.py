"""Scenes of the documentation: a sphere and a free-form surface in a small studio."""

import mitsuba as mi
import numpy as np

SIZE = 256


#: Windows: azimuth from behind the camera, elevation, radiance.
WINDOWS = ((-1.1, 0.75, 7.0), (1.6, 0.5, 2.5))


def studio(places=WINDOWS, width=512):
    """An environment: a soft gradient, a darker floor, and windows."""
    v, u = np.mgrid[0.5 : width // 2, 0.5:width]
    elevation = np.pi / 2 - v / (width // 2) * np.pi
    azimuth = u / width * 2 * np.pi - np.pi

    def window(at, height, wide, tall, soft=0.06):
        edge = lambda x, half: 1 / (1 + np.exp((np.abs(x) - half) / soft))  # noqa: E731
        around = np.angle(np.exp(1j * (azimuth - at)))
        return edge(around, wide) * edge(elevation - height, tall)

    sky = 0.25 + 0.35 * np.clip(np.sin(elevation), -0.5, 1)
    light = sky + sum(radiance * window(at, height, 0.45, 0.35) for at, height, radiance in places)
    image = 0.55 * light[..., None] * np.array([1.0, 0.99, 0.97])
    return mi.Bitmap(image.astype(np.float32))


def environment(places=WINDOWS):
    """The studio as an emitter, z up."""
    turn = mi.ScalarTransform4f().rotate([1, 0, 0], 90)
    return {"type": "envmap", "bitmap": studio(places), "to_world": turn}


def scene(shape, size=SIZE, light=None):
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
        "light": light or environment(),
        "shape": shape,
    }


def sphere(bsdf):
    """A sphere of radius 1."""
    return {"type": "sphere", "bsdf": bsdf}


def sheet(bsdf, n=200):
    """A sheet with folds, seen obliquely: normals from all over the visible hemisphere."""
    x, y = np.meshgrid(np.linspace(-0.95, 0.95, n), np.linspace(-0.85, 0.85, n), indexing="ij")
    height = 0.16 * np.sin(4.6 * x + 0.9 * np.sin(2.4 * y)) + 0.1 * np.cos(4.2 * y - 1.6 * x)
    points = np.stack([x, y, height - 0.1 + 0.3 * y], axis=-1).reshape(-1, 3)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([
        np.stack([corner, corner + n, corner + 1], axis=1), np.stack([corner + 1, corner + n, corner + n + 1], axis=1)
    ])  # fmt: skip
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    mesh = mi.Mesh("sheet", len(points), len(faces), has_vertex_normals=True, has_vertex_texcoords=True, props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = points.ravel().astype(np.float32)
    parameters["faces"] = faces.ravel().astype(np.uint32)
    uv = np.stack([x, y], axis=-1).reshape(-1, 2) / 2 + 0.5
    parameters["vertex_texcoords"] = uv.ravel().astype(np.float32)
    parameters.update()
    mesh.recompute_vertex_normals()
    return mesh


def render(shape, spp=256, seed=1, **options):
    """Linear sRGB image on black."""
    return np.array(mi.render(mi.load_dict(scene(shape, **options)), spp=spp, seed=seed))[:, :, :3]
