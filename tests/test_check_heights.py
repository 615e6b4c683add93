"""check: heights that are shifted, scaled, in other units, or whose first layer is another; layers left out."""

import models
import numpy as np
import oracle
import plants
import pytest
from shapely import affinity

from rasterslice.check.run import check
from rasterslice.check.table import lines

T = 0.4


@pytest.fixture(scope="module")
def params(tmp_path_factory):
    folder = tmp_path_factory.mktemp("part")
    mesh = models.write_stl(folder / "part.stl", plants.part().triangles())
    return models.write_params(folder, mesh, scaffolding=0, thickness=T, pitch=0.2)


def slices(heights):
    """Return exact slices of the part at some heights."""
    regions = oracle.regions(plants.part().triangles(), np.asarray(heights))
    return [plants.Slice(float(z), plants.clean(oracle.to_shapely(r))) for z, r in zip(heights, regions, strict=True)]


TRUE = slices(np.arange(T / 2, 30.0, T))


def lifted(change, size=1.0):
    return [plants.Slice(change(k.z), affinity.scale(k.region, size, size, origin=(0, 0))) for k in TRUE]


@pytest.mark.parametrize("first", [0.2, 0.3, 0.5])
@pytest.mark.parametrize("kind", ["CSV", "PrusaSlicer"])
def test_a_first_layer_of_another_height(first, kind, params, tmp_path):
    heights = [first / 2, *np.arange(first + T / 2, 30.0, T)]
    layers = slices(heights)
    if kind == "CSV":
        path = plants.csv_nan(layers, tmp_path / "a.csv", T)
    else:  # its writer adds half a layer to each height
        layers[0].z = first - T / 2
        path = plants.BEAD_WRITERS["G-code PrusaSlicer"][1](layers, tmp_path / "a.gcode", T)
    r = check(params, path)
    assert r["verdict"] == "pass" and not r["failed"], r["worst"][:2]
    assert any("beside ours" in note for note in r["notes"]) and r["layers"] == len(heights)
    missing = layers[:7] + layers[8:]
    path = plants.csv_nan(missing, tmp_path / "b.csv", T)
    if kind == "CSV":
        worst = check(params, path)["worst"]
        assert [w["reasons"] for w in worst if w["verdict"] == "fail"] == ["the layer is missing"]


@pytest.mark.parametrize(
    ("change", "size", "said"),
    [
        (lambda z: z + T / 4, 1.0, ["all layers lie 0.100 mm too high"]),
        (lambda z: z - T / 4, 1.0, ["all layers lie 0.100 mm too low"]),
        (lambda z: z + T, 1.0, ["all layers lie 0.400 mm too high"]),
        (lambda z: 1.01 * z, 1.0, ["the heights are 1.0100 times what they should be"]),
        (lambda z: z / 25.4, 1 / 25.4, ["the file is 25.4 times too small: inches", "the heights are 25.4 times too"]),
        (lambda z: z, 1 / 25.4, ["the file is 25.4 times too small: inches"]),
        (lambda z: z / 10, 0.1, ["the file is 10 times too small: centimetres", "the heights are 10 times too small"]),
    ],
)
def test_wrong_heights_are_named_once(change, size, said, params, tmp_path):
    r = check(params, plants.csv_nan(lifted(change, size), tmp_path / "a.csv", T))
    assert len(r["faults"]) == len(said) and r["verdict"] == "fail" and len(r["failed"]) <= 1, r["worst"][:2]
    assert all(fault.startswith(start) for fault, start in zip(r["faults"], said, strict=True)), r["faults"]


def plinth():
    """Return a cone on a block whose top lies where two layers meet, as a mesh and as exact slices."""
    block, cone = models.box((-15, -12, 0), (15, 12, 4.0)), models.cone(12.0, 20.0, 96)
    heights = np.arange(T / 2, 20.0, T)
    both = [[oracle.to_shapely(r) for r in oracle.regions(b.triangles(), heights)] for b in (block, cone)]
    return models.join(block, cone), [
        plants.Slice(float(z), plants.clean(a.union(b))) for z, a, b in zip(heights, *both, strict=True)
    ]


