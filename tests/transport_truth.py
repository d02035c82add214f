"""Random recipes, walked by another program: NumPy, all paths at once, absorption by dice, nothing shared with the crates.

`judge` bakes one recipe by both solvers at one incidence and compares shares, moments and binned lobes. The model: a fresh facet at every
interface, Fresnel's reflectance of the complex indices, rays by Snell's law of the real ones; a layer lets exp(−4πkd/(λ|cos θ|)) pass.
"""

import json
import random
import subprocess

import numpy as np
import OpenEXR
from built import BIN
from scipy import stats

PATHS = {"decay": 200_000, "space": 100_000}
CELLS = {"decay": "48", "space": "16x8"}
# What doublings are asked for, per cent of the reflected light.
DOUBLING_PERCENT = {"decay": 0.02, "space": 0.1}
# Paths of a bin of a lobe, or of a share that is judged, at least.
FEWEST = 200
WAVELENGTH_NM = 550
# k/n beyond which a bake must refuse a layer: the first, and others.
MOST_ABSORBING = (0.02, 0.2)
INTERIOR, SINGLE, REHIT, TRANSMITTED, ABSORBED = range(5)


# Recipes -----------------------------------------------------------------------------------------------------------------------------


def material(dice, first=False):
    most = MOST_ABSORBING[0 if first else 1]
    n = round(dice.uniform(1.3, 2.2), 4)
    k = 0 if dice.random() < 0.5 else n * most * 10 ** dice.uniform(-4, 0)
    if dice.random() < 0.03:
        k = dice.uniform(0.3, 3)
    return {"n": n, "k": float(f"{k:.3g}")}


def request(seed):
    """A recipe, its incidence in degrees, and its effects."""
    dice = random.Random(seed)
    space, sheets = dice.random() < 0.4, dice.random() < 0.12
    stack = {"ambient": {"n": 1 if dice.random() < 0.5 else round(dice.uniform(1, 1.5), 3)}}
    if dice.random() < 0.02:
        stack["ambient"]["k"] = 0.1
    if dice.random() < 0.4 and not sheets:
        count = dice.randint(1, 8)
        stack["explicit"] = [material(dice, i == 0) | {"thickness_nm": round(dice.uniform(5, 600), 1)} for i in range(count)]
    else:
        stack["layers"] = round(10 ** dice.uniform(0.4 if sheets else 0, 1.8))
        stack["aragonite"] = material(dice, True) | {"thickness_nm": round(dice.uniform(100, 600), 1)}
        stack["conchiolin"] = material(dice) | {"thickness_nm": round(dice.uniform(5, 60), 1)}
        if dice.random() < 0.4:
            stack["conchiolin"]["n"] = round(stack["aragonite"]["n"] - dice.uniform(0.005, 0.15), 4)
    metal = dice.random() < 0.4
    stack["substrate"] = {"n": round(dice.uniform(0.05, 3), 3), "k": round(dice.uniform(0, 3), 3)} if metal else {"n": round(dice.uniform(1, 2), 3)}
    if sheets:
        stack["conchiolin"]["k"] = 0
        if stack["layers"] % 2 == 0:
            stack["substrate"] = {"n": stack["aragonite"]["n"]}
    sd = dice.uniform(1.5, 8) if space else 10 ** dice.uniform(-0.5, 1)
    recipe = {
        "stack": stack,
        "facets": {"slope_sd_deg": round(sd, 3), "normals": dice.choice(["unweighted", "unweighted", "visible"])},
        "azimuth": {"mode": "space" if space else "decay"},
        "light": {"wavelength_nm": WAVELENGTH_NM},
    }
    theta = dice.uniform(85, 89.5) if dice.random() < 0.2 else dice.uniform(1, 85)
    effects = ["surface", "blur", "azimuth", "absorption"]
    effects += ["coherent_sheets"] if sheets else []
    effects += ["polarisation"] if not space and dice.random() < 0.25 else []
    return recipe, round(theta, 2), effects


def layers(stack):
    if "explicit" in stack:
        return stack["explicit"]
    return [stack[("aragonite", "conchiolin")[i % 2]] for i in range(stack["layers"])]


def is_refused(stack):
    over = any(layer["k"] > MOST_ABSORBING[0 if i == 0 else 1] * layer["n"] for i, layer in enumerate(layers(stack)))
    return over or stack["ambient"].get("k", 0) > 0


