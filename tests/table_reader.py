"""A reader of pearl tables written from docs/LUT-FORMAT.md alone, in NumPy; the numbers in brackets are its sections.

It shares no code with Rust or the plugin, and integrates by rules of its own. `table_truth.py` compares it with `pearl eval`.
"""

import base64
import json
import zlib

import numpy as np
import OpenEXR
from scipy.interpolate import CubicSpline
from scipy.special import i0e

HALF_PI = np.pi / 2
COMPONENTS = ["diffuse", "incoherent", "mirror", "blur"]
X6, W6 = np.polynomial.legendre.leggauss(6)


# ---- the file [1, 2, 11, 12]


def load(path):
    """Metadata, and of each band {component: values [incidence, φ row, column]}."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        meta = json.loads(file.header()["pearl"])
        pixels = {name: channel.pixels.astype(float) for name, channel in file.channels().items()}
    if "packed" in meta:
        meta = json.loads(zlib.decompress(base64.b64decode(meta["packed"])))
    axis, count = meta["exit_axis"], len(meta["per_incidence"])
    rows, columns = (1, axis["cells"]) if axis["kind"] == "plane" else (axis["phi_cells"], axis["theta_cells"])
    names = ["interior", "rehit"]
    form = meta.get("compact", {}).get("form", {"kind": None})
    if form["kind"] == "analytic":
        x, y = 2 * (np.arange(columns) + 0.5) / columns - 1, (np.arange(rows) + 0.5) / rows
        t = lambda order, at: np.cos(order * np.arccos(at))
        terms = np.array([np.outer(t(2 * n, y), t(m, x)) for m, n in form["terms"]])
        return meta, [{name: np.exp(np.tensordot(pixels[name], terms, 1)) for name in names}]
    shaped = {name: values.reshape(count, rows, columns) for name, values in pixels.items()}
    if form["kind"] == "half":
        exponents = np.array(form["exponent"], float)[:, :, None, None]
        shaped = {name: shaped[name] * 2.0 ** exponents[:, k] for k, name in enumerate(["interior", "surface", "rehit"])}
    bands = [{name: shaped[name] for name in names}]
    for k in range(len(meta.get("dispersion", {}).get("bands", []))):
        bands.append({name: shaped[f"{name}_band{k + 1:02}"] for name in names})
    return meta, bands


# ---- axes and reading [3, 4, 5, 13]


class Axis:
    """Cells finest around a centre; lo, centre, hi and width may be arrays of one entry an incidence."""

    def __init__(self, lo, centre, hi, width, cells):
        self.lo, self.centre, self.hi, self.width, self.cells = lo, centre, hi, width, cells
        one_sided = np.all(centre <= lo)
        self.above, self.start = (cells, 0) if one_sided else (cells / 2, cells / 2)

    def position(self, x):
        up = np.arcsinh((x - self.centre) / self.width) / np.arcsinh((self.hi - self.centre) / self.width)
        if self.start == 0:
            return self.above * up
        down = np.arcsinh((self.centre - x) / self.width) / np.arcsinh((self.centre - self.lo) / self.width)
        return self.start + self.above * np.where(x >= self.centre, up, -down)

    def at(self, position):
        """The coordinate, and its slope by position."""
        t = (position - self.start) / self.above
        room = self.hi - self.centre if self.start == 0 else np.where(t >= 0, self.hi - self.centre, self.centre - self.lo)
        reach = np.arcsinh(room / self.width)
        return self.centre + self.width * np.sinh(t * reach), self.width * reach * np.cosh(t * reach) / self.above

    def hats(self):
        """Positions of a rule on half cells, and the matrix that takes weighted values there to the cells' hats."""
        half = np.arange(2 * self.cells)[:, None] / 2
        position = (half + 0.25 * (1 + X6)).ravel()
        near, t = neighbours(position, self.cells)
        matrix, k, weight = np.zeros((len(position), self.cells)), np.arange(len(position)), np.tile(0.25 * W6, 2 * self.cells)
        np.add.at(matrix, (k, near), weight * (1 - t))
        np.add.at(matrix, (k, np.minimum(near + 1, self.cells - 1)), weight * t)
        return position, matrix


