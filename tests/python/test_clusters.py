"""Bakes on clusters: Dask with a worker killed in the middle, and a Slurm job array, give the bytes of one bake."""

import os
import signal
import subprocess
import sys

import pytest
from built import BIN, ROOT

distributed = pytest.importorskip("distributed")
import nacre  # noqa: E402

DRIVER = ROOT / "tools" / "dask" / "bake.py"
SLURM = ROOT / "tools" / "slurm"
RECIPE = '{"stack":{"layers":40}}'
FURTHER = ["--incident-deg", "0,40,80", "--seed", "11"]
OPTIONS = ["--", "incident_deg=[0,40,80]", "seed=11"]


@pytest.fixture
def recipe(tmp_path):
    path = tmp_path / "recipe.json"
    path.write_text(RECIPE)
    return path


def single(folder, recipe, paths):
    """The bytes of a bake in one process."""
    output = folder / "single.exr"
    subprocess.run([BIN / "bake-brdf", recipe, "--paths", str(paths), *FURTHER, "-q", "-o", output], check=True, stdout=subprocess.DEVNULL)
    return output.read_bytes()


def driver(*args):
    command = [sys.executable, DRIVER, *args]
    return subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_a_worker_killed_in_the_middle_costs_no_bit(tmp_path, recipe):
    paths = 2_000_000
    whole = single(tmp_path, recipe, paths)
    output = tmp_path / "dask.exr"
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        victims = client.run(os.getpid)
        bake = driver(recipe, "--paths", paths, "--shards", 30, "-o", output, "--scheduler", cluster.scheduler_address, *OPTIONS)
        # Both workers walk when the first tenth of the shards is done.
        first = bake.stderr.readline()
        assert "/30 shards" in first, first + bake.stderr.read()
        victim = next(iter(victims.values()))
        os.kill(victim, signal.SIGKILL)
        stdout, stderr = bake.communicate(timeout=120)
        assert bake.returncode == 0, stderr
        survivors = client.run(os.getpid)
    assert victim not in survivors.values()
    assert stdout.strip() == str(output) and "30/30 shards" in stderr
    assert output.read_bytes() == whole


def test_a_sweep_makes_a_table_a_recipe_on_the_embedded_cluster(tmp_path, recipe):
    other = tmp_path / "other.json"
    other.write_text('{"stack":{"layers":10},"name":"other"}')
    paths = 100_000
    bake = driver(recipe, other, "--paths", paths, "--shards", 3, "-o", tmp_path / "tables", "--workers", 2, "-q", *OPTIONS)
    stdout, stderr = bake.communicate(timeout=120)
    assert bake.returncode == 0, stderr
    assert sorted(stdout.split()) == [str(tmp_path / "tables" / f"{name}.exr") for name in ("other", "recipe")]
    for path in (recipe, other):
        assert (tmp_path / "tables" / f"{path.stem}.exr").read_bytes() == single(tmp_path, path, paths)


