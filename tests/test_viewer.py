"""The layer viewer in a real browser: headless Chromium, through Playwright; skipped where either is missing."""

from __future__ import annotations

import dataclasses
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fakes import layer, pack, ring, washer

from rasterslice.export import FORMATS, Context, html
from rasterslice.export.assets import asset
from rasterslice.export.relief import LEVELS, levels, relief
from rasterslice.export.viewdata import SETS, packed, thinned, varints, zigzag
from rasterslice.grid import cover

CONTEXT = Context("a <job> & more", cover((-12, -12), (12, 12), 0.2, 1.0), 0.4, 1.5, 1.5)
SIZES = {
    "wide": (1500, 900), "tablet": (900, 700), "phone": (390, 800), "lying phone": (844, 390), "small": (400, 300),
}  # fmt: skip


def layers() -> list[Any]:
    items = [washer(k, 0.4 * (k + 0.5)) for k in range(30)]
    items[7].stats["flags"] = "open;area"
    items[20].stats["flags"] = "dropped"
    items[20] = layer(20, 8.2, part=pack([ring(2), ring(0.4) + (6, 0)], True), part_boundary=pack([ring(1.5)], True))
    items[20].stats["flags"] = "dropped"
    items[20] = dataclasses.replace(items[20], part_second_fill=pack([[(0, -1), (0, 1)]], False))
    return items


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    api = pytest.importorskip("playwright.sync_api")
    names = ("chromium", "chromium-browser", "google-chrome")
    found = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, names)), None)
    with api.sync_playwright() as play:
        found = found or play.chromium.executable_path
        if not Path(found).exists():
            pytest.skip("no Chromium")
        browser = play.chromium.launch(executable_path=found, args=["--no-sandbox", "--enable-unsafe-swiftshader"])
        yield browser
        browser.close()


def opened(browser: Any, path: Path) -> Any:
    """Return a page that shows a viewer and collects what goes wrong in ``page.wrong``, requests in ``page.asked``."""
    page = browser.new_page(viewport={"width": 1500, "height": 900})
    page.wrong, page.asked = [], []
    page.on("pageerror", lambda error: page.wrong.append(str(error)))
    page.on("console", lambda m: page.wrong.append(m.text) if m.type == "error" else None)
    page.on("request", lambda r: (page.asked if r.url.startswith("file:") else page.wrong).append(r.url))
    page.goto(path.as_uri())
    page.wait_for_function("window.viewer && viewer.takeTimes().length")
    return page


