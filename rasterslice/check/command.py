"""The arguments of ``rasterslice check``."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from .support import Holding
from .verdict import FAIL, UNKNOWN

DISAGREE, UNTOLD = 6, 7  # exit codes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command to a parser."""
    parser.add_argument("what", metavar="PARAMS.txt", type=Path, help="parameter file, or the folder of a run")
    parser.add_argument("--against", metavar="FILE", type=Path, required=True, help="what another program wrote")
    parser.add_argument("--align", metavar="auto|none|dx,dy", type=_shift, default="auto", help="shift in x and y, mm")
    parser.add_argument("--tolerance", metavar="MM", type=_length, help="deviation that is forgiven; default pitch / 4")
    parser.add_argument("--width", metavar="MM", type=_length, help="width of outer beads, when the file does not say")
    parser.add_argument(
        "--support", metavar="LAYERS,MM,DEGREES", type=_support,
        help="check overhangs, by gap below it, reach seen from above, angle; default 2, three widths, 40",
    )  # fmt: skip
    parser.add_argument("--device", metavar="S", help="part of the name of an OpenCL device")
    parser.add_argument("-o", "--out", metavar="DIR", type=Path, help="write check.csv, check.json, check.html there")


def run(args: argparse.Namespace) -> tuple[dict[str, Any], int]:
    """Do what the arguments say; return the report and the exit code."""
    from .run import check

    result = check(
        args.what, args.against, shift=args.align, tolerance=args.tolerance, width=args.width, holding=args.support,
        device=args.device, out=args.out,
    )  # fmt: skip
    return result, {FAIL: DISAGREE, UNKNOWN: UNTOLD}.get(result["verdict"], 0)


def _length(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (value > 0 and math.isfinite(value)):
        raise argparse.ArgumentTypeError(f"must be > 0 mm, got {text}")
    return value


def _shift(text: str) -> tuple[float, float] | str:
    if text in ("auto", "none"):
        return text
    try:
        dx, dy = (float(word) for word in text.split(","))
    except ValueError:
        dx = dy = math.nan
    if not (math.isfinite(dx) and math.isfinite(dy)):
        raise argparse.ArgumentTypeError(f"must be auto, none or dx,dy in mm, got {text}")
    return dx, dy


def _support(text: str) -> Holding:
    try:
        gap, reach, angle = (float(word) for word in text.split(","))
    except ValueError:
        gap = reach = angle = math.nan
    if not (0 <= gap <= 100 and 0 <= reach <= 1000 and 0 < angle < 90):
        raise argparse.ArgumentTypeError(f"must be layers (0 to 100), mm (0 to 1000), degrees (0 to 90), got {text}")
    return Holding(gap, reach, angle)