@pytest.mark.parametrize("up", [0.1, -0.5, 1.7, -1.7, 2.9, 8.0, 100.0])
@pytest.mark.parametrize("kind", ["CSV polylines", "G-code PrusaSlicer"])
def test_any_shift_of_all_heights_is_named_and_no_layer_accused(up, kind, tmp_path):
    """The block's top is no slope: a shift that is found only nearly would fail the layer below it."""
    body, layers = plinth()
    params = models.write_params(tmp_path, models.write_stl(tmp_path / "m.stl", body.triangles()), scaffolding=0,
                                 thickness=T, pitch=0.2)  # fmt: skip
    suffix, write = {**plants.AREA_WRITERS, **plants.BEAD_WRITERS}[kind]
    r = check(params, write([plants.Slice(k.z + up, k.region) for k in layers], tmp_path / f"a{suffix}", T))
    assert r["faults"] == [f"all layers lie {abs(up):.3f} mm too {'high' if up > 0 else 'low'}"], r["worst"][:2]
    assert not r["failed"], r["worst"][:2]


@pytest.mark.parametrize("up", [0.1, 1.7])
def test_a_shift_is_named_though_many_walls_are_laid_otherwise(up, params, tmp_path):
    layers = [plants.Slice(k.z + up, k.region.buffer(-0.15) if i % 4 == 0 else k.region) for i, k in enumerate(TRUE)]
    r = check(params, plants.BEAD_WRITERS["G-code PrusaSlicer"][1](layers, tmp_path / "a.gcode", T))
    assert r["faults"] == [f"all layers lie {up:.3f} mm too high"] and all(i % 4 == 0 for i in r["failed"])


@pytest.mark.parametrize("kind", ["CSV polylines", "CLI ASCII", "G-code PrusaSlicer"])
@pytest.mark.parametrize("start", [0, 1])
def test_every_second_layer_left_out(kind, start, params, tmp_path):
    suffix, write = {**plants.AREA_WRITERS, **plants.BEAD_WRITERS}[kind]
    r = check(params, write(TRUE[start::2], tmp_path / f"a{suffix}", T))
    assert r["verdict"] == "fail" and len(r["failed"]) >= 34


def test_thicker_layers_pass(params, tmp_path):
    r = check(params, plants.csv_nan(slices(np.arange(T, 30.0, 2 * T)), tmp_path / "a.csv", 2 * T))
    assert r["verdict"] == "pass" and any("layers of 0.8 mm" in note for note in r["notes"])


def test_another_thickness_is_said_in_the_closing_line(params, tmp_path):
    r = check(params, plants.csv_nan(slices(np.arange(T, 30.0, 2 * T)), tmp_path / "a.csv", 2 * T))
    assert lines(r)[-1].endswith("; another thickness than asked for")
    r = check(params, plants.csv_nan(TRUE, tmp_path / "b.csv", T))
    assert "thickness" not in lines(r)[-1]


def test_pictures_of_another_thickness(params, tmp_path):
    thin = slices(np.arange(0.15, 30.0, 0.3))
    r = check(params, plants.png_stack(thin, tmp_path / "a", 0.3))
    note = "another thickness: 100 pictures, 75 are due; layers of 0.3 mm make as many, and 0.4 mm are asked for"
    assert note in r["notes"] and r["verdict"] == "fail"


def nearly_symmetric():
    """Return a part that only a small knob tells from its mirror image, as a mesh and as exact slices."""
    body = models.join(models.box((-12, -8, 0), (12, 8, 12)), models.box((2, 7.5, 0), (5, 9, 12)))
    heights = np.arange(T / 2, 12.0, T)
    box = plants.shapely.box
    outline = plants.clean(box(-12, -8, 12, 8).union(box(2, 7, 5, 9)))
    return body, [plants.Slice(float(z), outline) for z in heights]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ((1, 1), []), ((1, -1), ["the file is mirrored in y"]), ((-1, 1), ["the file is mirrored in x"]),
        ((-1, -1), ["the file is turned by 180 degrees"]),
    ],
)  # fmt: skip
def test_turns_of_a_nearly_symmetric_part(change, said, tmp_path):
    body, layers = nearly_symmetric()
    mesh = models.write_stl(tmp_path / "m.stl", body.triangles())
    params = models.write_params(tmp_path, mesh, scaffolding=0, thickness=T)
    layers = [plants.Slice(k.z, plants.clean(affinity.scale(k.region, *change, origin=(0, 0)))) for k in layers]
    r = check(params, plants.csv_nan(layers, tmp_path / "a.csv", T))
    assert r["faults"] == said and not r["failed"] and not r["cannot_tell"], r["worst"][:2]


