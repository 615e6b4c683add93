"""The parameters of a run, whoever makes them: types, units, limits, and what is not built yet."""

from __future__ import annotations

import math
import numbers
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from .errors import UsageError

Triple = tuple[float, float, float]

_MIN_MM, _MAX_MM = 1e-3, 1e6  # finer or larger than any machine; keeps slice and pixel counts finite
_ANY = -1


class Spec(NamedTuple):
    """Limits of a number, or of each of `size` numbers (0: not a sequence)."""

    label: str
    unit: str
    low: float
    high: float
    size: int = 0
    whole: bool = False


SPECS = {
    "inexact": Spec("inexact", "", 0, 1, whole=True),
    "option": Spec("slicing option", "", 1, 3, whole=True),
    "scaffolding": Spec("scaffolding", "", 0, 1, whole=True),
    "tolerance": Spec("tolerance", "mm", 1e-12, _MAX_MM),
    "part_width": Spec("part path width", "mm", _MIN_MM, _MAX_MM),
    "support_width": Spec("support path width", "mm", _MIN_MM, _MAX_MM),
    "thickness": Spec("slice thickness", "mm", _MIN_MM, _MAX_MM),
    "smooth_angle": Spec("smooth angle", "degrees", 1e-12, 180),
    "scaling": Spec("scale factor", "", 1e-6, 1e6, 3),
    "rotation": Spec("rotation", "degrees", -360, 360, 3),
    "translation": Spec("translation", "mm", -_MAX_MM, _MAX_MM, 3),
    "part_fraction": Spec("part fraction", "", 0, 1, 2),
    "scaffold_subset": Spec("scaffolding subset", "", 0, 1, 2),
    "copies": Spec("number of copies", "", 1, 1000, 3, whole=True),
    "scaffold_buffer": Spec("scaffolding buffer", "mm", 0, _MAX_MM),
    "pitch": Spec("pitch", "mm", _MIN_MM, _MAX_MM),
    "slice_position": Spec("slice_position", "", 0, 1),
    "fill_angles": Spec("fill angle", "degrees", -360, 360, _ANY),
    "fill_inset": Spec("fill_inset", "mm", 0, _MAX_MM),
    "part_layers_per_slice": Spec("part_layers_per_slice", "", 1, 1000, whole=True),
    "min_point_spacing": Spec("min_point_spacing", "mm", _MIN_MM, _MAX_MM),
    "memory_mb": Spec("memory_mb", "MB", 1, 2**30, whole=True),
    "copy_gap": Spec("copy_gap", "mm", 0, _MAX_MM),
    "lenient": Spec("lenient", "", 0, 1, whole=True),
    "report": Spec("report", "", 0, 1, whole=True),
}
SWITCHED = ("scaling", "rotation", "translation")
_OPTIONAL = (*SWITCHED, "memory_mb", "copy_gap")  # may be None
#: mm in each unit that a parameter file may name.
UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
_CHOICES = {
    "units": tuple(UNITS), "winding": ("nonzero", "positive", "evenodd"), "scaffold_union": ("above", "own"),
}  # fmt: skip


class Invalid(UsageError):
    """A bad value, with the fields it came from, so that the reader can name the line."""

    def __init__(self, message: str, *names: str) -> None:
        super().__init__(message)
        self.names = names


@dataclass(frozen=True)
class Params:
    """What to make of which mesh: validated when built, by `read_params` or in Python.

    Lengths are mm and angles are degrees. ``dataclasses.replace`` gives a changed, validated copy.

    Attributes
    ----------
    files : tuple of Path
        Mesh files, which are moved, turned and sliced as one body.
    option : int
        1: boundary paths only; 2: boundary and fill paths; 3: those of the middle slice for all. See `fill`.
    inexact : bool
        Whether vertices within `tolerance` are made one after the transform.
    scaling, rotation : (float, float, float) or None
        Factors (> 0), and 1-2-3 Euler angles; None is off.
    translation : tuple of three float or str, or None
        Where the minimum goes on each axis, or ``"cent"``, or ``"orig"``; None is off.
    export : tuple of str
        Names of exports, checked by whoever makes them.
    memory_mb : int or None
        Memory budget; None is the default of the pipeline.
    copy_gap : float or None
        Clear distance between the copies with their scaffolds, mm; None is the wider of the path widths.
    units : str
        Of mesh files that do not name their own: mm, cm, m or inch.
    lenient : bool
        Whether a mesh file that is cut short is sliced as far as it goes.
    report : bool
        Whether the mesh is surveyed: closed or not, and every kind of damage, counted.
    machine : Path or None
        The machine profile, a TOML file, for the exports that need one; None is the Cobra 600's.
    source : Path or None
        The parameter file, where there is one; not compared.
    lines : dict of str to int
        The line of each field that the parameter file gives; not compared.

    The other fields are the numbers of the paper's Table 1 and of ``docs``: `part_fraction` and
    `scaffold_subset` are (min, max), `copies` is (p1, p2, p3).

    Raises
    ------
    UsageError
        When a value is out of its limits or asks for what is not built yet.
    """

    files: tuple[Path, ...]
    inexact: bool = False
    option: int = 2
    scaffolding: bool = True
    tolerance: float = 1e-4
    part_width: float = 1.5
    support_width: float = 1.5
    thickness: float = 0.4
    smooth_angle: float = 45.0
    scaling: Triple | None = None
    rotation: Triple | None = None
    translation: tuple[float | str, float | str, float | str] | None = None
    part_fraction: tuple[float, float] = (0.0, 1.0)
    scaffold_subset: tuple[float, float] = (0.0, 1.0)
    copies: tuple[int, int, int] = (1, 1, 1)
    scaffold_buffer: float = 5.0
    pitch: float = 0.2
    slice_position: float = 0.5
    fill_angles: tuple[float, ...] = (0.0, 90.0)
    fill_inset: float = 0.0
    winding: str = "nonzero"
    scaffold_union: str = "above"
    part_layers_per_slice: int = 2
    min_point_spacing: float = 0.2
    memory_mb: int | None = None
    copy_gap: float | None = None
    units: str = "mm"
    lenient: bool = False
    report: bool = False
    export: tuple[str, ...] = ()
    machine: Path | None = None
    source: Path | None = field(default=None, compare=False)
    lines: dict[str, int] = field(default_factory=dict, compare=False, repr=False)

    def __post_init__(self) -> None:
        """Bring every value to its type and check it."""
        files: Any = (self.files,) if isinstance(self.files, (str, Path)) else self.files
        files = tuple(files) if hasattr(files, "__iter__") else (files,)
        if not all(isinstance(f, (str, Path)) for f in files):
            raise Invalid(f"files must be paths of mesh files, got {shown(files)}", "files")
        object.__setattr__(self, "files", tuple(Path(f) for f in files))
        if self.machine is not None:
            if not isinstance(self.machine, (str, Path)):
                raise Invalid(f"machine must be the path of a TOML file, got {shown(self.machine)}", "machine")
            object.__setattr__(self, "machine", Path(self.machine))
        export = self.export.replace(",", " ").split() if isinstance(self.export, str) else self.export
        object.__setattr__(self, "export", tuple(str(e) for e in export))
        for name, spec in SPECS.items():
            value = getattr(self, name)
            if value is not None or name not in _OPTIONAL:
                object.__setattr__(self, name, _checked(name, value, spec))
        for name in ("inexact", "scaffolding", "lenient", "report"):
            object.__setattr__(self, name, bool(getattr(self, name)))
        _check_together(self)
        _refuse_later(self)

    @property
    def fill(self) -> bool:
        """Whether fill lines are asked for (slicing options 2 and 3)."""
        return self.option >= 2

    def at(self, *names: str) -> str:
        """Return what a message about fields begins with: the parameter file, and the line of the first it gives."""
        line = next((f":{self.lines[name]}" for name in names if name in self.lines), "")
        return f"{self.source}{line}: " if self.source is not None else ""