def test_shards_of_another_recipe_of_the_sweep_are_refused(monkeypatch, recipe):
    """All shards of two recipes change places on their way: each table would be whole, and the other's."""
    sys.path.insert(0, str(DRIVER.parent))
    import bake as dask_bake

    sweep = {"one": {"stack": {"layers": 10}}, "other": {"stack": {"layers": 12}}}
    walked = dask_bake.walk
    swapped = lambda content, *rest: walked({"stack": {"layers": 22 - content["stack"]["layers"]}}, *rest)
    with distributed.Client(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as client:
        tables = dict(dask_bake.bake(client, sweep, paths=2000, shards=2, incident_deg=[0, 40]))
        assert [table.meta["recipe"]["stack"]["layers"] for _, table in sorted(tables.items())] == [10, 12]
        monkeypatch.setattr(dask_bake, "walk", swapped)
        with pytest.raises(RuntimeError, match="the shards are those of another recipe"):
            list(dask_bake.bake(client, sweep, paths=2000, shards=2, incident_deg=[0, 40]))


def test_shards_that_make_no_bake_are_refused(recipe):
    walk = lambda index, count=2, **options: nacre.walk_shard(recipe, index, count, **{"paths": 2000, "incident_deg": [0], **options})
    first, second = walk(1), walk(2)
    assert nacre.merge([second, first]) == nacre.bake(recipe, solver="walk", paths=2000, incident_deg=[0])
    for shards, said in (
        ([], "no shards"),
        ([first], "2"),
        ([first, first], "again"),
        ([first, walk(2, seed=5)], "another bake"),
        ([first, second[:-1]], r"shards\[1\]: .*checksum"),
    ):
        with pytest.raises(nacre.InputError, match=said):
            nacre.merge(shards)
    for wrong in ({"index": 3}, {"index": 0}, {"index": 1, "effects": "body"}, {"index": 1, "paths": 0}, {"index": 1, "threads": 0}):
        with pytest.raises(nacre.InputError):
            walk(**wrong)


def test_wrong_input_is_one_line_and_exit_2(tmp_path, recipe):
    bad = tmp_path / "bad.json"
    bad.write_text('{"stack":{"layer":5}}')
    kept = tmp_path / "kept.exr"
    kept.write_bytes(b"the old table")
    for args, word in [
        ([bad, "--paths", 1000, "-o", kept, "--workers", 1, "-q"], "layer"),
        ([tmp_path / "absent.json", "--paths", 1000, "-o", kept, "--workers", 1, "-q"], "absent.json"),
        ([recipe, "--paths", 0, "-o", kept], "paths"),
        ([recipe, "-o", kept], "paths"),
        ([recipe, "--paths", 1000, "-o", kept, "--workers", 1, "-q", "--", "seed"], "'seed' is not NAME=VALUE"),
        ([recipe, "--paths", 1000, "-o", kept, "--workers", 1, "-q", "--", "azimuth=flat"], "azimuth"),
    ]:
        bake = driver(*args)
        _, stderr = bake.communicate(timeout=120)
        assert bake.returncode == 2, stderr
        assert len(stderr.strip().splitlines()) == 1 and word in stderr, stderr
        assert kept.read_bytes() == b"the old table"


def test_clusters_side_by_side_are_quiet(tmp_path, recipe):
    refused = [recipe, "--paths", 1000, "-o", tmp_path / "none.exr", "--workers", 1, "-q", "--", "azimuth=flat"]
    bakes = [driver(*refused) for _ in range(3)]
    for bake in bakes:
        _, stderr = bake.communicate(timeout=120)
        assert bake.returncode == 2 and len(stderr.strip().splitlines()) == 1, stderr


SBATCH = """#!/bin/bash
# Answers as sbatch does, and runs each task of the array here, the last one first, as Slurm would elsewhere. ANSWER is what
# --parsable prints. How many tasks the array has is not what a shard may go by: it says 1.
set -e
echo "$*" >> "$SUBMITTED"
tasks=1
for word; do
    case $word in
        --array=*-*) tasks=$(seq "${word#--array=1-}" -1 1) ;;
        --array=*) tasks=${word#--array=} ;;
        --dependency=*) [[ $word =~ ^--dependency=afterok:[0-9]+$ ]] || { echo "Job dependency problem ($word)" >&2; exit 1; } ;;
        *.sbatch) job=$word ;;
    esac
done
for task in $tasks; do SLURM_ARRAY_TASK_ID=$task SLURM_ARRAY_TASK_COUNT=1 bash "$job"; done
case "$*" in *--parsable*) echo "$ANSWER" ;; *) echo "Submitted batch job 4243" ;; esac
"""


class Slurm:
    """A stand-in for Slurm in a folder."""

    def __init__(self, folder, answer):
        shim = folder / "bin"
        shim.mkdir()
        (shim / "sbatch").write_text(SBATCH)
        (shim / "sbatch").chmod(0o755)
        self.submitted = folder / "submitted"
        path = f"{shim}{os.pathsep}{BIN}{os.pathsep}{os.environ['PATH']}"
        self.env = {**os.environ, "PATH": path, "ANSWER": answer, "SUBMITTED": str(self.submitted), "BAKE_ARGUMENTS": " ".join(FURTHER)}

    def run(self, *command, **env):
        command = [str(word) for word in command]
        return subprocess.run(command, env={**self.env, **env}, capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize(("answer", "clusters"), [("4242", []), ("4242;nautilus", ["--clusters=nautilus"])])
def test_the_slurm_job_array_makes_the_bytes_of_one_bake(tmp_path, recipe, answer, clusters):
    slurm, output = Slurm(tmp_path, answer), tmp_path / "slurm.exr"
    done = slurm.run(SLURM / "submit.sh", recipe, "100000", "5", output)
    assert done.returncode == 0, done.stderr
    whole = single(tmp_path, recipe, 100_000)
    assert output.read_bytes() == whole
    merge = slurm.submitted.read_text().splitlines()[-1].split()
    assert "--dependency=afterok:4242" in merge and [word for word in merge if "cluster" in word] == clusters

    # A lost shard is walked again by an array of one task.
    shards = tmp_path / "slurm.exr.shards"
    (shards / "3-of-5.shard").unlink()
    output.unlink()
    by_hand = {"RECIPE": str(recipe), "PATHS": "100000", "SHARD_COUNT": "5", "SHARDS": str(shards), "OUTPUT": str(output)}
    for submission in (["--array=3", SLURM / "shard.sbatch"], [SLURM / "merge.sbatch"]):
        done = slurm.run("sbatch", *submission, **by_hand)
        assert done.returncode == 0, done.stderr
    assert output.read_bytes() == whole


def test_slurm_shards_of_another_bake_are_refused(tmp_path, recipe):
    slurm, output = Slurm(tmp_path, "4242"), tmp_path / "slurm.exr"
    assert slurm.run(SLURM / "submit.sh", recipe, "1000", "2", output).returncode == 0
    output.write_bytes(b"the old table")
    recipe.write_text('{"stack":{"layers":41}}')
    stale = slurm.run(SLURM / "submit.sh", recipe, "1000", "2", output)
    assert stale.returncode != 0 and "belongs to another bake" in stale.stderr, stale.stderr
    assert output.read_bytes() == b"the old table"
