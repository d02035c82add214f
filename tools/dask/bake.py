#!/usr/bin/env python3
"""Bakes a pearl table, or one for each of many recipes, on a Dask cluster.

    python tools/dask/bake.py akoya.json --paths 1000000 -o akoya.exr              on this machine's cores
    python tools/dask/bake.py sweep/*.json --paths 100000 -o tables                one table a recipe
    python tools/dask/bake.py akoya.json --paths 1000000 -o akoya.exr \\
        --scheduler tcp://head:8786 --shards 256                                   on any dask.distributed cluster
    ... -- --incident-deg 0:90:5 --azimuth space                                    further arguments of bake-brdf

Each bake is cut into shards (`bake-brdf --shard I/N`), which workers walk in any order; `lut merge` makes the table, bit
for bit that of a bake on one machine, and only of shards that say themselves that they belong to the bake asked for.
Shards of a worker that is lost are walked again by another. Workers need `bake-brdf` at the same place as here (or by
--bin) and no common file system: recipes and shards travel with the tasks.

Exit codes as of every tool: 0 ok, 1 runtime failure, 2 wrong usage or input.
"""

import argparse
import contextlib
import json
import logging
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time
from typing import NamedTuple

import dask
from dask.distributed import Client, LocalCluster, as_completed

BAD_INPUT = 2


class Refused(Exception):
    """Wrong usage or input: repeating it would not help."""


def walk_shard(binary, recipe, arguments, index, count, threads):
    """One task, on a worker: the bytes of a shard, or the line with which the bake was refused."""
    with tempfile.TemporaryDirectory(prefix="nacre-") as folder:
        command = [binary, *arguments, "--shard", f"{index}/{count}", "--threads", str(threads), "-q", "-o", "part.shard"]
        if recipe is not None:
            (pathlib.Path(folder) / "recipe.json").write_bytes(recipe)
            command.insert(1, "recipe.json")
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if done.returncode == BAD_INPUT:
            return None, done.stderr.strip()
        if done.returncode != 0:
            # Dask tries again elsewhere: a full disk or a killed process is the machine's fault.
            raise RuntimeError(f"shard {index}/{count}: exit {done.returncode}: {done.stderr.strip()}")
        return (pathlib.Path(folder) / "part.shard").read_bytes(), None


class Progress:
    """Shards done of all, on stderr: a line that moves on a terminal, else one every tenth of the way."""

    def __init__(self, total, quiet):
        self.total, self.done, self.quiet, self.start, self.tenth = total, 0, quiet, time.monotonic(), 0

    def step(self, workers):
        self.done += 1
        if self.quiet:
            return
        elapsed = time.monotonic() - self.start
        left = elapsed * (self.total - self.done) / self.done
        line = f"{self.done}/{self.total} shards, {workers} workers, {elapsed:.0f} s + {left:.0f} s left"
        if sys.stderr.isatty():
            print(f"\r{line}\033[K", end="\n" if self.done == self.total else "", file=sys.stderr, flush=True)
        elif 10 * self.done // self.total > self.tenth:
            self.tenth = 10 * self.done // self.total
            print(line, file=sys.stderr, flush=True)


def tool(folder, name):
    """A tool of ours: in --bin, else on the PATH, else where cargo puts it."""
    built = pathlib.Path(__file__).resolve().parents[2] / "target" / "release"
    for path in [folder and shutil.which(name, path=folder), None if folder else shutil.which(name), shutil.which(name, path=built)]:
        if path:
            return str(pathlib.Path(path).resolve())
    raise Refused(f"{name}: not found in {folder or 'PATH'}; build it with cargo build --release, or give --bin")


def outputs(recipes, output):
    """The table of each recipe: the output itself for one, files in it for many."""
    if len(recipes) == 1:
        return [pathlib.Path(output)]
    names = [pathlib.Path(recipe).stem for recipe in recipes]
    for name in names:
        if names.count(name) > 1:
            raise Refused(f"{name}.json: two recipes of this name; their tables would be one file")
    folder = pathlib.Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    return [folder / f"{name}.exr" for name in names]


def content_hash(binary, wanted, further):
    """What the shards of a bake must say that they hold; a recipe or an argument that is wrong is refused here."""
    with tempfile.TemporaryDirectory(prefix="nacre-") as folder:
        command = [binary, *further, "--dry-run", "--json", "-q"]
        if wanted.recipe is not None:
            (pathlib.Path(folder) / "recipe.json").write_bytes(wanted.recipe)
            command.insert(1, "recipe.json")
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if done.returncode == BAD_INPUT:
        raise Refused(f"{wanted.name}: {done.stderr.strip()}")
    if done.returncode != 0:
        raise RuntimeError(done.stderr.strip())
    return json.loads(done.stdout)["content_hash"]