def test_a_fault_does_not_bend_the_alignment(params, tmp_path):
    layers = list(TRUE)
    for i in (3, 14, 25, 36):
        layers[i] = plants.Slice(TRUE[i].z, plants.clean(affinity.translate(TRUE[i].region, 0.09, 0.0)))
    r = check(params, plants.csv_nan(layers, tmp_path / "a.csv", T))
    assert r["failed"] == [3, 14, 25, 36] and abs(r["alignment"]["dx"]) < 0.0005


@pytest.mark.parametrize("gone", [0, 1])
@pytest.mark.parametrize("name", ["layer_{:04d}", "part_{:04d}"])
def test_a_first_picture_that_is_missing(gone, name, params, tmp_path):
    """Only the layer of the missing picture is accused, whether names count from 0 or from 1."""
    folder = plants.png_stack(TRUE, tmp_path / "a", T)
    for path in sorted(folder.glob("*.png")):
        path.rename(folder / (name.format(int(path.stem[-4:])) + ".png"))
    (folder / (name.format(gone) + ".png")).unlink()
    assert check(params, folder)["failed"] == [gone]


INCHES = "25.4 times too small: inches read as millimetres"


@pytest.mark.parametrize("z", [25.4, 1.0])
@pytest.mark.parametrize("which", [[0], [5], [20, 21, 22], None])
@pytest.mark.parametrize("kind", ["box", "flat cone", "part"])
def test_inches_are_named_whatever_the_file_holds(kind, which, z, tmp_path):
    """One layer, a few or all, of a part that changes with height and of one that does not."""
    body, tall = {
        "box": (models.box((0, 0, 0), (20, 14, 8)), 8.0), "flat cone": (models.cone(13, T, 64), T),
        "part": (plants.part(), 30.0),
    }[kind]  # fmt: skip
    heights = np.arange(T / 2, tall, T)
    if which and which[-1] >= len(heights):
        return
    mesh = models.write_stl(tmp_path / "m.stl", body.triangles())
    params = models.write_params(tmp_path, mesh, scaffolding=0, thickness=T)
    asked = heights if which is None else heights[which]
    shapes = [plants.clean(oracle.to_shapely(r)) for r in oracle.regions(body.triangles(), asked)]
    small = [affinity.scale(s, 1 / 25.4, 1 / 25.4, origin=(0, 0)) for s in shapes]
    rows = []
    for h, shape in zip(asked / z, small, strict=True):
        for p in plants.loops_of(plants.Slice(float(h), shape)):
            rows += [f"{x:.7f} {y:.7f} {h:.7f}" for x, y in p] + ["NaN NaN NaN"]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(rows) + "\n")
    r = check(params, path)
    named = [f"the file is {INCHES}", f"the heights are {INCHES}"] if z > 1 else [f"the file is {INCHES}"]
    assert r["faults"] == named and not any("beside ours" in note for note in r["notes"]), (r["faults"], r["notes"])
    rest = set(range(len(heights))) - set(np.arange(len(heights))[which] if which else range(len(heights)))
    assert set(r["failed"]) == rest and r["alignment"]["thickness"] == pytest.approx(T)  # what is not there is missing


SMOOTH = np.cumsum(0.4 - 0.125 * (1 - np.cos(np.linspace(0, 5 * np.pi, 130))))  # tops of layers that vary smoothly
SMOOTH = SMOOTH[SMOOTH < 30.0]


def varying(first=0.4):
    """Return slices of layers whose heights vary, and how thick each is."""
    tops = np.append(first, SMOOTH - SMOOTH[0] + first)
    tops = tops[np.append(True, np.diff(tops) > 1e-9) & (tops < 30.0)]
    thick = np.diff(tops, prepend=0.0)
    return slices(tops - thick / 2), thick


