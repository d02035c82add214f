"""Which pearls a scene shows: scenes written as people write them, and what the plan makes of them."""

import json
import os
import pathlib
import resource
import subprocess

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]
BIN = pathlib.Path(os.environ.get("NACRE_BIN", ROOT / "target" / "release"))
COARSE = ["--solver", "auto", "--accuracy", "20", "--incident-deg", "0:90:30"]
# No walk: what is asked is who is shown.
DULL = '<float name="brightness" value="0"/><float name="depth" value="0"/>'


def tool(folder, *args, limit=None):
    def bounded():
        if limit:
            resource.setrlimit(resource.RLIMIT_AS, (limit, limit))

    command = [BIN / "bake-brdf", *args]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, preexec_fn=bounded)


def plan(folder, text, *flags):
    (folder / "s.xml").write_text(text)
    done = tool(folder, "plan", "--scene", "s.xml", "--json", *COARSE, *flags)
    assert done.returncode == 0, done.stderr
    return {pearl["id"]: pearl for pearl in json.loads(done.stdout)["pearls"]}


def pearl(name, inner=DULL):
    return f'<bsdf type="pearl" id="{name}">{inner}</bsdf>'


def shown(folder, text, *flags):
    return sorted(name for name, found in plan(folder, text, *flags).items() if found["used"])


def on(found):
    return {name for name, effect in found["effects"].items() if effect["on"]}


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
        "a mask that hides": (
            '<shape type="disk"><bsdf type="mask"><float name="opacity" value="0"/><ref id="a"/></bsdf></shape>',
            [],
        ),
        "a blend of weight 0 in a blend of weight 1": (
            '<shape type="disk"><bsdf type="blendbsdf"><float name="weight" value="1.0"/><ref id="a"/>'
            '<bsdf type="blendbsdf"><float name="weight" value="0"/><ref id="b"/><ref id="c"/></bsdf></bsdf></shape>',
            ["b"],
        ),
        "a comment": ('<!-- <shape type="disk"><ref id="a"/></shape> -->', []),
        "character data": ('<string name="x" value="y"/><![CDATA[<shape type="disk"><ref id="a"/></shape>]]>', []),
        "shared by shapes": ('<shape type="disk"><ref id="a"/></shape><shape type="cube"><ref id="a"/></shape>', ["a"]),
    }.values(),
)
def test_a_plan_finds_the_pearls_that_are_shown(body, expected, tmp_path):
    scene = f'<scene version="3.0.0">{pearl("a")}{pearl("b")}{pearl("c")}{body}</scene>'
    assert shown(tmp_path, scene) == expected


def test_a_definition_on_the_command_line_goes_before_the_default(tmp_path):
    inner = '<float name="brightness" value="0"/><float name="depth" value="$deep"/>'
    scene = f'<scene version="3.0.0"><default name="deep" value="0"/>{pearl("a", inner)}<shape type="disk"><ref id="a"/></shape></scene>'
    assert "emission" not in on(plan(tmp_path, scene)["a"])
    assert "emission" in on(plan(tmp_path, scene, "-D", "deep=0.5")["a"])
    assert "emission" in on(plan(tmp_path, scene, "-Ddeep=0.5")["a"])
    done = tool(tmp_path, "plan", "--scene", "s.xml", "-D", "deep")
    assert done.returncode == 2 and "--define: \"deep\" is not NAME=VALUE" in done.stderr


def test_a_bump_map_is_a_texture_and_names_its_line(tmp_path):
    body = '<shape type="disk">\n<bsdf type="normalmap"><texture type="checkerboard"/><ref id="a"/></bsdf></shape>'
    found = plan(tmp_path, f'<scene version="3.0.0">{pearl("a")}{body}</scene>')["a"]
    assert found["effects"]["texture"]["on"] and "s.xml:2" in found["effects"]["texture"]["why"]


@pytest.mark.parametrize(
    "text, said",
    {
        "misspelt": ('<float name="brightnes" value="0"/>', 'no parameter (did you mean "brightness"?)'),
        "British": ('<rgb name="body_colour" value="0.5"/>', 'no parameter (did you mean "body_color"?)'),
        "no table's name": ('<string name="filename" value=""/>', "filename is empty"),
        "far from any": ('<float name="zzz" value="0"/>', '"zzz" is no parameter; expected one of filename'),
        "infinite": ('<float name="depth" value="inf"/>', 'depth "inf" is not valid'),
    }.values(),
)
def test_a_bad_parameter_is_one_line(text, said, tmp_path):
    (tmp_path / "s.xml").write_text(f'<scene version="3.0.0">{pearl("a", text)}</scene>')
    done = tool(tmp_path, "plan", "--scene", "s.xml")
    assert done.returncode == 2 and said in done.stderr and done.stderr.count("\n") == 1, done.stderr


@pytest.mark.parametrize(
    "text, said",
    {
        "deep": ("<scene>" + "<a>" * 100_000 + "</a>" * 100_000 + "</scene>", "nest deeper"),
        "a long attribute": (f'<scene><bsdf type="pearl" id="{"x" * 10_000_000}"/></scene>', "a value has 10000000 bytes"),
        "a ring of instances": (
            '<scene><shape type="shapegroup" id="g"><shape type="instance"><ref id="g"/></shape></shape>'
            '<shape type="instance"><ref id="g"/></shape></scene>',
            "instances go round in a circle",
        ),
        "groups of groups": (
            "<scene>"
            + '<shape type="shapegroup" id="g0"><shape type="sphere"/></shape>'
            + "".join(
                f'<shape type="shapegroup" id="g{i}">' + f'<shape type="instance"><ref id="g{i - 1}"/></shape>' * 10 + "</shape>"
                for i in range(1, 12)
            )
            + '<shape type="instance"><ref id="g11"/></shape></scene>',
            "hold more than 100000 shapes",
        ),
    }.values(),
)
def test_a_scene_without_bounds_is_one_line_in_bounded_memory(text, said, tmp_path):
    (tmp_path / "s.xml").write_text(text)
    done = tool(tmp_path, "plan", "--threads", "1", "--scene", "s.xml", limit=600 << 20)
    assert done.returncode == 2 and said in done.stderr and done.stderr.count("\n") == 1, done.stderr[:500]
