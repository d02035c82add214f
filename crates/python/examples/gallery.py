#!/usr/bin/env python3
"""Renders the pictures of docs/GALLERY.md with the Mitsuba plugin.

    gallery.py -o docs/images                every picture, a minute or two each
    gallery.py -o docs/images strand golden  some of them
    gallery.py -o proofs --draft             all of them, small and noisy

Tables are baked as the scenes call for them and kept in the user's cache folder.
"""

import argparse
import ctypes
import pathlib

import mitsuba as mi
import numpy as np
from PIL import Image

import nacre.mitsuba  # noqa: F401

ROOT = pathlib.Path(__file__).resolve().parents[3]
RECIPES = ROOT / "data" / "recipes"


def recipe(name):
    """The file of a recipe of this checkout."""
    return str(RECIPES / f"{name}.json")


def rgb(*value):
    return {"type": "rgb", "value": list(value) * (3 if len(value) == 1 else 1)}


def pearl(name, bump=None, **parameters):
    """The BSDF of a recipe; `bump` is a texture around it."""
    made = {"type": "pearl", "recipe": recipe(name)}
    for key, value in parameters.items():
        made[key] = rgb(*value) if isinstance(value, (list, tuple)) else value
    return made if bump is None else {"type": "bumpmap", "arbitrary": bump, "scale": 1.0, "nested": made}


def matte(*value):
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": rgb(*value)}}


def texture(values, **more):
    """A picture of numbers, rows first, as a raw texture."""
    bitmap = mi.Bitmap(np.ascontiguousarray(values[..., None].astype(np.float32)))
    return {"type": "bitmap", "bitmap": bitmap, "raw": True, **more}


def noise(rows, columns, scales, seed):
    """Smooth noise of unit spread: white noise of several scales, each with its weight; it repeats at its edges."""
    random = np.random.default_rng(seed)
    total = np.zeros((rows, columns))
    down, across = np.fft.fftfreq(rows)[:, None], np.fft.fftfreq(columns)[None, :]
    for scale, weight in scales:
        spectrum = np.fft.fft2(random.normal(size=total.shape)) * np.exp(-2 * (np.pi * scale) ** 2 * (down**2 + across**2))
        field = np.fft.ifft2(spectrum).real
        total += weight * field / field.std()
    return total / total.std()


def place(x=0.0, y=0.0, z=0.0):
    return mi.ScalarTransform4f().translate([x, y, z])


#: Soft boxes: azimuth from behind the camera (positive to the right) and elevation, half width and half height, all in degrees;
#: radiance. A large one on the left, a strip on the right, a dim one high above.
BOXES = ((-62, 42, 26, 18, 5.0), (68, 30, 6, 30, 5.0), (150, 68, 40, 14, 1.5))


def lights(boxes=BOXES, sky=0.09, height=512):
    """A studio: soft boxes in a dim room. One environment, so that every sample knows all of it."""
    elevation = np.radians(90 - 180 * (np.arange(height) + 0.5) / height)[:, None]
    azimuth = np.radians(360 * (np.arange(2 * height) + 0.5) / (2 * height) - 180)[None, :]

    def inside(x, half):
        return 1 / (1 + np.exp(np.clip((np.abs(x) - half) / np.radians(1.2), -60, 60)))

    light = sky * (0.75 + 0.25 * np.sin(elevation)) + 0 * azimuth
    for at, up, wide, tall, radiance in boxes:
        # Angles in the box's own frame: boxes high above are not drawn narrow.
        x = np.cos(elevation) * np.sin(azimuth - np.radians(at))
        depth = np.cos(elevation) * np.cos(azimuth - np.radians(at))
        y = np.sin(elevation) * np.cos(np.radians(up)) - depth * np.sin(np.radians(up))
        z = np.sin(elevation) * np.sin(np.radians(up)) + depth * np.cos(np.radians(up))
        across, along = np.arctan2(x, z), np.arctan2(y, np.hypot(x, z))
        # Brighter towards the middle, as a lamp behind a cloth is.
        shape = 0.7 + 0.3 * np.exp(-((across / np.radians(wide)) ** 2) - (along / np.radians(tall)) ** 2)
        light = light + radiance * shape * inside(across, np.radians(wide)) * inside(along, np.radians(tall))
    image = light[..., None] * np.array([1.0, 0.99, 0.97])
    turn = mi.ScalarTransform4f().rotate([1, 0, 0], 90)
    return {"light": {"type": "envmap", "bitmap": mi.Bitmap(image.astype(np.float32)), "to_world": turn}}