def written(kind, layers, thick, path):
    """Write layers: CSV has their middles, G-code their tops; its writer adds half a thickness to each."""
    if kind == "CSV":
        return plants.csv_nan(layers, path / "a.csv", T)
    tops = [plants.Slice(k.z + t / 2 - T / 2, k.region) for k, t in zip(layers, thick, strict=True)]
    return plants.BEAD_WRITERS["G-code PrusaSlicer"][1](tops, path / "a.gcode", T)


@pytest.mark.parametrize("kind", ["CSV", "PrusaSlicer"])
@pytest.mark.parametrize("first", [0.25, 0.4, 0.55])
def test_layers_that_vary_are_not_accused(first, kind, params, tmp_path):
    layers, thick = varying(first)
    r = check(params, written(kind, layers, thick, tmp_path))
    assert r["verdict"] == "pass" and not r["failed"], (r["faults"], r["worst"][:2])


@pytest.mark.parametrize("kind", ["CSV", "PrusaSlicer"])
@pytest.mark.parametrize(
    ("gone", "rows"),
    [(slice(0, 2), (1, 2)), (slice(30, 31), (1, 1)), (slice(30, 50), (10, 25)), (slice(80, None), (20, 60))],
)
def test_layers_missing_where_heights_vary(gone, rows, kind, params, tmp_path):
    layers, thick = varying()
    kept = [i for i in range(len(layers)) if i not in range(len(layers))[gone]]
    r = check(params, written(kind, [layers[i] for i in kept], thick[kept], tmp_path))
    lost = r["layers"] - len(kept)
    assert r["verdict"] == "fail" and rows[0] <= lost <= rows[1] and 0 < len(r["failed"]) <= lost, r["worst"][:2]


@pytest.mark.parametrize("by", [0.05, -0.08])
@pytest.mark.parametrize("kind", ["CSV", "PrusaSlicer"])
def test_one_height_that_is_off_hides_no_missing_layer(by, kind, params, tmp_path):
    """It is said of that layer alone, and what is above another is missing still."""
    layers = [plants.Slice(k.z + (by if i == 12 else 0.0), k.region) for i, k in enumerate(TRUE)]
    thick = np.full(len(layers), T)
    r = check(params, written(kind, layers, thick, tmp_path))
    due = TRUE[12].z + (0.0 if kind == "CSV" else T / 2)
    assert r["failed"] == [12] and f"z {due + by:g}, where {due:g} is due" in r["worst"][0]["reasons"], r["worst"][:2]
    kept = [*range(40), *range(41, 60)]
    r = check(params, written(kind, [layers[i] for i in kept], thick[kept], tmp_path))
    assert set(r["failed"]) >= {12, 40, *range(60, 66)} and len(r["failed"]) <= 2 + len(TRUE[60:])


@pytest.mark.parametrize("z", [400.4, 9e4, -500.0])
@pytest.mark.parametrize("kind", ["CSV", "PrusaSlicer"])
def test_a_layer_far_from_all_others_is_one_fault(z, kind, params, tmp_path):
    """No row is made from its height, and nothing else is accused but the layer that is missing now."""
    layers = [plants.Slice(z, k.region) if i == 33 else k for i, k in enumerate(TRUE)]
    r = check(params, written(kind, layers, np.full(len(layers), T), tmp_path))
    far = [fault for fault in r["faults"] if "far" in fault]
    assert len(far) == 1 and (kind != "CSV" or f"z {z:g} mm" in far[0]), r["faults"]
    assert r["failed"] == [33] and r["layers"] == len(TRUE), r["worst"][:2]


@pytest.mark.parametrize("z", [45.0, -5.3])
def test_a_layer_beside_the_part_makes_no_rows(z, params, tmp_path):
    layers = [plants.Slice(z, k.region) if i == 33 else k for i, k in enumerate(TRUE)]
    r = check(params, plants.csv_nan(layers, tmp_path / "a.csv", T))
    assert r["layers"] == len(TRUE) + 1 and len(r["failed"]) == 2, r["worst"][:3]
