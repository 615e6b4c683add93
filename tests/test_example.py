"""The example body is what its script says, and its parameter file reads."""

from pathlib import Path

import numpy as np
import pytest

from rasterslice.intake import read_mesh
from rasterslice.mesh import Mesh, transform
from rasterslice.params import read_params

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture(scope="module")
def body() -> Mesh:
    return read_mesh(EXAMPLES / "body.ply")


def test_size(body: Mesh) -> None:
    assert 20_000 <= len(body.triangles) <= 40_000
    assert (EXAMPLES / "body.ply").stat().st_size < 1_000_000
    assert 60 <= body.high[2] - body.low[2] <= 80


def test_closed_oriented_and_pierced(body: Mesh) -> None:
    """Every edge is used once each way, the volume is positive, and there are holes."""
    corners, index = np.unique(body.triangles.reshape(-1, 3), axis=0, return_inverse=True)
    faces = index.reshape(-1, 3).astype(np.int64)
    n = len(corners)
    edges = np.concatenate([faces[:, [i, (i + 1) % 3]] for i in range(3)])
    forward, backward = edges[:, 0] * n + edges[:, 1], edges[:, 1] * n + edges[:, 0]
    assert len(np.unique(forward)) == len(forward)
    assert np.array_equal(np.sort(forward), np.sort(backward))
    p = body.triangles.astype(np.float64)
    assert np.einsum("ij,ij->", p[:, 0], np.cross(p[:, 1], p[:, 2])) / 6 > 10_000
    euler = n - len(forward) // 2 + len(faces)
    assert 1 - euler // 2 >= 4  # three arches, and the ring of the wings


def test_parameter_file(body: Mesh) -> None:
    params = read_params(EXAMPLES / "params.txt")
    assert params.files == (EXAMPLES / "body.ply",)
    assert params.export == ("sheet", "svg")
    part = transform(body, params.scaling, params.rotation, params.translation)
    assert part.low[2] == 0
    np.testing.assert_allclose((part.low + part.high)[:2], 0, atol=1e-9)
