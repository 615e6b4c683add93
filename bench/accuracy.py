#!/usr/bin/env python3
"""Measure how exact the contours are, for docs/accuracy.md.

    bench/accuracy.py [--pitch 0.2] [--lucy]

Prints tables in Markdown: errors of contours, insets and areas of bodies of known section; what corners and
creases cost an inset, by angle; and, with --lucy or where examples/body.ply is, sculpted bodies against exact
polygons. Needs the test extra (manifold3d, shapely, scipy).
"""

import argparse
import math
import sys
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[1] / "tests"), str(Path(__file__).resolve().parents[1])]

import models  # noqa: E402
import oracle  # noqa: E402

INSET = 0.75
FORMS = {"sphere": 1.0, "torus": 0.5, "cone": 1.0, "tilted_box": 1.0, "plate": 0.5, "two_boxes": 0.5}
LAYERS = 24


def table(head, rows):
    """Print a Markdown table."""
    print("| " + " | ".join(head) + " |")
    print("|" + "---|" * len(head))
    for row in rows:
        print("| " + " | ".join(f"{v:.4g}" if isinstance(v, float) else str(v) for v in row) + " |")
    print()


def errors_of(points, exact, level, source, pitch):
    """Return | distance - level | in pixels of the points that are farther than two pixels from corners."""
    free = oracle.away(points, oracle.corners(exact), 2 * pitch)
    reflex = oracle.corners(source)
    if level < 0 and len(reflex):
        free &= oracle.away(points, reflex, -level + 2 * pitch)
    return np.abs(oracle.signed_distance(points[free], source) - level) / pitch


def large(shape, pitch, depth):
    """Whether a circle of ten pixels fits into the shape's inset."""
    return not oracle.grow(shape, -depth - 10 * pitch).is_empty()


def closed_forms(pitch):
    """Errors of contour points far from corners, and of areas."""
    rows = []
    for name, thickness in FORMS.items():
        layers = models.slice_body(models.body(name), thickness=thickness, pitch=pitch)
        cuts = oracle.regions(models.triangles(name), [k.z for k in layers])
        found = {0.0: [np.empty(0)], -INSET: [np.empty(0)]}
        areas = []
        for layer, shape in zip(layers, cuts, strict=True):
            source = oracle.polygons(shape)
            for level, paths in ((0.0, layer.part), (-INSET, layer.part_boundary)):
                if name == "torus" or large(shape, pitch, -level):
                    exact = oracle.polygons(oracle.grow(shape, level))
                    found[level].append(errors_of(paths.points, exact, level, source, pitch))
            if large(shape, pitch, 0.0):
                areas.append((layer.stats["part_area"] - shape.area(), shape.area(), len(layer.part)))
        zero, inset = (np.concatenate(found[level]) for level in found)
        wrong = np.array(areas) if areas else np.full((1, 3), math.nan)
        rows.append(
            (
                name,
                len(zero),
                float(zero.max(initial=0)),
                float(zero.mean()) if len(zero) else math.nan,
                len(inset),
                float(inset.max(initial=0)),
                float(inset.mean()) if len(inset) else math.nan,
                float(np.abs(wrong[:, 0] / wrong[:, 1]).max() * 100),
                float((wrong[:, 0] / wrong[:, 2]).mean() / pitch**2),
            )
        )
    print(f"Errors at pitch {pitch:g} mm, in pixels, farther than two pixels from corners.\n")
    table(
        (
            "body",
            "points",
            "worst",
            "mean",
            f"points at -{INSET} mm",
            "worst",
            "mean",
            "area, worst %",
            "px^2 a loop",
        ),
        rows,
    )


