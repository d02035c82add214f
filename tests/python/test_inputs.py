"""What every tool says of its input and of where its output goes: one line, and nothing left behind."""

import codecs
import json
import subprocess

import pytest
from built import BIN, ROOT

RECIPE = '{"name": "π", "stack": {"layers": 4}}'
PAIR = '{"wi": [0, 0, 1], "wo": [0.1, 0, 0.995]}\n'
CASE = (ROOT / "tests" / "data" / "hard_cases.json").read_text()
CASES = json.dumps({**json.loads(CASE), "cases": json.loads(CASE)["cases"][:2]})


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    folder = tmp_path_factory.mktemp("inputs")
    (folder / "recipe.json").write_text(RECIPE)
    bake = [BIN / "bake-brdf", "recipe.json", "--paths", "2000", "--incident-deg", "0,40,80", "-q", "-o", "table.exr"]
    subprocess.run(bake, cwd=folder, check=True, capture_output=True)
    return folder / "table.exr"


def run(folder, name, *args, **further):
    return subprocess.run([BIN / name, *map(str, args)], cwd=folder, capture_output=True, timeout=120, **further)


def one_line(done, *words):
    stderr = done.stderr.decode()
    assert len(stderr.strip().splitlines()) == 1 and all(word in stderr for word in words), stderr


def readers(table):
    """Every tool that reads text: the arguments that name a file `text`, and the text."""
    return [
        (["bake-brdf", "text", "--dry-run", "--json", "--paths", 1000], RECIPE),
        (["bake-brdf", "plan", "text", "--json", "--paths", 1000], RECIPE),
        (["thinfilm", "colour", "text"], RECIPE),
        (["thinfilm", "spectrum", "text"], RECIPE),
        (["thinfilm", "verify", "text"], CASES),
        (["pearl", "eval", table, "--input", "text"], PAIR),
    ]


def said(done):
    """What a tool printed, but how long it will take."""
    assert done.returncode == 0 and done.stdout, (done.args, done.stderr)
    return [line for line in done.stdout.decode().splitlines() if "seconds" not in line]


def test_a_byte_order_mark_changes_nothing(tmp_path, table):
    for args, text in readers(table):
        (tmp_path / "text").write_text(text)
        plain = said(run(tmp_path, *args))
        (tmp_path / "text").write_bytes(codecs.BOM_UTF8 + text.encode())
        assert said(run(tmp_path, *args)) == plain, args
        piped = run(tmp_path, *("-" if word == "text" else word for word in args), input=codecs.BOM_UTF8 + text.encode())
        assert [line.replace('"-"', '"text"') for line in said(piped)] == plain, args


@pytest.mark.parametrize(("encoding", "name"), [("utf-16", "UTF-16"), ("utf-16-be", "UTF-16"), ("utf-32", "UTF-32"), ("utf-32-le", "UTF-32")])
def test_another_encoding_is_refused_by_its_name(tmp_path, table, encoding, name):
    for args, text in readers(table):
        (tmp_path / "text").write_bytes(text.encode(encoding))
        done = run(tmp_path, *args)
        assert done.returncode == 2, (args, done.stderr)
        one_line(done, "text: ", f"the encoding is {name}, expected UTF-8")


def test_latin_1_is_refused_with_its_line(tmp_path):
    (tmp_path / "text").write_bytes('{"name":\n"naïve"}'.encode("latin-1"))
    one_line(run(tmp_path, "thinfilm", "colour", "text"), "text: line 2 is not encoded in UTF-8")


def test_a_name_that_is_no_recipe_is_answered_with_those_there_are(tmp_path):
    for args in (["bake-brdf", "akoja"], ["bake-brdf", "plan", "akoja"], ["thinfilm", "colour", "akoja"], ["pearl", "studio", "akoja"]):
        done = run(tmp_path, *args)
        assert done.returncode == 2
        one_line(done, "akoja: there is no such file, and the built-in recipes are abalone, akoya,")


def test_a_table_is_not_read_from_standard_input(tmp_path, table):
    for args in (["lut", "info", "-"], ["lut", "diff", table, "-"], ["pearl", "furnace", "-"]):
        done = run(tmp_path, *args, input=table.read_bytes())
        assert done.returncode == 2
        one_line(done, "-: a table is read from a file, not from standard input")


def limited(folder, kibibytes, *args, stdout=subprocess.PIPE):
    """Runs a tool that may write no file longer than that, the signal of the limit as a shell finds it."""
    command = ["bash", "-c", f'ulimit -f {kibibytes}; exec "$@"', "bash", BIN / args[0], *map(str, args[1:])]
    return subprocess.run(command, cwd=folder, stdout=stdout, stderr=subprocess.PIPE, timeout=120, restore_signals=True)


