"""Random requests to `thinfilm spectrum` over all its options, and their answers by other means.

Coherent and incoherent stacks: amplitude matrices and star products in 40 digits (mpmath). Means over lines and ensembles: the same matrices in
NumPy's complex128 over so many waves or thicknesses that nothing is left to converge. A request that has no answer must be refused.
"""

import json
import random
import subprocess

import numpy as np
from built import BIN
from mpmath import cos, exp, matrix, mp, mpc, mpf, pi, sin, sqrt

DIGITS = 40
# Promises: absolute errors of R, T and A of single waves; what a wavelength's rounding (2^-53) changes counts five times on top.
SINGLE = 1e-12
# Known of the references themselves.
LINE_REFERENCE = {"gaussian": 1e-7, "lorentzian": 5e-5}


class Refused(Exception):
    """The request has no answer."""


# Media -------------------------------------------------------------------------------------------------------------------------------


def index(medium, nm):
    """n + ik of a medium of a recipe at a wavelength (a number of any kind)."""
    n, k = medium["n"], medium.get("k", 0)
    if isinstance(n, dict) and "cauchy" in n:
        n = sum(c / (nm * nm / 1000000) ** power for power, c in enumerate(n["cauchy"]))
    elif isinstance(n, dict) and isinstance(nm, np.ndarray):
        at, n, more = np.transpose(n["table"])
        n, k = np.interp(nm, at, n), k + np.interp(nm, at, more)
    elif isinstance(n, dict):
        rows = n["table"]
        upper = next(i for i in range(1, len(rows)) if rows[i][0] >= nm)
        (a, n_a, k_a), (b, n_b, k_b) = rows[upper - 1], rows[upper]
        part = (nm - a) / (b - a)
        n, k = n_a + part * (n_b - n_a), k + k_a + part * (k_b - k_a)
    return n, k


