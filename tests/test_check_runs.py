"""check: two runs of ours whose pixels differ agree, and what pixels do not explain is found."""

import dataclasses
from pathlib import Path

import models
import numpy as np
import plants
import pytest
import shapely
from shapely import affinity

from rasterslice.check import readers
from rasterslice.check.run import check
from rasterslice.cli import main

EXAMPLE = Path(__file__).parents[1] / "examples"
PITCHES = (0.2, 0.5)


@pytest.fixture(scope="module", params=["regions", "boundary"])
def runs(request, tmp_path_factory):
    """Give the example sliced at two pitches, with regions or without."""
    folder = tmp_path_factory.mktemp(request.param)
    text = (EXAMPLE / "params.txt").read_text().replace("body.ply", str(EXAMPLE / "body.ply"))
    text = "\n".join(line for line in text.splitlines() if not line.startswith(("pitch", "export")))
    extra = "export = svg\n" if request.param == "regions" else ""
    found = []
    for pitch in PITCHES:
        path = folder / f"p{pitch}.txt"
        path.write_text(f"{text}\npitch = {pitch}\n{extra}")
        assert main([str(path), "--quiet"]) == 0
        found.append(folder / f"p{pitch}.slices")
    return request.param, found


@pytest.mark.parametrize("turned", [False, True])
def test_pixels_accuse_nobody(runs, turned):
    """Two pitches of the example, whose wings are thinner than two paths: no layer fails, whichever comes first."""
    r = check(*runs[1][:: -1 if turned else 1])
    assert r["verdict"] == "pass" and not r["failed"] and not r["faults"], r["worst"][:2]
    assert r["tolerance"] == 0.5 / 4 and r["uncertainty"] >= 0.1 * sum(PITCHES)  # of both
    assert len(r["cannot_tell"]) <= 0.25 * r["layers"]
    assert any("pixels of 0.2 and 0.5 mm" in note for note in r["notes"])


def region(layer):
    """Return the solid of a layer."""
    shape = shapely.Polygon()
    for p in layer.loops:
        shape = shape.symmetric_difference(shapely.make_valid(shapely.Polygon(p)))
    return plants.clean(shape)


def shifted(shape):
    """Move by a little more than tolerance and uncertainty at these pitches, 0.5 mm at most."""
    return affinity.translate(shape, 0.0, 0.5 / 4 + 0.25)


def hole_made(shape):
    room = shape.buffer(-1.0)
    return shape.difference(room.representative_point().buffer(0.6)) if not room.is_empty else shape


def island_deleted(shape):
    return shapely.MultiPolygon(sorted(shape.geoms, key=lambda p: p.area)[1:]) if len(shape.geoms) > 1 else shape


@pytest.mark.parametrize("plant", [shifted, hole_made, island_deleted])
@pytest.mark.parametrize("other", [0, 1])
def test_faults_of_one_run_are_found(runs, plant, other, monkeypatch):
    """One layer of one run is changed, of the finer or of the coarser one: it fails, and no other."""
    kind, folders = runs
    read, rng = readers.ours, np.random.default_rng(7)
    layers = read(folders[other], kind).layers
    for k in rng.permutation(len(layers) - 1)[:60].tolist():
        shape = region(layers[k])
        new = plants.clean(plant(shape))
        if not plants.clean(shape.symmetric_difference(new).buffer(-0.4 if plant is not shifted else 0)).is_empty:
            break
    else:
        pytest.fail("no layer shows this fault")
    loops = plants.loops_of(plants.Slice(layers[k].z, new))

    def planted(folder, areas=""):
        found = read(folder, areas)
        if folder == folders[other]:
            found.layers[k] = dataclasses.replace(found.layers[k], loops=loops, declared=[0] * len(loops))
        return found

    monkeypatch.setattr(readers, "ours", planted)
    r = check(*folders)
    assert r["verdict"] == "fail" and r["failed"] == [k], (k, r["failed"], r["worst"][:2])


def test_a_filled_hole(tmp_path):
    """A tube, 3 mm inside, against the same without its hole."""
    runs = []
    for name, pitch, inner in (("a", 0.2, 1.5), ("b", 0.4, 1.5), ("c", 0.4, None)):
        rings = [models.circle(6, (0, 0), 64)] + ([models.circle(inner, (0, 0), 64)[::-1]] if inner else [])
        (tmp_path / name).mkdir()
        mesh = models.write_stl(tmp_path / name / "m.stl", models.prism(rings, 0.0, 2.0).triangles())
        params = models.write_params(tmp_path / name, mesh, scaffolding=0, thickness=0.4, pitch=pitch, export="svg")
        assert main([str(params), "--quiet"]) == 0
        runs.append(tmp_path / name / "params.slices")
    a, b, c = runs
    assert check(a, b)["passed"] == check(b, a)["passed"] == 5
    assert len(check(a, c)["failed"]) == len(check(c, a)["failed"]) == 5