def corner_row(angle, pitch):
    """Measure one apex angle over several turns, in pixels.

    The corner at level 0, the crease of the inset, and the arc round the corner in the scaffold's inset.
    """
    corner, crease, arc = [], [], []
    for turn in np.arange(0.0, 90.0, 7.3):
        body = models.wedge(angle, float(turn)).moved((0.037 * turn, 0.11, 0))
        settings = {"thickness": 0.5, "pitch": pitch, "scaffold_union": "own"}
        layer = models.slice_body(body, **settings)[0]
        shape = oracle.regions(body.triangles(), [layer.z])[0]
        apex = body.triangles()[:, :, :2].reshape(-1, 2)
        apex = apex[np.hypot(*(apex - (0.037 * turn, 0.11)).T).argmin()]
        corner.append(reach(apex, list(layer.part)))
        inset = oracle.polygons(oracle.grow(shape, -INSET))
        if inset:
            tip = apex + (INSET / math.sin(math.radians(angle / 2))) * direction(float(turn))
            crease.append(reach(tip, list(layer.part_boundary)))
        ring = oracle.polygons(oracle.grow(oracle.scaffold(shape, shape, 5.0), -INSET))
        points = oracle.sample(ring)
        near = points[np.abs(np.hypot(*(points - apex).T) - INSET) < 0.01]
        if len(near):
            arc.append(float(oracle.distance(near, list(layer.scaffold_boundary)).max()))
    return [f"{angle}", *(max(e) / pitch if e else math.nan for e in (corner, crease, arc))]


def direction(turn):
    return np.array((math.cos(math.radians(turn)), math.sin(math.radians(turn))))


def reach(point, loops):
    """Return the distance of a corner from contours, mm."""
    return float(oracle.distance(np.asarray(point)[None], loops)[0])


def corners(pitch):
    """Print what corners and creases cost."""
    rows = [corner_row(angle, pitch) for angle in (20, 30, 45, 60, 90, 120, 150)]
    print("Wedges in 13 orientations: how far the contour passes from the corner, worst, in pixels.\n")
    table(
        (
            "apex, degrees",
            "corner of the part",
            f"crease of its inset (-{INSET} mm)",
            "arc of the scaffold's inset",
        ),
        rows,
    )


def sculpted(path, pitch):
    """Compare a sculpted body with exact polygons."""
    layers = models.slice_file(path, pitch=pitch)
    mesh = models.read_grounded(path)
    loops = oracle.loops_by_plane(
        oracle.section(mesh.vertices[mesh.faces], [k.z for k in layers], mesh.faces)
    )
    parts = [oracle.region(p) for p in loops]
    wanted = np.unique(np.linspace(1, len(layers) - 2, LAYERS).round().astype(int)).tolist()
    above = oracle.unions_from_top(parts, wanted)
    results = {w: [] for w in ("part", "scaffold", "part_boundary", "scaffold_boundary")}
    area = []
    for k in wanted:
        support = oracle.scaffold(above[k], parts[k], 5.0)
        if support.area() > 1:
            area.append(abs(layers[k].stats["scaffold_area"] / support.area() - 1) * 100)
        for which in results:
            shape = parts[k] if which.startswith("part") else support
            level = -INSET if which.endswith("boundary") else 0.0
            exact = oracle.polygons(oracle.grow(shape, level))
            results[which].append(oracle.compare(list(getattr(layers[k], which)), exact))
    print(f"{path.name}, {len(wanted)} layers; scaffold area off by {max(area):.4f} % at worst.")
    print("Distances in mm; `worst` is farther than 0.5 mm from corners.\n")
    rows = [
        (
            which,
            sum(r.samples for r in found),
            max(r.worst for r in found),
            sum(r.worst > 0.05 for r in found),
            100.0 * sum(r.beyond for r in found) / max(1, sum(r.samples for r in found)),
            sum(r.slivers for r in found),
        )
        for which, found in results.items()
    ]
    table(
        ("contours", "samples", "worst", "layers over 0.05", "samples over 0.05, %", "of them in slivers"),
        rows,
    )


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument("--pitch", type=float, default=0.2, help="mm between pixels")
    ap.add_argument("--lucy", action="store_true", help="also the shared statue of 62,500 facets")
    args = ap.parse_args()
    closed_forms(args.pitch)
    corners(args.pitch)
    if models.EXAMPLE.exists():
        sculpted(models.EXAMPLE, args.pitch)
    statue = models.SHARED_MODELS / "lucy_62k5.ply"
    if args.lucy and not statue.exists():
        raise SystemExit(f"no {statue}")
    if args.lucy:
        sculpted(statue, args.pitch)


if __name__ == "__main__":
    main()