def sweep(bsdf, depth=9.0, rise=8.0, width=60.0, radius=4.0):
    """A photographer's backdrop: a floor that rises behind the subject without an edge."""
    angles = np.linspace(0, np.pi / 2, 24)
    y = np.concatenate([[-30.0], depth + radius * np.sin(angles), [depth + radius]])
    z = np.concatenate([[0.0], radius * (1 - np.cos(angles)), [radius + rise]])
    x = np.linspace(-width / 2, width / 2, 2)
    points = np.stack([np.broadcast_to(x[:, None], (2, len(y))), np.broadcast_to(y, (2, len(y))), np.broadcast_to(z, (2, len(z)))], -1)
    return grid(points, bsdf)


def grid(points, bsdf):
    """A mesh of a grid of points [u, v, (x, y, z)], with smooth normals and u, v as texture coordinates."""
    rows, columns = points.shape[:2]
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    faces = np.concatenate([
        np.stack([corner, corner + columns, corner + 1], axis=1),
        np.stack([corner + 1, corner + columns, corner + columns + 1], axis=1),
    ])  # fmt: skip
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    mesh = mi.Mesh("grid", rows * columns, len(faces), has_vertex_normals=True, has_vertex_texcoords=True, props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = points.reshape(-1, 3).ravel().astype(np.float32)
    parameters["faces"] = faces.ravel().astype(np.uint32)
    uv = np.stack(np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij"), -1)
    parameters["vertex_texcoords"] = uv.ravel().astype(np.float32)
    parameters.update()
    mesh.recompute_vertex_normals()
    return mesh


def ball(bsdf, x, y, radius=1.0, z=None):
    """A pearl that lies on the floor."""
    to_world = place(x, y, radius if z is None else z).scale(radius)
    return {"type": "sphere", "to_world": to_world, "bsdf": bsdf}


def camera(origin, target, fov, size, draft, focus):
    if draft:
        size = (size[0] * 5 // 16, size[1] * 5 // 16)
    lens = {"type": "perspective"} if focus is None else {"type": "thinlens", "focus_distance": focus, "aperture_radius": 0.12}
    return {
        **lens,
        "fov": fov,
        "to_world": mi.ScalarTransform4f().look_at(origin, target, [0, 0, 1]),
        "film": {"type": "hdrfilm", "width": size[0], "height": size[1], "rfilter": {"type": "box"}},
        "sampler": {"type": "multijitter", "sample_count": PASS},
    }


def denoised(linear, library):
    """A picture through Intel Open Image Denoise, a library of C."""
    oidn = ctypes.CDLL(str(library))
    for name in ("oidnNewDevice", "oidnNewFilter"):
        getattr(oidn, name).restype = ctypes.c_void_p
    image = np.ascontiguousarray(linear, np.float32)
    result = np.zeros_like(image)
    device = ctypes.c_void_p(oidn.oidnNewDevice(1))  # the processor
    oidn.oidnCommitDevice(device)
    filter_ = ctypes.c_void_p(oidn.oidnNewFilter(device, b"RT"))
    size = [ctypes.c_size_t(n) for n in (image.shape[1], image.shape[0], 0, 0, 0)]
    for name, data in ((b"color", image), (b"output", result)):
        oidn.oidnSetSharedFilterImage(filter_, name, data.ctypes.data_as(ctypes.c_void_p), 3, *size)
    oidn.oidnSetFilterBool(filter_, b"hdr", ctypes.c_bool(True))
    oidn.oidnCommitFilter(filter_)
    oidn.oidnExecuteFilter(filter_)
    message = ctypes.c_char_p()
    if oidn.oidnGetDeviceError(device, ctypes.byref(message)):
        raise RuntimeError(f"{library}: {message.value.decode()}")
    oidn.oidnReleaseFilter(filter_)
    oidn.oidnReleaseDevice(device)
    return result


#: Samples a pixel of one pass.
PASS = 8


class Studio:
    """Renders scenes at the size and noise that were asked for."""

    def __init__(self, folder, spp, draft, denoiser=None):
        self.folder, self.spp, self.draft, self.denoiser = folder, spp, draft, denoiser

    def render(self, parts, origin, target, fov=34.0, size=(1280, 720), depth=4, focus=None):
        """Linear sRGB of a scene."""
        scene = {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": depth, "hide_emitters": False},
            "sensor": camera(origin, target, fov, size, self.draft, focus),
            **parts,
        }
        scene = mi.load_dict(scene)
        # In passes: one would need the memory of all its paths at once.
        passes = 1 if self.draft else max(1, self.spp // PASS)
        return sum(np.array(mi.render(scene, seed=seed))[:, :, :3].astype(float) for seed in range(passes)) / passes

    def save(self, name, linear, exposure=1.0):
        """Writes a JPEG: exposed, highlights rolled off above half of white, sRGB."""
        if self.denoiser:
            linear = denoised(linear, self.denoiser)
        light = np.maximum(exposure * linear, 0)
        peak = light.max(axis=2, keepdims=True)
        over = np.maximum(peak - 0.5, 0)
        light *= np.where(peak > 0.5, (0.5 + 0.5 * over / (0.5 + over)) / np.maximum(peak, 1e-9), 1)
        srgb = np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)
        path = self.folder / f"{name}.jpg"
        Image.fromarray(np.uint8(np.round(255 * np.clip(srgb, 0, 1)))).save(path, quality=90, subsampling=0, optimize=True)
        print(f"{path} {path.stat().st_size // 1000} kB", flush=True)


# ---- the pictures


def strand(studio):
    """A strand of Akoya pearls on warm grey paper."""
    corners = np.array([
        (-13, 8), (-8, 6.2), (-3.5, 4.6), (0.5, 4.3), (3.9, 3.4), (4.9, 1.2), (2.8, -0.6), (-0.6, -0.3), (-3.6, -0.9),
        (-4.4, -3.0), (-2.4, -4.5), (0.8, -4.3), (4.2, -4.9), (9, -7.5), (14, -9),
    ])  # fmt: skip
    t = np.linspace(1, len(corners) - 2 - 1e-9, 4000)
    i, f = t.astype(int), (t % 1)[:, None]
    before, here, there, after = (corners[i + k] for k in (-1, 0, 1, 2))
    bend = 3 * (here - there) + after - before
    curve = here + 0.5 * f * (there - before + f * (2 * before - 5 * here + 4 * there - after + f * bend))
    radius, random = 0.5, np.random.default_rng(3)
    looks = [pearl("akoya-rg", thickness=t, coherence=0.55, depth=0.6) for t in (0.95, 0.98, 1.0, 1.02, 1.05)]
    parts, at = {}, curve[0]
    for point in curve:
        if np.hypot(*(point - at)) >= 2 * radius:
            parts[f"pearl{len(parts)}"] = ball(looks[random.integers(len(looks))], point[0], point[1], radius * random.uniform(0.985, 1.0))
            at = point
    parts |= {"floor": sweep(matte(0.2, 0.185, 0.175))} | lights()
    studio.save("strand", studio.render(parts, [0, -14, 7.0], [0, -0.7, 0.1], 34, focus=14.0), 1.15)


def tahitian(studio):
    """Black Tahitian pearls on slate."""
    slate = {"type": "roughplastic", "alpha": 0.25, "diffuse_reflectance": rgb(0.035, 0.038, 0.042)}
    parts = {
        "a": ball(pearl("tahitian"), -1.35, 0.1, 1.0),
        "b": ball(pearl("tahitian", thickness=0.93), 0.85, 0.75, 1.1),
        "c": ball(pearl("tahitian", thickness=1.07), 0.75, -1.35, 0.85),
        "floor": sweep(slate),
    } | lights()
    studio.save("tahitian", studio.render(parts, [0, -11, 4.2], [0, 0, 0.75], 34), 1.15)


def folds(bsdf, seed=5, width=26.0, depth=30.0, height=0.55, n=(260, 220)):
    """Draped cloth: long folds that run across the picture."""
    x, y = np.meshgrid(np.linspace(-width / 2, width / 2, n[0]), np.linspace(-6, depth - 6, n[1]), indexing="ij")
    bend = 0.8 * np.sin(0.35 * x + 0.5) + 0.35 * np.sin(0.9 * x + 1.7)
    wave = np.sin(1.5 * (y + bend)) * (0.6 + 0.4 * np.sin(0.5 * x + seed)) + 0.5 * np.sin(0.7 * y + 0.45 * x)
    flat = np.exp(-((x / 3.6) ** 2 + ((y + 0.1) / 2.2) ** 2))
    return grid(np.stack([x, y, height * wave * (1 - flat) - 0.04 * flat], -1), bsdf)


def golden(studio):
    """Golden South Sea pearls on cream silk."""
    silk = {"type": "twosided", "bsdf": {"type": "principled", "base_color": rgb(0.6, 0.52, 0.42), "roughness": 0.45, "sheen": 0.6, "specular": 0.3}}
    parts = {
        "a": ball(pearl("golden"), -1.25, 0.25, 1.05),
        "b": ball(pearl("golden", thickness=0.96), 1.0, 0.55, 1.0),
        "c": ball(pearl("golden", thickness=1.04), 0.05, -1.25, 0.95),
        "silk": folds(silk),
    } | lights()
    studio.save("golden", studio.render(parts, [0, -11, 5.6], [0, 0.1, 0.55], 32), 0.95)


def akoya(studio):
    """Akoya pearls of interference types R, RG and G, beside each other."""
    names = ("akoya-r", "akoya-rg", "akoya-g")
    parts = {name: ball(pearl(name), 2.5 * (i - 1), 0) for i, name in enumerate(names)}
    parts |= {"floor": sweep(matte(0.14, 0.14, 0.145))} | lights()
    studio.save("akoya", studio.render(parts, [0, -13, 3.4], [0, 0, 0.85], 33, (1280, 500)), 0.85)


def mother_of_pearl(studio):
    """A plate of mother-of-pearl whose thickness follows a map of growth lines."""
    n = 512
    x, y = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n), indexing="ij")
    cloud = noise(n, n, [(40, 1.0), (14, 0.35)], seed=8)
    lines = np.sin(9 * (np.hypot(x + 1.4, y + 1.1) + 0.06 * cloud)) * 0.05
    thickness = np.clip(0.98 + 0.07 * cloud + lines, 0.72, 1.38)
    bsdf = pearl("mother-of-pearl", thickness=texture(thickness), body_color=(0.3, 0.3, 0.29), coherence=0.95, depth=0.8)
    # Slightly domed and wavy.
    waves = 0.05 * noise(400, 400, [(60, 1.0)], seed=2)
    shell = disc((2.9, 2.1), lambda px, py: 0.55 - 0.42 * (px**2 + py**2) + waves, bsdf, 400)
    parts = {"shell": shell, "floor": sweep({"type": "roughplastic", "alpha": 0.3, "diffuse_reflectance": rgb(0.03, 0.032, 0.035)})}
    parts |= lights()
    studio.save("mother-of-pearl", studio.render(parts, [0, -10, 7.5], [0, -0.1, 0.2], 34), 1.4)


def disc(radius, height, bsdf, n=300):
    """An elliptic disc with square texture coordinates; `height` is a function of places on the unit disc."""
    px, py = on_disc(n)
    return grid(np.stack([radius[0] * px, radius[1] * py, height(px, py)], -1), bsdf)


def on_disc(n):
    """A square grid, mapped to the unit disc."""
    u, v = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n), indexing="ij")
    return u * np.sqrt(1 - v**2 / 2), v * np.sqrt(1 - u**2 / 2)