def test_a_limit_on_the_size_of_files_ends_a_tool_as_a_full_disk_does(tmp_path, table):
    (tmp_path / "recipe.json").write_text(RECIPE)
    writers = [
        ("bake-brdf", "recipe.json", "--solver", "doubling", "--accuracy", 5, "--incident-deg", "0,45", "-q", "-o", "f"),
        ("bake-brdf", "recipe.json", "--paths", 10_000, "--incident-deg", "0,45", "--shard", "1/1", "-q", "-o", "f"),
        ("lut", "export", table, "--to", "bsdf-rgb", "-o", "f"),
        ("lut", "fit", table, "--form", "table", "-o", "f"),
        ("lut", "plot", table, "-o", "."),
        ("pearl", "preview", table, "--size", 64, "--samples", 1, "-o", "."),
        ("thinfilm", "swatch", "recipe.json", "-o", "f"),
    ]
    for args in writers:
        before = sorted(tmp_path.iterdir())
        done = limited(tmp_path, 2, *args)
        assert done.returncode == 1, (args, done.returncode, done.stderr)
        one_line(done, "File too large")
        assert b".part" not in done.stderr, done.stderr
        assert sorted(tmp_path.iterdir()) == before, args


def test_a_limit_on_standard_output_is_named(tmp_path, table):
    pairs = tmp_path / "pairs.jsonl"
    pairs.write_text(PAIR * 200)
    for args in [("lut", "slice", table, "--theta-i", 30), ("pearl", "eval", table, "--input", pairs), ("bake-brdf", "schema")]:
        with open(tmp_path / "out", "wb") as out:
            done = limited(tmp_path, 2, *args, stdout=out)
        assert done.returncode == 1, (args, done.returncode, done.stderr)
        one_line(done, "standard output: File too large")


def test_what_is_read_is_not_written_over(tmp_path, table):
    (tmp_path / "table").write_bytes(table.read_bytes())
    (tmp_path / "recipe").write_text(RECIPE)
    (tmp_path / "link").symlink_to("table")
    for args, output in [
        (["bake-brdf", "recipe", "--paths", 1000, "--incident-deg", 0], "recipe"),
        (["thinfilm", "swatch", "recipe"], "recipe"),
        (["lut", "fit", "table"], "table"),
        (["lut", "export", "table", "--to", "csv"], "link"),
        (["pearl", "page", "table"], "link"),
    ]:
        done = run(tmp_path, *args, "-o", output)
        assert done.returncode == 2, args
        one_line(done, f"--output: {output} is the ", " itself")
    assert (tmp_path / "table").read_bytes() == table.read_bytes() and (tmp_path / "recipe").read_text() == RECIPE


def test_a_file_is_no_folder(tmp_path, table):
    (tmp_path / "file").write_text("kept")
    for args in (["lut", "plot", table], ["pearl", "preview", table], ["bake-brdf", "study"]):
        done = run(tmp_path, *args, "-o", "file")
        assert done.returncode == 1, args
        one_line(done, "file: is no folder")


def test_a_shard_is_walked_and_its_place_is_checked_before_anything(tmp_path):
    (tmp_path / "recipe").write_text(RECIPE)
    bake = ["bake-brdf", "recipe", "--paths", 1000, "--incident-deg", 0, "-q", "-o", "out"]
    for further, said in [
        (["--shard", "3/2"], '--shard: "3/2" is not I/N'),
        (["--shard", "3/2", "--dry-run"], '--shard: "3/2" is not I/N'),
        (["--shard", "1/2", "--solver", "doubling"], "--shard: a share of the paths is walked; expected solver walk or auto"),
    ]:
        done = run(tmp_path, *bake, *further)
        assert done.returncode == 2, further
        one_line(done, said)
    assert not (tmp_path / "out").exists()


def test_no_flag_is_there_that_nothing_reads(table):
    """--json prints one object wherever it is taken, and there is no -v."""
    folder = table.parent
    (folder / "pairs.jsonl").write_text(PAIR)
    shard = ["bake-brdf", "recipe.json", "--paths", 1000, "--incident-deg", "0", "--shard", "1/1", "-q", "-o", "one.shard"]
    assert run(folder, *shard).returncode == 0
    for args in [
        ["lut", "plot", table, "-o", "."],
        ["lut", "merge", "one.shard", "-o", "merged.exr"],
        ["lut", "slice", table, "--theta-i", 30],
        ["pearl", "preview", table, "--size", 16, "--samples", 1, "-o", "."],
        ["thinfilm", "swatch", "recipe.json", "-o", "swatch.png"],
        ["thinfilm", "materials"],
    ]:
        done = run(folder, *args, "--json")
        assert done.returncode == 0 and json.loads(done.stdout)["schema"], (args, done.stderr)
        one_line(run(folder, *args, "-v"), "-v")