# The walk ----------------------------------------------------------------------------------------------------------------------------


class Walk:
    """Walks every path at once."""

    def __init__(self, recipe, effects):
        stack = recipe["stack"]
        listed = layers(stack)
        self.sheet, self.last_sheet = None, 0
        if "coherent_sheets" in effects:
            self.sheet, self.last_sheet = listed[1], len(listed) // 2
            listed = listed[::2]
        media = [stack["ambient"], *listed, stack["substrate"]]
        self.index = np.array([complex(m["n"], m.get("k", 0)) for m in media])
        self.depth = np.array([0] + [4 * np.pi * m["k"] * m["thickness_nm"] / WAVELENGTH_NM for m in listed] + [0])
        self.layers = len(listed)
        self.sd = np.radians(recipe["facets"]["slope_sd_deg"])
        self.visible = recipe["facets"]["normals"] == "visible"
        self.space = recipe["azimuth"]["mode"] == "space"
        self.tracked = "polarisation" in effects

    def facets(self, dice, travel, above):
        """Normals towards the rays, by rejection."""
        normal, missing = np.empty_like(travel), np.arange(len(travel))
        steepest = 6.5 * self.sd if self.space else np.tan(min(6.5 * self.sd, np.radians(80)))
        while len(missing):
            d = travel[missing]
            a, b = self.sd * dice.standard_normal((2, len(d)))
            if self.space:
                m, slope = np.stack([-a, -b, np.ones(len(d))], 1) / np.sqrt(1 + a * a + b * b)[:, None], np.hypot(a, b)
            else:
                m, slope = np.stack([-np.sin(a), 0 * a, np.cos(a)], 1), np.abs(np.tan(a))
            m *= np.where(above[missing], 1, -1)[:, None]
            cos = -(d * m).sum(1)
            taken = cos > 0
            if self.visible:
                most = np.abs(d[:, 2]) + np.hypot(d[:, 0], d[:, 1]) * steepest
                taken &= (slope <= steepest) & (dice.random(len(d)) * most < cos / np.abs(m[:, 2]))
            normal[missing[taken]] = m[taken]
            missing = missing[~taken]
        return normal

    def reflectances(self, first, second, cos, interface):
        """Of s and p."""
        n1, n2 = self.index[first], self.index[second]
        kx2 = n1.real**2 * (1 - cos * cos)
        q1, q2 = np.sqrt(n1 * n1 - kx2), np.sqrt(n2 * n2 - kx2)
        s = (q1 - q2) / (q1 + q2)
        p = (n2 * n2 * q1 - n1 * n1 * q2) / (n2 * n2 * q1 + n1 * n1 * q2)
        is_sheet = (interface >= 1) & (interface <= self.last_sheet)
        if is_sheet.any():
            n1, n2 = n1[is_sheet].real + 0j, self.sheet["n"] + 0j
            kx2 = kx2[is_sheet]
            q1, q2 = np.sqrt(n1 * n1 - kx2), np.sqrt(n2 * n2 - kx2)
            turn = np.exp(4j * np.pi * self.sheet["thickness_nm"] / WAVELENGTH_NM * q2)
            for r, (a, b) in ((s, (q1, q2)), (p, (q1 * n2 / n1, q2 * n1 / n2))):
                face = (a - b) / (a + b)
                r[is_sheet] = face * (1 - turn) / (1 - face * face * turn)
        return [np.minimum(np.abs(r) ** 2, 1) for r in (s, p)]

    def run(self, dice, theta, paths):
        """Fates, and directions of travel."""
        fate, out = np.full(paths, -1), np.zeros((paths, 3))
        path = np.arange(paths)
        d = np.tile([np.sin(theta), 0.0, -np.cos(theta)], (paths, 1))
        medium, interface, events = (np.zeros(paths, int) for _ in range(3))
        entered = np.zeros(paths, bool)
        share = dice.integers(0, 2, paths).astype(float) if self.tracked else np.full(paths, 0.5)
        while len(path):
            above = medium == interface
            other = np.where(above, interface + 1, interface)
            normal = self.facets(dice, d, above)
            events += 1
            cos = -(d * normal).sum(1)
            s, p = self.reflectances(medium, other, cos, interface)
            eta = self.index[medium].real / self.index[other].real
            beyond = 1 - eta**2 * (1 - cos**2)
            reflected = dice.random(len(path)) < share * s + (1 - share) * p
            lost = ~reflected & (beyond <= 0)
            cos_t = np.sqrt(np.maximum(beyond, 0))
            along = np.where(reflected, 2 * cos, eta * cos - cos_t)
            d = np.where(reflected, 1.0, eta)[:, None] * d + along[:, None] * normal
            medium = np.where(reflected, medium, other)
            entered |= ~reflected

            above, up = medium == interface, d[:, 2] > 0
            moves = (above == up) & ~lost
            ends = moves & np.where(up, interface == 0, interface == self.layers)
            crosses = moves & ~ends
            lost |= crosses & (dice.random(len(path)) > np.exp(-self.depth[medium] / np.maximum(np.abs(d[:, 2]), 1e-300)))
            interface = interface + np.where(crosses, np.where(up, -1, 1), 0)
            home = np.where(entered, INTERIOR, np.where(events == 1, SINGLE, REHIT))
            done = ends | lost
            fate[path[done]] = np.where(lost, ABSORBED, np.where(up, home, TRANSMITTED))[done]
            out[path[done]] = d[done]
            path, d, medium, interface, events, entered, share = (a[~done] for a in (path, d, medium, interface, events, entered, share))
        return fate, out


