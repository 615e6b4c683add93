"""check: a file in another unit, or mirrored, is named by that, and its layers are judged in it, widths as well."""

import re

import models
import numpy as np
import oracle
import plants
import pytest
from shapely import affinity, union_all
from shapely.geometry import Polygon

from rasterslice.check.run import check
from rasterslice.cli import main
from rasterslice.errors import RasterSliceError

T = 0.4
FACTORS = [25.4, 1 / 25.4, 10.0, 0.1, 1000.0, 0.001]


@pytest.fixture(scope="module")
def part(tmp_path_factory):
    """Give the parameter file of a tube and a foot beside it, and their exact slices."""
    folder = tmp_path_factory.mktemp("part")
    tube = models.prism([models.circle(6, (6, 6), 48), models.circle(3, (6, 6), 48)[::-1]], 0.0, 4.0)
    body = models.join(tube, models.prism([models.rectangle(14, 2, 22, 18)], 0.0, 3.2)).triangles()
    params = models.write_params(folder, models.write_stl(folder / "p.stl", body), scaffolding=0, thickness=T)
    heights = np.arange(T / 2, 4.0, T)
    shapes = [plants.clean(oracle.to_shapely(r)) for r in oracle.regions(body, heights)]
    return params, [plants.Slice(float(z), s) for z, s in zip(heights, shapes, strict=True)]


def times(factor, letters, text):
    """Return G-code with some of the words of its moves multiplied."""
    number = re.compile(rf"([{letters}])(-?[0-9.]+)")
    changed = lambda word: f"{word[1]}{float(word[2]) * factor:.9f}"  # noqa: E731
    return "\n".join(number.sub(changed, k) if k.startswith(("G0 ", "G1 ")) else k for k in text.split("\n"))


def widths(factor, text):
    return re.sub(r"(?m)^;(LINE_)?WIDTH:([0-9.]+)", lambda m: f";{m[1] or ''}WIDTH:{float(m[2]) * factor:.9f}", text)


def named(result, factor):
    way = "too large" if factor > 1 else "too small"
    return any(f"{max(factor, 1 / factor):g} times {way}" in fault for fault in result["faults"])


def judged_in_it(result, factor, layers):
    assert named(result, factor), result["faults"]
    assert result["verdict"] == "fail" and not result["failed"] and result["passed"] >= layers - 1


@pytest.mark.parametrize("factor", FACTORS)
@pytest.mark.parametrize("kind", ["PrusaSlicer", "Cura"])
@pytest.mark.parametrize(("letters", "wide"), [("XY", False), ("XYZ", False), ("XYZ", True)])
def test_beads_in_another_unit(letters, wide, kind, factor, part, tmp_path):
    params, layers = part
    path = plants.BEAD_WRITERS[f"G-code {kind}"][1](layers, tmp_path / "a.gcode", T)
    text = times(factor, letters, path.read_text())
    path.write_text(widths(factor, text) if wide else text)
    if wide and factor == 1000 and ";WIDTH:" in text:  # no bead is as wide
        with pytest.raises(RasterSliceError, match=r"a\.gcode:\d+: "):
            check(params, path)
        return
    judged_in_it(check(params, path), factor, len(layers))
    assert main(["check", str(params), "--against", str(path)]) == 6


@pytest.mark.parametrize("factor", FACTORS[:4])
def test_three_copies_in_another_unit(factor, part, tmp_path):
    params, layers = part
    three = [
        plants.Slice(k.z, plants.clean(union_all([affinity.translate(k.region, 0, 25 * i) for i in range(3)])))
        for k in layers
    ]
    path = plants.BEAD_WRITERS["G-code PrusaSlicer"][1](three, tmp_path / "a.gcode", T)
    path.write_text(times(factor, "XY", path.read_text()))
    result = check(params, path)
    judged_in_it(result, factor, len(layers))
    assert len(result["copies"]) == 3


@pytest.mark.parametrize("factor", FACTORS)
def test_areas_in_another_unit(factor, part, tmp_path):
    params, layers = part
    suffix, write = plants.AREA_WRITERS["SVG Slic3r legacy"]
    path = write(layers, tmp_path / f"a{suffix}", T)
    scaled = lambda m: "".join(  # noqa: E731
        f"{float(w) * factor:.9f}" if w[:1].isdigit() or w[:1] == "-" else w for w in re.split(r"([ ,]+)", m[1])
    )
    path.write_text(re.sub(r'points="([^"]*)"', lambda m: f'points="{scaled(m)}"', path.read_text()))
    judged_in_it(check(params, path), factor, len(layers))


@pytest.mark.parametrize("factor", FACTORS[:4])
def test_our_own_cli_in_another_unit(factor, part, tmp_path):
    params, layers = part
    text = params.read_text() + "\nexport = cli\n"
    (params.parent / "cli.txt").write_text(text)
    assert main([str(params.parent / "cli.txt"), "-o", str(tmp_path / "run")]) == 0
    path = next((tmp_path / "run").glob("*.cli"))
    path.write_text(path.read_text().replace("$$UNITS/1.0", f"$$UNITS/{factor:.9f}"))
    judged_in_it(check(params, path), factor, len(layers))


@pytest.mark.parametrize("mirrored", [False, True])
def test_beads_of_a_part_that_is_nearly_its_own_mirror_image(mirrored, tmp_path):
    """Beads miss in many places, here at both ends; what tells the mirror is a small dent."""
    def dented(wide):
        return [(0, 0), (20, 0), (20, 12), (6, 12), (6, 12 - wide), (5, 12 - wide), (5, 12), (0, 12)]

    outline = np.array(dented(0.3), float)
    body = models.prism([outline], 0.0, 6.0).triangles()
    params = models.write_params(tmp_path, models.write_stl(tmp_path / "p.stl", body), scaffolding=0, thickness=T)
    layers = []
    for z in np.arange(T / 2, 6.0, T):
        points = [(x + (0.1 if x == 20 else -0.1 if x == 0 else 0), 12 - y if mirrored else y) for x, y in outline]
        layers.append(plants.Slice(float(z), plants.clean(Polygon(points))))
    result = check(params, plants.BEAD_WRITERS["G-code PrusaSlicer"][1](layers, tmp_path / "a.gcode", T))
    assert result["faults"] == (["the file is mirrored in y"] if mirrored else [])
