"""A bake survives what machines do to it: SIGKILL, SIGINT, a full disk, a second bake, other shards.

Ten kills by default; the whole test of 50 (about a minute and a half on two cores):

    NACRE_KILLS=50 .venv/bin/python -m pytest -s tests/python/test_faults.py -k kills
"""

import contextlib
import json
import os
import pathlib
import random
import signal
import subprocess
import time
import zlib

import pytest
from built import BIN

KILLS = int(os.environ.get("NACRE_KILLS", "10"))
SEED = 7


def tool(folder, name, *args):
    return subprocess.run([BIN / name, *map(str, args)], cwd=folder, capture_output=True, text=True)


def baked(folder, *args):
    """The bytes of a bake that nobody disturbs."""
    done = tool(folder, "bake-brdf", *args, "-q", "-o", "undisturbed.exr")
    assert done.returncode == 0, done.stderr
    path = folder / "undisturbed.exr"
    content = path.read_bytes()
    path.unlink()
    return content


def started(folder, *args):
    return subprocess.Popen(
        [BIN / "bake-brdf", *map(str, args)],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def one_line(stderr, *words):
    assert len(stderr.strip().splitlines()) == 1, stderr
    assert all(word in stderr for word in words), stderr


def wait_until_heard(process, number):
    """Until the process has a handler of its own for a signal."""
    status = pathlib.Path(f"/proc/{process.pid}/status")
    caught = lambda: int(status.read_text().split("SigCgt:")[1].split()[0], 16) >> (number - 1) & 1
    while not caught():
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)


def wait_for(path, seconds=60):
    end = time.monotonic() + seconds
    while not path.exists():
        assert time.monotonic() < end, f"{path} never appeared"
        time.sleep(0.01)


def bake_of(folder, seconds):
    """Arguments of a bake that takes about `seconds` on this machine; of few layers, so that it can stop often."""
    recipe = folder / "recipe.json"
    recipe.write_text('{"stack":{"layers":40}}')
    probe = 500_000
    args = [recipe, "--incident-deg", "0:80:40", "--seed", 3]
    start = time.monotonic()
    baked(folder, *args, "--paths", probe)
    rate = probe / (time.monotonic() - start)
    return [*args, "--paths", int(rate * seconds)]


def seconds_to_a_checkpoint(folder, args):
    """How long a life takes here until it has something to be resumed from."""
    checkpoint = folder / "pearl.exr.checkpoint"
    start = time.monotonic()
    life = started(folder, *args, "--resume", "--checkpoint-every", 0.1, "-q")
    wait_for(checkpoint)
    seconds = time.monotonic() - start
    life.kill()
    life.communicate()
    checkpoint.unlink()
    return seconds


def killed_and_resumed(folder, args, longest, whole):
    """(kills, lives that went on from another's work): KILLS of them, or fewer where a life got through."""
    moments = random.Random(SEED)
    output, checkpoint = folder / "pearl.exr", folder / "pearl.exr.checkpoint"
    kills = resumed = 0
    while kills < KILLS:
        resumed += checkpoint.exists()
        life = started(folder, *args, "--resume", "--checkpoint-every", 0.1, "-q")
        try:
            life.wait(timeout=moments.uniform(0.0, longest))
        except subprocess.TimeoutExpired:
            life.send_signal(signal.SIGKILL)
        life.communicate()
        if life.returncode == 0:
            break
        assert life.returncode == -signal.SIGKILL
        kills += 1
        if output.exists():
            # Killed between its last rename and its end.
            assert output.read_bytes() == whole, "half a table"
            break
        if not checkpoint.exists():
            longest *= 1.5  # the machine has become busier since
    return kills, resumed


