"""The million-facet statue: the area of every layer against an independent float64 shoelace."""

import models
import numpy as np
import oracle
import pytest

STATUE = models.SHARED_MODELS / "lucy_1M.ply"


@pytest.fixture(scope="module")
def statue():
    if not STATUE.exists():
        pytest.skip(f"no {STATUE}")
    layers = models.slice_file(STATUE, {"regions": False})
    mesh = models.read_grounded(STATUE)
    cut = oracle.section(mesh.vertices[mesh.faces], [k.z for k in layers], mesh.faces)
    return layers, cut.areas(), cut.loop_counts()


def column(layers, name):
    return np.array([np.nan if k.stats[name] is None else k.stats[name] for k in layers], float)


def test_all_layers_are_there(statue):
    layers, exact, loops = statue
    assert len(layers) == 765
    assert (exact > 0).all() and (loops > 0).all() and loops.sum() > 1000


def test_exact_area_is_exact(statue):
    """The slicer's own shoelace agrees with the oracle's; it is blank only where shells overlap."""
    layers, exact, _ = statue
    reported = column(layers, "part_area_exact")
    assert np.isfinite(reported).sum() >= 0.9 * len(layers)
    known = np.isfinite(reported)
    np.testing.assert_allclose(reported[known], exact[known], rtol=1e-5, atol=1e-3)


def test_area_of_every_layer(statue):
    layers, exact, loops = statue
    error = np.abs(column(layers, "part_area") - exact)
    assert np.isfinite(error).all()
    limit = 2e-4 * exact + 0.03 * loops
    worst = int((error / limit).argmax())
    assert error[worst] <= limit[worst], f"layer {worst}: {error[worst]:.4f} mm2 of {exact[worst]:.2f}"


def test_no_layer_is_open(statue):
    layers, _, _ = statue
    assert sum(k.stats["open_rows"] for k in layers) == 0