def merge(lut, folder, shards, content, output):
    """Makes the table of all shards; `lut` writes it whole or not at all, and only of shards of this content."""
    paths = []
    for index, shard in shards.items():
        paths.append(pathlib.Path(folder) / f"{index}.shard")
        paths[-1].write_bytes(shard)
    done = subprocess.run([lut, "merge", *paths, "--content-hash", content, "-o", output], capture_output=True, text=True)
    for path in paths:
        path.unlink()
    if done.returncode != 0:
        raise RuntimeError(done.stderr.strip())


def prepare(arguments):
    """The tools, and of each recipe its name, its bytes and its table; what is wrong with them shows before any work."""
    tools = tool(arguments.bin, "bake-brdf"), tool(arguments.bin, "lut")
    recipes = []
    for recipe in arguments.recipes:
        try:
            recipes.append((recipe, pathlib.Path(recipe).read_bytes()))
        except OSError as why:
            raise Refused(f"{recipe}: {why.strerror}") from why
    recipes = recipes or [("the paper's pearl", None)]
    tables = outputs([name for name, _ in recipes], arguments.output)
    return tools, [Wanted(*recipe, table) for recipe, table in zip(recipes, tables)]


class Wanted(NamedTuple):
    """A table to be made."""

    name: str
    recipe: bytes | None
    table: pathlib.Path


def bake(client, arguments, tools, wanted):
    bake_brdf, lut = tools
    count = arguments.shards
    further = ["--paths", str(arguments.paths), *arguments.further]
    # Of the bytes that the workers get: the file may have changed since it was read.
    contents = [content_hash(bake_brdf, of, further) for of in wanted]
    jobs = {}
    for which, of in enumerate(wanted):
        for index in range(1, count + 1):
            future = client.submit(
                walk_shard, bake_brdf, of.recipe, further, index, count, arguments.threads_per_shard,
                retries=arguments.retries, pure=False,
            )
            jobs[future] = (which, index)
    shards = [{} for _ in wanted]
    progress = Progress(len(jobs), arguments.quiet)
    with tempfile.TemporaryDirectory(prefix="nacre-merge-") as folder:
        for future, (content, refusal) in as_completed(list(jobs), with_results=True):
            which, index = jobs.pop(future)
            if refusal is not None:
                client.cancel(list(jobs))
                raise Refused(f"{wanted[which].name}: {refusal}")
            shards[which][index] = content
            future.release()
            progress.step(len(client.scheduler_info()["workers"]))
            if len(shards[which]) == count:
                merge(lut, folder, shards[which], contents[which], wanted[which].table)
                shards[which].clear()
                print(wanted[which].table, flush=True)


@contextlib.contextmanager
def cluster(arguments):
    """A client of the scheduler asked for, or of a cluster of one process a core on this machine."""
    # A shard may lose as many workers as it may fail before it counts as the culprit.
    with dask.config.set({"distributed.scheduler.allowed-failures": arguments.retries}):
        if arguments.scheduler:
            try:
                client = Client(arguments.scheduler, timeout=20)
            except OSError as why:
                raise Refused(f"--scheduler: {arguments.scheduler}: no Dask scheduler answers: {why}") from why
            with client:
                yield client
            return
        workers = arguments.workers or max(1, (os.cpu_count() or 1) // arguments.threads_per_shard)
        with (
            LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None) as local,
            Client(local) as client,
        ):
            yield client


def at_least_one(text):
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text} is less than 1")
    return number


class Parser(argparse.ArgumentParser):
    def error(self, message):
        raise Refused(message)


def parse(argv):
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recipes", nargs="*", help="recipes (JSON); none: the paper's pearl")
    parser.add_argument("-o", "--output", required=True, help="table to write; a folder where there are several recipes")
    parser.add_argument("--paths", type=at_least_one, required=True, help="paths per incidence")
    parser.add_argument("--shards", type=at_least_one, default=16, help="shards of each table [16]")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="a dask.distributed scheduler; without it a cluster on this machine")
    parser.add_argument("--workers", type=at_least_one, help="workers of the cluster on this machine [one a core]")
    parser.add_argument("--threads-per-shard", type=at_least_one, default=1, help="threads of each bake-brdf [1]")
    parser.add_argument("--retries", type=at_least_one, default=5, help="failures or lost workers that a shard survives [5]")
    parser.add_argument("--bin", metavar="DIR", help="folder of bake-brdf and lut, here and on the workers")
    parser.add_argument("-q", "--quiet", action="store_true", help="no progress on stderr")
    # What follows -- is for bake-brdf.
    split = argv.index("--") if "--" in argv else len(argv)
    arguments = parser.parse_args(argv[:split])
    arguments.further = argv[split + 1 :]
    return arguments


def main():
    # A client that is closed while results are on their way says so at length.
    logging.getLogger("tornado.application").setLevel(logging.CRITICAL)
    try:
        arguments = parse(sys.argv[1:])
        tools, recipes = prepare(arguments)
        with cluster(arguments) as client:
            bake(client, arguments, tools, recipes)
    except Refused as why:
        print(f"dask/bake.py: {why}", file=sys.stderr)
        return BAD_INPUT
    except Exception as why:
        print(f"dask/bake.py: {' '.join(str(why).split()) or type(why).__name__}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