def test_kills_at_random_moments_cost_nothing_but_time(tmp_path):
    # Lives keep what they walked every tenth of a second, and last up to twice as long as the first checkpoint takes, on
    # a busy machine too. The bake is long enough to be killed KILLS times before it is through, or, if the machine becomes
    # faster meanwhile, a longer one is.
    output, checkpoint = tmp_path / "pearl.exr", tmp_path / "pearl.exr.checkpoint"
    for times in (1, 2, 4):
        longest = max(0.8, 2 * seconds_to_a_checkpoint(tmp_path, bake_of(tmp_path, 20)))
        args = bake_of(tmp_path, times * 0.625 * longest * KILLS)
        whole = baked(tmp_path, *args)
        kills, resumed = killed_and_resumed(tmp_path, args, longest, whole)
        last = tool(tmp_path, "bake-brdf", *args, "--resume", "-q")
        assert last.returncode == 0, last.stderr
        assert output.read_bytes() == whole
        assert not checkpoint.exists()
        if kills == KILLS:
            break
        output.unlink()
    assert kills == KILLS, f"through after {kills} kills, three times: the machine gets faster and faster"
    assert resumed > KILLS / 4, "no life went on from another's work"
    parts = [path for path in tmp_path.iterdir() if path.suffix == ".part"]
    print(f"{kills} kills, {resumed} lives resumed, {len(parts)} temporary files left behind: same bytes")


def test_an_interrupt_writes_a_last_checkpoint(tmp_path):
    args = bake_of(tmp_path, 4.0)
    whole = baked(tmp_path, *args)
    checkpoint = tmp_path / "pearl.exr.checkpoint"
    # No checkpoint is due within the bake: the one that is found is the interrupt's.
    life = started(tmp_path, *args, "--checkpoint", "--checkpoint-every", 1000, "-q")
    wait_until_heard(life, signal.SIGINT)
    time.sleep(0.3)
    assert not checkpoint.exists()
    life.send_signal(signal.SIGINT)
    _, stderr = life.communicate()
    assert life.returncode == 1
    one_line(stderr, "interrupted", "pearl.exr.checkpoint", "--resume")
    start = time.monotonic()
    resumed = tool(tmp_path, "bake-brdf", *args, "--resume", "-q")
    assert resumed.returncode == 0, resumed.stderr
    print(f"the rest took {time.monotonic() - start:.1f} s of about 4")
    assert (tmp_path / "pearl.exr").read_bytes() == whole
    assert not checkpoint.exists()


