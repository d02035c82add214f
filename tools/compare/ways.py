"""The ways to an image: what each says for the same light paths."""

import json
import pathlib
import subprocess

import drjit as dr
import mitsuba as mi
import numpy as np
import scenes
import walk


class Refused(Exception):
    """Why a way cannot answer; the text says what would make it."""


def interaction(samples, wavelengths=None):
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(samples.pixel))
    si.wi = samples.wi
    if wavelengths:
        si.wavelengths = wavelengths
    return si


def of_mitsuba(bsdf, samples, wavelengths):
    """f·cos θ of a Mitsuba BSDF, [sample, channel]."""
    value = bsdf.eval(mi.BSDFContext(), interaction(samples, wavelengths), samples.wo, samples.valid)
    return np.array(value).T.astype(float)


class Plugin:
    """(b) the plugin."""

    key, title = "b", "plugin pearl"

    def __init__(self, table, parameters, tools):
        red, green, blue = parameters["body"]
        colour = {"type": "rgb", "value": [red, green, blue]}
        if "spectral" in mi.variant():
            # What the tools make of an RGB body: flat within each channel's part of the spectrum. (Mitsuba's own smooth
            # spectrum of that colour is another body.)
            nodes = [(360, blue), (475, blue), (505, green), (565, green), (595, red), (830, red)]
            listed = [", ".join(str(node[k]) for node in nodes) for k in (0, 1)]
            colour = {"type": "irregular", "wavelengths": listed[0], "values": listed[1]}
        self.bsdf = mi.load_dict({
            "type": "pearl", "filename": str(table), "body_color": colour,
            **{name: parameters[name] for name in ("depth", "coherence", "brightness")},
        })  # fmt: skip

    def __call__(self, samples, wavelengths):
        return of_mitsuba(self.bsdf, samples, wavelengths)

    def sampler(self, wi, u, uv):
        """Exit directions and densities: from the plugin, every third from the whole hemisphere alike, so that another way's
        light where the plugin has next to none, as at the horizon, weighs what it is."""
        si = dr.zeros(mi.SurfaceInteraction3f, dr.width(u))
        si.wi = wi
        if "spectral" in mi.variant():
            si.wavelengths = [500.0] * 4
        ctx = mi.BSDFContext()
        even = u < 1 / 3
        sample, _ = self.bsdf.sample(ctx, si, dr.clip(1.5 * (u - 1 / 3), 0.0, 1.0 - 1e-7), uv)
        wo = dr.select(even, mi.warp.square_to_uniform_hemisphere(uv), sample.wo)
        pdf = self.bsdf.pdf(ctx, si, wo) * (2 / 3) + 1 / (6 * dr.pi)
        return wo, dr.select(even | (sample.pdf > 0), pdf, 0)


class Measured:
    """(a) Mitsuba's stock `measured` on the exported file."""

    key, title = "a", "measured on the exported .bsdf"

    def __init__(self, table, parameters, tools):
        spectral = "spectral" in mi.variant()
        self.file = pathlib.Path(tools.folder) / f"{pathlib.Path(table).stem}-{'spectral' if spectral else 'rgb'}.bsdf"
        form = "bsdf-spectral" if spectral else "bsdf-rgb"
        # With the look of the recipe in the table, which is what is compared.
        tools.run("lut", "export", table, "--to", form, "-o", self.file)
        self.bsdf = mi.load_dict({"type": "measured", "filename": str(self.file)})

    def __call__(self, samples, wavelengths):
        return of_mitsuba(self.bsdf, samples, wavelengths)


class Rust:
    """(d) the evaluator behind `pearl preview`, asked through `pearl eval`."""

    key, title = "d", "evaluator of the tool pearl"

    def __init__(self, table, parameters, tools):
        look = ["--depth", parameters["depth"], "--coherence", parameters["coherence"],
                "--brightness", parameters["brightness"], "--body-rgb", ",".join(map(str, parameters["body"]))]  # fmt: skip
        self.command = [tools.path("pearl"), "eval", str(table), "--input", "-", *map(str, look)]

    def __call__(self, samples, wavelengths, chosen):
        valid = np.flatnonzero(np.array(samples.valid) & chosen)
        wi, wo = (np.array(w).T[valid].astype(float).tolist() for w in (samples.wi, samples.wo))
        lines = "\n".join(f'{{"wi":{a},"wo":{b}}}' for a, b in zip(wi, wo))
        asked = ["--wavelengths-nm", ",".join(map(str, wavelengths))] if wavelengths else []
        done = subprocess.run([*self.command, *asked], input=lines, capture_output=True, text=True)
        if done.returncode != 0:
            raise Refused(done.stderr.strip())
        key = "spectral" if wavelengths else "rgb"
        found = np.array([json.loads(line)[key] for line in done.stdout.splitlines()])
        values = np.zeros((dr.width(samples.pixel), found.shape[1]))
        values[valid] = found
        return values


class Walk:
    """(c) the table-free walk: it has no density, so it answers scenes whose light a direction can hit by chance."""

    key, title = "c", "walk without a table"

    def __init__(self, table, parameters, tools):
        meta = tools.meta(table)
        if meta["azimuth"] != "space":
            raise Refused("the walk is in space: compare it on a table baked with `--azimuth space`")
        if parameters["depth"] or parameters["coherence"] or parameters["brightness"] != 1:
            raise Refused("the walk adds intensities: it takes depth 0, coherence 0 and brightness 1")
        try:
            self.stack = walk.Stack(meta["recipe"])
        except walk.Refused as why:
            raise Refused(str(why)) from None
        self.body = parameters["body"]

    def light(self, samples, seed):
        """Light that reaches the camera along each sample, on directions of its own, [sample, rgb]."""
        if samples.radiance is None:
            raise Refused("a walk has no density, and no direction hits a point light by chance")
        # Only where the camera sees something.
        index = dr.compress(samples.valid)
        pick = lambda value: dr.gather(type(value), value, index)
        wi = pick(samples.wi)
        rng = scenes.generators(dr.width(index), seed)
        wo, weight = walk.sample(self.stack, wi, rng, self.body)
        full = dr.zeros(mi.Vector3f, dr.width(samples.pixel))
        dr.scatter(full, wo, index)
        colour = dr.zeros(mi.Color3f, dr.width(samples.pixel))
        dr.scatter(colour, weight, index)
        light = samples.radiance(samples.frame.to_world(full)) * colour
        return np.array(dr.select(samples.valid, light, 0)).T.astype(float)


WAYS = {way.key: way for way in (Measured, Plugin, Walk, Rust)}
