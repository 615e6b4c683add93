"""The two tables of docs/cross-check.md, real slicers and planted faults, and the statue against its G-code.

    python bench/check.py --slicers [--models NAME...]
    python bench/check.py --plants [--per-kind 3] [--kinds NAME...] [--faults NAME...] [--example]
    python bench/check.py --statue [GCODE]

Without any of the three, both tables are made.
"""

from __future__ import annotations

import argparse
import collections
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import models
import oracle
import plants
import race
import shapely
from shapely.geometry import MultiPolygon, Polygon
from stages import compile_package, measure

from rasterslice.check.run import check

EXAMPLE = Path(__file__).parents[1] / "examples" / "body.ply"
STATUES = ("lucy_62k5", "lucy_1M")  # of the shared models, for the table and for --statue
WIDTH = "0.8"
FORMS = {  # closed forms
    "sphere": lambda: models.sphere(12.0, 128, 64).grounded(),
    "cone": lambda: models.cone(12.0, 24.0, 128),
    "torus": lambda: models.torus(12.0, 4.0, 128, 64).grounded(),
    "pyramid": models.stepped_pyramid,
}
SUPPORT = "support missing"
KINDS = [*plants.AREA_WRITERS, *plants.BEAD_WRITERS]
FAULTS = list(dict.fromkeys([*plants.AREA_FAULTS, *plants.BEAD_FAULTS, SUPPORT]))


def mesh_of(path: Path) -> np.ndarray:
    body = models.read_grounded(path)
    return body.vertices[body.faces]


def true_slices(triangles: np.ndarray, thickness: float, heights: np.ndarray | None = None) -> list[plants.Slice]:
    """Return exact slices, by polygons."""
    if heights is None:
        top = float(triangles[..., 2].max())
        heights = np.arange(0.5 * thickness, top, thickness)
    shapes = [plants.clean(oracle.to_shapely(r)) for r in oracle.regions(triangles, heights)]
    return [plants.Slice(float(z), shape) for z, shape in zip(heights, shapes, strict=True)]


def params_of(folder: Path, mesh: Path) -> Path:
    return models.write_params(folder, mesh, scaffolding=0, thickness=0.4)


def stl_of(mesh: Path, folder: Path) -> Path:
    return models.write_stl(folder / (mesh.stem + ".stl"), mesh_of(mesh))


def slicer_outputs(mesh: Path, folder: Path) -> dict[str, Path]:
    """Run every slicer that is there, and two pipelines of polygons."""
    found = {}
    stl = stl_of(mesh, folder)
    common = ["--layer-height", "0.4", "--first-layer-height", "0.4", "--nozzle-diameter", "0.6"]
    for what in ("", "external-perimeter-", "first-layer-"):
        common += [f"--{what}extrusion-width", WIDTH]
    if shutil.which("slic3r"):
        out = folder / "slic3r.svg"
        args = ["--layer-height", "0.4", "--first-layer-height", "0.4", "--print-center", "0,0"]
        _run("slic3r", "--export-svg", *args, "-o", str(out), str(stl))
        found["Slic3r 1.3.0, SVG"] = out
        out = folder / "slic3r.gcode"
        _run("slic3r", *common, "--gcode-comments", "--print-center", "200,200", "-o", str(out), str(stl))
        found["Slic3r 1.3.0, G-code"] = out
    if shutil.which("prusa-slicer"):
        out = folder / "prusa.gcode"
        bed = ["--bed-shape", "0x0,400x0,400x400,0x400", "--max-print-height", "400", "--center", "200,200"]
        _run(
            "prusa-slicer",
            "-g",
            *common,
            "--elefant-foot-compensation",
            "0",
            "--skirts",
            "0",
            *bed,
            "-o",
            str(out),
            str(stl),
        )
        found["PrusaSlicer 2.5.0, G-code"] = out
    slices = true_slices(mesh_of(mesh), 0.4)
    found["manifold3d, CLI"] = plants.cli_binary(slices, folder / "manifold.cli", 0.4)
    found["trimesh and shapely, CSV"] = plants.csv_nan(trimesh_slices(mesh, slices), folder / "shapely.csv", 0.4)
    return {name: path for name, path in found.items() if path.exists()}


def trimesh_slices(mesh: Path, like: list[plants.Slice]) -> list[plants.Slice]:
    """Return slices by trimesh and shapely."""
    import trimesh

    body = models.read_grounded(mesh)
    solid = trimesh.Trimesh(body.vertices, body.faces, process=False)
    new = []
    for k in like:
        lines = trimesh.intersections.mesh_plane(solid, (0, 0, 1), (0, 0, k.z))[..., :2].round(7)
        rings = shapely.get_parts(shapely.line_merge(shapely.multilinestrings(list(shapely.linestrings(lines)))))
        shape = Polygon()
        for ring in rings:
            if ring.is_closed and len(ring.coords) > 3:
                shape = shape.symmetric_difference(shapely.make_valid(Polygon(ring)))
        new.append(plants.Slice(k.z, plants.clean(shape)))
    return new


