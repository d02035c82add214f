"""What the peers share: their options, and the line of JSON that they print."""

import argparse
import json
import math
import resource
from dataclasses import dataclass


def arguments(about):
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--paths", type=lambda text: int(float(text)), default=200_000)
    parser.add_argument("--theta", type=float, default=30, help="incidence, degrees")
    parser.add_argument("--sigma-deg", type=float, default=2)
    parser.add_argument("--dim", type=int, choices=(2, 3), default=3, help="2: plane walk, 3: space walk")
    parser.add_argument("--layers", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1)
    return parser.parse_args()


def cpu_seconds():
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


@dataclass
class Result:
    name: str
    options: argparse.Namespace
    bins: list  # 180 counts of the exit angle, 1 degree each from -90 (space walk: 90 to 179 only)
    crossings: int
    cpu: float


def report(result):
    count = sum(result.bins)
    angles = [i - 89.5 for i in range(180)]
    mean = sum(a * n for a, n in zip(angles, result.bins)) / count
    sd = math.sqrt(sum((a - mean) ** 2 * n for a, n in zip(angles, result.bins)) / count)
    print(
        json.dumps(
            {
                "impl": result.name,
                "paths": result.options.paths,
                "crossings": result.crossings,
                "cpu_s": result.cpu,
                "threads": result.options.threads,
                "albedo": count / result.options.paths,
                "mean_theta": mean,
                "sd_theta": sd,
                "ns_per_crossing_cpu": result.cpu / result.crossings * 1e9,
            }
        )
    )
