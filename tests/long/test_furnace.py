"""The white furnace over 10,000 random pairs of recipe and controls: part of `cargo xtask long`.

NACRE_FURNACES sets another number. Tools are found through NACRE_BIN, else in target/release.
"""

import concurrent.futures
import json
import os
import random
import subprocess

from built import BIN

FURNACES = int(os.environ.get("NACRE_FURNACES", "10000"))
CONTROLS_PER_RECIPE = 50
# Angles of incidence a furnace looks at, off the nodes of the tables.
STEPS = 13


def random_recipe(draw):
    def layer():
        thickness = 10 ** draw.uniform(1.0, 2.9)
        irregularity = draw.choice([0.0, draw.uniform(0.0, 0.2)])
        return {
            "n": draw.uniform(1.2, 2.2),
            "k": draw.choice([0.0, 10 ** draw.uniform(-6.0, -3.0)]),
            "thickness_nm": thickness,
            "thickness_sd_nm": irregularity * thickness,
        }

    return {
        "stack": {
            "layers": int(10 ** draw.uniform(0.0, 2.9)),
            "aragonite": layer(),
            "conchiolin": layer(),
            "substrate": {"n": draw.uniform(1.0, 2.5)},
        },
        "facets": {"slope_sd_deg": draw.uniform(1.0, 12.0)},
        "azimuth": {"mode": draw.choice(["decay", "decay", "space"])},
        "look": {"depth": 0.5, "coherence": 0.5},
    }


def bake(folder, number, recipe):
    """The table of a recipe, or None where doubling refuses it (it says so in one line)."""
    path, table = folder / f"{number}.json", folder / f"{number}.exr"
    path.write_text(json.dumps(recipe))
    done = subprocess.run(
        [BIN / "bake-brdf", path, "--solver", "doubling", "--accuracy", "5", "--incident-deg", "0:90:5", "--threads", "1", "-q", "-o", table],
        capture_output=True,
        text=True,
    )
    if done.returncode == 2:
        print(f"refused: {done.stderr.strip()}")
        return None
    assert done.returncode == 0, done.stderr
    return table


def random_controls(draw):
    def colour():
        return ",".join(f"{draw.choice([0.0, 1.0, draw.random()]):.3f}" for _ in range(3))

    def share():
        return f"{draw.choice([0.0, 1.0, draw.random(), draw.random()]):.3f}"

    return [
        "--depth",
        share(),
        "--brightness",
        share(),
        "--coherence",
        share(),
        "--body-rgb",
        draw.choice(["1,1,1", colour()]),
        "--tint-rgb",
        draw.choice(["1,1,1", colour()]),
    ]


def furnace(table, controls):
    """Largest and least albedo of any channel and angle."""
    done = subprocess.run(
        [BIN / "pearl", "furnace", table, *controls, "--steps", str(STEPS), "--threads", "1", "--json"], capture_output=True, text=True
    )
    assert done.returncode in (0, 3), done.stderr
    albedos = [albedo for row in json.loads(done.stdout)["per_incidence"] for albedo in row["albedo"]]
    return max(albedos), min(albedos)


def test_no_channel_sends_out_more_than_it_receives(tmp_path):
    draw = random.Random(20)
    recipes = FURNACES // CONTROLS_PER_RECIPE
    seeds = [draw.randrange(2**32) for _ in range(recipes)]
    largest, failures, count = 0.0, [], 0

    def work(number):
        own = random.Random(seeds[number])
        table = bake(tmp_path, number, random_recipe(own))
        if table is None:
            return []
        jobs = [random_controls(own) for _ in range(CONTROLS_PER_RECIPE)]
        return [(number, controls, *furnace(table, controls)) for controls in jobs]

    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        for results in pool.map(work, range(recipes)):
            for number, controls, most, _ in results:
                count += 1
                largest = max(largest, most)
                if most > 1.0 + 1e-4:
                    failures.append((number, seeds[number], controls, most))
            if results:
                # After every recipe, so that a run that is cut off leaves its figure.
                print(f"{count} furnaces so far: largest albedo 1 + {largest - 1.0:.2e}, {len(failures)} above 1 + 1e-4", flush=True)
    print(f"{count} furnaces of {recipes} recipes: largest albedo 1 + {largest - 1.0:.2e}, {len(failures)} above 1 + 1e-4")
    assert count > FURNACES // 2, "too many recipes were refused for the figure to mean anything"
    assert not failures, failures[:5]


def test_a_white_body_loses_nothing(tmp_path):
    """Without absorption, tint or interference colours' own losses, white stays at least 0.98."""
    draw = random.Random(21)
    least = 1.0
    for number in range(40):
        recipe = random_recipe(draw)
        for layer in ("aragonite", "conchiolin"):
            recipe["stack"][layer]["k"] = 0.0
        table = bake(tmp_path, number, recipe)
        if table is None:
            continue
        for coherence in ("0", "0.5", "1"):
            _, low = furnace(table, ["--depth", "0", "--coherence", coherence, "--body-rgb", "1,1,1"])
            least = min(least, low)
    print(f"white body, no absorption: least albedo {least:.4f}")
    assert least >= 0.98