# Tables ------------------------------------------------------------------------------------------------------------------------------


def warped(lo, hi, centre, width, cells):
    """Edges of cells, finest around a centre (docs/LUT-FORMAT.md §3)."""

    def side(room, count):
        return width * np.sinh(np.linspace(0, 1, count + 1) * np.arcsinh(room / width))

    if centre == lo:
        return lo + side(hi - lo, cells)
    return np.concatenate([centre - side(centre - lo, cells // 2)[::-1], centre + side(hi - centre, cells // 2)[1:]])


def edges(axis, theta):
    w, quarter = axis["width"], np.pi / 2

    def held(a):
        return np.hypot(a, w) - a

    if axis["kind"] == "plane":
        return [warped(-quarter, quarter, theta - held(quarter - theta) + held(quarter + theta), w, axis["cells"])]
    centre = theta - held(quarter - theta) + held(theta)
    return [warped(0, quarter, centre, w, axis["theta_cells"]), warped(0, np.pi, 0, w / np.tan(centre), axis["phi_cells"])]


class Table:
    """The one incidence of a file: shares of the incident light by cell and their variances, moments."""

    def __init__(self, path, theta):
        with OpenEXR.File(str(path), separate_channels=True) as file:
            meta = json.loads(file.header()["pearl"])
            channel = {name: c.pixels.astype(float) for name, c in file.channels().items()}
        self.at, self.edges = meta["per_incidence"][0], edges(meta["exit_axis"], theta)
        size = np.diff(self.edges[0])[None]
        if len(self.edges) == 2:
            size = 2 * -np.diff(np.cos(self.edges[0]))[None] * np.diff(self.edges[1])[:, None]
        self.cells, self.errors = {}, {}
        for name, share in (("interior", self.at["albedo"] - self.at["surface"]), ("surface", self.at["surface"])):
            mass = channel[name] * size
            unit = share / mass.sum() if share > 0 else 0.0
            self.cells[name] = (unit * mass).ravel()
            self.errors[name] = (unit * channel[f"{name}_std_error"] * size).ravel()


def binned(counts):
    """Index of the bin of each cell: neighbours together, until they hold FEWEST paths."""
    index, held, at = np.zeros(len(counts), int), 0, 0
    for i, count in enumerate(counts):
        index[i] = at
        held += count
        if held >= FEWEST:
            at, held = at + 1, 0
    return np.minimum(index, at - 1), at


def lobe_p(cells, errors, truth_cells, paths, own_paths):
    """Probability of a χ² as large as that of a lobe; both samples' covariances are multinomial. None where no bin is full."""
    if truth_cells.sum() < FEWEST:
        return None
    index, bins = binned(truth_cells)

    def total(x):
        return np.bincount(index, x, bins)

    got, want = total(cells), total(truth_cells) / paths
    covariance = (np.diag(want) - np.outer(want, want)) / paths
    if own_paths:
        covariance += np.diag(total(errors**2 + cells**2 / own_paths)) - np.outer(got, got) / own_paths
    values, vectors = np.linalg.eigh(covariance)
    kept = values > 1e-9 * values.max()
    z = vectors[:, kept].T @ (got - want) / np.sqrt(values[kept])
    return float(stats.chi2.sf(z @ z, kept.sum()))


def baked(folder, seed):
    """Tables by solver, or the line of the refusal that is due."""
    recipe, theta_deg, effects = request(seed)
    mode, text = recipe["azimuth"]["mode"], folder / f"r{seed}.json"
    text.write_text(json.dumps(recipe))
    solvers = {"walk": ["--paths", PATHS[mode]], "doubling": ["--accuracy", DOUBLING_PERCENT[mode]]}
    if {"coherent_sheets", "polarisation"} & set(effects):
        del solvers["doubling"]
    tables = {}
    for solver, how in solvers.items():
        path = folder / f"r{seed}-{solver}.exr"
        command = [BIN / "bake-brdf", text, "--solver", solver, "--incident-deg", theta_deg, "--cells", CELLS[mode], *how]
        command += ["--effects", ",".join(effects), "--seed", seed % 1000 + 2, "--threads", 1, "-q", "-o", path]
        done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
        if is_refused(recipe["stack"]):
            assert done.returncode == 2 and done.stderr.strip().count("\n") == 0 and not path.exists(), (seed, done)
            return done.stderr.strip()
        assert done.returncode == 0, f"seed {seed}, {recipe}: {done.stderr}"
        tables[solver] = Table(path, np.radians(theta_deg))
    return tables


def judge(folder, seed):
    """("refused", line, recipe) or ("judged", [(solver, what, z or None, p)], recipe)."""
    recipe, theta_deg, effects = request(seed)
    theta, mode = np.radians(theta_deg), recipe["azimuth"]["mode"]
    paths = PATHS[mode]
    tables = baked(folder, seed)
    if isinstance(tables, str):
        return "refused", tables, recipe
    fate, out = Walk(recipe, effects).run(np.random.default_rng([seed, 77]), theta, paths)
    home = fate <= REHIT
    polar = np.arccos(np.clip(out[:, 2], -1, 1))
    if mode == "space":
        places = [polar, np.abs(np.arctan2(out[:, 1], out[:, 0]))]
    else:
        places = [np.where(out[:, 0] >= 0, polar, -polar)]
    found = []
    for solver, table in tables.items():
        at, walked = table.at, solver == "walk"
        systematic = 0 if walked else DOUBLING_PERCENT[mode] / 100 * at["albedo"]

        def compare(what, got, got_error, want, want_error, solver=solver):
            z = (got - want) / np.sqrt(got_error**2 + want_error**2)
            found.append((solver, what, z, 2 * stats.norm.sf(abs(z))))

        wanted = {
            "albedo": home,
            "transmitted": fate == TRANSMITTED,
            "absorbed": fate == ABSORBED,
            "surface": (fate == SINGLE) | (fate == REHIT),
            "rehit": fate == REHIT,
        }
        for what, mask in wanted.items():
            want = mask.mean()
            if FEWEST / paths < want < 1 - FEWEST / paths:
                # A share of re-hits has no error in the file: that of its count is close.
                error = at["std_error"].get(what, np.sqrt(want * (1 - want) / max(at["paths"], 1))) if walked else systematic
                compare(what, at[what], error, want, np.sqrt(want * (1 - want) / paths))
            else:
                assert abs(at[what] - want) < 3 * FEWEST / paths, f"seed {seed}, {recipe}: {what} {at[what]}, {want} expected"
        angle = np.degrees(places[0][home])
        if home.sum() > 2000:
            sd = angle.std()
            fourth = np.mean((angle - angle.mean()) ** 4)
            spread = 0 if walked else DOUBLING_PERCENT[mode] / 100 * 90
            for what, want, error in (
                ("mean_theta_o_deg", angle.mean(), sd / np.sqrt(len(angle))),
                ("sd_theta_o_deg", sd, np.sqrt((fourth - sd**4) / len(angle)) / (2 * sd)),
            ):
                compare(what, at[what], at["std_error"][what] if walked else spread, want, error)
        for what, mask in (("interior", fate == INTERIOR), ("surface", wanted["surface"])):
            counts = np.histogramdd([place[mask] for place in places], table.edges)[0].T.ravel()
            p = lobe_p(table.cells[what], table.errors[what], counts, paths, at["paths"] if walked else 0)
            if p is not None:
                found.append((solver, f"{what} lobe", None, p))
    return "judged", found, recipe
