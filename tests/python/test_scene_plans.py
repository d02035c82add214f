"""Plans of scenes, read by Mitsuba's own parser: which pearls are shown, how, and what is refused. Hardly anything is baked."""

import json
import pathlib
import re
import subprocess
import sys

import numpy as np
import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]
SCENES = ROOT / "data" / "scenes"
PLANS = json.loads((SCENES / "plans.json").read_text())

mi = pytest.importorskip("mitsuba")
import nacre  # noqa: E402
import nacre.cache  # noqa: E402
import nacre.mitsuba.scene  # noqa: E402
from nacre.__main__ import main  # noqa: E402

# No lobe and no colours: what is asked is who is shown.
DULL = '<float name="brightness" value="0"/><float name="depth" value="0"/>'
THIN = {"name": "thin", "stack": {"layers": 6}, "facets": {"slope_sd_deg": 8}}


@pytest.fixture(autouse=True)
def coarse(monkeypatch, tmp_path):
    """Costs are looked for at an accuracy that takes no time; files of scenes lie in a folder of their own."""
    monkeypatch.setattr(nacre.cache, "ACCURACY", 30.0)
    monkeypatch.setattr(nacre.cache, "_in_memory", {})
    monkeypatch.setenv("NACRE_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    mi.set_variant("scalar_rgb")


def write(name, text):
    path = pathlib.Path(name)
    path.parent.mkdir(exist_ok=True)
    path.write_text(text) if isinstance(text, str) else path.write_bytes(text)


def scene(body, version="3.0.0"):
    return f'<scene version="{version}">{body}</scene>'


def plan(text, **options):
    write("s.xml", text)
    return {pearl["id"]: pearl for pearl in nacre.plan("s.xml", **options)["pearls"]}


def pearl(name, inner=DULL):
    return f'<bsdf type="pearl" id="{name}">{inner}</bsdf>'


def shown(text):
    return sorted(name for name, found in plan(text).items() if found["used"])


def on(found):
    return {name for name, effect in found["effects"].items() if effect["on"]}


def on_sphere(inner, name="p"):
    return scene(f'{pearl(name, inner)}<shape type="sphere"><ref id="{name}"/></shape>')


@pytest.mark.parametrize("name", PLANS)
def test_every_scene_has_the_plan_written_for_it(name, monkeypatch):
    # What the effects cost takes seconds to foresee: here it is not asked.
    monkeypatch.setattr(nacre.mitsuba.scene, "plan_pearls", lambda pearls, **_: pearls)
    pearls = nacre.plan(SCENES / f"{name}.xml")
    for each in pearls:
        each["effects"] = nacre.effects(each["recipe"], each["look"])
    found = {each["id"]: on(each) if each["used"] else "unused" for each in pearls}
    assert found == {id: effects if effects == "unused" else set(effects.split()) for id, effects in PLANS[name].items()}


GROUP = '<shape type="shapegroup" id="g"><shape type="sphere"><ref id="a"/></shape></shape>'


@pytest.mark.parametrize(
    "body, expected",
    {
        "a group without an instance": (GROUP, []),
        "a group with an instance": (GROUP + '<shape type="instance"><ref id="g"/></shape>', ["a"]),
        "a named reference": (GROUP + '<shape type="instance"><ref name="shapegroup" id="g"/></shape>', ["a"]),
        "merged shapes": ('<shape type="merge"><shape type="sphere"><ref id="a"/></shape></shape>', ["a"]),
        "twosided": ('<shape type="sphere"><bsdf type="twosided"><ref id="a"/><ref id="b"/></bsdf></shape>', ["a", "b"]),
        "nested adapters": (
            '<bsdf type="mask" id="m"><float name="opacity" value="0.5"/><bsdf type="bumpmap"><texture type="checkerboard"/>'
            '<bsdf type="twosided"><ref id="b"/></bsdf></bsdf></bsdf><shape type="disk"><ref id="m"/></shape>',
            ["b"],
        ),
        "an adapter of no kind that is known": ('<shape type="disk"><bsdf type="varnish"><ref name="under" id="a"/></bsdf></shape>', ["a"]),
        "a mask that hides": (
            '<shape type="disk"><bsdf type="mask"><float name="opacity" value="0"/><ref id="a"/></bsdf></shape>',
            [],
        ),
        "a blend of weight 0 in a blend of weight 1": (
            '<shape type="disk"><bsdf type="blendbsdf"><float name="weight" value="1.0"/><ref id="a"/>'
            '<bsdf type="blendbsdf"><float name="weight" value="0"/><ref id="b"/><ref id="c"/></bsdf></bsdf></shape>',
            ["b"],
        ),
        "an alias": ('<alias id="a" as="z"/><shape type="disk"><ref id="z"/></shape>', ["a"]),
        "a comment": ('<!-- <shape type="disk"><ref id="a"/></shape> -->', []),
        "shared by shapes": ('<shape type="disk"><ref id="a"/></shape><shape type="cube"><ref id="a"/></shape>', ["a"]),
        "groups of groups": (
            '<shape type="shapegroup" id="g0"><shape type="sphere"><ref id="a"/></shape></shape>'
            + "".join(
                f'<shape type="shapegroup" id="g{i}">' + f'<shape type="instance"><ref id="g{i - 1}"/></shape>' * 10 + "</shape>"
                for i in range(1, 12)
            )
            + '<shape type="instance"><ref id="g11"/></shape>',
            ["a"],
        ),
    }.values(),
)
def test_a_plan_finds_the_pearls_that_are_shown(body, expected):
    assert shown(scene(pearl("a") + pearl("b") + pearl("c") + body)) == expected


def test_shapes_places_and_tables_are_those_of_the_scene():
    write("r.json", json.dumps(THIN))
    given = '<string name="recipe" value="r.json"/>'
    body = f"""
        {pearl("a", given)}
        {pearl("b", given + '<float name="coherence" value="0"/>')}
        {pearl("c", given)}
        <shape type="disk"><bsdf type="normalmap"><texture type="checkerboard"/><ref id="a"/></bsdf></shape>
        <shape type="cube"><ref id="b"/></shape><shape type="sphere"><ref id="c"/></shape>"""
    write("s.xml", scene(body))
    report = nacre.plan("s.xml")
    a, b, c = report["pearls"]
    assert [a["place"], a["shapes"], a["recipe_from"]] == ["s.xml:2", ["disk (s.xml:5)"], "r.json"]
    assert a["effects"]["texture"]["why"] == "normalmap (s.xml:5)" and not b["effects"]["texture"]["on"]
    assert b["effects"]["coherent"]["why"] == "coherence 0 (s.xml:3)" and a["effects"]["coherent"]["why"] == "coherence 0.5 (r.json)"
    # The same effects but for the texture, which no table holds.
    assert [found["table"] for found in (a, b, c)] == [0, 1, 0] and len(report["tables"]) == 2
    assert report["schema"] == "bake-plan/1" and report["seconds"] == pytest.approx(sum(table["seconds"] for table in report["tables"]))
    for found in (a, b, c):
        assert len(found["effects"]) == 13 and all(effect["why"] for effect in found["effects"].values())
        assert all(effect["on"] or effect["seconds"] == effect["bytes"] == 0 for effect in found["effects"].values())
    # A table is paid for once.
    assert a["effects"]["surface"]["bytes"] > 0 and c["effects"]["surface"]["bytes"] == 0


def test_values_of_names_go_before_their_defaults_and_those_of_no_name_are_refused():
    inner = '<float name="brightness" value="0"/><float name="depth" value="$deep"/>'
    text = scene(f'<default name="deep" value="0"/>{pearl("a", inner)}<shape type="disk"><ref id="a"/></shape>')
    assert "emission" not in on(plan(text)["a"])
    assert "emission" in on(plan(text, defaults={"deep": 0.5})["a"])
    for defaults, said in (({"depe": "0"}, "unused parameters: - $depe=0"), ({"filename": "x"}, r"\$filename: ")):
        with pytest.raises(nacre.InputError, match=re.escape(said) if "-" in said else said):
            nacre.plan("s.xml", defaults=defaults)


def test_the_variant_is_the_one_given_or_what_the_scene_hints_at():
    write("r.json", json.dumps(THIN | {"stack": {"layers": 6, "aragonite": {"n": {"cauchy": [1.5, 0.01]}}}}))
    body = '<string name="recipe" value="r.json"/>'
    why = lambda text, effect, **options: plan(text, **options)["p"]["effects"][effect]["why"]
    plain = on_sphere(body)
    assert why(plain, "polarisation") == "the variant is not polarised (default)"
    assert why(plain, "polarisation", variant="llvm_ad_spectral_polarized") == "the variant is polarised (as given)"
    assert why(plain, "dispersion", variant="mono") == "the variant has one band (as given)"
    hinted = plain.replace("</scene>", '\n<integrator type="stokes"><integrator type="path"/></integrator></scene>')
    assert why(hinted, "polarisation") == "the variant is polarised (s.xml:2)"
    film = '\n<sensor type="perspective"><film type="hdrfilm"><string name="pixel_format" value="luminance"/></film></sensor></scene>'
    assert why(plain.replace("</scene>", film), "dispersion") == "the variant has one band (s.xml:2)"
    with pytest.raises(nacre.InputError, match='variant: "cmyk" is none; expected mono, rgb'):
        nacre.plan("s.xml", variant="cmyk")


DULL_PEARL = f'<bsdf type="pearl" id="p">{DULL}</bsdf>'
SHOWN = scene(f'<shape type="sphere">{DULL_PEARL}</shape>')


@pytest.mark.parametrize(
    "files, expected",
    {
        "an include of an include is looked for beside the one that holds it": (
            {"s.xml": scene('<include filename="sub/b.xml"/>'), "sub/b.xml": scene('<include filename="c.xml"/>'), "sub/c.xml": SHOWN},
            "sub/c.xml:1",
        ),
        "an include of an old version": (
            {
                "s.xml": scene('<include filename="sub/old.xml"/>'),
                "sub/old.xml": scene(
                    '<shape type="rectangle"><transform name="toWorld"><scale value="2"/></transform>'
                    + DULL_PEARL.replace("<float", '<rgb name="bodyColor" value="0.5"/><float', 1)
                    + "</shape>",
                    "0.6.0",
                ),
            },
            "sub/old.xml:1",
        ),
        "a dollar that is escaped": ({"s.xml": on_sphere(DULL, "p\\$1")}, "s.xml:1"),
        "a blank line first": ({"s.xml": '\n<?xml version="1.0"?>\n' + SHOWN}, "s.xml:3"),
        "an ampersand alone": ({"s.xml": SHOWN.replace("<shape", '<default name="note" value="salt & pepper"/><shape')}, "s.xml:1"),
        "UTF-16": ({"s.xml": SHOWN.encode("utf-16")}, "s.xml:1"),
        "a byte-order mark": ({"s.xml": b"\xef\xbb\xbf" + SHOWN.encode()}, "s.xml:1"),
    }.values(),
)
def test_what_mitsuba_reads_is_read(files, expected):
    for name, text in files.items():
        write(name, text)
    [found] = nacre.plan("s.xml")["pearls"]
    assert found["used"] and found["place"].endswith(expected)


def test_files_are_looked_for_where_mitsuba_looks_for_them(tmp_path, monkeypatch):
    for folder in ("", "lib/", "later/"):
        write(f"{folder}r.json", json.dumps(THIN | {"name": folder or "here"}))
    paths = '<path value="lib"/><path value="later"/>'
    given = '<string name="recipe" value="r.json"/>'
    before = str(mi.file_resolver())
    monkeypatch.chdir("/")
    for path, expected in ((paths, "later/"), (paths[:19], "lib/"), ("", "here")):
        write(tmp_path / "s.xml", on_sphere(given + DULL).replace("<bsdf", path + "<bsdf"))
        [found] = nacre.plan(tmp_path / "s.xml")["pearls"]
        assert found["recipe"]["name"] == expected
    assert str(mi.file_resolver()) == before and mi.variant() == "scalar_rgb"


UNIFORM = 'name="body_color" type="uniform"><float name="value" value="0.5"/>'


@pytest.mark.parametrize(
    "body, why, textured",
    [
        (f"<spectrum {UNIFORM}</spectrum>", "is a texture (s.xml:2)", False),
        (f"<texture {UNIFORM}</texture>", "is a texture (s.xml:2)", False),
        ('<texture name="body_color" type="mesh_attribute"><string name="name" value="vertex_c"/></texture>', "is a texture (s.xml:2)", True),
        ('<spectrum name="body_color" value="400:0.1, 700:0.5"/>', "is a texture (s.xml:1)", False),
        ('<rgb name="body_color" value="0.5 0.25 0.5"/>', "0.5 0.25 0.5 (s.xml:1)", False),
        ('<float name="body_color" value="0.5"/>', "0.5 0.5 0.5 (s.xml:1)", False),
    ],
)
def test_body_colours_are_numbers_spectra_and_textures(body, why, textured):
    effects = plan(on_sphere(f"{DULL}\n{body}"))["p"]["effects"]
    assert effects["body"]["why"] == f"body_color {why}" and effects["texture"]["on"] == textured


@pytest.mark.parametrize(
    "text, said",
    {
        "misspelt": ('<float name="brightnes" value="0"/>', "brightnes: no such parameter (did you mean 'brightness'?)"),
        "British": ('<rgb name="body_colour" value="0.5"/>', "body_colour: no such parameter (did you mean 'body_color'?)"),
        "far from any": ('<float name="zzz" value="0"/>', "zzz: no such parameter; expected one of filename"),
        "a BSDF inside": ('<bsdf type="diffuse"/>', "_arg_0: no such parameter"),
        "out of range": ('<float name="depth" value="1.5"/>', "depth: 1.5 is not valid; expected a number from 0 to 1"),
        "infinite": ('<float name="depth" value="inf"/>', "depth: inf is not valid"),
        "a text for a number": ('<string name="coherence" value="0.5"/>', "coherence: '0.5' is not valid"),
        "a colour out of range": ('<rgb name="tint" value="0.1 2 0.3"/>', "tint[1]: 2.0 is not valid"),
        "a spectrum for a tint": ('<spectrum name="tint" value="400:0.1, 700:0.5"/>', "tint: a "),
        "a text for a colour": ('<string name="body_color" value="red"/>', "body_color: is no colour, spectrum or texture"),
        "hexadecimal": ('<rgb name="body_color" value="#808080"/>', 'could not parse RGB value "#808080"'),
        "a thickness out of range": ('<float name="thickness" value="3"/>', "thickness: is 3; expected a number from 0.7 to 1.4"),
        "a text for a thickness": ('<string name="thickness" value="1"/>', "thickness: is no number or texture"),
        "components: sum": ('<string name="components" value="sum"/>', "components: 'sum' is none of them"),
        "components: +": ('<string name="components" value="mirror+blur"/>', "components: 'mirror+blur' is none"),
        "components: blanks": ('<string name="components" value="mirror blur"/>', "components: 'mirror blur' is none"),
        "components: nothing between": ('<string name="components" value="mirror,,blur"/>', "components: '' is none"),
        "components: all and one": ('<string name="components" value="all,mirror"/>', "components: 'all' is none"),
        "no recipe": ('<string name="recipe" value="gone.json"/>', "gone.json: there is no such file"),
        "a bad recipe": ('<string name="recipe" value="bad.json"/>', "bad.json: stack.layers"),
        "no table": ('<string name="filename" value="fake.exr"/>', "fake.exr"),
        "a table and a recipe": ('<string name="filename" value="t.exr"/><string name="recipe" value="akoya"/>', "both are given"),
    }.values(),
)
def test_what_the_plugin_refuses_is_refused_with_the_same_words_and_the_place(text, said):
    write("bad.json", '{"stack": {"layers": 0}}')
    write("fake.exr", "no table")
    # A thin pearl, where none is named: what is refused only after a bake is refused after a short one.
    write("r.json", json.dumps(THIN))
    given = "" if "recipe" in text or "filename" in text else '<string name="recipe" value="r.json"/>'
    write("s.xml", on_sphere(f"{given}\n{text}"))
    with pytest.raises(nacre.InputError) as planned:
        nacre.plan("s.xml")
    line = str(planned.value)
    assert re.match(r"s\.xml:[12]: ", line) and said in line and "\n" not in line, line
    with pytest.raises(Exception) as loaded:
        mi.load_file("s.xml")
    assert said in str(loaded.value)


@pytest.mark.parametrize(
    "text, said",
    {
        "not XML": ("<scene>\n<shape></scene>", "s.xml:2: not XML: Start-end tags mismatch"),
        "empty": ("", "s.xml:1: not XML: No document element found"),
        "no include": (scene('\n<include filename="gone.xml"/>'), 's.xml:2: included file "gone.xml" not found'),
        "an include of itself": (scene('<include filename="s.xml"/>'), "s.xml:1: Exceeded maximum include recursion depth"),
        "no such name": (scene('<bsdf type="pearl"><float name="depth" value="$d"/></bsdf>'), "s.xml:1: undefined parameter: $d"),
        "twice": (on_sphere('<float name="depth" value="0"/>\n<float name="depth" value="1"/>'), "s.xml:2: "),
        "no such object": (scene('<shape type="sphere"><ref id="q"/></shape>'), 's.xml:1: unresolved reference to "q"'),
        "an id twice": (scene(pearl("p") + "\n" + pearl("p")), 's.xml:2: duplicate ID: "p"'),
        "a ring": (
            scene('<bsdf type="twosided" id="a"><ref id="b"/></bsdf><bsdf type="twosided" id="b"><ref id="a"/></bsdf>'),
            "circular reference detected: a -> b -> a",
        ),
        "no UTF-8": (scene('<bsdf type="pearl" id="@"/>').encode().replace(b"@", b"\xe9"), "s.xml: a text in it is not encoded in UTF-8"),
    }.values(),
)
def test_what_mitsuba_refuses_is_one_line_that_names_the_place(text, said):
    write("s.xml", text)
    with pytest.raises(nacre.InputError) as refused:
        nacre.plan("s.xml")
    assert said in str(refused.value) and "\n" not in str(refused.value)


def test_a_table_in_place_of_a_recipe_says_what_it_shows():
    """What it has no colours for is off, as in the plugin; one that is not there yet is planned as the paper's pearl."""
    nacre.bake(THIN, effects="surface,blur,body", solver="doubling", accuracy=20).save("t.exr")
    named = lambda name, more="": on_sphere(f'<string name="filename" value="{name}"/>{more}')
    found = plan(named("t.exr"))["p"]
    assert found["recipe"]["name"] == "thin" and on(found) == {"surface", "blur", "azimuth", "body"}
    assert found["effects"]["emission"]["why"] == "depth 0 (./t.exr)"
    with pytest.raises(nacre.InputError, match=r"s.xml:1: pearl: depth: is 0.5, but ./t.exr has no interference colours"):
        plan(named("t.exr", '<float name="depth" value="0.5"/>'))
    later = plan(named("later.exr", DULL))["p"]
    assert later["recipe"]["name"] == "paper" and later["recipe_from"] == "the paper's pearl: there is no later.exr yet"


@pytest.mark.parametrize("inner", ["", '<string name="components" value="mirror"/>', '<float name="coherence" value="0"/>'])
def test_the_plugin_bakes_what_is_planned(inner):
    write("r.json", json.dumps(THIN))
    text = on_sphere(f'<string name="recipe" value="r.json"/>{inner}')
    planned = on(plan(text, variant="scalar_rgb")["p"])
    assert set(mi.load_file("s.xml").shapes()[0].bsdf().table.meta["effects"]) == planned


def test_the_command_prints_the_plan(capsys):
    path = str(SCENES / "two-strands.xml")
    assert main(["plan", path, "--json", "-D", "size=8", "-Dspp=1"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert [pearl["id"] for pearl in report["pearls"]] == ["soft", "vivid", "masked"] and len(report["tables"]) == 2
    assert main(["plan", path]) == 0
    text = capsys.readouterr().out
    assert all(effect["why"] in text for pearl in report["pearls"][:2] for effect in pearl["effects"].values())
    assert "masked" in text and "unused: no shape shows this pearl" in text
    assert main(["plan", "varnish", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["bytes"] == nacre.plan("varnish")["bytes"]


def test_the_command_refuses_in_one_line(capsys):
    write("s.xml", SHOWN)
    for words, said in (
        ([], "required: command"),
        (["plan"], "required: SCENE"),
        (["plan", "gone.xml"], "gone.xml: there is no such file"),
        (["plan", "s.xml", "-D", "deep"], "'deep' is not NAME=VALUE"),
        (["plan", "s.xml", "-D", "deep=1"], "unused parameters: - $deep=1"),
        (["plan", "s.xml", "--variant", "cmyk"], 'variant: "cmyk" is none'),
        (["plan", "akoya", "--variant", "mono"], "variant: belongs to a scene"),
        (["plan", "akoja"], "akoja: there is no such file"),
    ):
        assert main(words) == 2
        out, said_at_all = capsys.readouterr()
        assert said in said_at_all and said_at_all.count("\n") == 1 and not out, words
    script = "import sys; sys.modules['mitsuba'] = None; from nacre.__main__ import main; sys.exit(main(['plan', 's.xml']))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 1 and "pip install 'nacre[mitsuba]'" in done.stderr and done.stderr.count("\n") == 1, done.stderr


def test_what_each_effect_changes_is_seen_in_a_picture():
    write("r.json", json.dumps(THIN))
    write("s.xml", on_sphere(f'<string name="recipe" value="r.json"/>{DULL}'))
    [found] = nacre.plan("s.xml", why_not=True)["why_not"]
    changes = found["effects"]
    assert changes["body"]["on"] and changes["body"]["delta_e"] > 10 and changes["body"]["not_shown"] is None
    assert changes["absorption"]["not_shown"] == "nothing absorbs (every k is 0)" and changes["absorption"]["delta_e"] is None
    assert "acts on blur alone" in changes["polarisation"]["not_shown"] and changes["blur"]["delta_e"] == 0


def test_the_surrounding_has_the_hue_of_the_view():
    """Without lobes and at depth 1 a pixel is ρ·Ê(view)·(2·cos θo/π + 0.4) of a light of irradiance 2 and a surrounding of 0.4."""
    recipe = {"stack": {"layers": 2}, "look": {"brightness": 0.0, "depth": 1.0, "body_rgb": [0.4, 0.4, 0.4]}}
    found = nacre.plan(recipe, why_not=True)["why_not"][0]["effects"]["emission"]
    emission = nacre.arrays(nacre.bake(recipe, effects="body,emission"))["emission_rgb"].astype(float)
    y, x = np.mgrid[-39:40:2, -39:40:2] / 40
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    cos = np.maximum(np.stack([x, y, z], axis=-1) @ [-0.45, 0.55, 0.703562363974], 0)[z > 0]
    plain = 0.4 * (2 * cos / np.pi + 0.4)
    node = 1024 * np.sqrt(1 - np.sqrt(z[z > 0]))
    coloured = plain * np.array([np.interp(node, np.arange(1025), curve) for curve in emission])
    expected = np.sqrt(((coloured - plain) ** 2).mean()) / coloured.mean()
    # Albedos are taken at whole degrees.
    assert abs(found["relative_rmse"] / expected - 1) < 0.01


PAGES = [ROOT / "docs" / "PLUGIN.md", SCENES / "README.md"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_commands_of_the_pages_run_as_printed(page):
    lines = re.findall(r"^    (python -m nacre .*)$", page.read_text(), re.M)
    assert lines
    for line in lines:
        words = line.replace("python", sys.executable, 1).split()
        done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
        assert done.returncode == 0 and done.stdout, (line, done.stderr)
