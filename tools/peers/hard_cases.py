#!/usr/bin/env python3
"""Hard cases for `thinfilm verify` beyond the 83 of tests/data/hard_cases.json, with references in 40 digits.

    pip install mpmath
    python3 tools/peers/hard_cases.py > tests/data/hard_cases_own.json
    python3 tools/peers/hard_cases.py --recompute tests/data/hard_cases.json     # this code against another's references

The cases are ours; the references are plain characteristic matrices, multiplied with so many digits that nothing can cancel, and
condition numbers by differences of 1e-40 of the inputs. Exit code 3 if `--recompute` differs by more than 1e-30.
"""

import argparse
import json
import random
import sys

from mpmath import cos, matrix, mp, mpc, mpf, nstr, pi, sin, sqrt

DIGITS = 40


def root(w):
    """Im >= 0, Re >= 0 where Im = 0."""
    z = sqrt(w)
    return -z if z.imag < 0 or (z.imag == 0 and z.real < 0) else z


def power(unit, repeat):
    product = mp.eye(2)
    while repeat:
        if repeat & 1:
            product = product * unit
        unit, repeat = unit * unit, repeat >> 1
    return product


def response(p):
    """r, t, R, T of a dictionary of exact numbers."""
    n_in, n_sub = p["n_in"], p["n_sub"]
    kx = p["kx"] if p.get("kx") is not None else n_in * sin(p["theta_rad"])
    admittance = lambda n: (root(n * n - kx * kx), n * n)

    def q(n):
        kz, eps = admittance(n)
        return kz if p["pol"] == "s" else kz / eps

    # The ambient's own kz is n cos theta: exact at grazing incidence.
    kz_in = n_in * cos(p["theta_rad"]) if p.get("kx") is None else root(n_in * n_in - kx * kx)
    q_in = kz_in if p["pol"] == "s" else kz_in / (n_in * n_in)
    q_sub = q(n_sub)

    def layer(n, d):
        kz, eps = admittance(n)
        x = 2 * pi / p["lambda_nm"] * d
        delta = kz * x
        sinc = sin(delta) / delta if delta != 0 else mpf(1)
        weight = mpf(1) if p["pol"] == "s" else eps
        return matrix([[cos(delta), -1j * sinc * x * weight], [-1j * kz * kz / weight * sinc * x, cos(delta)]])

    product = mp.eye(2)
    for repeat, unit in p["stack"]:
        period = mp.eye(2)
        for material, d in unit:
            period = period * layer(p["materials"][material], d)
        product = product * power(period, repeat)
    b, c = product * matrix([mpf(1), q_sub])
    r = (q_in * b - c) / (q_in * b + c)
    t_psi = 2 * q_in / (q_in * b + c)
    t = t_psi if p["pol"] == "s" else t_psi * n_in / n_sub
    flux = q_sub.real / q_in.real if q_in.real != 0 else mpf(0)
    return {"r": r, "t": t, "R": abs(r) ** 2, "T": abs(t_psi) ** 2 * flux}


def exact(case):
    index = lambda pair: mpc(mpf(pair[0]), mpf(pair[1]))
    p = {"pol": case["pol"], "lambda_nm": mpf(case["lambda_nm"]), "n_in": index(case["n_in"]), "n_sub": index(case["n_sub"])}
    for angle in ("theta_rad", "kx"):
        if case.get(angle) is not None:
            p[angle] = mpf(case[angle])
    p["materials"] = [index(m) for m in case["materials"]]
    p["stack"] = [(b["repeat"], [(m, mpf(d)) for m, d in b["unit"]]) for b in case["stack"]]
    return p


def digits(case):
    """Twice the decades by which the fields grow, and 100."""
    largest = max([1.0] + [abs(complex(*m)) for m in [*case["materials"], case["n_in"], case["n_sub"]]])
    thickness = sum(b["repeat"] * sum(d for _, d in b["unit"]) for b in case["stack"])
    k = max([abs(m[1]) for m in case["materials"]] + [0.0])
    # Evanescent layers decay with at most n_in; a stop band with the logarithm of the contrast per period.
    evanescent = case["n_in"][0] if any(m[0] < case["n_in"][0] for m in case["materials"]) else 0.0
    decay = 6.3 / case["lambda_nm"] * thickness * (k + evanescent) / 2.3
    periods = sum(b["repeat"] * len(b["unit"]) for b in case["stack"])
    return int(min(6000, 150 + 2 * decay + min(periods, 3000) * 0.3)), largest