def eye_shadow(studio):
    """A pan of pressed eye shadow: flakes of coated mica."""
    n = 1024
    # Rows of a texture run against v, columns along u.
    x, y = (np.flipud(part.T) for part in on_disc(n))
    wave = np.sin(20 * (y + 0.1 * np.sin(4 * x))) / (1 + np.exp((np.hypot(x, y) - 0.74) * 40))
    relief = texture(0.006 * noise(n, n, [(1.5, 1.0), (4, 0.5)], seed=4) + 0.02 * wave)
    hue = texture(np.clip(1.0 + 0.06 * noise(n, n, [(1.2, 1.0)], seed=9), 0.75, 1.35))
    powder = pearl("cosmetic-flake", bump=relief, thickness=hue, body_color=(0.3, 0.13, 0.2), coherence=1.0)
    steel = {"type": "twosided", "bsdf": {"type": "roughconductor", "material": "Al", "alpha": 0.12}}
    case = {"type": "roughplastic", "alpha": 0.12, "diffuse_reflectance": rgb(0.02)}
    parts = {
        "powder": disc((2.2, 2.2), lambda px, py: 0.44 - 0.03 * (px**2 + py**2), powder),
        "rim": ring(2.2, 2.38, 0.52, steel),
        "side": {"type": "cylinder", "p0": [0, 0, 0], "p1": [0, 0, 0.5], "radius": 2.38, "bsdf": steel},
        "floor": sweep(case),
    } | lights()
    studio.save("eye-shadow", studio.render(parts, [0, -9.5, 7.5], [0, -0.1, 0.2], 33), 1.5)


