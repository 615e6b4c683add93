"""Black and white pictures are held against the part at the middles of their pixels, where they say what they mean.

The contour of such a picture runs half-way between a white middle and a black one, up to 0.71 pixels beside a true
boundary. So it raises a doubt only where a middle is white and farther outside the part than the tolerance, or black
and deeper inside. Who is accused is decided by the contour, and what its writer may have rounded.
"""

from __future__ import annotations

import numpy as np

from .findings import Limits
from .form import Floats, TheirLayer
from .loops import Ints
from .ours import Samples, Slices

ROUNDED = 0.71  # pixels between a true boundary and the contour


def at_middles(
    ours: Slices, other: Slices, layers: list[TheirLayer], segments: Floats, layer: Ints, limits: Limits
) -> tuple[Samples, Floats]:
    """Return a sample for each place where a contour passes between two pixels, and by how much it is off, mm.

    Parameters
    ----------
    ours, other : Boundary
        The part, and the contours of the pictures.
    layers : list of TheirLayer
    segments, layer : (N, 4) float64, (N,) int64
        Of the contours.
    limits : Limits
    """
    points, vector = segments[:, :2], segments[:, 2:] - segments[:, :2]
    length = np.hypot(vector[:, 0], vector[:, 1])
    normal = np.stack([vector[:, 1], -vector[:, 0]], axis=1) / np.maximum(length, 1e-12)[:, None]
    frame = np.array([np.zeros((3, 2)) if k.middle is None else k.middle for k in layers])[layer]
    right, up = frame[:, 1] - frame[:, 0], frame[:, 2] - frame[:, 0]
    column = np.einsum("nd,nd->n", points - frame[:, 0], right) / np.einsum("nd,nd->n", right, right)
    above = np.abs(column - np.round(column)) < 0.25  # the two pixels lie in one column
    half = np.where(above[:, None], up, right) / 2
    one, two = (ours.distance(points + s, layer) for s in (half, -half))
    white = other.distance(points + half, layer) < 0
    beyond = np.where(white, one, two).clip(min=0.0)  # of the white one, outside
    lacking = -np.where(white, two, one).clip(max=0.0)  # of the black one, inside
    told = np.where(beyond >= lacking, beyond, -lacking)
    contour = ours.distance(points, layer)
    more = np.sign(contour) * np.maximum(np.abs(contour), np.abs(told))
    off = np.where(np.abs(told) <= limits.tolerance, told, more)
    return Samples(points, layer, length, normal), off


def rounded_off(inward: Floats, limits: Limits) -> Floats:
    """Return by how much our boundary is farther from the contour of pictures than their pixels round, mm."""
    beyond = (np.abs(inward) - ROUNDED * limits.pixel).clip(min=0.0)
    return np.where(beyond <= limits.tolerance, np.sign(inward) * beyond, inward)
