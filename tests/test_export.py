"""Every format through one battery, and the drawings read back."""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ET
from pathlib import Path

import cv2
import numpy as np
import pytest
import shapely
from fakes import layer, pack, ring, tree, washer

from rasterslice.export import FORMATS, Context, find, stack, write
from rasterslice.export.copies import Copied, grid_of_copies
from rasterslice.export.format import RESERVED
from rasterslice.export.sheet import spread
from rasterslice.export.svg import path_data
from rasterslice.grid import cover
from rasterslice.paths import Layer, Paths

CONTEXT = Context("job", cover((-12, -12), (12, 12), 0.2, 1.0), 0.4, 1.5, 1.5)
SVG = "{http://www.w3.org/2000/svg}"

BATTERY: dict[str, list[Layer]] = {
    "no layers": [],
    "an empty layer": [layer(0, 0.2)],
    "one line": [layer(0, 0.2, part_fill=pack([[(0, 0), (5, 0)]], False))],
    "a line of no length": [layer(0, 0.2, part_fill=pack([[(1, 1), (1, 1)]], False))],
    "a region of no area": [layer(0, 0.2, part=pack([[(0, 0), (1, 0), (2, 0)]], True))],
    "one point": [layer(0, 0.2, part=pack([[(3, 3)]], True))],
    "a path of no points": [layer(0, 0.2, part=pack([ring(3), np.empty((0, 2)), ring(2, clockwise=True)], True))],
    "no regions": [washer(0, 0.2, regions=False)],
    "holes": [washer(k, 0.4 * (k + 0.5)) for k in range(3)],
    "more than a page": [washer(k, 0.4 * (k + 0.5)) for k in range(40)],
    "beyond the grid": [layer(0, 0.2, part=pack([ring(500)], True))],
}


def flagged() -> Layer:
    item = washer(0, 0.2)
    item.stats["flags"] = "open;mended;and-more-words-than-fit-on-a-card-of-the-sheet"
    item.stats["part_area"] = None
    return item


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("case", [*BATTERY, "flags and blanks"])
def test_battery(tmp_path: Path, name: str, case: str) -> None:
    layers = BATTERY.get(case) or ([flagged()] if case == "flags and blanks" else [])
    f, written = FORMATS[name], []
    for copy in "ab":
        (tmp_path / copy).mkdir()
        target = f.target.format(stem="job")
        f.write(layers, tmp_path / copy / target, CONTEXT)
        written.append(tree(tmp_path / copy))
    assert written[0] == written[1]
    if (tmp_path / "a" / target).is_file():
        assert list(written[0]) == [target]
    if name == "sheet":
        image = cv2.imdecode(np.frombuffer(written[0]["sheet.png"], np.uint8), cv2.IMREAD_COLOR)
        assert image.shape[1] == 2000
        assert 100 < image.shape[0] < 8000
    elif name == "cobra":
        folder = "job.cobra" if "job.cobra/JOB.RSD" in written[0] else "{stem}.cobra"
        assert {n.removeprefix(folder + "/") for n in written[0]} == {"JOB.RSD", "JOB.json", "RSCFG.V2", "RSPLAY.V2"}
    elif name == "svg":
        assert sorted(written[0]) == [f"svg/layer_{k:04d}.svg" for k in range(len(layers))]
        for text in written[0].values():
            ET.fromstring(text)
    elif name == "png":
        assert len(written[0]) == 2 * len(layers)


@pytest.mark.parametrize("name", [n for n in FORMATS if n != "cobra"])  # which has no place for these
def test_every_format_lays_all_copies(tmp_path: Path, name: str) -> None:
    """A build of two copies is the same bytes as one part that consists of both, but for what tells of the run."""
    shift, items = (22.0, 0.0), [washer(k, 0.4 * (k + 0.5)) for k in range(3)]
    both = list(Copied(items, np.array([(0, 0), shift])))
    assert all(len(b.part_boundary) == 2 * len(a.part_boundary) for a, b in zip(items, both, strict=True))
    grid = grid_of_copies(CONTEXT.grid, np.array([(0, 0), shift]))
    told = dataclasses.replace(CONTEXT, about={"copies": [(0.0, 0.0), shift]})
    for folder in "ab":
        (tmp_path / folder).mkdir()
    write([FORMATS[name]], items, tmp_path / "a", told)
    target = FORMATS[name].target.format(stem="job")
    FORMATS[name].write(both, tmp_path / "b" / target, dataclasses.replace(told, grid=grid))
    written = tree(tmp_path / "a")
    assert written == tree(tmp_path / "b")
    (tmp_path / "c").mkdir()
    write([FORMATS[name]], items, tmp_path / "c", CONTEXT)
    assert written != tree(tmp_path / "c")


def read_paths(data: str) -> list[np.ndarray]:
    lines = [line.rstrip("Z \n") for line in data.split("M")[1:]]  # XML turns a line break into a blank
    return [np.array([[float(v) for v in p.split(",")] for p in line.split("L")]) for line in lines]


def drawing(folder: Path, item: Layer) -> dict[str, ET.Element]:
    FORMATS["svg"].write([item], folder / "svg", CONTEXT)
    root = ET.parse(folder / "svg" / f"layer_{item.index:04d}.svg").getroot()
    return {e.attrib["id"]: e for e in root.iter() if "id" in e.attrib} | {"root": root}