def ring(inner, outer, top, bsdf):
    """A rounded metal rim."""
    turn, around = np.meshgrid(np.linspace(0, 2 * np.pi, 200), np.linspace(0, np.pi, 24), indexing="ij")
    middle, half = (inner + outer) / 2, (outer - inner) / 2
    radius = middle - half * np.cos(around)
    return grid(np.stack([radius * np.cos(turn), radius * np.sin(turn), top - 0.1 + half * np.sin(around)], -1), bsdf)


PRESETS = [
    ["paper", "akoya", "akoya-r", "akoya-rg", "akoya-g"],
    ["freshwater", "south-sea", "golden", "tahitian"],
    ["mother-of-pearl", "abalone", "cosmetic-flake", "varnish"],
]


def presets(studio):
    """Every built-in recipe as a bead, in the order of the page."""
    parts = {}
    for row, names in enumerate(PRESETS):
        for column, name in enumerate(names):
            parts[name] = ball(pearl(name), 2.4 * (column - (len(names) - 1) / 2), 2.6 * (1 - row))
    parts |= {"floor": sweep(matte(0.2, 0.2, 0.21))} | lights()
    studio.save("presets", studio.render(parts, [0, -15, 11], [0, 0.1, 0.4], 37), 1.15)


RICH = {"depth": 0.7, "coherence": 0.7}