def varied(p):
    """Every real input, as (value, function that replaces it)."""

    def replaced(key, value):
        return {**p, key: value}

    yield p["lambda_nm"], lambda x: replaced("lambda_nm", x)
    for key in ("theta_rad", "kx"):
        if key in p:
            yield p[key], lambda x, key=key: replaced(key, x)
    if sum(len(unit) for _, unit in p["stack"]) > 60:
        return
    for key in ("n_in", "n_sub"):
        yield p[key].real, lambda x, key=key: replaced(key, mpc(x, p[key].imag))
        yield p[key].imag, lambda x, key=key: replaced(key, mpc(p[key].real, x))
    for i, m in enumerate(p["materials"]):
        put = lambda z, i=i: replaced("materials", [z if j == i else other for j, other in enumerate(p["materials"])])
        yield m.real, lambda x, put=put, m=m: put(mpc(x, m.imag))
        yield m.imag, lambda x, put=put, m=m: put(mpc(m.real, x))
    for block, (_, unit) in enumerate(p["stack"]):
        for at, (material, d) in enumerate(unit):

            def put(x, block=block, at=at, material=material):
                stack = [(n, list(layers)) for n, layers in p["stack"]]
                stack[block][1][at] = (material, x)
                return replaced("stack", stack)

            yield d, put


def condition(p, base):
    kappa = dict.fromkeys(base, mpf(0))
    for value, replace in varied(p):
        if value == 0:
            continue
        # Inward at 90 degrees and at k that may not change its sign.
        step = mpf(10) ** -40
        moved = response(replace(value * (1 - step)))
        for key in base:
            if base[key] != 0:
                kappa[key] += abs((moved[key] - base[key]) / base[key]) / step
    return {key: float(nstr(value, 4)) if value < mpf(10) ** 300 else None for key, value in kappa.items()}


