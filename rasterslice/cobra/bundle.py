"""The folder ``<stem>.cobra/``: what is copied to the controller, and a manifest."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from .. import __version__
from ..errors import UsageError
from ..paths import Layer, Toolpath
from ..profile import FileRules, Motion, Nozzle, PathRules, Place, PlayerRules, Profile, Robot
from ..trajectory import Planner
from . import program
from .checks import Checker
from .fit import Site
from .motion import Estimate
from .records import RecordWriter, base_name
from .sound import manifest_fault, profile_fault

KIND = "cobra"
_SECTIONS: dict[str, type[Any]] = {
    "robot": Robot, "part": Place, "part_nozzle": Nozzle, "scaffold_nozzle": Nozzle, "motion": Motion,
    "program": PlayerRules, "path": PathRules, "files": FileRules,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Bundle:
    """A folder that was written: its manifest, and the profile it was written with."""

    folder: Path
    manifest: dict[str, Any]
    profile: Profile

    @property
    def records(self) -> Path:
        """The trajectory file."""
        return self.folder / str(self.manifest["records_file"])


def write_bundle(
    layers: Sequence[Layer], folder: Path, planner: Planner, stem: str, widths: tuple[float, float],
    site: Site | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Write the folder; return its manifest.

    Parameters
    ----------
    layers : sequence of Layer
        In print order.
    folder : Path
        Is made; removed again when a check fails.
    planner : Planner
    stem : str
        Name of the job.
    widths : (float, float)
        Of the beads of part and scaffold, mm.
    site : Site, optional
        Where the copies stand that the layers hold; default one part.

    Raises
    ------
    UsageError
        When a check fails.
    """
    name = base_name(stem)
    folder.mkdir()
    try:
        manifest = _write(layers, folder, planner, name, stem, widths, site or Site())
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return manifest


def _write(
    layers: Sequence[Layer], folder: Path, planner: Planner, name: str, stem: str, widths: tuple[float, float],
    site: Site,
) -> dict[str, Any]:  # fmt: skip
    p = planner.profile
    checker, estimate = Checker(p, planner.smooth_angle, max(widths), site, planner.heights), Estimate()
    records = f"{name}.RSD"
    kept: list[Toolpath] = []

    def checked() -> Iterator[Toolpath]:
        motions = 0
        for path in planner.toolpaths(layers):
            checker.add(path)
            estimate.add(path, p)
            motions += len(path.points) + 2 * len(path)
            if motions <= p.files.literal_steps:
                kept.append(path)
            yield path

    with RecordWriter(folder / records, name, p) as writer:
        for path in checked():
            writer.add(path)
    checks = checker.finish()
    texts = {"RSCFG.V2": program.settings(p, records)}
    if p.files.literal_steps and len(kept) == writer.layers:
        texts |= program.literal(kept, p, p.files.literal_steps) or {}
    for file, content in texts.items():
        (folder / file).write_bytes(content.encode("ascii"))
    (folder / program.PLAYER.name).write_bytes(program.player())
    tally = {key: round(v, 4) if isinstance(v, float) else v for key, v in asdict(planner.tally).items()}
    tally["run_to_run_mm"], tally["run_to_run_unordered_mm"] = tally.pop("travel"), tally.pop("file_travel")
    manifest = {
        "program": "rasterslice", "version": __version__, "kind": KIND, "name": stem, "records_file": records,
        "layers": writer.layers, "paths": writer.paths, "points": writer.points, "records": writer.records,
        "low": _box(checker.low), "high": _box(checker.high),
        "wet_mm": {"part": round(estimate.wet[0], 3), "scaffold": round(estimate.wet[1], 3)},
        "dry_mm": round(estimate.dry, 3), "travel_mm": round(estimate.travel, 3),
        "tool_changes": estimate.changes, "estimated_seconds": round(estimate.seconds, 1),
        "trajectory": tally, "warnings": [*warnings(planner), *checker.warnings()], "checks": checks,
        "bottom": _bottom(layers, planner), "copies": site.copies.tolist(),
        "thickness": planner.thickness, "slice_position": planner.slice_position,
        "smooth_angle": planner.smooth_angle, "part_layers": planner.part_layers, "widths": list(widths),
        "profile": asdict(p), "files": _files(folder),
    }  # fmt: skip
    text = json.dumps(manifest, indent=1, allow_nan=False) + "\n"
    (folder / f"{name}.json").write_bytes(text.encode("ascii"))
    return manifest


