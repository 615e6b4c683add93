"""Layers -> toolpaths: thinned, split at corners, ordered, with lead-ins and valve signals.

Based on: the slicing paper (deposit only at constant speed, unlinked fill lines, smooth angle, 0.2 mm between points,
two ice layers in a slice). Leads, delays and spacing come from the machine profile: nothing is published about them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .order import nearest_next, walls_next
from .paths import BOUNDARY, FILL, ICE, SCAFFOLD, Layer, Paths, Toolpath
from .profile import Profile
from .runs import Leads, Points, check_delays, leads_of, motions, overlap_of, pick, split, unit
from .thin import thin

_BATCH = 32  # slices that are thinned together


@dataclass(slots=True)
class Tally:
    """What was lost or bent on the way, over all toolpaths so far.

    Attributes
    ----------
    short : int
        Runs left out because the valve could not open and shut within them.
    short_mm : float
        Their length, mm.
    lost_loops : int
        Closed paths left out because they cannot hold three points.
    deviation : float
        Largest distance of a path's point from the thinned path, mm.
    coarse, thinned : int
        How many points lie farther than the chord tolerance, because the spacing forces it; of how many.
    coarse_layer : int
        The slice of the worst of them, -1 when there is none.
    through_walls : int
        Lead-ins of boundaries through fresh walls, because every start would.
    runs : int
    file_travel, travel : float
        Dry way between runs in the order in which the layers hold them, and in the order chosen, mm.
    """

    short: int = 0
    short_mm: float = 0.0
    lost_loops: int = 0
    deviation: float = 0.0
    coarse: int = 0
    thinned: int = 0
    coarse_layer: int = -1
    through_walls: int = 0
    runs: int = 0
    file_travel: float = 0.0
    travel: float = 0.0

    def bend(self, deviation: Points, layer: NDArray[np.int64], tolerance: float) -> None:
        """Count points that lie off the motions by some distances, mm, in some slices."""
        if len(deviation):
            k = int(deviation.argmax())
            if deviation[k] > max(self.deviation, tolerance):
                self.coarse_layer = int(layer[k])
            self.deviation = max(self.deviation, float(deviation[k]))
            self.coarse += int(np.count_nonzero(deviation > tolerance))


@dataclass(frozen=True, slots=True)
class Planner:
    """Makes toolpaths of layers.

    Attributes
    ----------
    profile : Profile
    thickness, slice_position, smooth_angle
        As in the parameter file: mm, share of the thickness, degrees.
    part_layers : int
        Ice layers in a slice.
    tally : Tally
        Counts what passes.
    """

    profile: Profile
    thickness: float
    slice_position: float = 0.5
    smooth_angle: float = 45.0
    part_layers: int = 2
    tally: Tally = field(default_factory=Tally)

    @property
    def heights(self) -> tuple[float, float]:
        """Of a layer of ice and of scaffold, mm."""
        return self.thickness / self.part_layers, self.thickness

    def toolpaths(self, layers: Iterable[Layer]) -> Iterator[Toolpath]:
        """Yield toolpaths in the order of laying: upwards, materials interleaved by height.

        Parameters
        ----------
        layers : iterable of Layer
            In print order.

        Raises
        ------
        UsageError
            When the delays of a nozzle do not fit its speed.
        """
        for name, nozzle in zip(("part", "scaffold"), self.profile.nozzles, strict=True):
            check_delays(name, nozzle, self.profile)
        at: Points = np.array(self.profile.motion.purge_at)
        tool = -1
        hold_every, seen = self.profile.path.hold_every, 0
        stream = iter(layers)
        while batch := list(itertools.islice(stream, _BATCH)):
            for layer, sets in zip(batch, _thinned(batch, self.profile, self.tally), strict=True):
                hold = hold_every > 0 and seen > 0 and seen % hold_every == 0
                for material, pass_, top in self._events(layer):
                    fill = layer.scaffold_fill if material == SCAFFOLD else layer.ice_fill(pass_)
                    if tool != material:
                        at = np.array(self.profile.motion.purge_at)
                    path, end = self._deposit(layer.index, pass_, material, top, hold, sets[material], fill, at)
                    if path is not None:
                        yield path
                        at, tool, hold = end, material, False
                seen += 1

    def _events(self, layer: Layer) -> list[tuple[int, int, float]]:
        """Return (material, layer of it, top) of a slice, upwards."""
        bottom = layer.z - self.slice_position * self.thickness
        events = [(ICE, i, bottom + (i + 1) * self.thickness / self.part_layers) for i in range(self.part_layers)]
        events.insert(self.part_layers - self.profile.path.scaffold_first, (SCAFFOLD, 0, bottom + self.thickness))
        return events

    def _deposit(
        self, index: int, pass_: int, material: int, top: float, hold: bool, boundary: Paths, fill: Paths, at: Points
    ) -> tuple[Toolpath | None, Points]:
        """Order the runs of one material in one layer and give them their leads."""
        p, nozzle = self.profile, self.profile.nozzles[material]
        leads = leads_of(nozzle, p)
        begin = at
        walls, at, places = self._boundary(boundary, leads, at)
        lines, at, more = self._fill(fill, leads, at)
        runs = [*walls, *lines]
        if not runs:
            return None, at
        offsets = np.concatenate([[0], np.cumsum([len(r) for r in runs])])
        points, ops, ends = motions(np.concatenate(runs), offsets, leads)
        t = self.tally
        t.runs += len(runs)
        t.travel += _between(points[ends[:-1]], points[ends[1:] - 1], begin)
        start, leave = np.concatenate([places, more]).transpose(1, 0, 2)
        t.file_travel += _between(start, leave, begin)
        kinds = np.repeat(np.array([BOUNDARY, FILL], np.uint8), [len(walls), len(lines)])
        speed = nozzle.speed
        return Toolpath(
            index, pass_, material, top, speed, leads.open_distance, leads.close_distance, hold,
            points, ops, ends.astype(np.uint32), kinds,
        ), at  # fmt: skip

    def _boundary(self, paths: Paths, leads: Leads, at: Points) -> tuple[list[Points], Points, Points]:
        """Return ordered wet runs, where the tip is then, and both dry ends of each in the order of the file."""
        smooth = math.radians(self.smooth_angle)
        loops, pieces, loop_owner, piece_owner = split(paths, smooth, self.profile.path.max_points)
        pieces, piece_owner = self._long_enough(pieces, piece_owner, leads)
        runs = [*loops, *pieces]
        if not runs:
            return [], at, np.empty((0, 2, 2))
        # Possible starts: every point of a loop, both ends of a piece.
        ahead = [np.roll(r, -1, axis=0) for r in loops]
        start = [*loops, *(r[[0, -1]] for r in pieces)]
        into = [*(unit(b - a) for a, b in zip(loops, ahead, strict=True)), *(_inward(r) for r in pieces)]
        count = [len(s) for s in start]
        owner = np.repeat(np.arange(len(runs)), count)
        s, d = np.concatenate(start), np.concatenate(into)
        other = [*(r + overlap_of(leads, self.profile) * u for r, u in zip(loops, into, strict=False)),
                 *(r[[-1, 0]] for r in pieces)]  # fmt: skip
        away = [*into[: len(loops)], *(-_inward(r)[::-1] for r in pieces)]
        entry, leave = s - leads.before * d, np.concatenate(other) + leads.after * np.concatenate(away)
        walls = [np.stack([r, b], axis=1) for r, b in zip(loops, ahead, strict=True)]
        walls += [np.stack([r[:-1], r[1:]], axis=1) for r in pieces]
        chosen, through, at = walls_next(entry, s, leave, owner, walls, at)
        self.tally.through_walls += through
        first = np.concatenate([[0], np.cumsum(count)])
        ordered = []
        for k in chosen:
            r, i = int(owner[k]), k - int(first[owner[k]])
            if r < len(loops):
                end = s[k] + overlap_of(leads, self.profile) * d[k]
                ordered.append(np.concatenate([np.roll(runs[r], -i, axis=0), [s[k], end]]))
            else:
                ordered.append(runs[r][::-1] if i else runs[r])
        by_file = np.argsort(np.concatenate([loop_owner, piece_owner]), kind="stable")
        return ordered, at, np.stack([entry[first[:-1]], leave[first[:-1]]], axis=1)[by_file]

    def _fill(self, paths: Paths, leads: Leads, at: Points) -> tuple[list[Points], Points, Points]:
        lines, _ = self._long_enough(paths, np.arange(len(paths)), leads)
        if not len(lines):
            return [], at, np.empty((0, 2, 2))
        ends = lines.points.reshape(-1, 2, 2)
        along = unit(ends[:, 1] - ends[:, 0])[:, None, :] * np.array([[[1.0], [-1.0]]])
        entry, leave = ends - leads.before * along, ends[:, ::-1] + leads.after * along
        order, backwards, at = nearest_next(entry, leave, at)
        turned = np.array(backwards)[:, None, None] == 1
        laid = ends[order]
        return list(np.where(turned, laid[:, ::-1], laid)), at, np.stack([entry[:, 0], leave[:, 0]], axis=1)

    def _long_enough(
        self, paths: Paths, owner: NDArray[np.int64], leads: Leads
    ) -> tuple[Paths, NDArray[np.int64]]:
        """Leave out runs within which the valve cannot open and shut, and count them."""
        length = paths.lengths()
        shortest = max(leads.spacing + leads.close_distance - leads.open_distance, leads.spacing / 2)
        keep = np.flatnonzero(length >= shortest * (1 - 1e-9))
        if len(keep) == len(length):
            return paths, owner
        self.tally.short += len(length) - len(keep)
        self.tally.short_mm += float(length.sum() - length[keep].sum())
        return pick(paths, keep), owner[keep]


def _thinned(layers: list[Layer], profile: Profile, tally: Tally) -> list[tuple[Paths, Paths]]:
    """Thin the boundaries of a batch; return those of part and scaffold of each layer."""
    sets = []
    for name, nozzle in zip(("part_boundary", "scaffold_boundary"), profile.nozzles, strict=True):
        paths: list[Paths] = [getattr(layer, name) for layer in layers]
        size = np.concatenate([[0], *(np.diff(p.offsets) for p in paths)]).cumsum().astype(np.uint32)
        packed = Paths(np.concatenate([p.points for p in paths]), size, True)
        index = np.repeat([layer.index for layer in layers], [len(p) for p in paths])
        tally.thinned += len(packed.points)
        packed, deviation, gone, lost = thin(packed, profile.spacing(nozzle.speed))
        tally.bend(deviation, index[gone], profile.path.chord_tolerance)
        tally.lost_loops += lost
        ends = np.cumsum([0] + [len(p) for p in paths])
        sets.append([pick(packed, np.arange(a, b)) for a, b in zip(ends[:-1], ends[1:], strict=True)])
    return list(zip(*sets, strict=True))


def _inward(run: Points) -> Points:
    """Return the direction into an open run at its first and its last point, (2, 2)."""
    return unit(np.array([run[1] - run[0], run[-2] - run[-1]]))


def _between(start: Points, leave: Points, at: Points) -> float:
    """Return the length of the ways between runs, mm."""
    gap = start - np.concatenate([[at], leave[:-1]])
    return float(np.hypot(gap[:, 0], gap[:, 1]).sum())
