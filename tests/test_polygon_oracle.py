"""Scaffold and buffered paths of sculpted bodies against an exact polygon pipeline (manifold3d)."""

import functools
import math
from dataclasses import dataclass

import manifold3d
import models
import numpy as np
import oracle
import pytest

AREA_LIMIT = 5e-4
HAUSDORFF = 0.05  # mm, farther than 0.5 mm from corners of the polygon result
SHARE = 0.01  # of all samples, corners included
LAYERS = 24
WIDTH, BUFFER = 1.5, 5.0

MODELS = {
    "lucy_62k5": (models.SHARED_MODELS / "lucy_62k5.ply", {}),
    "lucy_own": (models.SHARED_MODELS / "lucy_62k5.ply", {"scaffold_union": "own", "thickness": 2.0}),
    "example": (models.EXAMPLE, {}),
}


@dataclass
class Exact:
    """The polygons of one layer."""

    part: manifold3d.CrossSection
    scaffold: manifold3d.CrossSection

    def contours(self, which):
        return {
            "part": lambda: self.part,
            "scaffold": lambda: self.scaffold,
            "part_boundary": lambda: oracle.grow(self.part, -WIDTH / 2),
            "scaffold_boundary": lambda: oracle.grow(self.scaffold, -WIDTH / 2),
        }[which]()


@functools.cache
def both(name):
    """Slice a model both ways; return (layer, exact) of evenly spread layers."""
    path, settings = MODELS[name]
    layers = models.slice_file(path, **settings)
    mesh = models.read_grounded(path)
    loops = oracle.loops_by_plane(
        oracle.section(mesh.vertices[mesh.faces], [k.z for k in layers], mesh.faces)
    )
    parts = [oracle.region(p) for p in loops]
    wanted = np.unique(np.linspace(1, len(layers) - 2, LAYERS).round().astype(int)).tolist()
    above = oracle.unions_from_top(parts, wanted, settings.get("scaffold_union", "above"))
    return [(layers[k], Exact(parts[k], oracle.scaffold(above[k], parts[k], BUFFER))) for k in wanted]


@pytest.fixture(params=MODELS)
def pairs(request):
    path, _ = MODELS[request.param]
    if not path.exists():
        pytest.skip(f"no {path}")
    found = both(request.param)
    assert len(found) >= 20
    return found


def test_scaffold_area(pairs):
    with_scaffold = [(k, e) for k, e in pairs if e.scaffold.area() > 1.0]
    assert len(with_scaffold) >= 15
    wrong = [
        (k.index, k.stats["scaffold_area"], e.scaffold.area())
        for k, e in with_scaffold
        if not math.isclose(k.stats["scaffold_area"], e.scaffold.area(), rel_tol=AREA_LIMIT)
    ]
    assert not wrong, wrong


#: Contours in which a crease thinner than a pixel, or its tip, still strays farther (docs/accuracy.md lists them).
STRAYS = {
    ("lucy_62k5", "scaffold"), ("lucy_62k5", "part_boundary"), ("lucy_62k5", "scaffold_boundary"),
    ("lucy_own", "part_boundary"), ("lucy_own", "scaffold_boundary"),
    ("example", "scaffold"), ("example", "part_boundary"), ("example", "scaffold_boundary"),
}  # fmt: skip


def compared(pairs, which):
    results = {
        k.index: oracle.compare(list(getattr(k, which)), oracle.polygons(e.contours(which)), HAUSDORFF)
        for k, e in pairs
    }
    judged = [r for r in results.values() if r.judged > 50]
    assert len(judged) >= 15
    return results, judged


WHICH = ("part", "scaffold", "part_boundary", "scaffold_boundary")


@pytest.mark.parametrize("which", WHICH)
def test_share_of_samples_beyond(request, pairs, which):
    """At most 1 % of all samples, corners and slivers included, lie beyond the limit; few layers have any."""
    results, judged = compared(pairs, which)
    beyond, samples = sum(r.beyond for r in judged), sum(r.samples for r in judged)
    slivers = sum(r.slivers for r in judged)
    assert beyond - slivers <= SHARE * samples, f"{beyond} of {samples}"
    if (request.node.callspec.params["pairs"], which) == ("example", "part_boundary") and beyond > SHARE * samples:
        pytest.xfail(f"{beyond} of {samples} samples, {slivers} of them in tongues thinner than a pixel")
    assert beyond <= SHARE * samples, f"{beyond} of {samples}"
    assert sum(r.worst > HAUSDORFF for r in results.values()) <= 0.25 * len(results)


@pytest.mark.parametrize("which", WHICH)
def test_hausdorff_distance(request, pairs, which):
    """No sample away from corners lies beyond the limit."""
    results, _ = compared(pairs, which)
    wrong = {i: r for i, r in results.items() if r.worst > HAUSDORFF}
    if wrong and (request.node.callspec.params["pairs"], which) in STRAYS:
        worst = max(wrong.values(), key=lambda r: r.worst)
        pytest.xfail(f"{len(wrong)} of {len(results)} layers, worst {worst.worst:.3f} mm at {worst.where}")
    assert not wrong, f"{len(wrong)} layers: {list(wrong.items())[:4]}"