def _check_together(p: Params) -> None:
    """Check words, and what depends on several values."""
    for name, allowed in _CHOICES.items():
        if getattr(p, name) not in allowed:
            raise Invalid(f"{name} must be {' or '.join(allowed)}, got {shown(getattr(p, name))}", name)
    for name in ("part_width", "support_width")[: 1 + p.scaffolding]:
        width = getattr(p, name)
        if p.pitch > width / 2:
            raise Invalid(
                f"pitch {p.pitch:g} mm is too coarse for a {SPECS[name].label} of {width:g} mm; "
                f"use a pitch of {width / 2:g} mm or less", "pitch", name,
            )  # fmt: skip
    for name in ("part_fraction", "scaffold_subset"):
        low, high = getattr(p, name)
        if low >= high:
            raise Invalid(f"{SPECS[name].label} must be min < max, got {low:g} {high:g}", name)
    a, b, c = p.copies
    if c > a * b:
        raise Invalid(f"{c} copies do not fit in a grid of {a} x {b}; use at most {a * b}", "copies")


def _refuse_later(p: Params) -> None:
    """Refuse by name what is valid but not built yet: it must never be ignored."""
    if not p.files:
        raise Invalid("no mesh file is named; name one", "files")
    if p.part_layers_per_slice > 2 and len(p.fill_angles) > 2:
        raise Invalid(
            f"part_layers_per_slice = {p.part_layers_per_slice} with {len(p.fill_angles)} fill angles is not built "
            "yet, because a slice holds two sets of fill lines; use two fill angles, or two ice layers",
            "part_layers_per_slice", "fill_angles",
        )  # fmt: skip


def _checked(name: str, value: Any, spec: Spec) -> Any:
    """Return a field in its own type, or raise."""
    if not spec.size:
        return _number(name, value, spec)
    if isinstance(value, str) or not hasattr(value, "__iter__"):
        raise Invalid(f"{spec.label} must be a sequence, got {shown(value)}", name)
    values = tuple(value)
    if len(values) != spec.size and (spec.size != _ANY or not values):
        wanted = "at least 1" if spec.size == _ANY else spec.size
        raise Invalid(f"{spec.label} takes {wanted} values, got {len(values)}", name)
    return tuple(_number(name, v, spec) for v in values)


def _number(name: str, value: Any, spec: Spec) -> float | str:
    label, unit = spec.label, f" {spec.unit}" if spec.unit else ""
    if name == "translation" and isinstance(value, str):
        if value.lower() not in ("cent", "orig"):
            raise Invalid(f"{label} must be a number, cent or orig, got {shown(value)}", name)
        return value.lower()
    if not isinstance(value, numbers.Integral if spec.whole else numbers.Real):
        raise Invalid(f"{label} must be a {'whole ' * spec.whole}number, got {shown(value)}", name)
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if math.isnan(number):
        raise Invalid(f"{label} must be a number, got nan", name)
    if number <= 0 < spec.low and not spec.whole:
        raise Invalid(f"{label} must be > 0{unit}, got {shown(number)}", name)
    if not spec.low <= number <= spec.high:
        raise Invalid(f"{label} must be {spec.low:g} to {spec.high:g}{unit}, got {shown(number)}", name)
    return int(number) if spec.whole else number


def shown(value: Any) -> str:
    """Return a value as messages show it: short, on one line."""
    text = f"{value:g}" if isinstance(value, float) else repr(value)
    return text if len(text) <= 40 else text[:37] + "..."
