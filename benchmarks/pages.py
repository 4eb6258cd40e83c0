"""Pages in headless Chromium: their size, and the script time of a frame.

The time is that of integrating, drawing and writing the numbers, without a graphics card, at 1400 × 900 pixels, for a
second of each preset of the playground; then with the processor slowed four times.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

from nontwist import nontwisting, simulate, view
from nontwist.playground import playground

from .rows import Row

SECONDS, SLOWED = 1.0, 4
WATCH = """() => {
    window.taken = [];
    const own = frame;
    frame = (now) => {
        const begin = performance.now();
        own(now);
        taken.push(performance.now() - begin);
    };
}"""


def rows() -> list[Row]:
    """Measure all."""
    from playwright.sync_api import sync_playwright

    page, run = (
        playground(),
        simulate(nontwisting([3, 4, 5]), t_end=9.99, step=0.01, material_angular_velocity=(1, 2, 0)),
    )
    found = [
        Row("view: size of the page of a run of 1000 states", len(view(run).html.encode()) / 1e3, "kB", 400, True),
        Row("playground: size of the page", len(page.html.encode()) / 1e3, "kB", 150, True),
    ]
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as folder:
        options = ["--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu"]
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=options)
        tab = browser.new_page(viewport={"width": 1400, "height": 900})
        tab.goto(page.save(Path(folder) / "page.html").as_uri())
        tab.evaluate(WATCH)
        times = _frames(tab)
        tab.context.new_cdp_session(tab).send("Emulation.setCPUThrottlingRate", {"rate": SLOWED})
        slowed = _frames(tab)
        browser.close()
    return [
        *found,
        Row("   frames drawn", len(times), ""),
        Row("   median script time of a frame", median(times), "ms", 4, True),
        Row("   99 % of the frames take at most", sorted(times)[int(0.99 * len(times))], "ms"),
        Row(f"   median, the processor slowed {SLOWED} times", median(slowed), "ms", 16, True),
    ]


def _frames(tab: Any) -> list[float]:
    times: list[float] = []
    for button in tab.locator("#presets button").all():
        button.click()
        tab.evaluate("world.advance(10 * POINTS)")  # the path is as long as it becomes
        tab.evaluate("taken = []")
        tab.wait_for_timeout(1000 * SECONDS)
        times += tab.evaluate("taken")
    return times
