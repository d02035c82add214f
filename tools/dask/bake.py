#!/usr/bin/env python3
"""Bakes a pearl table, or one for each of many recipes, on a Dask cluster.

    python tools/dask/bake.py akoya --paths 1000000 -o akoya.exr                   on this machine's cores
    python tools/dask/bake.py sweep/*.json --paths 100000 -o tables                one table a recipe
    python tools/dask/bake.py akoya --paths 1000000 -o akoya.exr \\
        --scheduler tcp://head:8786 --shards 256                                   on any dask.distributed cluster
    ... -- incident_deg=[0,40,80] azimuth=space seed=11                            further arguments of nacre.walk_shard

Each bake is cut into shards (`nacre.walk_shard`), which workers walk in any order; `nacre.merge` makes the table, bit for bit
that of a bake on one machine. Shards of a worker that is lost are walked again by another. Workers need the package `nacre` and no
common file system: recipes and shards travel with the tasks. Scripts call `bake(client, recipes, ...)` with a client of their own.

Exit codes as of every tool: 0 ok, 1 runtime failure, 2 wrong usage or input.
"""

import argparse
import contextlib
import json
import logging
import os
import pathlib
import sys
import time

import dask
from dask.distributed import Client, LocalCluster, as_completed

import nacre


class Refused(Exception):
    """Wrong usage or input: repeating it would not help."""


def walk(recipe, index, count, options):
    """One task, on a worker: the bytes of a shard, or the line with which the bake was refused."""
    try:
        return nacre.walk_shard(recipe, index, count, **options), None
    except (nacre.InputError, TypeError) as why:
        return None, str(why)


def bake(client, recipes, *, paths, shards=16, retries=5, done=lambda: None, **options):
    """Yields name and table of every recipe (a dict from names to recipes), as they get ready: one sweep, cut into shards.

    `options` are those of `nacre.walk_shard`; `done` is called after every shard; a shard survives `retries` failures.
    """
    contents = {name: nacre.Recipe(recipe).to_dict() for name, recipe in recipes.items()}
    options = {"threads": 1, **options, "paths": paths}
    jobs = {
        client.submit(walk, content, index, shards, options, retries=retries, pure=False): (name, index)
        for name, content in contents.items()
        for index in range(1, shards + 1)
    }
    walked = {name: {} for name in recipes}
    for future, (shard, refusal) in as_completed(list(jobs), with_results=True):
        name, index = jobs.pop(future)
        if refusal is not None:
            client.cancel(list(jobs))
            raise Refused(f"{name}: {refusal}")
        walked[name][index] = shard
        future.release()
        done()
        if len(walked[name]) == shards:
            table = nacre.merge(list(walked.pop(name).values()))
            # Options may choose another azimuth.
            if table.meta["recipe"] | {"azimuth": None} != contents[name] | {"azimuth": None}:
                raise RuntimeError(f"{name}: the shards are those of another recipe, {table.meta['recipe']['name']}")
            yield name, table


class Progress:
    """Shards done of all, on stderr: a line that moves on a terminal, else one every tenth of the way."""

    def __init__(self, total, client, quiet):
        self.total, self.done, self.client, self.quiet, self.start, self.tenth = total, 0, client, quiet, time.monotonic(), 0

    def step(self):
        self.done += 1
        if self.quiet:
            return
        elapsed, workers = time.monotonic() - self.start, len(self.client.scheduler_info()["workers"])
        left = elapsed * (self.total - self.done) / self.done
        line = f"{self.done}/{self.total} shards, {workers} workers, {elapsed:.0f} s + {left:.0f} s left"
        if sys.stderr.isatty():
            print(f"\r{line}\033[K", end="\n" if self.done == self.total else "", file=sys.stderr, flush=True)
        elif 10 * self.done // self.total > self.tenth:
            self.tenth = 10 * self.done // self.total
            print(line, file=sys.stderr, flush=True)


def outputs(recipes, output):
    """The table of each recipe: the output itself for one, files in it for many."""
    if len(recipes) == 1:
        return {recipes[0]: pathlib.Path(output)}
    names = [pathlib.Path(recipe).stem for recipe in recipes]
    for name in names:
        if names.count(name) > 1:
            raise Refused(f"{name}: two recipes of this name; their tables would be one file")
    folder = pathlib.Path(output)
    folder.mkdir(parents=True, exist_ok=True)
    return {recipe: folder / f"{name}.exr" for recipe, name in zip(recipes, names)}


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
        # Workers that end while they hold tasks, as where a recipe is refused, and a second cluster on this machine, say so at length.
        quiet = {"dashboard_address": None, "scheduler_kwargs": {"dashboard_address": ":0"}, "silence_logs": logging.CRITICAL}
        with LocalCluster(n_workers=workers, threads_per_worker=1, processes=True, **quiet) as local, Client(local) as client:
            yield client


def at_least_one(text):
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text} is less than 1")
    return number


def option(text):
    """NAME=VALUE, the value as JSON or as it stands."""
    name, equals, value = text.partition("=")
    if not equals:
        raise Refused(f"{text!r} is not NAME=VALUE")
    with contextlib.suppress(ValueError):
        value = json.loads(value)
    return name, value


class Parser(argparse.ArgumentParser):
    def error(self, message):
        raise Refused(message)


def parse(argv):
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recipes", nargs="*", default=["paper"], help="recipes: files (JSON) or built-in names [paper]")
    parser.add_argument("-o", "--output", required=True, help="table to write; a folder where there are several recipes")
    parser.add_argument("--paths", type=at_least_one, required=True, help="paths per incidence")
    parser.add_argument("--shards", type=at_least_one, default=16, help="shards of each table [16]")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="a dask.distributed scheduler; without it a cluster on this machine")
    parser.add_argument("--workers", type=at_least_one, help="workers of the cluster on this machine [one a core]")
    parser.add_argument("--threads-per-shard", type=at_least_one, default=1, help="threads of each shard [1]")
    parser.add_argument("--retries", type=at_least_one, default=5, help="failures or lost workers that a shard survives [5]")
    parser.add_argument("-q", "--quiet", action="store_true", help="no progress on stderr")
    # What follows -- is for nacre.walk_shard.
    split = argv.index("--") if "--" in argv else len(argv)
    arguments = parser.parse_args(argv[:split])
    arguments.options = dict(map(option, argv[split + 1 :])) | {"threads": arguments.threads_per_shard}
    return arguments


def main():
    # A client that is closed while results are on their way says so at length.
    logging.getLogger("tornado.application").setLevel(logging.CRITICAL)
    try:
        arguments = parse(sys.argv[1:])
        recipes = {name: nacre.Recipe(name) for name in arguments.recipes}
        tables = outputs(arguments.recipes, arguments.output)
        with cluster(arguments) as client:
            progress = Progress(arguments.shards * len(recipes), client, arguments.quiet)
            sweep = {"paths": arguments.paths, "shards": arguments.shards, "retries": arguments.retries, "done": progress.step}
            for name, table in bake(client, recipes, **arguments.options | sweep):
                table.save(tables[name])
                print(tables[name], flush=True)
    except (Refused, nacre.InputError) as why:
        print(f"dask/bake.py: {why}", file=sys.stderr)
        return 2
    except Exception as why:
        print(f"dask/bake.py: {' '.join(str(why).split()) or type(why).__name__}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