def neighbours(position, cells):
    from_first = np.clip(position - 0.5, 0, cells - 1)
    near = np.minimum(from_first.astype(int), max(cells - 2, 0))
    return near, from_first - near


def monotone(x, y):
    """The monotone cubic of the page, constant beyond its ends."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    if len(x) == 1:
        return lambda at: np.full(np.shape(at), y[0])
    h, s = np.diff(x), np.diff(y) / np.diff(x)

    def end(h0, h1, s0, s1):
        slope = ((2 * h0 + h1) * s0 - h0 * s1) / (h0 + h1)
        return 0.0 if slope * s0 <= 0 else np.clip(slope, -3 * abs(s0), 3 * abs(s0))

    if len(x) == 2:
        m = np.array([s[0], s[0]])
    else:
        inner = (h[1:] * s[:-1] + h[:-1] * s[1:]) / (h[1:] + h[:-1])
        most = 3 * np.minimum(abs(s[1:]), abs(s[:-1]))
        inner = np.where(s[1:] * s[:-1] > 0, np.clip(inner, -most, most), 0)
        m = np.concatenate([[end(h[0], h[1], s[0], s[1])], inner, [end(h[-1], h[-2], s[-1], s[-2])]])
    if x[0] == 0:
        m[0] = 0

    def at(value):
        value = np.clip(value, x[0], x[-1])
        i = np.clip(np.searchsorted(x, value, "right") - 1, 0, len(x) - 2)
        t = (value - x[i]) / h[i]
        a, b = (1 + 2 * t) * y[i] + t * h[i] * m[i], (3 - 2 * t) * y[i + 1] - (1 - t) * h[i] * m[i + 1]
        return (1 - t) ** 2 * a + t * t * b

    return at


class Lobes:
    """Interior and rehit of one band, as read."""

    def __init__(self, meta, rows, values):
        self.axis, self.values = meta["exit_axis"], [values["interior"], values["rehit"]]
        self.plane = self.axis["kind"] == "plane"
        self.reciprocal = meta.get("reciprocal")
        self.theta = np.radians([row["theta_i_deg"] for row in rows])
        self.width = np.radians([row["azimuth_width_deg"] for row in rows])
        albedo = {key: monotone(self.theta, [row[key] for row in rows]) for key in ("surface", "rehit")}
        interior = monotone(self.theta, [max(row["albedo"] - row["surface"], 0) for row in rows])
        self.albedo = [interior, albedo["rehit"]]
        self.single = lambda theta: np.maximum(albedo["surface"](theta) - albedo["rehit"](theta), 0)

    def axes(self, theta_i):
        w = self.axis["width"]
        h = lambda a: np.hypot(a, w) - a
        if self.plane:
            centre = theta_i - h(HALF_PI - theta_i) + h(HALF_PI + theta_i)
            return Axis(-HALF_PI, centre, HALF_PI, w, self.axis["cells"]), None
        centre = theta_i - h(HALF_PI - theta_i) + h(theta_i)
        columns = Axis(0.0, centre, HALF_PI, w, self.axis["theta_cells"])
        return columns, Axis(0.0, 0.0, np.pi, w / np.tan(centre), self.axis["phi_cells"])

    def between(self, theta_i):
        if len(self.theta) == 1:
            return np.zeros(np.shape(theta_i), int), np.zeros(np.shape(theta_i), int), np.zeros(np.shape(theta_i))
        i = np.clip(np.searchsorted(self.theta, theta_i, "right") - 1, 0, len(self.theta) - 2)
        return i, i + 1, np.clip((theta_i - self.theta[i]) / (self.theta[i + 1] - self.theta[i]), 0, 1)

    def corrections(self, theta_i):
        """A/∫ of interior and rehit at incidences [n]."""
        found = np.empty((2, len(theta_i)))
        for part in np.array_split(np.arange(len(theta_i)), max(len(theta_i) // 64, 1)):
            theta = theta_i[part][:, None]
            i, j, t = self.between(theta_i[part])
            columns, phi = self.axes(theta)
            position, hats = columns.hats()
            x, slope = columns.at(position)
            if self.plane:
                w = self.width[i] * (1 - t) + self.width[j] * t
                c = np.sin(theta) * abs(np.sin(x)) / w[:, None] ** 2
                e2 = np.exp(-2 * c)
                mean = np.where(c > 1e-6, (i0e(c) - e2) / np.maximum(-np.expm1(-2 * c), 1e-300), 0.5)
                weights = (2 * np.pi * abs(np.sin(x)) * np.where(x >= 0, mean, 1 - mean) * slope) @ hats
                weights = weights[:, None, :]
            else:
                around, hats_around = phi.hats()
                _, turn = phi.at(around)
                weights = ((2 * turn) @ hats_around)[:, :, None] * ((np.sin(x) * slope) @ hats)[:, None, :]
            for k, values in enumerate(self.values):
                mixed = values[i] * (1 - t)[:, None, None] + values[j] * t[:, None, None]
                integral = (mixed * weights).sum((1, 2))
                found[k, part] = np.where(integral > 0, self.albedo[k](theta_i[part]) / np.maximum(integral, 1e-300), 1)
        return found

    def uncorrected(self, theta_i, theta_o, phi):
        i, j, t = self.between(theta_i)
        columns, around = self.axes(theta_i)

        def along(s, row):
            near, u = neighbours(columns.position(s), columns.cells)
            read = lambda values, at: values[at, row, near] * (1 - u) + values[at, row, near + 1] * u
            return np.array([read(values, i) * (1 - t) + read(values, j) * t for values in self.values])

        if self.plane:
            w = self.width[i] * (1 - t) + self.width[j] * t
            x = np.maximum(np.sin(theta_i) * np.sin(theta_o) / w**2, 1e-12)
            decay = (np.exp((np.cos(phi) - 1) * x) - np.exp(-2 * x)) / -np.expm1(-2 * x)
            decay = np.where(x < 1e-6, (1 + np.cos(phi)) / 2, decay)
            return along(theta_o, 0) * decay + along(-theta_o, 0) * (1 - decay)
        row, v = neighbours(around.position(phi), around.cells)
        return along(theta_o, row) * (1 - v) + along(theta_o, row + 1) * v

    def read(self, theta_i, theta_o, phi):
        """Interior and rehit, f·cos θo: [2, n]."""
        if not self.reciprocal:
            unique, back = np.unique(theta_i, return_inverse=True)
            return self.uncorrected(theta_i, theta_o, phi) * self.corrections(unique)[:, back]
        larger, smaller = np.maximum(theta_i, theta_o), np.minimum(theta_i, theta_o)
        unique, back = np.unique(larger, return_inverse=True)
        read = self.uncorrected(larger, smaller, phi) * self.corrections(unique)[:, back]
        return read * np.where(theta_o > theta_i, np.cos(theta_o) / np.cos(theta_i), 1)


# ---- curves [14]

NODES = 1025
COS = (1 - (np.arange(NODES) / 1024) ** 2) ** 2
THETA = np.arccos(COS)


def place(cos):
    u = 1024 * np.sqrt(1 - np.sqrt(np.clip(cos, 0, 1)))
    i = np.minimum(u.astype(int), NODES - 2)
    return i, u - i


def curve(y, cos):
    """Curves [..., node] at the cosines of angles."""
    i, t = place(cos)
    return y[..., i] * (1 - t) + y[..., i + 1] * t


def cosine_mean(y):
    """2 ∫ y μ dμ of curves as they are read: in u = √(1 − √μ), where they are linear pieces."""
    x, w = np.polynomial.legendre.leggauss(6)
    i, t = np.arange(NODES - 1)[:, None], 0.5 * (1 + x)
    u = (i + t) / 1024
    mass = 0.5 * w / 1024 * 8 * u * (1 - u * u) ** 3
    return ((y[..., :-1, None] * (1 - t) + y[..., 1:, None] * t) * mass).sum((-1, -2))


# ---- the single reflection [14]


class Mirror:
    def __init__(self, model, lobes):
        self.sigma, self.ratio = max(model["slope_sd"], 1e-4), model["n_first"] / model["n_ambient"]
        self.visible, self.reciprocal = model["normals"] == "visible", lobes.reciprocal
        pieces = [self.slopes(theta) for theta in THETA]
        mass, self.half, exits = (np.array(part) for part in zip(*pieces))
        self.mass = mass
        share = lobes.single(THETA)
        if not self.reciprocal:
            total = mass.sum(1)
            self.scale = np.where(total > 0, share / np.maximum(total, 1e-300), 0)
            return
        self.scale, kernel, (i, t) = np.ones(NODES), mass * exits, place(exits)
        for _ in range(300):
            light = self.scale * (kernel * (self.scale[i] * (1 - t) + self.scale[i + 1] * t)).sum(1)
            factor = np.where((light > 0) & (share > 0), np.sqrt(share / np.maximum(light, 1e-300)), 0)
            self.scale = self.scale * factor
            if abs(factor[share > 0] - 1).max() < 1e-11:
                break
        self.mass = kernel * (self.scale[i] * (1 - t) + self.scale[i + 1] * t)

    def fresnel(self, cos):
        cos_t = np.sqrt(np.maximum(1 - (1 - cos**2) / self.ratio**2, 0) + 0j)
        s, p = (cos - self.ratio * cos_t) / (cos + self.ratio * cos_t), (self.ratio * cos - cos_t) / (self.ratio * cos + cos_t)
        total = 1 - (1 - cos**2) / self.ratio**2 <= 0
        return np.where(total, 1.0, (abs(s) ** 2 + abs(p) ** 2) / 2)

    def slopes(self, theta):
        """Of one incidence: masses of the reflection over slopes, cos θd and cos θo."""
        sin, cos, far = np.sin(theta), max(np.cos(theta), 1e-12), 9 * self.sigma
        x, w = np.polynomial.legendre.leggauss(160)
        y, v = np.polynomial.legendre.leggauss(48)
        top = min(far, 1 / cos)
        q, around = 0.5 * top * (1 + y)[:, None], v[:, None] * top  # both signs
        chord = np.sqrt(np.maximum(1 - (q * cos) ** 2, 0))
        low, high = np.maximum(-(sin + chord) / cos, -far), np.minimum((chord - sin) / cos, far)
        p, along = low + 0.5 * (high - low) * (1 + x), 0.5 * np.maximum(high - low, 0) * w
        slant = 1 + p**2 + q**2
        seen = cos - p * sin
        half = np.clip(seen / np.sqrt(slant), 0, 1)
        density = np.exp(-(p**2 + q**2) / (2 * self.sigma**2)) / (2 * np.pi * self.sigma**2)
        mass = along * around * density * self.fresnel(half) * (np.maximum(seen, 0) if self.visible else 1)
        return mass.ravel(), half.ravel(), np.maximum(2 * seen / slant - cos, 0).ravel()

    def read(self, wi, wo):
        h = wi + wo
        length = np.sqrt((h**2).sum(0))
        z, half = h[2] / length, length / 2
        density = np.exp(-(1 / z**2 - 1) / (2 * self.sigma**2)) / (2 * np.pi * self.sigma**2 * z**3)
        light = density * self.fresnel(half) / (4 * half) * (half / z if self.visible else 1) * curve(self.scale, wi[2])
        return light * (curve(self.scale, wo[2]) * wo[2] if self.reciprocal else 1), half


# ---- the BSDF [9, 12, 14]


class Band:
    """The pearl with the lobes of one band. Channels: red, green, blue, then those of the spectra."""

    def __init__(self, meta, own, values, spectra):
        self.lobes = Lobes(meta, own["per_incidence"], values)
        self.mirror = Mirror(own["surface_model"], self.lobes)
        coherent = spectra.get("coherent")
        count = 3 + len(spectra.get("wavelength_nm", [0]))
        self.modulation = np.ones((count, NODES))
        if coherent:
            ratio = np.divide(coherent["incoherent"], own.get("incoherent", coherent["incoherent"]))
            columns = np.hstack([coherent["modulation_rgb"], coherent["modulation"]]) * ratio[:, None]
            angles = np.radians(coherent["theta_deg"])
            self.modulation = np.array([monotone(angles, column)(THETA) for column in columns.T])
        self.means = self.mean_colours()

    def mean_colours(self):
        """Means of M over interior, rehit and single, at the nodes: [part, channel, node]."""
        every = np.arange(0, NODES, 8)
        found = np.zeros((3, len(self.modulation), len(every)))
        for k, node in enumerate(every):
            parts = [(mass, half) for mass, half in self.tabulated(min(THETA[node], HALF_PI - 1e-6))]
            parts.append((self.mirror.mass[node], self.mirror.half[node]))
            for part, (mass, half) in enumerate(parts):
                i, t = place(half)
                seen = np.bincount(i, mass * (1 - t), NODES) + np.bincount(i + 1, mass * t, NODES)
                found[part, :, k] = self.modulation @ seen / max(seen.sum(), 1e-300)
        return np.maximum(CubicSpline(every, found, axis=2)(np.arange(NODES)), 0)

    def tabulated(self, theta_i):
        """(masses, cos θd) of interior and of rehit at one incidence, both without their scale."""
        columns, around = self.lobes.axes(np.array(theta_i))

        def rule(edges, points=3):
            x, w = np.polynomial.legendre.leggauss(points)
            edges = np.unique(edges)
            half = 0.5 * np.diff(edges)[:, None]
            return (0.5 * (edges[1:] + edges[:-1])[:, None] + half * x).ravel(), (half * w).ravel()

        halves = np.append(abs(columns.at(np.arange(2 * columns.cells + 1) / 2)[0]), [0.0, HALF_PI])
        theta, d_theta = rule(np.clip(halves, 0, HALF_PI))
        if around is None:
            around = Axis(0.0, 0.0, np.pi, max(float(self.lobes.width.min()), 1e-3), 24)
        phi, d_phi = rule(np.clip(around.at(np.arange(2 * around.cells + 1) / 2)[0], 0, np.pi))
        theta, phi, weight = (x.ravel() for x in (theta[:, None] + 0 * phi, phi + 0 * theta[:, None], np.outer(d_theta * np.sin(theta), d_phi)))
        if self.lobes.reciprocal:
            light = self.lobes.read(np.full(len(theta), theta_i), theta, phi)
        else:
            light = self.lobes.uncorrected(np.full(len(theta), theta_i), theta, phi)
        dot = np.cos(theta_i) * np.cos(theta) - np.sin(theta_i) * np.sin(theta) * np.cos(phi)
        half = np.sqrt(np.maximum((1 + dot) / 2, 0))
        return [(part * weight, half) for part in light]


class Pearl:
    def __init__(self, path):
        meta, values = load(path)
        spectra = meta.get("spectra", {})
        dispersion = meta.get("dispersion", {"bands": [], "rgb_weights": [[1, 1, 1]]})
        owns = [meta, *dispersion["bands"]]
        self.bands = [Band(meta, own, of, spectra) for own, of in zip(owns, values)]
        self.band_nm = np.array([own["wavelength_nm"] for own in owns])
        self.rgb_weights = np.array(dispersion["rgb_weights"])
        self.nm = np.array(spectra.get("wavelength_nm", [meta["wavelength_nm"]]))
        look = meta["recipe"].get("look", {})
        self.look = {"depth": 0.5, "brightness": 1.0, "coherence": 0.5, "body_rgb": [0.8, 0.78, 0.75]} | look | {"tint_rgb": [1, 1, 1]}
        emission = spectra.get("emission")
        self.look["coherence"] *= "coherent" in spectra
        self.look["depth"] *= bool(emission)
        self.emission = np.ones((3 + len(self.nm), NODES))
        if emission:
            columns = np.hstack([emission["radiance_rgb"], emission["radiance"]]).T
            self.emission = np.array([monotone(np.radians(emission["theta_deg"]), column)(THETA) for column in columns])
        self.reciprocal = meta.get("reciprocal")
        if not spectra:
            of_channels = np.full((1, 3), 1 / 3)
        else:
            ramp = lambda centre: np.clip((self.nm - centre) / 30 + 0.5, 0, 1)
            of_channels = np.array([ramp(580), ramp(490) - ramp(580), 1 - ramp(490)]).T
        self.reflectance = np.vstack([np.eye(3), of_channels])

    def albedos(self, band):
        """Interior, rehit and single at the nodes."""
        found = np.array([*(albedo(THETA) for albedo in band.lobes.albedo), band.lobes.single(THETA)])
        if self.reciprocal:
            steps = np.linspace(0, HALF_PI, 361)
            found[0] += np.interp(THETA, steps, self.reciprocal["interior_gain"])
            found[1] += np.interp(THETA, steps, self.reciprocal["rehit_gain"])
        return np.maximum(found, 0)

    def components(self, band, wi, wo, look):
        """[component, channel, pair] with the lobes of one band."""
        body, tint = (self.reflectance @ look[name] for name in ("body_rgb", "tint_rgb"))
        tint, gamma, depth = tint[:, None], look["coherence"], look["depth"]
        colour = lambda m: look["brightness"] * ((1 - gamma) + gamma * tint * m)
        albedo = (self.albedos(band)[:, None, :] * colour(band.means)).sum(0)
        limit = 1 / np.maximum(albedo, 1)
        if self.reciprocal:
            limit = np.broadcast_to(limit.min(1, keepdims=True), limit.shape)
        rest = np.maximum(1 - albedo * limit, 0)
        mean = cosine_mean(rest)[:, None]
        theta_i, theta_o = np.arccos(wi[2]), np.arccos(wo[2])
        azimuth = np.arctan2(wo[1], wo[0]) - np.arctan2(-wi[1], -wi[0])
        phi = np.arccos(np.cos(azimuth))
        interior, rehit = band.lobes.read(theta_i, theta_o, phi)
        single, half = band.mirror.read(wi, wo)
        lobe = colour(curve(band.modulation, half)) * curve(limit, wi[2])
        base = np.where(mean > 1e-12, curve(rest, wi[2]) * curve(rest, wo[2]) * wo[2] / (np.pi * np.maximum(mean, 1e-12)), 0)
        emission = tint * curve(self.emission, wi[2])
        body = body[:, None] / np.maximum(1, body[:, None] * ((1 - depth) + depth * emission))
        return np.array([base * body * (1 - depth), base * body * depth * emission, lobe * (single + rehit), lobe * interior])

    def rgb(self, wi, wo, **controls):
        """f·cos θo in linear sRGB: [component, channel, pair]."""
        look = self.look | controls
        found = sum(w[:, None] * self.components(band, wi, wo, look)[:, :3] for w, band in zip(self.rgb_weights, self.bands))
        return np.maximum(found, 0)

    def at(self, wi, wo, nm, **controls):
        """f·cos θo at a wavelength: [component, pair]."""
        look = self.look | controls

        def around(nodes):
            order = np.argsort(nodes)
            x = np.interp(nm, nodes[order], np.arange(len(nodes)))
            i = min(int(x), max(len(nodes) - 2, 0))
            return [(order[i], 1 - (x - i)), (order[min(i + 1, len(nodes) - 1)], x - i)]

        found = 0.0
        for k, share in around(self.band_nm):
            if share:
                channels = self.components(self.bands[k], wi, wo, look)[:, 3:]
                found = found + share * sum(weight * channels[:, c] for c, weight in around(self.nm))
        return found