def components(studio):
    """The components of the look and their sum, as the paper's Fig. 4."""
    names = ("diffuse", "incoherent", "mirror", "blur", "all")
    parts = {name: ball(pearl("akoya-rg", components=name, **RICH), 2.35 * (i - 2), 0) for i, name in enumerate(names)}
    parts |= {"floor": sweep(matte(0.1))} | lights()
    studio.save("components", studio.render(parts, [0, -20, 3.6], [0, 0, 0.95], 34, (1280, 300)), 1.0)


def sphere(studio):
    """The paper's pearl as a sphere, as its Fig. 11."""
    parts = {"pearl": ball(pearl("paper", **RICH), 0, 0, 1.5), "floor": sweep(matte(0.3, 0.3, 0.31))}
    parts |= lights()
    studio.save("sphere", studio.render(parts, [0, -11, 3.6], [0, 0, 1.25], 34), 0.9)


def free_form(studio):
    """A free-form surface of mother-of-pearl, as the paper's Fig. 12."""
    n = 360
    x, y = np.meshgrid(np.linspace(-0.98, 0.98, n), np.linspace(-0.9, 0.9, n), indexing="ij")
    height = 0.16 * np.sin(4.6 * x + 0.9 * np.sin(2.4 * y)) + 0.1 * np.cos(4.2 * y - 1.6 * x)
    bsdf = pearl("mother-of-pearl", depth=0.7, coherence=0.9, body_color=(0.3, 0.3, 0.29))
    sheet = grid(np.stack([3.6 * x, 2.6 * y, 2.4 * height + 0.75], -1), bsdf)
    parts = {"sheet": sheet, "floor": sweep(matte(0.05, 0.05, 0.055))} | lights()
    studio.save("free-form", studio.render(parts, [0, -10.5, 8.0], [0, -0.1, 0.3], 40), 1.2)


