"""Scenes that Blender and Mitsuba get alike: meshes with normals, an area light, a sky, one camera (those of tools/compare)."""

import numpy as np

ORIGIN = np.array([0.0, -6.0, 1.5])
FOV = 2 * np.arctan(0.185)
CORNER, EDGE_U, EDGE_V = np.array([-2.6, -3.0, 2.2]), np.array([1.6, 0.0, 0.0]), np.array([0.0, 1.1, 1.1])
AREA_RADIANCE = 9.0


def sky(d):
    """Radiance from directions [..., 3]: a soft gradient and two lamps."""
    lamp = lambda at, sharp: np.exp(sharp * (d @ (np.array(at) / np.linalg.norm(at)) - 1))
    return 0.35 + 0.25 * d[..., 2] + 5 * lamp((-1, -1, 1), 30.0) + 2 * lamp((1.5, -0.5, 0.6), 60.0)


def _grid(rows, columns):
    """Triangles of a grid of vertices."""
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns - 1), indexing="ij")
    a = (i * columns + j).ravel()
    return np.concatenate([np.stack([a, a + 1, a + columns + 1], 1), np.stack([a, a + columns + 1, a + columns], 1)])


def sphere(rows=192, columns=385):
    theta, phi = np.meshgrid(np.linspace(0, np.pi, rows), np.linspace(0, 2 * np.pi, columns), indexing="ij")
    points = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).reshape(-1, 3)
    faces = _grid(rows, columns)[:, ::-1]
    corners = points[faces]
    # Those at the poles have no area.
    kept = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) > 1e-9
    return points, points, faces[kept]


def sheet(count=160):
    """A folded sheet."""
    x, y = np.meshgrid(np.linspace(-1, 1, count), np.linspace(-1, 1, count), indexing="xy")
    z = 0.5 * y + 0.2 * np.sin(2.6 * x + 0.8 * np.sin(2.1 * y)) + 0.16 * np.sin(2.1 * y)
    slope_x = 0.52 * np.cos(2.6 * x + 0.8 * np.sin(2.1 * y))
    slope_y = 0.5 + 0.2 * 0.8 * 2.1 * np.cos(2.1 * y) * np.cos(2.6 * x + 0.8 * np.sin(2.1 * y)) + 0.336 * np.cos(2.1 * y)
    normals = np.stack([-slope_x, -slope_y, np.ones_like(x)], -1).reshape(-1, 3)
    return np.stack([x, y, z], -1).reshape(-1, 3), normals / np.linalg.norm(normals, axis=1, keepdims=True), _grid(count, count)


SHAPES = {"sphere": sphere, "sheet": sheet}


def angles(rows, columns):
    return (np.arange(rows) + 0.5) / rows, (np.arange(columns) + 0.5) / columns


def sky_of_blender(rows=128):
    """Top row first: u = 0.5 − atan2(y, x)/2π, v = 0.5 + elevation/π from the bottom."""
    v, u = np.meshgrid(*angles(rows, 2 * rows), indexing="ij")
    azimuth, elevation = 2 * np.pi * (0.5 - u), np.pi * (0.5 - v)
    cos = np.cos(elevation)
    values = sky(np.stack([cos * np.cos(azimuth), cos * np.sin(azimuth), np.sin(elevation)], -1))
    return np.repeat(values[..., None], 3, -1).astype(np.float32)


def sky_of_mitsuba(rows=128):
    """Top row first: u = atan2(x, −z)/2π, v = acos(y)/π; turned so that its y is our z."""
    v, u = np.meshgrid(*angles(rows, 2 * rows), indexing="ij")
    azimuth, polar = 2 * np.pi * u, np.pi * v
    # Mitsuba's own frame; to_world = rotation by 90° about x: (x, y, z) becomes (x, −z, y).
    x, y, z = np.sin(azimuth) * np.sin(polar), np.cos(polar), -np.cos(azimuth) * np.sin(polar)
    return np.repeat(sky(np.stack([x, -z, y], -1))[..., None], 3, -1).astype(np.float32)


def for_blender(shape, light, path):
    """Writes a scene for tests/renderers/in_blender.py."""
    vertices, normals, faces = SHAPES[shape]()
    lights = {
        "environment": {"sky": sky_of_blender()},
        "white": {"sky": np.ones((8, 16, 3), np.float32)},
        "area": {"area": np.array([CORNER, CORNER + EDGE_U, CORNER + EDGE_U + EDGE_V, CORNER + EDGE_V]), "area_radiance": AREA_RADIANCE},
    }
    np.savez(path, vertices=vertices, normals=normals, faces=faces, origin=ORIGIN, fov=FOV, **lights[light])


def for_mitsuba(shape, light, bsdf, size, samples):
    """The scene for mi.load_dict."""
    import mitsuba as mi

    vertices, normals, faces = SHAPES[shape]()
    mesh = mi.Mesh(shape, len(vertices), len(faces), has_vertex_normals=True, props=properties(mi, bsdf))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
    parameters["vertex_normals"] = normals.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2, "hide_emitters": True},
        "sensor": {
            "type": "perspective", "fov": float(np.degrees(FOV)),
            "to_world": mi.ScalarTransform4f().look_at(ORIGIN.tolist(), [0, 0, 0], [0, 0, 1]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgba", "rfilter": {"type": "box"}},
            "sampler": {"type": "independent", "sample_count": samples},
        },
        "shape": mesh,
    }  # fmt: skip
    if light == "area":
        # The square from −1 to 1 becomes the light, which faces the shape.
        middle, u, v = CORNER + 0.5 * (EDGE_U + EDGE_V), 0.5 * EDGE_U, 0.5 * EDGE_V
        normal = np.cross(u, v)
        if normal @ middle > 0:
            u, normal = -u, -normal
        frame = np.eye(4)
        frame[:3, 0], frame[:3, 1], frame[:3, 2], frame[:3, 3] = u, v, normal / np.linalg.norm(normal), middle
        scene["light"] = {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f(frame),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": AREA_RADIANCE}},
        }
    else:
        turned = mi.ScalarTransform4f().rotate([1, 0, 0], 90)
        scene["light"] = {"type": "envmap", "bitmap": mi.Bitmap(sky_of_mitsuba()), "to_world": turned}
    return scene


def properties(mi, bsdf):
    held = mi.Properties()
    held["bsdf"] = bsdf
    return held