def solved(case):
    mp.dps, _ = digits(case)
    p = exact(case)
    base = response(p)
    # What only rounding makes of an r that is exactly 0.
    for key in ("r", "R"):
        if abs(base[key]) < mpf(10) ** (-mp.dps // 2):
            base[key] = mpc(0) if key == "r" else mpf(0)
    text = lambda x: nstr(x, DIGITS)
    pair = lambda z: [text(z.real), text(z.imag)]
    reference = {"r": pair(base["r"]), "t": pair(base["t"]), "R": text(base["R"]), "T": text(base["T"])}
    return {**case, "ref": reference, "kappa": condition(p, base)}


def cases():
    nacre = [[1.53, 0.0], [1.43, 0.0]]
    nacre_unit = [[0, 450.0], [1, 25.0]]

    def case(name, why, materials, stack, n_in=1.0, n_sub=1.53, nm=550.0, pols="sp", **wave):
        index = lambda n: [n.real, n.imag] if isinstance(n, complex) else [float(n), 0.0]
        wave = wave or {"theta_rad": 0.5}
        for pol in pols:
            yield {
                "id": f"{name}_{pol}",
                "why": why,
                "pol": pol,
                "lambda_nm": nm,
                "n_in": index(n_in),
                "n_sub": index(n_sub),
                "materials": materials,
                "stack": [{"repeat": n, "unit": unit} for n, unit in stack],
                **wave,
            }

    run = lambda n: [(n, nacre_unit)]
    draw = random.Random(2026)
    irregular = [[i % 2, max(0.0, draw.gauss(*((450, 13.5) if i % 2 == 0 else (25, 0.75))))] for i in range(500)]
    wide = [[i % 2, max(0.0, draw.gauss(*((450, 45) if i % 2 == 0 else (25, 2.5))))] for i in range(500)]
    absorbing = [[1.53, 1e-3], [1.43, 1e-2]]
    right = 1.5707963267948966
    qw = [[2.35, 0.0], [1.46, 0.0]]
    quarter = [[0, 550 / 4 / 2.35], [1, 550 / 4 / 1.46]]
    yield from case("graze_1e-9_irregular", "1e-9 rad from grazing, irregular nacre", nacre, [(1, irregular)], theta_rad=right - 1e-9)
    yield from case("graze_absorbing", "89.9999 deg, absorbing nacre", absorbing, run(250), theta_rad=right * 89.9999 / 90)
    yield from case(
        "graze_total",
        "89.99 deg from glass onto a film of 1.33 and air",
        [[1.33, 0.0]],
        [(1, [[0, 300.0]])],
        n_in=1.5,
        n_sub=1.0,
        theta_rad=right * 89.99 / 90,
    )
    yield from case(
        "near_critical_substrate",
        "1e-9 rad below the critical angle of the substrate",
        nacre,
        run(50),
        n_in=1.5,
        n_sub=1.0,
        theta_rad=0.7297276562269663 - 1e-9,
    )
    yield from case("past_critical_substrate", "1e-12 rad past it", nacre, run(50), n_in=1.5, n_sub=1.0, theta_rad=0.7297276562269663 + 1e-12)
    yield from case(
        "near_critical_in_10000", "kx 1e-7 below the index of every second layer, 10,000 layers", nacre, run(5000), n_in=1.6, kx=1.43 - 1e-7
    )
    yield from case("past_critical_in_10000", "kx 1e-7 above it", nacre, run(5000), n_in=1.6, kx=1.43 + 1e-7)
    yield from case(
        "critical_absorbing_layer",
        "kx at the real index of a layer of k = 1e-9",
        [[1.43, 1e-9], [1.53, 0.0]],
        [(20, [[1, 450.0], [0, 400.0]])],
        n_in=1.6,
        kx=1.43,
    )
    yield from case("tunnel_log_T", "total reflection across 0.2 mm of air", [[1.0, 0.0]], [(1, [[0, 2e5]])], n_in=1.5, n_sub=1.5, theta_rad=1.2)
    yield from case(
        "evanescent_2000",
        "2,000 layers, all evanescent",
        [[1.1, 0.0], [1.2, 0.0]],
        [(1000, [[0, 30.0], [1, 40.0]])],
        n_in=2.0,
        n_sub=2.0,
        theta_rad=1.0,
    )
    yield from case(
        "half_evanescent_1e5",
        "100,000 periods, every second layer evanescent",
        [[1.1, 0.0], [1.7, 0.0]],
        [(100000, [[0, 30.0], [1, 140.0]])],
        n_in=1.7,
        n_sub=1.7,
        theta_rad=0.9,
    )
    yield from case("black_0.1mm", "0.1 mm of k = 3: T far below f64", [[2.0, 3.0]], [(1, [[0, 1e5]])])
    yield from case("grey_10mm", "10 mm of k = 1e-4, coherent", [[1.5, 1e-4]], [(1, [[0, 1e7]])], n_sub=1.0)
    yield from case("k_1e-20", "500 layers of k = 1e-20", [[1.53, 1e-20], [1.43, 1e-20]], run(250))
    yield from case("nacre_1e6", "a million periods in a pass band", nacre, run(10**6), theta_rad=0.3)
    yield from case("nacre_1e6_absorbing", "a million absorbing periods", [[1.53, 1e-6], [1.43, 1e-5]], run(10**6), theta_rad=0.7)
    yield from case("quarter_wave_1e5", "100,000 quarter-wave pairs: T = 1e-41000", qw, [(100000, quarter)], theta_rad=0.0)
    yield from case("quarter_wave_40", "40 quarter-wave pairs, 1 - R = 1e-17", qw, [(40, quarter)], theta_rad=0.2)
    yield from case(
        "cavity",
        "half-wave cavity between mirrors of 12 pairs, at resonance",
        qw,
        [(12, quarter), (1, [[0, 550 / 2 / 2.35]]), (12, quarter[::-1])],
        theta_rad=0.0,
    )
    yield from case(
        "cavity_absorbing",
        "the same with k = 1e-6 in the cavity",
        [*qw, [2.35, 1e-6]],
        [(12, quarter), (1, [[2, 550 / 2 / 2.35]]), (12, quarter[::-1])],
        theta_rad=0.0,
    )
    yield from case("enz_1e-6", "n = k = 1e-6", [[1e-6, 1e-6]], [(1, [[0, 80.0]])], theta_rad=0.4)
    yield from case("enz_negative", "epsilon = -1e-12 + 2e-14 i", [[1e-8, 1e-6]], [(1, [[0, 200.0]])], theta_rad=1e-3)
    yield from case("no_n_small_k", "n = 0, k = 1e-4", [[0.0, 1e-4], [1.5, 0.0]], [(10, [[0, 50.0], [1, 70.0]])], theta_rad=0.8)
    yield from case("no_n_at_normal", "n = 0, k = 2 at normal incidence", [[0.0, 2.0]], [(1, [[0, 30.0]])], theta_rad=0.0)
    yield from case("metal_without_loss_below", "a substrate of n = 0, k = 4", nacre, run(20), n_sub=complex(0.0, 4.0))
    yield from case(
        "plasmon_long_range",
        "30 nm of silver in glass from a denser prism, at the long-range plasmon",
        [[0.05, 3.9], [1.52, 0.0]],
        [(1, [[1, 900.0], [0, 30.0]])],
        n_in=1.8,
        n_sub=1.52,
        nm=633.0,
        kx=1.545,
    )
    yield from case(
        "plasmon_lossless",
        "a resonance that no loss limits: n = 0, k = 3.9",
        [[0.0, 3.9], [1.52, 0.0]],
        [(1, [[1, 600.0], [0, 40.0]])],
        n_in=1.8,
        n_sub=1.52,
        nm=633.0,
        kx=1.55,
    )
    yield from case(
        "metals_no_thickness", "500 sheets of metal of no thickness in nacre", [*nacre, [0.1, 5.0]], [(250, [[0, 450.0], [2, 0.0], [1, 25.0]])]
    )
    yield from case("one_index", "everything of index 1.5, 1 mm", [[1.5, 0.0]], [(100, [[0, 1e4]])], n_in=1.5, n_sub=1.5, theta_rad=right * 89.9 / 90)
    yield from case("almost_one_index", "contrast 1e-14", [[1.5, 0.0], [1.5 + 1e-14, 0.0]], [(1000, [[0, 120.0], [1, 120.0]])], n_in=1.5, n_sub=1.5)
    xray = [[1 - 7.6e-6, 1.7e-7], [1 - 4.5e-5, 4.0e-6]]
    yield from case(
        "x_ray_past_critical",
        "silicon and tungsten for Cu K alpha, 0.3 deg from grazing",
        xray,
        [(50, [[0, 3.0], [1, 1.5]])],
        n_sub=complex(*xray[0]),
        nm=0.15406,
        theta_rad=right * 89.7 / 90,
    )
    yield from case(
        "x_ray_bragg",
        "the same near its Bragg angle",
        xray,
        [(50, [[0, 3.0], [1, 1.5]])],
        n_sub=complex(*xray[0]),
        nm=0.15406,
        theta_rad=right * 89.0 / 90,
    )
    yield from case(
        "neutron_like",
        "n = 1 - 1e-6 without loss, just past total reflection",
        [[1 - 1e-6, 0.0]],
        [(1, [[0, 500.0]])],
        n_sub=1 - 2e-6,
        nm=0.5,
        theta_rad=right - 1.5e-3,
    )
    yield from case(
        "euv",
        "molybdenum and silicon at 13.5 nm",
        [[0.9227, 0.0062], [0.999, 0.0018]],
        [(60, [[0, 2.8], [1, 4.15]])],
        n_sub=complex(0.999, 0.0018),
        nm=13.5,
        theta_rad=0.1,
    )
    yield from case("atom", "1e-9 nm of metal", [[0.2, 3.0]], [(1, [[0, 1e-9]])])
    yield from case("metre", "1 m of glass without loss", [[1.5, 0.0]], [(1, [[0, 1e9]])], n_sub=1.0, theta_rad=0.3)
    yield from case("index_1000", "n = 1000 on glass", [[1000.0, 0.0]], [(1, [[0, 0.2]])], theta_rad=1.0)
    yield from case("radio", "wavelength 1 m on nanometres of metal", [[300.0, 300.0]], [(1, [[0, 10.0]])], nm=1e9, theta_rad=1.1)
    yield from case("gamma", "wavelength 1e-3 nm in nacre", nacre, run(50), nm=1e-3, theta_rad=0.6)
    yield from case("wide_irregular", "10 % irregular nacre at 85 deg", nacre, [(1, wide)], theta_rad=right * 85 / 90)
    yield from case("wide_irregular_absorbing", "the same with absorption", absorbing, [(1, wide)], theta_rad=right * 60 / 90)
    yield from case(
        "thin_enz_60",
        "60 sheets of 0.02 nm of n = 0.06 without loss",
        [[0.0637547457989861, 0.0]],
        [(60, [[0, 0.020159466082092452]])],
        n_sub=complex(1.5, 1e-6),
        nm=780.0,
        theta_rad=0.9365625632065071,
    )
    yield from case("thin_enz_600", "600 of them between sheets of glass", [[0.03, 0.0], [1.5, 0.0]], [(600, [[0, 0.01], [1, 0.01]])], theta_rad=0.9)
    yield from case(
        "brewster_below",
        "p light at the substrate's Brewster angle through a film of its index",
        [[1.53, 0.0]],
        [(1, [[0, 100.0]])],
        pols="p",
        theta_rad=0.9919310470287873,
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recompute", metavar="CASES")
    o = parser.parse_args()
    if not o.recompute:
        source = "tools/peers/hard_cases.py: our own cases, characteristic matrices in mpmath"
        lines = ",\n".join(json.dumps(solved(case)) for case in cases())
        print(f'{{"source": {json.dumps(source)}, "cases": [\n{lines}\n]}}')
        return
    worst = (mpf(0), "")
    for case in json.load(open(o.recompute))["cases"]:
        mp.dps, _ = digits(case)
        found = response(exact(case))
        reference = case["ref"]
        for key in "rt":
            expected = mpc(*(mpf(x) for x in reference[key]))
            error = abs(found[key] - expected) / (abs(expected) if expected else 1)
            worst = max(worst, (error, f"{case['id']} {key}"))
    print(f"largest relative difference: {nstr(worst[0], 3)} ({worst[1]})")
    sys.exit(3 if worst[0] > mpf(10) ** -30 else 0)


if __name__ == "__main__":
    main()