@contextlib.contextmanager
def small_disk(folder, kibibytes):
    """A tmpfs, which only root may mount."""
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={kibibytes}k", "tmpfs", folder], capture_output=True, text=True)
    if mounted.returncode != 0:
        pytest.skip(f"NOT TESTED: a full disk. Mounting a small tmpfs needs root: {mounted.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)


def fill(disk):
    """Leaves not one free page."""
    with open(disk / "filler", "ab", buffering=0) as filler:
        with contextlib.suppress(OSError):
            while True:
                filler.write(bytes(4096))


@pytest.fixture
def disk(tmp_path):
    folder = tmp_path / "disk"
    folder.mkdir()
    with small_disk(folder, 1024):
        yield folder


def test_a_full_disk_ends_a_bake_with_one_line_and_leaves_the_old_table(tmp_path, disk):
    args = ["--paths", 20_000, "--incident-deg", "0,40,80"]
    old = baked(tmp_path, *args)
    (disk / "pearl.exr").write_bytes(old)
    fill(disk)
    new = tool(disk, "bake-brdf", *args, "--seed", 2, "-q")
    assert new.returncode == 1
    one_line(new.stderr, "pearl.exr", "No space left on device")
    assert (disk / "pearl.exr").read_bytes() == old
    assert sorted(path.name for path in disk.iterdir()) == ["filler", "pearl.exr"]
    (disk / "filler").unlink()
    again = tool(disk, "bake-brdf", *args, "--seed", 2, "-q")
    assert again.returncode == 0 and (disk / "pearl.exr").read_bytes() != old


def test_a_disk_that_fills_up_in_the_middle_costs_no_work(tmp_path, disk):
    args = bake_of(tmp_path, 4.0)
    whole = baked(tmp_path, *args)
    (disk / "pearl.exr").write_bytes(b"the old table")
    checkpoint = disk / "pearl.exr.checkpoint"
    life = started(disk, *args, "--checkpoint", "--checkpoint-every", 0.1, "-q")
    wait_for(checkpoint)
    fill(disk)
    _, stderr = life.communicate()
    assert life.returncode == 1
    # Once that checkpoints stop, once that the table could not be written.
    lines = stderr.strip().splitlines()
    assert len(lines) == 2 and "no checkpoint kept" in lines[0] and "pearl.exr" in lines[1], stderr
    assert all("No space left on device" in line for line in lines), stderr
    assert (disk / "pearl.exr").read_bytes() == b"the old table"
    assert sorted(path.name for path in disk.iterdir()) == ["filler", "pearl.exr", "pearl.exr.checkpoint"]
    (disk / "filler").unlink()
    resumed = tool(disk, "bake-brdf", *args, "--resume", "-q")
    assert resumed.returncode == 0, resumed.stderr
    assert (disk / "pearl.exr").read_bytes() == whole


@pytest.mark.parametrize("keeping", [[], ["--checkpoint", "--checkpoint-every", "0.05"]])
def test_of_two_bakes_onto_one_output_one_whole_table_wins(tmp_path, keeping):
    args = ["--paths", 40_000, "--incident-deg", "0,30,60"]
    expected = {baked(tmp_path, *args, "--seed", seed) for seed in (1, 2)}
    output = tmp_path / "pearl.exr"
    for _ in range(3):
        output.unlink(missing_ok=True)
        rivals = [started(tmp_path, *args, *keeping, "--seed", seed, "-q") for seed in (1, 2)]
        while any(rival.poll() is None for rival in rivals):
            # A renderer that looks while both write sees nothing, or one whole table.
            with contextlib.suppress(FileNotFoundError):
                assert output.read_bytes() in expected
            time.sleep(0.002)
        for rival in rivals:
            _, stderr = rival.communicate()
            assert rival.returncode == 0, stderr
        assert output.read_bytes() in expected
        assert [path.name for path in tmp_path.iterdir()] == ["pearl.exr"]


RECIPE = '{"stack":{"layers":6}}'


@pytest.fixture(scope="module")
def sharded(tmp_path_factory):
    """One small bake whole, and its shards by (index, count)."""
    folder = tmp_path_factory.mktemp("shards")
    (folder / "recipe.json").write_text(RECIPE)
    (folder / "other.json").write_text('{"stack":{"layers":7}}')
    args = ["--paths", 800_001, "--incident-deg", "0,40,80"]
    whole = baked(folder, "recipe.json", *args)

    def shard(index, count, recipe="recipe.json", seed=1):
        name = f"{pathlib.Path(recipe).stem}-{seed}-{index}-of-{count}.shard"
        if not (folder / name).exists():
            done = tool(folder, "bake-brdf", recipe, *args, "--seed", seed, "--shard", f"{index}/{count}", "-q", "-o", name)
            assert done.returncode == 0, done.stderr
        return name

    return folder, whole, shard


@pytest.mark.parametrize("count", [1, 2, 7, 24])
def test_shards_in_any_order_make_the_bytes_of_one_bake(sharded, count):
    folder, whole, shard = sharded
    names = [shard(index, count) for index in range(1, count + 1)]
    random.Random(SEED + count).shuffle(names)
    merged = tool(folder, "lut", "merge", *names, "-o", f"merged-{count}.exr")
    assert merged.returncode == 0, merged.stderr
    assert (folder / f"merged-{count}.exr").read_bytes() == whole


def test_shards_that_do_not_make_one_bake_are_refused_by_name(sharded):
    folder, _, shard = sharded
    seven = [shard(index, 7) for index in range(1, 8)]
    foreign = shard(3, 7, recipe="other.json")
    seed = shard(3, 7, seed=2)
    cases = [
        (seven + [seven[4]], [seven[4], "shard 5"]),
        (seven[:3] + seven[4:], ["shard 4 of 7 missing"]),
        (seven[:1] + seven[5:], ["shard 2, 3, 4, 5 of 7 missing"]),
        (seven[:2] + [foreign] + seven[3:], [foreign, "the recipe differs"]),
        (seven[:2] + [seed] + seven[3:], [seed, "the seed differs"]),
        (seven[:6] + [shard(2, 2)], [shard(2, 2), "the number of shards differs"]),
    ]
    (folder / "kept.exr").write_bytes(b"the old table")
    for names, words in cases:
        refused = tool(folder, "lut", "merge", *names, "-o", "kept.exr")
        assert refused.returncode == 2, names
        one_line(refused.stderr, *words)
        assert (folder / "kept.exr").read_bytes() == b"the old table"


def test_a_shard_cut_short_is_refused_by_name(sharded):
    folder, _, shard = sharded
    first, second = shard(1, 2), shard(2, 2)
    content = (folder / second).read_bytes()
    for length in (0, 10, 17, len(content) // 2, len(content) - 1):
        (folder / "cut.shard").write_bytes(content[:length])
        refused = tool(folder, "lut", "merge", first, "cut.shard", "-o", "never.exr")
        assert refused.returncode == 2
        one_line(refused.stderr, "cut.shard")
        assert not (folder / "never.exr").exists()


def test_a_shard_of_no_bake_asked_for_is_refused(sharded):
    folder, whole, shard = sharded
    pair = [shard(1, 2), shard(2, 2)]
    forecast = tool(folder, "bake-brdf", "recipe.json", "--paths", 800_001, "--incident-deg", "0,40,80", "--dry-run", "--json", "-q")
    content = json.loads(forecast.stdout)["content_hash"]
    merged = tool(folder, "lut", "merge", *pair, "--content-hash", content, "-o", "checked.exr")
    assert merged.returncode == 0 and (folder / "checked.exr").read_bytes() == whole, merged.stderr
    other = tool(folder, "lut", "merge", *pair, "--content-hash", content[::-1], "-o", "never.exr")
    assert other.returncode == 2
    one_line(other.stderr, pair[0], "content hash", content[::-1])
    assert not (folder / "never.exr").exists()


def test_an_output_that_would_replace_its_own_input_is_refused(sharded):
    folder, _, shard = sharded
    pair = [shard(1, 2), shard(2, 2)]
    before = (folder / pair[1]).read_bytes()
    (folder / "alias").unlink(missing_ok=True)
    (folder / "alias").symlink_to(pair[1])
    for output in (pair[1], "alias"):
        refused = tool(folder, "lut", "merge", *pair, "-o", output)
        assert refused.returncode == 2 and (folder / pair[1]).read_bytes() == before
        one_line(refused.stderr, "--output", pair[1])
    refused = tool(folder, "bake-brdf", "recipe.json", "--paths", 1000, "-q", "-o", "./recipe.json")
    assert refused.returncode == 2 and (folder / "recipe.json").read_text() == RECIPE
    one_line(refused.stderr, "--output", "recipe.json")


ENDLESS = ["/dev/zero", "/dev/urandom"]


@pytest.mark.parametrize("device", ENDLESS)
def test_a_device_without_end_is_refused_at_once(sharded, device):
    folder, _, shard = sharded
    (folder / "pearl.exr.checkpoint").unlink(missing_ok=True)
    (folder / "pearl.exr.checkpoint").symlink_to(device)
    for name, *args in [
        ("lut", "merge", shard(1, 2), device, "-o", "never.exr"),
        ("lut", "info", device),
        ("lut", "check", device),
        ("pearl", "furnace", device),
        ("bake-brdf", device, "-o", "never.exr"),
        ("bake-brdf", "--reproduce", device),
        ("bake-brdf", "--paths", 1000, "--resume", "-q"),
    ]:
        # Half a gigabyte: what is read of it stays small.
        limited = ["bash", "-c", 'ulimit -v 524288; exec "$@"', "bash", str(BIN / name), *map(str, args)]
        refused = subprocess.run(limited, cwd=folder, capture_output=True, text=True, timeout=30)
        assert refused.returncode == 2, (name, args, refused.stderr)
        one_line(refused.stderr, "checkpoint" if "--resume" in args else device)
    assert not (folder / "never.exr").exists()
    (folder / "pearl.exr.checkpoint").unlink()


UNWRITABLE = {
    "folder": "folder",
    "absent/pearl.exr": "no such folder",
    "x" * 300 + ".exr": "too long",
    "circle": "circle",
}


@pytest.mark.parametrize("output", UNWRITABLE)
def test_an_output_that_cannot_be_written_is_refused_before_the_work(tmp_path, output):
    (tmp_path / "folder").mkdir()
    (tmp_path / "circle").symlink_to("circle")
    start = time.monotonic()
    # Minutes of work, were it begun.
    refused = tool(tmp_path, "bake-brdf", "--paths", 10**9, "-q", "-o", output)
    assert refused.returncode == 1 and time.monotonic() - start < 30
    one_line(refused.stderr, output, UNWRITABLE[output])
    assert ".tmp" not in refused.stderr and sorted(path.name for path in tmp_path.iterdir()) == ["circle", "folder"]


def test_a_link_is_written_through_also_to_a_file_yet_to_be_made(tmp_path):
    (tmp_path / "link.exr").symlink_to("real.exr")
    for seed in (1, 2):
        done = tool(tmp_path, "bake-brdf", "--paths", 2000, "--incident-deg", "0,40", "--seed", seed, "-q", "-o", "link.exr")
        assert done.returncode == 0, done.stderr
        assert (tmp_path / "link.exr").is_symlink()
        assert json.loads(tool(tmp_path, "lut", "info", "real.exr", "--json").stdout)["seed"] == seed


def stopped(folder, args):
    """The checkpoint that SIGTERM leaves of a bake."""
    life = started(folder, *args, "--checkpoint", "--checkpoint-every", 0.1, "-q")
    wait_for(folder / "pearl.exr.checkpoint")
    life.send_signal(signal.SIGTERM)
    _, stderr = life.communicate()
    assert life.returncode == 1
    one_line(stderr, "interrupted", "--resume")
    return (folder / "pearl.exr.checkpoint").read_bytes()


def test_a_checkpoint_that_cannot_be_gone_on_from_is_refused_and_kept(tmp_path):
    args = bake_of(tmp_path, 3.0)
    whole = baked(tmp_path, *args)
    good = stopped(tmp_path, args)
    checkpoint = tmp_path / "pearl.exr.checkpoint"
    magic = b"nacre-state/1\n"
    newer = good[len(magic) + 4 :].replace(b"bake-brdf 0.", b"bake-brdf 9.", 1)
    damaged = {
        "empty": b"",
        "cut short": good[: len(good) // 2],
        "a bit flipped": good[:100] + bytes([good[100] ^ 1]) + good[101:],
        "of another format": good.replace(b"nacre-state/1", b"nacre-state/2"),
        "of another version": magic + zlib.crc32(newer).to_bytes(4, "little") + newer,
    }
    for how, content in damaged.items():
        checkpoint.write_bytes(content)
        refused = tool(tmp_path, "bake-brdf", *args, "--resume", "-q")
        assert refused.returncode == 2, how
        one_line(refused.stderr, "pearl.exr.checkpoint", "version" if "version" in how else "bake state")
        assert checkpoint.read_bytes() == content and not (tmp_path / "pearl.exr").exists()
    checkpoint.write_bytes(good)
    for other in (["--seed", 9], ["--azimuth", "space"], ["--event-cap", 77], ["--precision", "f64"], ["--effects", "surface,blur"]):
        flags = [word for word in args if word not in ("--seed", 3)] if "--seed" in other else args
        refused = tool(tmp_path, "bake-brdf", *flags, *other, "--resume", "-q")
        assert refused.returncode == 2
        one_line(refused.stderr, "pearl.exr.checkpoint", "belongs to another bake")
        assert checkpoint.read_bytes() == good
    # As many threads as there were, or not.
    resumed = tool(tmp_path, "bake-brdf", *args, "--resume", "--threads", 3, "-q")
    assert resumed.returncode == 0, resumed.stderr
    assert (tmp_path / "pearl.exr").read_bytes() == whole and not checkpoint.exists()


def test_what_standard_output_cannot_take_is_named(sharded):
    folder, _, _ = sharded
    with open("/dev/full", "w") as full:
        done = subprocess.run([BIN / "bake-brdf", "schema"], stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 1
    one_line(done.stderr, "standard output", "No space left on device")