SWEEPS = {
    "depth": ("akoya-rg", {"brightness": 0.35, "coherence": 0.5}, [0.0, 0.25, 0.5, 0.75, 1.0]),
    "brightness": ("akoya-rg", {"depth": 0.5, "coherence": 0.6}, [0.0, 0.25, 0.5, 0.75, 1.0]),
    "coherence": ("tahitian", {"depth": 0.5}, [0.0, 0.25, 0.5, 0.75, 1.0]),
    "thickness": ("tahitian", {}, [0.8, 0.9, 1.0, 1.1, 1.2]),
    "tint": ("akoya-rg", {"depth": 0.6, "coherence": 0.8}, [[1, 1, 1], [1, 0.7, 0.7], [1, 0.88, 0.5], [0.65, 1, 0.75], [0.6, 0.75, 1]]),
    "body": ("akoya", {}, [[0.85, 0.82, 0.78], [0.85, 0.55, 0.5], [0.75, 0.55, 0.2], [0.15, 0.27, 0.24], [0.03, 0.03, 0.035]]),
    "grain": ("akoya-rg", RICH, [0.0, 0.5, 1.0, 2.0, 4.0]),
}


def controls(studio, name):
    """Five pearls beside each other, one control from end to end."""
    from_recipe, look, values = SWEEPS[name]
    bump = noise(512, 1024, [(3, 1.0), (9, 0.7)], seed=6)
    parts = {}
    for i, value in enumerate(values):
        if name == "grain":
            bsdf = pearl(from_recipe, bump=texture(0.004 * value * bump) if value else None, **look)
        else:
            bsdf = pearl(from_recipe, **look, **{"body_color" if name == "body" else name: value})
        parts[f"pearl{i}"] = ball(bsdf, 2.35 * (i - 2), 0)
    ground = 0.12 if from_recipe == "tahitian" else 0.35
    parts |= {"floor": sweep(matte(ground))} | lights()
    studio.save(f"sweep-{name}", studio.render(parts, [0, -20, 3.6], [0, 0, 0.95], 34, (1280, 300)), 0.95)


def light(studio):
    """One pearl under one soft box that moves around it."""
    pictures = []
    for turn in (-150, -95, -35, 35, 110):
        parts = {"pearl": ball(pearl("akoya-rg", **RICH), 0, 0), "floor": sweep(matte(0.3))}
        parts |= lights(boxes=[(turn, 35, 18, 18, 14.0)])
        pictures.append(studio.render(parts, [0, -11, 3.2], [0, 0, 0.95], 14.5, (256, 300)))
    studio.save("sweep-light", np.concatenate(pictures, axis=1), 0.9)


PICTURES = {
    "strand": strand, "tahitian": tahitian, "golden": golden, "akoya": akoya, "mother-of-pearl": mother_of_pearl,
    "eye-shadow": eye_shadow, "presets": presets, "components": components, "sphere": sphere, "free-form": free_form,
    **{f"sweep-{name}": (lambda studio, name=name: controls(studio, name)) for name in SWEEPS}, "sweep-light": light,
}  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pictures", nargs="*", help=", ".join(PICTURES))
    parser.add_argument("-o", "--output", type=pathlib.Path, required=True)
    parser.add_argument("--spp", type=int, default=64, help="samples a pixel, a multiple of 8")
    parser.add_argument("--denoise", type=pathlib.Path, metavar="LIBRARY", help="libOpenImageDenoise, which the Python package bpy has")
    parser.add_argument("--draft", action="store_true", help="small and noisy")
    parser.add_argument("--variant", default="llvm_ad_rgb")
    options = parser.parse_args()
    unknown = sorted(set(options.pictures) - set(PICTURES))
    if unknown:
        parser.error(f"no picture {', '.join(unknown)}; there are {', '.join(PICTURES)}")
    mi.set_variant(options.variant)
    options.output.mkdir(parents=True, exist_ok=True)
    studio = Studio(options.output, options.spp, options.draft, options.denoise)
    for name in options.pictures or PICTURES:
        PICTURES[name](studio)


if __name__ == "__main__":
    main()