def _run(*args: str) -> None:
    subprocess.run(args, check=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=300)


def slicers(names: list[Path]) -> None:
    print("| model | writer | layers | worst, mm | median, mm | pass | cannot tell | fail | verdict | seconds |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for mesh in names:
        with tempfile.TemporaryDirectory() as scratch:
            folder = Path(scratch)
            params = params_of(folder, mesh)
            for name, path in slicer_outputs(mesh, folder).items():
                start = time.perf_counter()
                r = check(params, path)
                seconds = round(time.perf_counter() - start, 1)
                counts = [r["passed"], len(r["cannot_tell"]), len(r["failed"])]
                cells = [mesh.stem, name, r["layers"], r["worst_deviation"], r["median_deviation"], *counts]
                cells += [r["verdict"], seconds]
                print("| " + " | ".join(str(c) for c in cells) + " |", flush=True)


def statue(gcode: Path | None, rounds: int = 3) -> None:
    """Time the check of the statue of a million facets against PrusaSlicer's G-code, with supports, beads of 1.5 mm."""
    mesh = models.SHARED_MODELS / f"{STATUES[1]}.ply"
    if not mesh.exists() or not (gcode or shutil.which("prusa-slicer")):
        raise SystemExit(f"{mesh} and prusa-slicer are needed; or name the G-code")
    compile_package()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        params = race.parameter_file(mesh, 0.2, folder)
        if gcode is None:
            gcode, stl = folder / "statue.gcode", race.write_stl(mesh, folder / "statue.stl")
            _run("prusa-slicer", *race.PRUSA_SETTINGS.split(), "--output", str(gcode), str(stl))
        command = [sys.executable, "-m", "rasterslice", "check", str(params), "--against", str(gcode)]
        size = gcode.stat().st_size / 1e6
        runs = [measure(command) for _ in range(1 + rounds)][1:]  # the first fills the kernel cache
    print(f"{runs[0].output.strip()}\n{size:.0f} MB, {rounds} rounds")
    for name in ("wall", "cpu"):
        seconds = [getattr(cost, name) for cost in runs]
        print(f"{name}: least {min(seconds):.1f} s, median {statistics.median(seconds):.1f} s")


class Planter:
    """Plants faults into one model and counts what is found."""

    def __init__(self, folder: Path, mesh: Path, first: int, count: int, seed: int = 0) -> None:
        self.folder, self.rng = folder, np.random.default_rng(seed)
        self.params = params_of(folder, mesh)
        self.triangles = mesh_of(mesh)
        self.slices = true_slices(self.triangles, 0.4)
        self.near: dict[int, list[MultiPolygon]] = {}
        self.window = range(first, first + count)
        self.score: dict[tuple[str, str], collections.Counter] = collections.defaultdict(collections.Counter)

    def between(self, i: int) -> list[MultiPolygon]:
        """Return a true slice, and those a little lower and higher: between them a slice may lie."""
        if i not in self.near:
            z = self.slices[i].z + plants.HEIGHT_SLACK * np.array([-1.0, 1.0])
            shapes = [plants.clean(oracle.to_shapely(r)) for r in oracle.regions(self.triangles, z)]
            self.near[i] = [self.slices[i].region, *shapes]
        return self.near[i]

    def one(self, kind: str, fault: str) -> None:
        """Plant one fault, say whether it counts, check, and score."""
        beads = kind in plants.BEAD_WRITERS
        suffix, write = (plants.BEAD_WRITERS if beads else plants.AREA_WRITERS)[kind]
        faults = plants.BEAD_FAULTS if beads else plants.AREA_FAULTS
        made = None
        for _ in range(20):
            k = int(self.rng.choice(self.window))
            made = faults[fault](self.rng, self.slices, k)
            if made is not None:
                break
        if made is None:
            return
        layers, wrong = made
        by_z = {round(layer.z, 3): layer for layer in layers}
        limits = plants.stated(kind, width=float(WIDTH))
        due = [
            i for i in wrong
            if carried(kind, fault)
            and plants.exceeds(self.between(i), by_z.get(round(self.slices[i].z, 3)), fault, limits, beads)
        ]  # fmt: skip
        r = check(self.params, write(layers, self.folder / f"planted{suffix}", 0.4))
        self.count(kind, fault, due, wrong, r)

    def count(self, kind: str, fault: str, due: list[int], wrong: list[int], r: dict) -> None:
        """Score one check."""
        score, failed = self.score[fault, kind], set(r["failed"])
        # A file-wide fault, or a failure elsewhere, is an accusation of the innocent.
        score["accused"] += len(failed - set(wrong)) + len(r["faults"])
        if due:
            score["planted"] += 1
            found = set(due) <= failed
            score["found"] += found
            if not found:
                print(f"missed: {fault}, {kind}, layers {due}, failed {sorted(failed)}", file=sys.stderr)
        elif failed & set(wrong):
            score["also"] += 1
        if failed - set(wrong) or r["faults"]:
            bad = [(w["layer"], w["reasons"]) for w in r["worst"] if w["verdict"] == "fail"]
            print(f"accused: {fault}, {kind}, {wrong}, {r['faults']}, {bad[:2]}", file=sys.stderr)


class Supports(Planter):
    """Breaks supports away."""

    def __init__(self, folder: Path, seed: int) -> None:
        folder = folder / "supports"
        folder.mkdir()
        mesh = models.write_ply(folder / "tops.ply", plants.overhanging())
        super().__init__(folder, mesh, 0, 26, seed)
        self.slices = plants.supported(self.slices)

    def one(self, kind: str, fault: str) -> None:
        """Break one pillar away, say whether that counts, check, and score."""
        suffix, write = {**plants.AREA_WRITERS, **plants.BEAD_WRITERS}[kind]
        made = None
        while made is None:
            made = plants.support_missing(self.rng, self.slices, int(self.rng.choice(self.window)))
        layers, wrong = made
        width = float(WIDTH) if kind in plants.BEAD_WRITERS else 1.5
        due = [k for k in wrong if plants.unheld(layers, k, width, 0.1)]
        r = check(self.params, write(layers, self.folder / f"planted{suffix}", 0.4))
        self.count(kind, fault, due, wrong, r)


def carried(kind: str, fault: str) -> bool:
    """Whether a format carries a fault: pictures have neither direction nor order."""
    if fault == "winding reversed":
        return kind in plants.CARRIES_WINDING
    return not (fault == "self intersection" and kind in plants.PICTURED)


def planted(planter: Planter, supports: Supports, per_kind: int, kinds: list[str], faults: list[str]) -> None:
    for kind in kinds:
        for fault in plants.BEAD_FAULTS if kind in plants.BEAD_WRITERS else plants.AREA_FAULTS:
            for _ in range(per_kind if fault in faults else 0):
                planter.one(kind, fault)
        for _ in range(per_kind if kind in plants.CARRIES_SUPPORT and SUPPORT in faults else 0):
            supports.one(kind, SUPPORT)
    show(planter.score, kinds)


def show(score: dict[tuple[str, str], collections.Counter], kinds: list[str]) -> None:
    faults = list(dict.fromkeys(fault for fault, _ in score))
    print("| fault | " + " | ".join(kinds) + " |\n|---|" + "---|" * len(kinds))
    for fault in faults:
        cells = []
        for kind in kinds:
            s = score.get((fault, kind))
            cells.append(f"{s['found']}/{s['planted']}" if s and s["planted"] else "-")
        print(f"| {fault} | " + " | ".join(cells) + " |")
    total = sum(score.values(), collections.Counter())
    print(f"\nfound {total['found']} of {total['planted']}; wrong accusations: {total['accused']}")


def table_of_slicers(names: list[str]) -> None:
    """Print the first table, for some models."""
    with tempfile.TemporaryDirectory() as scratch:
        forms = {name: body for name, body in FORMS.items() if name in names}
        meshes = [models.write_ply(Path(scratch) / f"{name}.ply", body()) for name, body in forms.items()]
        meshes += [EXAMPLE] if "example" in names else []
        statue = models.SHARED_MODELS / f"{STATUES[0]}.ply"
        slicers([*meshes, *([statue] if statue.exists() and STATUES[0] in names else [])])


def table_of_plants(args: argparse.Namespace) -> None:
    """Print the second table, for some formats and faults."""
    with tempfile.TemporaryDirectory() as scratch:
        if args.example:
            planter = Planter(Path(scratch), EXAMPLE, 8, 150, args.seed)
        else:
            mesh = models.write_ply(Path(scratch) / "part.ply", plants.part())
            planter = Planter(Path(scratch), mesh, 1, 13, args.seed)
        supports = Supports(Path(scratch), args.seed)
        supports.score = planter.score
        planted(planter, supports, args.per_kind, args.kinds, args.faults)


def main() -> None:
    every = [*FORMS, "example", STATUES[0]]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--slicers", action="store_true", help="real slicers on real models")
    parser.add_argument("--models", nargs="+", choices=every, default=every, metavar="NAME", help=", ".join(every))
    parser.add_argument("--plants", action="store_true", help="planted faults")
    parser.add_argument("--per-kind", type=int, default=3, help="plants of each fault in each format")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS, metavar="NAME", help=", ".join(KINDS))
    parser.add_argument("--faults", nargs="+", choices=FAULTS, default=FAULTS, metavar="NAME", help=", ".join(FAULTS))
    parser.add_argument("--example", action="store_true", help="plant into the example: ten times slower")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--statue", nargs="?", type=Path, const=Path(), metavar="GCODE", help="made where not named")
    args = parser.parse_args()
    if args.statue is not None and args.statue.name and not args.statue.exists():
        parser.error(f"{args.statue}: no such file")
    both = not (args.slicers or args.plants or args.statue is not None)
    if args.slicers or both:
        table_of_slicers(args.models)
    if args.plants or both:
        table_of_plants(args)
    if args.statue is not None:
        statue(args.statue if args.statue.name else None)


if __name__ == "__main__":
    main()
