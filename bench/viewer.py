"""How the layer viewer scrubs: ``python bench/viewer.py FILE.html [--runs N] [--shots DIR]`` prints times in ms.

``frame`` is from one frame of the browser to the next while 200 layers are shown in turn, which a screen of 60 Hz makes
a multiple of 16.7; ``cpu`` is what the page's main thread computes for such a frame, on average, whatever else the
machine does; ``turn`` is as ``frame``, while the stack turns; ``paint`` is drawing a layer and waiting until its
pixels are there. Headless Chromium without a GPU paints everything on the CPU, so other work on the machine counts: the
load is printed, and of several runs the fastest tells most about the viewer.
"""

from __future__ import annotations

import argparse
import os
import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Browser, sync_playwright

SIZES = {"desktop": (1600, 950, 1), "tablet": (834, 1112, 1), "phone": (390, 844, 2)}
SCRUB = """async () => { const gaps = []; let last = 0; for (let i = 0; i < 200; i++) {
  await new Promise(r => requestAnimationFrame(t => { if (last) gaps.push(t - last); last = t;
    viewer.show(Math.round(i * (viewer.count - 1) / 199)); r(); })); } return gaps; }"""
TURN = SCRUB.replace(
    "viewer.show(Math.round(i * (viewer.count - 1) / 199))", "viewer.stack.turn += .03; viewer.redraw()"
)
PAINT = """async () => { const times = [], pen = document.querySelector("#flat canvas").getContext("2d");
  for (let i = 0; i < 100; i++) { viewer.show(Math.round(i * (viewer.count - 1) / 99));
    await new Promise(r => requestAnimationFrame(() => { const t = performance.now(); pen.getImageData(0, 0, 1, 1);
      times.push(performance.now() - t + viewer.takeTimes().reduce((a, b) => a + b, 0)); r(); })); } return times; }"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("--shots", type=Path, help="folder for pictures of every size")
    parser.add_argument("--runs", type=int, default=1)
    args = parser.parse_args()
    with sync_playwright() as play:
        found = shutil.which("chromium") or shutil.which("google-chrome") or play.chromium.executable_path
        for _ in range(args.runs):
            print(f"load of the machine {os.getloadavg()[0]:.1f}, of {os.cpu_count()} cores")
            browser = play.chromium.launch(executable_path=found, args=["--no-sandbox", "--disable-gpu"])
            for name in SIZES:
                measure(browser, name, args.file, args.shots)
            browser.close()


def measure(browser: Browser, name: str, file: Path, shots: Path | None) -> None:
    """Open the file in a window of one size, scrub, print."""
    width, height, ratio = SIZES[name]
    page = browser.new_page(viewport={"width": width, "height": height}, device_scale_factor=ratio)
    start = time.perf_counter()
    page.goto(file.resolve().as_uri())
    page.wait_for_function("window.viewer && viewer.takeTimes().length && viewer.ready()")
    print(f"{name}: {width} x {height}, first layer after {time.perf_counter() - start:.2f} s")
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})
    for view in ("flat", "both", "stack"):
        page.click(f"#view_{view}")
        before = busy(session)
        print(f"  {view:6} frame {spread(page.evaluate(SCRUB))}", end="")
        print(f"   cpu {(busy(session) - before) / 200:4.1f}", end="")
        other = ("paint", PAINT) if view == "flat" else ("turn", TURN)
        print(f"   {other[0]} {spread(page.evaluate(other[1]))}")
        if shots is not None:
            page.wait_for_timeout(600)
            page.screenshot(path=shots / f"{name}_{view}.png")
    print(f"  kept: {page.evaluate('viewer.kept()')} blocks and layers")
    page.close()


def busy(session: Any) -> float:
    """Return how long the main thread has computed, ms."""
    metrics = {m["name"]: m["value"] for m in session.send("Performance.getMetrics")["metrics"]}
    return float(metrics["TaskDuration"]) * 1000


def spread(times: Any) -> str:
    return "median {:5.1f}, 95 % {:5.1f}".format(*np.percentile(times, (50, 95)))


if __name__ == "__main__":
    main()