def test_svg_holds_every_path_to_three_decimals(tmp_path: Path) -> None:
    item = washer(3, 1.4)
    found = drawing(tmp_path, item)
    for name in ("part", "scaffold"):
        for what in ("boundary", "fill"):
            want = getattr(item, f"{name}_{what}")
            got = read_paths(found[f"{name}_{what}"].attrib["d"])
            assert len(got) == len(want)
            for a, b in zip(got, want, strict=True):
                assert np.abs(a - b).max() <= 0.0005 + 1e-9


def test_area_drawn_is_the_area_of_the_region(tmp_path: Path) -> None:
    item = washer(2, 1.0)
    found = drawing(tmp_path, item)
    for name in ("part", "scaffold"):
        element = found[f"{name}_region"]
        assert element.attrib["fill-rule"] == "evenodd"
        outer, *holes = read_paths(element.attrib["d"])
        region = getattr(item, name)
        rounding = 0.0005 * region.lengths().sum()
        assert shapely.Polygon(outer, holes).area == pytest.approx(region.areas().sum(), abs=rounding)


def test_svg_shows_the_whole_grid_in_mm_with_y_up(tmp_path: Path) -> None:
    found = drawing(tmp_path, washer(0, 0.2))
    root, grid = found["root"], CONTEXT.grid
    x, y, width, height = (float(v) for v in root.attrib["viewBox"].split())
    assert root.attrib["width"] == f"{width:.3f}mm"
    assert root.attrib["height"] == f"{height:.3f}mm"
    low, high = grid.to_mm([(0, 0), (grid.width - 1, grid.height - 1)])
    assert (x, x + width) == pytest.approx((low[0], high[0]))
    assert y + height == pytest.approx(-low[1])
    assert y < -high[1]
    (flip,) = [e for e in root.iter(f"{SVG}g") if "transform" in e.attrib]
    assert flip.attrib["transform"] == "scale(1,-1)"


def test_svg_numbers_are_short_and_have_no_negative_zero() -> None:
    data = path_data(pack([[(-0.0001, 1 / 3), (1e-9, -2), (12345.67891, 0)]], True))
    assert data == "M0.000,0.333L0.000,-2.000L12345.679,0.000Z\n"
    assert path_data(Paths.empty(True)) == ""


def test_sheet_fills_regions_and_leaves_holes(tmp_path: Path) -> None:
    item = washer(0, 0.2)
    bare = layer(0, 0.2, part=item.part, scaffold=item.scaffold)
    FORMATS["sheet"].write([bare], tmp_path / "s.png", CONTEXT)
    image = cv2.imread(str(tmp_path / "s.png"))[152:-48]
    ice, warm = ((image == colour).all(axis=2).sum() for colour in ((0xF5, 0xE8, 0xCF), (0xE2, 0xEA, 0xEF)))
    assert bare.part is not None
    assert bare.scaffold is not None
    want = bare.part.areas().sum() / bare.scaffold.areas().sum()
    assert ice / warm == pytest.approx(want, rel=0.02)
    middle = np.argwhere((image == (0xF5, 0xE8, 0xCF)).all(axis=2)).mean(axis=0).astype(int)
    assert image[tuple(middle)].tolist() == [255, 255, 255]


def test_spread_is_even_and_complete() -> None:
    assert spread(0) == []
    assert spread(5) == [0, 1, 2, 3, 4]
    assert spread(24) == list(range(24))
    assert len(spread(765)) == 24
    assert set(np.diff(spread(765))) <= {31, 32}
    assert spread(765)[0] == 15


def test_formats_are_found_once_each_and_in_order() -> None:
    assert [f.name for f in find(["svg", "sheet", "svg"])] == ["sheet", "svg"]
    assert find([]) == []
    assert all(f.name == name for name, f in FORMATS.items())


@pytest.mark.parametrize("stem", ["layers", "report", "manifest", "sheet", "svg", "png", "Layers", "REPORT", "a.b"])
def test_no_job_has_two_files_of_one_name(stem: str) -> None:
    """Whatever the job is called, its files are neither each other's nor those that every run has."""
    names = [f.path(stem).casefold() for f in FORMATS.values()] + [f"{stem}.viewer".casefold()]
    assert len(set(names)) == len(names)
    own = {f.path(stem).casefold() for f in FORMATS.values() if "{stem}" in f.target}
    assert not own & RESERVED
    assert {f.target for f in FORMATS.values() if "{stem}" not in f.target} <= RESERVED


def test_a_tiff_above_4_gb_has_64_bit_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tifffile = pytest.importorskip("tifffile")
    assert not stack.needs_bigtiff((765, 2, 848, 656))
    assert stack.needs_bigtiff((2000, 2, 1100, 1000))
    monkeypatch.setattr(stack, "needs_bigtiff", lambda size: True)
    items = [washer(k, 0.4 * (k + 0.5)) for k in range(3)]
    FORMATS["tiff"].write(items, tmp_path / "x.ome.tif", CONTEXT)
    with tifffile.TiffFile(tmp_path / "x.ome.tif") as file:
        assert (file.is_bigtiff, file.is_ome) == (True, True)
        total = file.asarray().sum(axis=(0, 2, 3), dtype=float)
    for found, name in zip(total, ("part", "scaffold"), strict=True):
        want = sum(getattr(item, name).areas().sum() for item in items)
        assert found / 255 * 0.04 == pytest.approx(want, rel=1e-3)