# ---------------------------------------------------------------- the oracle itself
def test_own_sections_are_those_of_manifold():
    for name in ("sphere", "torus", "tilted_box", "plate", "two_boxes", "box_cavity", "pillars"):
        triangles = models.triangles(name)
        heights = np.linspace(0.11, 0.93, 5) * triangles[..., 2].max()
        own = [r.area() for r in oracle.regions(triangles, heights)]
        other = [r.area() for r in oracle.manifold_regions(triangles, heights)]
        assert min(own) > 1
        assert own == pytest.approx(other, rel=1e-6), name


def test_offsets_of_the_oracle():
    disc = oracle.region([models.circle(10, n=4000)])
    assert oracle.grow(disc, 5).area() == pytest.approx(math.pi * 225, rel=2e-5)
    assert oracle.grow(disc, -0.75).area() == pytest.approx(math.pi * 9.25**2, rel=2e-5)
    square = oracle.region([models.rectangle(0, 0, 10, 10)])
    assert oracle.grow(square, 5).area() == pytest.approx(100 + 200 + math.pi * 25, rel=2e-5)
    frame = oracle.regions(models.triangles("frame"), [1.0])[0]
    reflex = 4 * (1 - math.pi / 4) * 0.75**2
    assert oracle.grow(frame, -0.75).area() == pytest.approx(23.25**2 - 14.1**2 + reflex, rel=2e-5)


def test_scaffold_of_the_oracle():
    wide, narrow = (oracle.region([models.rectangle(-s, -s, s, s)]) for s in (6, 3))
    above = oracle.unions_from_top([narrow, wide, narrow], [0, 1, 2])
    assert [above[k].area() for k in (0, 1, 2)] == [144, 36, 0]
    own = oracle.unions_from_top([narrow, wide, narrow], [0, 1, 2], "own")
    assert [own[k].area() for k in (0, 1, 2)] == [144, 144, 36]
    ring = oracle.scaffold(above[0], narrow, 2.0)
    assert ring.area() == pytest.approx(144 + 4 * 12 * 2 + math.pi * 4 - 36, rel=1e-4)


def test_distances_of_the_oracle():
    points = np.random.default_rng(1).uniform(-14, 14, (3000, 2))
    frame = oracle.slice_loops(models.triangles("frame"), [1.0])[0]
    reach = np.abs(points).max(axis=1)
    hole = np.float64(np.float32(6.3))
    exact = np.maximum(reach - 12.375, hole - reach)
    inner = (reach > hole) & (reach < 12.375)
    exact[inner] = -np.minimum(12.375 - reach, np.hypot(*np.maximum(np.abs(points) - hole, 0).T))[inner]
    found = oracle.signed_distance(points, frame)
    assert inner.sum() > 500
    assert (np.sign(found) == np.sign(exact)).all()
    np.testing.assert_allclose(found[inner], exact[inner], atol=1e-9)


def test_comparison_sees_what_differs():
    """A comparison that cannot fail judges nothing: a missing loop and a bulge must show."""
    disc = models.circle(10)
    hole = models.circle(3)[::-1]
    same = oracle.compare([disc, hole], [disc, hole])
    assert same.worst < 1e-9 and same.beyond == 0 and same.judged > 500
    assert oracle.compare([disc], [disc, hole]).worst > 6
    assert oracle.compare([disc, hole], [disc]).worst > 6
    assert oracle.compare([disc * 1.006], [disc]).worst == pytest.approx(0.06, abs=1e-3)
    assert oracle.compare([], [disc]).worst == math.inf
    square = models.rectangle(-5, -5, 5, 5)
    cut = np.array([(-5, -4.8), (-4.8, -5), (5, -5), (5, 5), (-5, 5)], float)
    near = oracle.compare([cut], [square])
    assert near.worst < 1e-9 and near.beyond > 0


def test_shape_checks_of_the_oracle():
    square, hole = models.rectangle(0, 0, 10, 10), models.rectangle(2, 2, 5, 5)[::-1]
    bow = np.array([(0, 0), (1, 1), (1, 0), (0, 1)], float)
    assert oracle.is_simple(square) and not oracle.is_simple(bow) and not oracle.is_simple(square[:2])
    assert oracle.wrongly_oriented([square, hole]) == []
    assert oracle.wrongly_oriented([square[::-1], hole]) == [0]
    assert oracle.wrongly_oriented([square, hole[::-1]]) == [1]
    assert oracle.disjoint([square, hole]) and not oracle.disjoint([square, square + 3])
    assert oracle.spacing([square, hole]) == 3
    assert len(oracle.corners([square, hole])) == 8 and len(oracle.corners([models.circle(5)])) == 0