def _bottom(layers: Sequence[Layer], planner: Planner) -> float | None:
    """Return the height at which slice 0 begins, mm."""
    if not len(layers):
        return None
    return round(float(layers[0].z) - (layers[0].index + planner.slice_position) * planner.thickness, 6)


def warnings(planner: Planner) -> list[str]:
    """Return what was left out or bent, in words."""
    t, p = planner.tally, planner.profile
    out = []
    if t.short:
        out.append(f"{t.short} runs, {t.short_mm:.1f} mm in all, are too short for the valve and were left out; "
                   f"{p.finer()} to keep them")  # fmt: skip
    if t.lost_loops:
        out.append(f"{t.lost_loops} closed paths cannot hold three points at the least spacing and were left out")
    if t.coarse:
        out.append(f"{t.coarse} of {t.thinned} points of boundaries lie up to {t.deviation:.3f} mm from the motions, "
                   f"chord_tolerance is {p.path.chord_tolerance:g} mm, worst in layer {t.coarse_layer}: the least "
                   f"spacing forces it; {p.finer()}")  # fmt: skip
    if t.through_walls:
        out.append(f"{t.through_walls} lead-ins run through fresh walls: every start would")
    return out


def read_bundle(folder: Path) -> Bundle:
    """Read the manifest of ``<stem>.cobra/``, or of the only one in an output folder.

    Raises
    ------
    UsageError
        When there is none, or it is damaged.
    """
    if not folder.is_dir():
        raise UsageError(f"{folder}: no such folder; name one that --export cobra made")
    places = [folder, *sorted(folder.glob("*.cobra"))]
    for place in places:
        for file in sorted(place.glob("*.json")):
            try:
                manifest = json.loads(file.read_bytes())
                if isinstance(manifest, dict) and manifest.get("kind") == KIND:
                    return _sound(place, manifest)
            except OSError as error:
                raise UsageError(f"{file}: cannot be read: {error.strerror}") from None
            except KeyError as error:
                raise UsageError(f"{file}: damaged ({error.args[0]} is missing); export again") from None
            except (ValueError, TypeError, AttributeError, OverflowError, RecursionError) as error:
                raise UsageError(f"{file}: damaged ({error}); export again") from None
    raise UsageError(f"{folder}: holds no {KIND} export; make one: rasterslice export {folder} --to cobra")


def _sound(place: Path, manifest: dict[str, Any]) -> Bundle:
    """Return a bundle; raises ValueError when its manifest is none that was written."""
    if fault := manifest_fault(manifest):
        raise ValueError(fault)
    profile = _profile(manifest["profile"])
    if fault := profile_fault(profile):
        raise ValueError(fault)
    return Bundle(place, manifest, profile)


def verify(bundle: Bundle) -> None:
    """Compare the files with their sums in the manifest, but for the settings, which may be edited.

    Raises
    ------
    UsageError
        When one is missing or altered.
    """
    for entry in bundle.manifest["files"]:
        path = bundle.folder / entry["path"]
        if not path.is_file():
            raise UsageError(f"{path}: is missing; export again")
        if path.name != "RSCFG.V2" and _sha(path) != entry["sha256"]:
            raise UsageError(f"{path}: is not the file that was exported (its sha256 differs); export again")


def _profile(data: dict[str, Any]) -> Profile:
    def values(section: dict[str, Any]) -> dict[str, Any]:
        return {k: tuple(v) if isinstance(v, list) else v for k, v in section.items()}

    sections: dict[str, Any] = {f.name: data[f.name] for f in fields(Profile)}
    made = {k: kind(**values(sections[k])) for k, kind in _SECTIONS.items()}
    return Profile(name=data["name"], **made)


def _files(folder: Path) -> list[dict[str, Any]]:
    return [{"path": f.name, "bytes": f.stat().st_size, "sha256": _sha(f)} for f in sorted(folder.iterdir())]


def _sha(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _box(values: Any) -> list[float] | None:
    out: list[float] = [round(float(v), 4) for v in values]
    return out if all(abs(v) < 1e9 for v in out) else None
