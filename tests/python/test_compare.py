"""The comparison harness: its quick mode keeps every limit, its verdicts can fail, and it refuses in one line."""

import json
import os
import pathlib
import subprocess
import sys

import numpy as np
import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools" / "compare"))

pytest.importorskip("drjit")
pytest.importorskip("mitsuba")
import llvm  # noqa: E402  (it needs drjit)

LLVM_MISSING = llvm.missing("the comparison harness is")


def compare(*args):
    environment = {"NACRE_BIN": str(ROOT / "target" / "release"), **os.environ}
    return subprocess.run([sys.executable, ROOT / "tools" / "compare", *map(str, args)], capture_output=True, text=True, env=environment)


def test_the_quick_comparison_keeps_its_limits(tmp_path):
    if LLVM_MISSING:
        print(f"\n{LLVM_MISSING}", file=sys.__stderr__)
        pytest.skip(LLVM_MISSING)
    done = compare("--quick", "-o", tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    report = json.loads((tmp_path / "compare.json").read_text())
    assert report["schema"] == "pearl-compare/1" and report["pass"]
    passed = {line["ways"] for line in report["lines"] if line["verdict"] == "pass"}
    assert passed == {"a|b", "c|b", "d|b"}
    # `measured` on the exported file answers in rgb and in spectral variants.
    answered = {line["scene"].split(" · ")[2] for line in report["lines"] if line["ways"] == "a|b"}
    assert answered == {"llvm_ad_rgb", "llvm_ad_spectral"}
    assert all(line["why"] for line in report["lines"] if line["verdict"] == "refused")
    page = (tmp_path / "index.html").read_text()
    assert page.count("<img") > 15 and page.count("class=fail") == 0


def test_bad_usage_is_refused_in_one_line(tmp_path):
    for args, message in (
        (["--ways", "xyz"], "--ways: 'xyz' is not a choice"),
        (["--ways", ""], "--ways: ''"),
    ):
        done = compare("-o", tmp_path / "page", *args)
        assert done.returncode == 2 and message in done.stderr and done.stderr.count("\n") == 1, done.stderr
    assert not (tmp_path / "page").exists()


def test_the_speed_script_times_both_and_refuses_in_one_line(tmp_path):
    if LLVM_MISSING:
        print(f"\n{LLVM_MISSING}", file=sys.__stderr__)
        pytest.skip(LLVM_MISSING)
    script = ROOT / "tools" / "compare" / "speed.py"
    environment = {"NACRE_BIN": str(ROOT / "target" / "release"), **os.environ}
    run = lambda *args: subprocess.run([sys.executable, script, *args], capture_output=True, text=True, env=environment)
    # Small pictures say nothing of the speed: only that both were rendered.
    small = ("--size", "24", "--spp", "4", "--repeats", "2", "--variants", "llvm_ad_rgb", "--json")
    done = run(*small)
    assert done.returncode in (0, 3), done.stderr
    report = json.loads(done.stdout)
    (line,) = report["lines"]
    assert report["schema"] == "pearl-speed/1" and (done.returncode == 0) == report["pass"] == line["pass"]
    for way in ("matte", "pearl", "measured"):
        assert line[way]["seconds"] > 0 and line[way]["variance"] > 0, way
    for args, message in (
        (["--repeats", "3"], "--repeats: 3 is odd"),
        (["--spp", "0"], "--spp: 0 is not a count"),
        (["--table", "/nowhere.exr"], "--table: /nowhere.exr is not a file"),
        (["--variants", "llvm_ad_red"], "--variants: 'llvm_ad_red' is none of"),
    ):
        done = run(*args)
        assert done.returncode == 2 and message in done.stderr and done.stderr.count("\n") == 1, done.stderr


def compare_main():
    import importlib.util

    spec = importlib.util.spec_from_file_location("compare_main", ROOT / "tools" / "compare" / "__main__.py")
    main = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(main)
    return main


def test_pictures_that_differ_fail():
    main = compare_main()
    random = np.random.default_rng(1)
    picture = random.uniform(0.2, 1.0, (256, 3))
    verdicts = lambda lines: [line["verdict"] for line in lines]
    limits = main.LIMIT_MEASURED
    assert verdicts(main.against("x", "a", picture, picture, limits)) == ["pass", "pass", "pass"]
    assert verdicts(main.against("x", "a", picture * 1.002, picture, limits))[:2] == ["pass", "fail"]
    rough = picture * random.normal(1.0, 0.02, picture.shape)
    assert verdicts(main.against("x", "a", rough, picture, limits))[0] == "fail"
    # Noise of 10 % a pixel hides a gap of 0.1 %, but none of 10 %.
    variance = np.full(256, 0.06**2)
    for gap, verdict in ((0.001, "pass"), (0.1, "fail")):
        walked = picture * (1 + gap) + random.normal(0, 0.06, (256, 1))
        plugin = picture + random.normal(0, 0.06, (256, 1))
        assert verdicts(main.noise("x", (walked, variance), (plugin, variance), 16, 1e-3))[0] == verdict


def test_walks_that_seldom_find_light_are_judged_in_patches():
    """Counts of rare hits of one weight: the same picture passes as often as the significance says, a brighter one fails."""
    main = compare_main()
    random = np.random.default_rng(2)
    size, weight = 96, 1e-3
    y, x = np.mgrid[:size, :size] / size

    def judged(brightest, brighter):
        """A small light seen in one corner, and hardly anything elsewhere."""
        rate = 1e-3 + brightest * np.exp(-8 * (x + y)).ravel()
        hits = random.poisson(rate)
        # The plugin sees the light at every sample: noise of 1 % everywhere.
        seen = rate * brighter * random.normal(1.0, 0.01, rate.shape)
        image, plugin = (np.repeat((weight * picture)[:, None], 3, axis=1) for picture in (hits, seen))
        return main.noise("x", (image, hits * weight**2), (plugin, (0.01 * weight * rate) ** 2), size, weight)

    honest = [judged(40, 1.0) for _ in range(200)]
    assert sum(entry["verdict"] == "fail" for lines in honest for entry in lines) <= 3
    # An eighth of the p lies below 1/8, within four standard deviations of 200 draws.
    assert abs(sum(lines[0]["value"] < 0.125 for lines in honest) - 25) < 4 * (200 * 0.125 * 0.875) ** 0.5
    # 6,000 hits see 10 %; 150,000 see 3 %.
    for brightest, brighter in ((40, 1.1), (1000, 1.03)):
        assert all("fail" in [entry["verdict"] for entry in judged(brightest, brighter)] for _ in range(20))


def test_colour_differences_are_those_of_the_reference_data():
    import colour

    # Sharma, Wu & Dalal (2005), table 1, pairs 1, 7, 17 and 25, given as L*a*b*.
    pairs = [
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, 0.0, 0.0), (50.0, -1.0, 2.0), 2.3669),
        ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ]
    original = colour.lab
    try:
        colour.lab = lambda values: values
        for a, b, expected in pairs:
            found = colour.delta_e(np.array([a]), np.array([b]))[0]
            assert abs(found - expected) < 1e-4, (a, b, found)
    finally:
        colour.lab = original
