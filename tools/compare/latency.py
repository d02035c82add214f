#!/usr/bin/env python3
"""Times the page of `pearl studio` in chromium: from a control to its frame, and from a thickness to its first and its final picture.

    python tools/compare/latency.py                 the paper's pearl
    python tools/compare/latency.py akoya -n 5      another recipe, fewer times

Prints least, median and most of each and of its parts, milliseconds, and what the machine was doing beside. A frame is counted
once it is drawn into the page; the browser shows it with its next refresh. Wants an idle machine. Where there is no graphics
processor the page is drawn by SwiftShader. The tools are found through NACRE_BIN, else in target/release. Exit codes: 0 done,
1 runtime failure, 2 wrong usage.
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

import browser as chromium
from tables import Bad, Tools

SCHEMA = "pearl-latency/1"
#: Waits for the frame of the present state, and says when it was changed and how long the frame took from there.
PREPARE = """() => {
  const { page } = nacre;
  const tick = () => new Promise((resolve) => requestAnimationFrame(resolve));
  const frame = async () => {
    const { renderer } = page;
    while (renderer.firstOf !== renderer.stamp) await tick();
    return [renderer.changed, renderer.latency];
  };
  window.controlled = async (depth) => {
    const begun = performance.now();
    page.change({ depth });
    const [changed, drawn] = await frame();
    return { all: changed - begun + drawn, "paint the controls": changed - begun, "trace and draw": drawn };
  };
  window.thickened = async (nm) => {
    const { latency } = page.pearls;
    Object.assign(latency, { first: 0, last: 0 });
    performance.clearResourceTimings();
    const begun = performance.now();
    const recipe = structuredClone(page.state.a.recipe);
    recipe.stack.aragonite.thickness_nm = nm;
    page.change({ recipe });
    const found = {};
    for (const [quality, name] of [["first", "first picture"], ["last", "final picture"]]) {
      while (!latency[quality]) await tick();
      const [changed, drawn] = await frame();
      const request = performance.getEntriesByType("resource").filter(({ name }) => name.endsWith("/api/bake"))[quality === "first" ? 0 : 1];
      const parts = { all: changed - begun + drawn };
      for (const { name, duration } of request.serverTiming) parts[`server: ${name}`] = duration;
      parts["request and answer"] = request.duration - request.serverTiming.reduce((sum, { duration }) => sum + duration, 0);
      const before = quality === "first" ? begun : request.startTime;
      parts["unpack and upload"] = changed - before - request.duration;
      parts["trace and draw"] = drawn;
      found[name] = parts;
    }
    return found;
  };
}"""


def measured(options):
    """Milliseconds of every time, by what was done and its part."""
    server = subprocess.Popen(
        [Tools("").path("pearl"), "studio", options.recipe, "--no-browser"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    found = {}

    def note(what, parts):
        for part, milliseconds in parts.items():
            found.setdefault(what, {}).setdefault(part, []).append(milliseconds)

    try:
        url = server.stdout.readline().strip()
        if not url:
            raise Bad(server.stderr.read().strip().splitlines()[-1])
        with chromium.browser() as made:
            page = made.visit(url, offline=False, viewport={"width": options.width, "height": options.height})
            page.evaluate("nacre.ready")
            page.evaluate("nacre.page.pearls.baking")
            page.evaluate(PREPARE)
            note("size", page.evaluate("({ width: nacre.page.canvas.width, height: nacre.page.canvas.height })"))
            thickness = page.evaluate("nacre.state().a.recipe.stack?.aragonite?.thickness_nm")
            if not isinstance(thickness, (int, float)) or page.evaluate("Boolean(nacre.state().a.recipe.stack.explicit)"):
                raise Bad(f"{options.recipe}: has no stack.aragonite.thickness_nm to move; expected a stack of two materials")
            for k in range(options.times + 1):
                control = page.evaluate("(depth) => controlled(depth)", 0.2 + 0.6 * (k % 7) / 7)
                # A thickness that was never baked.
                bakes = page.evaluate("(nm) => thickened(nm)", thickness * (1.01 + 0.003 * k))
                # The first time compiles, and fills caches.
                if k > 0:
                    note("control to frame", control)
                    for what, parts in bakes.items():
                        note(f"thickness to {what}", parts)
            page.context.close()
    finally:
        server.terminate()
        server.wait()
    return found


def arguments():
    parser = argparse.ArgumentParser(prog="latency", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recipe", nargs="?", default="paper", metavar="RECIPE", help="what the studio opens with [paper]")
    parser.add_argument("-n", "--times", type=int, default=10, help="how often each is done [10]")
    parser.add_argument("--width", type=int, default=1440, help="of the window, pixels [1440]")
    parser.add_argument("--height", type=int, default=900, help="of the window, pixels [900]")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of lines")
    return parser.parse_args()


def main():
    options = arguments()
    for name in ("times", "width", "height"):
        if getattr(options, name) < 1:
            raise Bad(f"--{name}: {getattr(options, name)} is not a count; expected at least 1")
    if chromium.reason():
        raise Bad(chromium.reason())
    load = os.getloadavg()[0]
    found = measured(options)
    width, height = (int(found["size"][name][0]) for name in ("width", "height"))
    del found["size"]
    figures = {
        what: {part: {"least": min(all), "median": statistics.median(all), "most": max(all)} for part, all in parts.items()}
        for what, parts in found.items()
    }
    if options.json:
        report = {"schema": SCHEMA, "recipe": options.recipe, "processors": os.cpu_count(), "load_before": load,
                  "load_after": os.getloadavg()[0], "pixels": [width, height], "times": options.times, "milliseconds": figures}  # fmt: skip
        print(json.dumps(report))
        return 0
    print(f"{options.recipe}, picture of {width} × {height}, {options.times} times each; {os.cpu_count()} processors, "
          f"load {load:.1f} before, {os.getloadavg()[0]:.1f} after")  # fmt: skip
    for what, parts in figures.items():
        print(f"{what}, ms{'':32}"[:36] + "   least  median    most")
        for part, of in parts.items():
            print(f"  {part:32}" + "".join(f"{of[name]:8.1f}" for name in ("least", "median", "most")))
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except Bad as why:
        print(f"latency: {why}", file=sys.stderr)
        sys.exit(2)
    except Exception as why:  # whatever the browser says
        print(f"latency: {str(why).strip().splitlines()[-1] if str(why) else why!r}", file=sys.stderr)
        sys.exit(1)