@pytest.fixture(scope="module")
def page(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    path = tmp_path_factory.mktemp("viewer") / "job.html"
    FORMATS["html"].write(layers(), path, CONTEXT)
    page = opened(browser, path)
    yield page
    page.close()


def colours(page: Any, canvas: str = "#flat canvas") -> dict[str, int]:
    """Return how often each colour stands on a canvas, when it is drawn in full."""
    page.wait_for_timeout(150)
    page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    code = """selector => { const c = document.querySelector(selector);
      const copy = document.createElement("canvas");
      copy.width = c.width; copy.height = c.height; const pen = copy.getContext("2d"); pen.drawImage(c, 0, 0);
      const count = new Map(), data = new Uint32Array(pen.getImageData(0, 0, c.width, c.height).data.buffer);
      for (const v of data) count.set(v, (count.get(v) || 0) + 1); return Object.fromEntries(count); }"""
    found: dict[str, int] = page.evaluate(code, canvas)
    return found


def alike(a: dict[str, int], b: dict[str, int], most: int = 200) -> bool:
    """Tell whether two pictures are the same but for the last bit of some pixels, as another painter has it."""
    return sum(abs(a.get(colour, 0) - b.get(colour, 0)) for colour in a.keys() | b.keys()) <= most


def test_it_opens_at_the_middle_and_nothing_is_wrong(page: Any) -> None:
    assert page.evaluate("[viewer.count, viewer.current()]") == [30, 15]
    assert page.title() == "a <job> & more - layers"
    assert page.text_content("h1") == "a <job> & more"
    assert page.wrong == []
    assert sorted(colours(page).values())[-2] > 10000


def test_keys_slider_plot_and_number_go_to_a_layer(page: Any) -> None:
    for key, want in (("End", 29), ("ArrowLeft", 28), ("PageDown", 18), ("Home", 0), ("ArrowUp", 1), ("PageUp", 11)):
        page.keyboard.press(key)
        assert page.evaluate("viewer.current()") == want
    page.evaluate("document.activeElement.blur()")
    page.fill("#number", "4")
    page.press("#number", "Enter")
    page.evaluate("document.activeElement.blur()")
    assert page.evaluate("viewer.current()") == 4
    assert "z 1.80 mm" in page.text_content("aside")
    box = page.locator("#plot").bounding_box()
    page.mouse.move(box["x"] + 20, box["y"] + box["height"] - 30)
    page.mouse.down()
    assert page.evaluate("viewer.current()") == 0
    page.mouse.move(box["x"] + 20, box["y"] + 5)
    page.mouse.up()
    assert page.evaluate("viewer.current()") == 29


def test_flagged_layers_are_jumped_to(page: Any) -> None:
    page.keyboard.press("Home")
    seen = []
    for key in "nnnp":
        page.keyboard.press(key)
        seen.append(page.evaluate("viewer.current()"))
    assert seen == [7, 20, 7, 20]
    assert page.text_content("#flags") == "dropped"
    assert page.text_content("#flagged_text") == "next of 2 flagged"


def test_places_that_no_bead_reaches_are_circled(page: Any) -> None:
    page.evaluate("viewer.show(20)")
    page.wait_for_function("viewer.ready()")
    ((x, y, radius),) = page.evaluate("viewer.places()")
    corner, quantum = np.array([CONTEXT.grid.x0, CONTEXT.grid.y0]), CONTEXT.grid.pitch / 20
    assert np.array([x, y]) * quantum + corner == pytest.approx([6, 0], abs=0.02)
    assert radius * quantum == pytest.approx(0.57, abs=0.03)
    page.evaluate("viewer.show(10)")
    page.wait_for_function("viewer.ready()")
    assert page.evaluate("viewer.places()") == []


def test_the_fill_of_the_upper_ice_layer_can_be_seen(page: Any) -> None:
    page.evaluate("viewer.show(20)")
    before = colours(page)
    page.click("#show_second")
    assert not alike(colours(page), before)
    page.click("#show_second")
    assert alike(colours(page), before)


def test_travel_is_that_of_the_ice_layer_that_is_shown(page: Any) -> None:
    page.evaluate("viewer.show(20)")
    page.click("#show_travel")
    page.click("#show_fill")  # so that nothing but travel changes
    before = colours(page)
    page.click("#show_second")
    assert not alike(colours(page), before, most=20)  # it is one short line
    page.click("#show_second")
    assert alike(colours(page), before, most=20)
    page.click("#show_fill")
    page.click("#show_travel")


def test_space_toggles_what_has_the_focus(page: Any) -> None:
    page.evaluate("viewer.show(10)")
    page.focus("#show_travel")
    for want in (True, False):
        page.keyboard.press("Space")
        assert page.is_checked("#show_travel") == want
    assert page.evaluate("viewer.current()") == 10
    page.evaluate("document.activeElement.blur()")


@pytest.mark.parametrize(("typed", "want"), [("99999", 29), ("-5", 0), ("", 29), ("7", 7)])
def test_the_number_shows_the_layer_that_is_shown(page: Any, typed: str, want: int) -> None:
    page.evaluate("viewer.show(29)")
    page.fill("#number", typed)
    page.press("#number", "Enter")
    assert page.evaluate("viewer.current()") == want
    assert page.input_value("#number") == str(want)
    page.evaluate("document.activeElement.blur()")


@pytest.mark.parametrize("name", ["part", "scaffold", "boundary", "fill", "travel"])
def test_what_is_switched_off_is_not_drawn(page: Any, name: str) -> None:
    page.evaluate("viewer.show(10)")
    before = colours(page)
    page.click(f"#show_{name}")
    after = colours(page)
    page.click(f"#show_{name}")
    assert alike(colours(page), before)
    assert not alike(after, before)


def test_zoom_pan_and_fit(page: Any) -> None:
    box = page.locator("#flat").bounding_box()
    scale = page.evaluate("viewer.flat.scale")
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.wheel(0, -400)
    page.wait_for_function(f"viewer.flat.scale > {1.5 * scale}")
    x = page.evaluate("viewer.flat.x")
    page.mouse.down()
    page.mouse.move(box["x"] + 160, box["y"] + 100)
    page.mouse.up()
    assert page.evaluate("viewer.flat.x") == pytest.approx(x + 60)
    page.keyboard.press("f")
    assert page.evaluate("viewer.flat.scale") == pytest.approx(scale)


def test_play_ends_at_the_top(page: Any) -> None:
    page.evaluate("viewer.show(27)")
    page.keyboard.press("Space")
    page.wait_for_function("viewer.current() === 29")


def test_the_stack_turns_and_themes_change(page: Any) -> None:
    page.keyboard.press("3")
    if not page.evaluate("!!viewer.meshes()"):
        pytest.skip("this browser has no WebGL 2")
    box = page.locator("#stack").bounding_box()
    turn = page.evaluate("viewer.stack.turn")
    page.mouse.move(box["x"] + 300, box["y"] + 300)
    page.mouse.down()
    page.mouse.move(box["x"] + 400, box["y"] + 300)
    page.mouse.up()
    assert page.evaluate("viewer.stack.turn") == pytest.approx(turn + 1)
    page.keyboard.press("t")
    page.keyboard.press("t")
    page.keyboard.press("2")
    assert page.wrong == []


@pytest.mark.parametrize("size", SIZES)
def test_nothing_overflows_at_any_size(page: Any, size: str) -> None:
    width, height = SIZES[size]
    page.set_viewport_size({"width": width, "height": height})
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for part in ("#flat", "#plot", "aside", "#facts_table", "#toggles", "#slider", "#play"):
        if part == "#facts_table" and size == "small":
            continue  # which has no room for it
        box = page.locator(part).bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= width + 1
        assert box["y"] + box["height"] <= height + 1
    box = page.locator("#views").bounding_box()
    assert min(box["width"], box["height"]) > 150
    assert page.evaluate("document.querySelector('aside').scrollHeight <= document.querySelector('aside').clientHeight")
    assert page.evaluate("document.querySelector('aside').scrollWidth <= document.querySelector('aside').clientWidth")


@pytest.mark.parametrize("size", SIZES)
def test_screenshots_show_part_scaffold_and_theme(page: Any, size: str) -> None:
    """Of what can be told of a picture without looking: it has its colours, and is dark when it is dark."""
    import cv2

    width, height = SIZES[size]
    page.set_viewport_size({"width": width, "height": height})
    page.keyboard.press("1")
    page.evaluate("viewer.show(10)")
    light = {}
    for _ in range(2):
        page.wait_for_timeout(250)
        image = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
        assert image.shape == (height, width, 3)
        dark = page.evaluate("document.documentElement.classList.contains('dark')")
        light[dark] = float(np.median(image))
        for name in ("part_bead", "scaffold_bead"):
            colour = page.evaluate(f"getComputedStyle(document.documentElement).getPropertyValue('--{name}')").strip()
            bgr = [int(colour[i : i + 2], 16) for i in (5, 3, 1)]
            assert (image == bgr).all(axis=2).sum() > 0.01 * width * height, name
        page.keyboard.press("t")
    assert light[True] < 60 < 200 < light[False]
    page.keyboard.press("2")
    page.set_viewport_size({"width": 1500, "height": 900})


def test_frame_times_of_a_scrub_can_be_read(page: Any, record_property: Any) -> None:
    """They are recorded, not judged: other work on the machine counts. `bench/viewer.py` prints more."""
    page.evaluate("viewer.takeTimes()")
    frame = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
    for k in range(30):
        page.evaluate(f"viewer.show({k}); {frame}")
    times = page.evaluate("viewer.takeTimes()")
    assert len(times) >= 30
    assert min(times) > 0
    record_property("median_ms_of_drawing", float(np.median(times)))


def test_memory_is_bounded(page: Any) -> None:
    for k in range(30):
        page.evaluate(f"viewer.show({k})")
        page.evaluate("new Promise(done => requestAnimationFrame(done))")
    blocks, kept = page.evaluate("viewer.kept()")
    assert 1 <= blocks <= 24
    assert 1 <= kept <= 96


def test_at_rest_a_layer_is_drawn_in_full(page: Any) -> None:
    """While layers follow each other quickly lines are plain; 100 ms later the picture is that of a single step."""
    page.keyboard.press("1")
    page.evaluate("viewer.show(3)")
    page.wait_for_timeout(200)
    page.evaluate("viewer.show(10)")
    want = colours(page)
    frame = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
    page.evaluate(f"viewer.show(9); {frame}.then(() => viewer.show(10))")
    assert alike(colours(page), want)
    page.keyboard.press("2")


@pytest.fixture()
def large(browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Return the page of a job that is too large for one file; its name is one that has to be escaped."""
    monkeypatch.setattr(html, "LARGE", 1000)
    folder = tmp_path / "50 %"
    folder.mkdir()
    many = [washer(k, 0.4 * (k + 0.5)) for k in range(300)]
    FORMATS["html"].write(many, folder / "a #1.html", dataclasses.replace(CONTEXT, stem="a #1"))
    page = opened(browser, folder / "a #1.html")
    page.folder = folder / "a #1.viewer"
    yield page
    page.close()


def test_a_large_job_is_a_folder_of_blocks(large: Any) -> None:
    assert len(list(large.folder.glob("block*.js"))) == 38
    large.wait_for_function("viewer.ready()")
    assert len(large.asked) <= 5  # the page, the block of the middle, and what comes next
    large.evaluate("viewer.show(2)")
    large.wait_for_function("viewer.ready()")
    assert large.asked[-1].endswith("/50%20%25/a%20%231.viewer/block0.js")
    for k in range(0, 300, 3):
        large.evaluate(f"viewer.show({k})")
        large.wait_for_function("viewer.ready()")
    blocks, kept = large.evaluate("viewer.kept()")
    assert 1 <= blocks <= 24 < 38
    assert kept <= 96
    assert large.evaluate("document.head.querySelectorAll('script').length") <= 3
    assert large.text_content("#flat .loading") in ("", "loading")
    assert large.is_hidden("#flat .loading")
    assert large.wrong == []


def test_a_large_job_shows_what_one_file_shows(large: Any, browser: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(html, "LARGE", 10**9)
    path = large.folder.parent / "one.html"
    many = [washer(k, 0.4 * (k + 0.5)) for k in range(300)]
    FORMATS["html"].write(many, path, CONTEXT)
    other = opened(browser, path)
    for page in (large, other):
        page.evaluate("viewer.show(137)")
        page.wait_for_function("viewer.ready()")
    assert alike(colours(large), colours(other))
    other.close()


def test_a_block_that_is_not_there_is_said_once(large: Any) -> None:
    large.wait_for_function("viewer.ready()")
    (large.folder / "block0.js").unlink()
    large.evaluate("viewer.show(0)")
    large.wait_for_selector("#flat .loading")
    large.wait_for_function("document.querySelector('#flat .loading').textContent.startsWith('layer 0 cannot')")
    assert "is the folder a #1.viewer beside this page?" in large.text_content("#flat .loading")
    large.wait_for_timeout(100)
    assert sum(url.endswith("block0.js") for url in large.asked) == 1


def test_blocks_of_an_earlier_viewer_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / f"{CONTEXT.stem}.viewer"
    monkeypatch.setattr(html, "LARGE", 0)
    FORMATS["html"].write(layers(), tmp_path / "x.html", CONTEXT)
    assert sorted(p.name for p in folder.iterdir()) == [f"block{k}.js" for k in range(4)]
    FORMATS["html"].write(layers()[:9], tmp_path / "x.html", CONTEXT)
    assert len(list(folder.iterdir())) == 2
    monkeypatch.setattr(html, "LARGE", 10**9)
    (folder / "notes.txt").write_text("mine")
    FORMATS["html"].write(layers(), tmp_path / "x.html", CONTEXT)
    assert [p.name for p in folder.iterdir()] == ["notes.txt"]


def test_a_failed_viewer_leaves_no_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(html, "LARGE", 0)
    monkeypatch.setattr(html, "relief", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        FORMATS["html"].write(layers(), tmp_path / "x.html", CONTEXT)
    assert [p.name for p in tmp_path.iterdir()] == ["x.html"]


def test_the_size_of_a_viewer_is_foreseen(tmp_path: Path) -> None:
    many = [washer(k, 0.4 * (k + 0.5)) for k in range(300)]
    FORMATS["html"].write(many, tmp_path / "x.html", CONTEXT)
    page = (tmp_path / "x.html").read_text()
    text = sum(len(block) for block in re.findall('id="block[0-9]+">([^<]*)<', page))
    assert html.expected_bytes(many, 0.01, (-13.0, -13.0)) == pytest.approx(text, rel=0.05)


def test_scripts_are_sound() -> None:
    """Let Node read the scripts, where there is one: a slip is found without a browser."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("no node")
    code = "".join(asset(name) for name in ("data.js", "flat.js", "plot.js", "stack.js", "viewer.js"))
    done = subprocess.run([node, "--check", "-"], input=code, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def read_varints(data: bytes) -> list[int]:
    values, value, shift = [], 0, 0
    for byte in data:
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            values.append(value)
            value = shift = 0
    return values


def test_numbers_survive_packing() -> None:
    values = np.array([0, 1, 127, 128, 16383, 16384, 2**21 - 1, 2**28, 2**35 - 1])
    assert read_varints(varints(values)) == values.tolist()
    assert zigzag(np.array([0, -1, 1, -2, 2])).tolist() == [0, 1, 2, 3, 4]
    assert varints(np.array([], np.int64)) == b""


def test_a_packed_layer_is_the_layer_to_a_few_quanta() -> None:
    item = dataclasses.replace(washer(0, 0.2), part_second_fill=pack([[(1, -2), (1, 3.5)], [(2, 0), (2, 1)]], False))
    values = iter(read_varints(packed(item, 0.01, (-12.0, -12.0))))
    for name in SETS:
        want, x, y, total = getattr(item, name), 0, 0, 0.0
        assert next(values) == len(want)
        for path in want:
            points = []
            for _ in range(next(values)):
                dx, dy = (v // 2 if v % 2 == 0 else -(v + 1) // 2 for v in (next(values), next(values)))
                x, y = x + dx, y + dy
                points.append((x * 0.01 - 12, y * 0.01 - 12))
            p = pack([points], want.closed)
            total += p.lengths().sum()
            assert np.abs(np.asarray(points)[:, None] - path[None]).max(axis=2).min(axis=1).max() < 0.0051
        assert total == pytest.approx(want.lengths().sum(), rel=0.01)
    assert next(values) == 0  # no place is lost


def test_lost_loops_are_marked() -> None:
    *_, n, x, y, r = read_varints(packed(layers()[20], 0.01, (-12.0, -12.0)))
    assert n == 1
    assert (x / 2 * 0.01 - 12, y / 2 * 0.01 - 12) == pytest.approx((6, 0), abs=0.02)
    assert r == pytest.approx(57, abs=3)


def test_thinning_keeps_within_the_tolerance() -> None:
    paths = pack([ring(8, 4000), np.empty((0, 2)), ring(2, 900, clockwise=True)], True)
    thin = thinned(paths, 0.02)
    assert len(thin) == 2
    assert len(thin.points) < 300
    assert thin.areas().sum() == pytest.approx(paths.areas().sum(), rel=0.01)


def test_normals_point_out_of_the_material() -> None:
    items = [washer(k, 0.4 * (k + 0.5)) for k in range(8)]
    surface = relief(items, "part", CONTEXT)
    outer = surface.outlines[4][0]
    normals = surface.normals[4][: len(outer)]
    outward = outer / np.linalg.norm(outer, axis=1, keepdims=True)
    assert (normals[:, :2] * outward).sum(axis=1).min() > 0.7
    assert (normals[:, 2] > 0).mean() > 0.9  # it narrows upwards
    assert len(levels(765)) == LEVELS
    assert levels(3) == [0, 1, 2]