def layers(stack):
    """[(repeat, [layer])], from the ambient down."""
    if "explicit" in stack:
        return [(1, stack["explicit"])]
    pair = [stack["aragonite"], stack["conchiolin"]]
    return [(stack["layers"] // 2, pair), (stack["layers"] % 2, pair[:1])]


def check(stack, angles, nm):
    """What is refused by itself."""
    ambient, substrate = (index(stack[half], nm)[1] for half in ("ambient", "substrate"))
    if ambient < 0 or substrate < 0 or (ambient > 0 and any(angles)):
        raise Refused
    every = [layer for repeat, unit in layers(stack) if repeat for layer in unit]
    if not stack.get("gain") and any(layer.get("k", 0) < 0 for layer in every):
        raise Refused


# 40 digits ---------------------------------------------------------------------------------------------------------------------------


def upper(w):
    z = sqrt(w)
    return -z if z.imag < 0 or (z.imag == 0 and z.real < 0) else z


class Wave:
    """One wave, exact numbers: kx is real or the ambient is met at normal incidence."""

    def __init__(self, stack, nm, angle_deg, pol):
        self.nm, self.pol = mpf(nm), pol
        self.ambient = mpc(*index(stack["ambient"], self.nm))
        self.substrate = mpc(*index(stack["substrate"], self.nm))
        theta = mpf(angle_deg) * pi / 180
        self.kx = self.ambient * sin(theta)
        self.kz_0 = self.ambient * cos(theta)
        self.stack = stack

    def kz(self, n, forward=False):
        kz2 = n * n - self.kx * self.kx
        return sqrt(kz2) if forward and kz2.real > 0 else upper(kz2)

    def q(self, n, forward=False):
        kz = self.kz_0 if n is self.ambient else self.kz(n, forward)
        return kz if self.pol == "s" else kz / (n * n)

    def runs(self):
        return [(r, [(mpc(*index(layer, self.nm)), mpf(layer["thickness_nm"])) for layer in unit]) for r, unit in layers(self.stack) if r]

    def phase(self, n, d):
        delta = 2 * pi * d / self.nm * self.kz(n)
        return matrix([[exp(-1j * delta), 0], [0, exp(1j * delta)]])

    def through(self, q_a, q_b):
        """Amplitudes of psi above an interface from those below."""
        ratio = q_b / q_a
        return matrix([[(1 + ratio) / 2, (1 - ratio) / 2], [(1 - ratio) / 2, (1 + ratio) / 2]])

    def group(self, q_a, runs, q_b):
        """The matrix between two media. Every run in a medium of admittance q_a, a medium of no thickness."""
        whole = mp.eye(2)
        for repeat, unit in runs:
            period = mp.eye(2)
            for n, d in unit:
                q = self.q(n)
                period = period * self.through(q_a, q) * self.phase(n, d) * self.through(q, q_a)
            whole = whole * period**repeat
        return whole * self.through(q_a, q_b)


def coherent(stack, nm, angle, pol):
    """R, T."""
    wave = Wave(stack, nm, angle, pol)
    q_a, q_b = wave.q(wave.ambient), wave.q(wave.substrate)
    m = wave.group(q_a, wave.runs(), q_b)
    return abs(m[1, 0] / m[0, 0]) ** 2, q_b.real / q_a.real / abs(m[0, 0]) ** 2


def star(a, b):
    """(R, R', T) above (R, R', T)."""
    if a[1] * b[0] >= 1:
        raise Refused
    inner = 1 - a[1] * b[0]
    return a[0] + a[2] ** 2 * b[0] / inner, b[1] + b[2] ** 2 * a[1] / inner, a[2] * b[2] / inner


def mixed(stack, nm, angle, pol, above_nm):
    """R, T where layers thicker than `above_nm` in which light travels add intensities."""
    wave = Wave(stack, nm, angle, pol)
    if wave.ambient.imag != 0:
        raise Refused
    q_a, unit, whole = wave.q(wave.ambient), [], (mpf(0), mpf(0), mpf(1))

    def between(q_b, open_end):
        m = wave.group(q_a, [(1, unit)], q_b)
        # From below t is t q_b/q_a; the determinant has lost its digits where the group is opaque.
        passed = (q_b.real if open_end else abs(q_b)) / abs(q_a) / abs(m[0, 0]) ** 2
        return abs(m[1, 0] / m[0, 0]) ** 2, abs(m[0, 1] / m[0, 0]) ** 2, passed

    every = [layer for repeat, of_run in wave.runs() for layer in of_run * repeat]
    for n, d in every:
        if d <= above_nm or (n * n - wave.kx**2).real <= 0:
            unit.append((n, d))
            continue
        q_b = wave.q(n, forward=True)
        whole = star(whole, between(q_b, False))
        kz = wave.kz(n, forward=True)
        whole = star(whole, (mpf(0), mpf(0), exp(-4 * pi * d / wave.nm * kz.imag)))
        q_a, unit = q_b, []
    whole = star(whole, between(wave.q(wave.substrate), True))
    return whole[0], whole[2]


# complex128 --------------------------------------------------------------------------------------------------------------------------


def spectra(stack, nm, angle, pol, thicknesses=None):
    """R, T over arrays of wavelengths and of each layer's thickness."""
    nm = np.asarray(nm, dtype=float)
    value = lambda medium: (lambda n, k: np.asarray(n + 1j * k))(*index(medium, nm))
    ambient, substrate = value(stack["ambient"]), value(stack["substrate"])
    kx = ambient * np.sin(np.radians(angle))

    def q(n):
        kz = np.sqrt(n * n - kx * kx)
        kz = np.where((kz.imag < 0) | ((kz.imag == 0) & (kz.real < 0)), -kz, kz)
        return kz, kz if pol == "s" else kz / (n * n)

    q_0 = ambient * np.cos(np.radians(angle)) / (1 if pol == "s" else ambient**2)
    every = [layer for repeat, unit in layers(stack) for layer in unit * repeat]
    thicknesses = [layer["thickness_nm"] for layer in every] if thicknesses is None else thicknesses
    _, q_sub = q(substrate)
    b, c, decay = np.ones_like(nm, dtype=complex), q_sub + np.zeros_like(nm), np.zeros_like(nm)
    known = {}
    for layer, d in zip(reversed(every), reversed(thicknesses)):
        key = id(layer)
        if key not in known:
            known[key] = q(value(layer))
        kz, admittance = known[key]
        delta = 2 * np.pi * d / nm * kz
        # Without their growth, which would overflow.
        back = np.exp(2j * delta)
        cosine, sine, decay = (1 + back) / 2, (back - 1) / 2j, decay + delta.imag
        b, c = cosine * b - 1j * sine / admittance * c, cosine * c - 1j * admittance * sine * b
    below = q_0 * b + c
    return np.abs((q_0 * b - c) / below) ** 2, 4 * q_0.real * q_sub.real / np.abs(below) ** 2 * np.exp(-2 * decay)


def over_a_line(stack, nm, angle, pol, width, shape, waves):
    """R, T: trapezoids over a Gaussian, points at random places of equal strata over all of a Lorentzian."""
    share = width / nm
    if shape == "gaussian":
        x = np.linspace(-3.4, 3.4, waves)
        weight = np.exp(-4 * np.log(2) * x * x)
    else:
        strata = (np.arange(waves) + np.random.default_rng(waves).random(waves)) / waves
        x = 0.5 * np.tan(np.pi * (strata - 0.5))
        weight = np.ones(waves)
    total = np.zeros(2)
    for part in np.array_split(np.arange(waves), max(1, waves // 65536)):
        values = spectra(stack, nm / np.abs(1 + x[part] * share), angle, pol)
        total += [np.sum(weight[part] * v) for v in values]
    return total / weight.sum()


def over_thickness(stack, nm, angle, pol):
    """R, T of an ensemble whose one irregular layer has a normal distribution without its negative part."""
    every = [layer for repeat, unit in layers(stack) for layer in unit * repeat]
    at = next(i for i, layer in enumerate(every) if layer.get("thickness_sd_nm"))
    mean, sd = every[at]["thickness_nm"], every[at]["thickness_sd_nm"]
    d = np.linspace(max(0.0, mean - 9 * sd), mean + 9 * sd, 100_001)
    weight = np.exp(-0.5 * ((d - mean) / sd) ** 2)
    weight[[0, -1]] *= 0.5
    thicknesses = [d if i == at else layer["thickness_nm"] for i, layer in enumerate(every)]
    return [np.sum(weight * v) / weight.sum() for v in spectra(stack, np.full_like(d, nm), angle, pol, thicknesses)]


# Requests ----------------------------------------------------------------------------------------------------------------------------


def medium(draw, kind):
    """A dielectric (clear or absorbing), a metal, or an amplifier."""
    n = draw.uniform(1.2, 2.6)
    if kind == "metal":
        return {"n": draw.uniform(0.05, 2.5), "k": draw.uniform(0.5, 5.0)}
    if kind == "gain":
        return {"n": n, "k": -(10 ** draw.uniform(-6, -1.5))}
    if kind == "absorbing":
        return {"n": n, "k": 10 ** draw.uniform(-12, 0)}
    if draw.random() < 0.15:
        return {"n": {"cauchy": [n, draw.uniform(0, 0.02), draw.uniform(0, 0.001)]}, "k": 0.0}
    if draw.random() < 0.15:
        rows = [[nm, n + draw.uniform(-0.1, 0.1), draw.choice([0.0, draw.uniform(0, 0.3)])] for nm in (300.0, 500.0, 640.0, 900.0)]
        return {"n": {"table": rows}, "k": 0.0}
    return {"n": n, "k": 0.0}


def stack_of(draw, gain, thick):
    kinds = ["clear"] * 5 + ["absorbing"] * 3 + ["metal"] + (["gain"] * 3 if gain else [])
    thickness = lambda: draw.choice([draw.uniform(0, 50), draw.uniform(50, 600), draw.uniform(600, 4000)])
    layer = lambda: {**medium(draw, draw.choice(kinds)), "thickness_nm": thickness()}
    stack = {
        "ambient": {"n": draw.choice([1.0, 1.0, draw.uniform(1, 2)])},
        "substrate": medium(draw, draw.choice(["clear", "clear", "absorbing", "metal"])),
    }
    if thick or draw.random() < 0.8:
        stack["explicit"] = [layer() for _ in range(draw.randint(1, 16))]
        for at in draw.sample(range(len(stack["explicit"])), min(thick, len(stack["explicit"]))):
            stack["explicit"][at]["thickness_nm"] = 10 ** draw.uniform(3.7, 6)
    else:
        stack |= {"layers": int(10 ** draw.uniform(0, 3.5)), "aragonite": layer(), "conchiolin": layer()}
    if draw.random() < 0.03:
        stack["ambient"]["k"] = 10 ** draw.uniform(-12, 0)
    if gain:
        stack["gain"] = True
        if draw.random() < 0.05:
            stack["substrate"]["k"] = -(10 ** draw.uniform(-9, -1))
    return stack


def cavity(draw, pairs):
    """Two mirrors about a spacer, tuned to some visible wavelength."""
    centre, high, low = draw.uniform(450, 650), draw.uniform(1.9, 2.6), draw.uniform(1.3, 1.6)
    # No narrower than the waves of the reference resolve.
    pairs = min(pairs, int(0.5 * np.log(5e4) / np.log(high / low)))
    k = draw.choice([0.0, 0.0, 10 ** draw.uniform(-7, -4)])
    quarter = lambda n: {"n": n, "k": k if n == high else 0.0, "thickness_nm": centre / 4 / n}
    a, b = quarter(high), quarter(low)
    spacer = {**b, "thickness_nm": 2 * b["thickness_nm"] * draw.randint(1, 3)}
    explicit = [a, b] * pairs + [a, spacer, a] + [b, a] * pairs
    return {"ambient": {"n": 1.0}, "explicit": explicit, "substrate": {"n": draw.choice([1.0, 1.5])}}, centre


def request(seed):
    """Kind, recipe, angles, wavelengths, polarisation, flags and what they say."""
    draw = random.Random(seed)
    kind = draw.choice(["coherent"] * 3 + ["mixed"] * 3 + ["gaussian", "lorentzian", "members", "accuracy"])
    gain = kind in ("coherent", "mixed") and draw.random() < 0.25
    angles = sorted({draw.choice([0.0, draw.uniform(0, 60), draw.uniform(60, 89.9), 45.0]) for _ in range(2)})
    nms = [draw.uniform(380, 780)]
    option = {}
    if kind in ("coherent", "mixed"):
        stack = stack_of(draw, gain, draw.randint(1, 3) if kind == "mixed" else 0)
        if kind == "mixed":
            option["above_nm"] = draw.choice([4000.0, 4000.0, draw.uniform(0, 4000)])
    else:
        stack = {"ambient": {"n": 1.0}, "substrate": medium(draw, draw.choice(["clear", "absorbing", "metal"]))}
        plain = lambda m: {**m, "n": m["n"] if kind == "gaussian" or not isinstance(m["n"], dict) else 1.7}
        stack["substrate"] = plain(stack["substrate"])
        count = draw.randint(1, 6)
        stack["explicit"] = [
            {**plain(medium(draw, draw.choice(["clear", "clear", "absorbing"]))), "thickness_nm": draw.uniform(20, 3000)} for _ in range(count)
        ]
        angles = angles[:1]
        if kind in ("gaussian", "lorentzian"):
            option["width"] = draw.uniform(0.5, 12)
            if draw.random() < 0.6:
                stack, centre = cavity(draw, draw.randint(2, 10 if kind == "gaussian" else 4))
                angles, nms = [0.0], [centre + draw.uniform(-0.5, 0.5) * option["width"]]
            elif any(isinstance(m["n"], dict) and "table" in m["n"] for m in [*stack["explicit"], stack["substrate"]]):
                option["width"] = min(option["width"], 10.0)
        else:
            layer = stack["explicit"][draw.randrange(count)]
            layer["thickness_sd_nm"] = layer["thickness_nm"] * draw.choice([0.5, draw.uniform(0, 0.2)])
            if draw.random() < 0.3:
                stack, centre = cavity(draw, draw.randint(2, 6))
                spacer = len(stack["explicit"]) // 2
                layer = stack["explicit"][spacer]
                stack["explicit"][spacer] = {**layer, "thickness_sd_nm": 0.02 * layer["thickness_nm"]}
                angles, nms = [0.0], [centre]
            option[kind] = 2048 if kind == "members" else draw.choice([0.01, 0.003])
    flags = {
        "coherent": [],
        "mixed": ["--incoherent-above-nm", str(option.get("above_nm"))],
        "gaussian": ["--line-width-nm", str(option.get("width"))],
        "lorentzian": ["--line-width-nm", str(option.get("width")), "--line-shape", "lorentzian"],
        "members": ["--members", str(option.get("members")), "--seed", str(seed)],
        "accuracy": ["--accuracy", str(option.get("accuracy")), "--seed", str(seed)],
    }[kind]
    return {"seed": seed, "kind": kind, "stack": stack, "angles": angles, "nms": nms, "pol": draw.choice("spu"), "flags": flags, "option": option}


def ask(folder, r):
    """The tool's answer, or None where it refuses in one line."""
    path = folder / f"{r['seed']}.json"
    path.write_text(json.dumps({"stack": r["stack"]}))
    command = [
        BIN / "thinfilm",
        "spectrum",
        path,
        "--angles-deg",
        ",".join(map(repr, r["angles"])),
        "--wavelengths-nm",
        f"{r['nms'][0]!r}:{r['nms'][0]!r}:1",
        "--pol",
        r["pol"],
        "--json",
        *r["flags"],
    ]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode == 2:
        assert len(done.stderr.strip().splitlines()) == 1, done.stderr
        return None
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def mean_of(pol, value):
    s_p = [value(each) for each in (pol if pol != "u" else "sp")]
    return [sum(values) / len(s_p) for values in zip(*s_p)]


def off(r, answer):
    """[(error, what is promised)] of the answer to a request."""
    kind, stack, nm, option = r["kind"], r["stack"], r["nms"][0], r["option"]
    found = []
    for at, angle in enumerate(r["angles"]):
        ours = [answer[name][at][0] for name in "RTA"]
        if kind in ("coherent", "mixed"):
            one = lambda nm: mean_of(
                r["pol"], lambda pol: coherent(stack, nm, angle, pol) if kind == "coherent" else mixed(stack, nm, angle, pol, option["above_nm"])
            )
            theirs = one(mpf(nm))
            theirs = [*theirs, 1 - sum(theirs)]
            largest = float(max(1, *map(abs, theirs)))
            promise = SINGLE * largest**1.5
            error = max(float(abs(a - b)) for a, b in zip(ours, theirs))
            if stack["ambient"].get("k"):
                error = max(float(abs(a - b)) for a, b in zip(ours[:2], theirs))
            if error > promise:
                step = mpf(10) ** -18
                slope = max(abs(a - b) for a, b in zip(one(mpf(nm) * (1 + step)), theirs)) / step
                promise += 5 * 2.0**-53 * float(slope)
            found.append((error, promise))
        elif kind in ("gaussian", "lorentzian"):
            waves = 1 << (19 if kind == "gaussian" else 20)
            theirs = mean_of(r["pol"], lambda pol: over_a_line(stack, nm, angle, pol, option["width"], kind, waves))
            error = max(abs(a - b) for a, b in zip(ours, theirs))
            assert answer["converged"] == (answer["error"] <= answer["accuracy"]), answer
            found.append((error, answer["error"] + LINE_REFERENCE[kind]))
        else:
            theirs = mean_of(r["pol"], lambda pol: over_thickness(stack, nm, angle, pol))
            for name, ours_, theirs_ in zip("RT", ours, theirs):
                # Five standard errors: one in two million, were they normal; 5/N for what is rarer than one member in N.
                deviation = 5 * answer[f"{name}_std_error"][at][0] + 5 / answer["members"] + 1e-9
                found.append((abs(ours_ - theirs_), deviation))
            if kind == "accuracy":
                assert answer["converged"] and answer["R_std_error"][0][0] <= option["accuracy"], answer
                assert answer["members"] * option["accuracy"] >= 1, answer
    return found


def judge(folder, seed):
    """Kind, largest error and largest ratio to the promise; errors where refusals differ."""
    r = request(seed)
    answer = ask(folder, r)
    with mp.workdps(DIGITS):
        try:
            check(r["stack"], r["angles"], r["nms"][0])
            if answer is None:
                if r["kind"] == "mixed":
                    for angle in r["angles"]:
                        mean_of(r["pol"], lambda pol: mixed(r["stack"], r["nms"][0], angle, pol, r["option"]["above_nm"]))
                raise AssertionError(f"seed {seed}: refused: {r}")
            errors = off(r, answer)
        except Refused:
            assert answer is None, f"seed {seed}: not refused: {r}"
            return r["kind"], "refused", 0.0, 0.0
    worst = max(errors, key=lambda pair: pair[0] / pair[1])
    assert worst[0] <= worst[1], f"seed {seed}: off by {worst[0]:.2e}, promised {worst[1]:.2e}: {r}\n{answer}"
    return r["kind"], "answered", max(error for error, _ in errors), worst[0] / worst[1]
