"""What the pictures share: colours, and text."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..paths import Stat

PAGE, CARD, RULE = "#eef1f4", "#ffffff", "#d9dfe5"
DARK, GREY, RED = "#1f2a33", "#6b7782", "#b3261e"
TINT = {"part": "#cfe8f5", "scaffold": "#efeae2"}
BEAD = {"part": "#7fbcdc", "scaffold": "#d2c3ad"}
LINE = {"part": "#0b5f92", "scaffold": "#94795a"}

Image = NDArray[np.uint8]


def area(stats: dict[str, Stat], name: str) -> str:
    """Return an area as the pictures show it."""
    value = stats.get(name)
    return "-" if value is None else f"{value:.1f} mm\N{SUPERSCRIPT TWO}"


def text(image: Image, text: str, at: tuple[int, int], size: int, colour: str, weight: int = 400) -> int:
    """Draw text with its base line at a point; return where it ends."""
    import cv2

    if hasattr(cv2, "FontFace"):  # OpenCV 5 has a real font
        end, _ = cv2.putText(image, text, at, bgr(colour), cv2.FontFace("sans"), size, weight)
        return int(end[0])
    text = text.replace("\N{SUPERSCRIPT TWO}", "2").replace("\N{MIDDLE DOT}", "-")
    scale, thick = size / 32, 2 if weight > 500 else 1
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, bgr(colour), thick, cv2.LINE_AA)
    return at[0] + int(cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, thick)[0][0])


def bgr(colour: str) -> Any:
    """Return ``#rrggbb`` in OpenCV's order."""
    return tuple(bytes.fromhex(colour[1:])[::-1])
