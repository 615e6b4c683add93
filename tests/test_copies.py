"""Copies and ice layers: exports hold every copy; one ice layer in a slice has one fill."""

import json

import models
import numpy as np

import rasterslice
from rasterslice.cli import main
from rasterslice.export.copies import Copied, grid_of_copies
from rasterslice.grid import cover


def test_every_copy_is_where_the_manifest_says(tmp_path):
    mesh = models.write_stl(tmp_path / "a.stl", models.box((0, 0, 0), (8, 6, 1.2)).triangles())
    file = models.write_params(tmp_path, mesh, copies="2 2 3", thickness=0.4)
    assert main([str(file), "--export", "csv,svg,sheet", "--quiet", "-o", str(tmp_path / "out")]) == 0
    manifest = json.loads((tmp_path / "out/manifest.json").read_text())
    offsets = np.array(manifest["copies"])
    assert len(offsets) == 3
    one = rasterslice.open(tmp_path / "out")
    layers = Copied(one, offsets)
    assert len(layers) == len(one) == 3
    for single, layer in zip(one, layers, strict=True):
        for name in ("part", "scaffold", "part_boundary", "scaffold_boundary", "part_fill", "part_second_fill"):
            a, b = getattr(single, name), getattr(layer, name)
            assert len(b) == 3 * len(a)
            for i, offset in enumerate(offsets):
                for j in range(len(a)):
                    np.testing.assert_array_equal(b[i * len(a) + j], a[j] + offset)
    rows = (tmp_path / "out" / f"{manifest['name']}.csv").read_text().splitlines()
    boundary = sum(len(layer.part_boundary.points) for layer in layers)
    assert sum(",part,boundary," in row for row in rows) == 2 * boundary > 0  # two ice layers


def test_the_grid_holds_all_copies():
    grid = cover((0, 0), (10, 10), 0.2, 5.0)
    wide = grid_of_copies(grid, np.array([(0.0, 0.0), (24.0, 0.0), (0.0, 30.0)]))
    assert (wide.x0, wide.y0) == (grid.x0, grid.y0)
    assert wide.width * 0.2 >= grid.width * 0.2 + 24.0 and wide.height * 0.2 >= grid.height * 0.2 + 30.0


def test_one_ice_layer_has_no_second_fill(tmp_path):
    body = models.box((0, 0, 0), (8, 6, 1.2))
    one = models.slice_body(body, thickness=0.4, part_layers_per_slice=1)
    two = models.slice_body(body, thickness=0.4)
    for a, b in zip(one, two, strict=True):
        assert len(a.part_second_fill) == 0 < len(b.part_second_fill)
        # slice k is ice layer k, or ice layers 2 k and 2 k + 1
        np.testing.assert_array_equal(a.part_fill.points, b.ice_fill(a.index).points)
