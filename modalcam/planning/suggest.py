"""Marker positions and frame rates that would narrow the planned intervals."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace

import numpy as np

from modalcam.planning.predict import motions, predict
from modalcam.planning.request import PlannedMode, PlanRequest
from modalcam.planning.results import BetterPositions, FrameRate, ModePlan
from tracker import FloatArray

_GRID = 101
# Information on the worst mode that new positions must gain: a tenth less standard deviation.
_WORTH_MOVING = 1.25
# Rates that high-speed cameras offer.
_RATES = np.array(
    [60, 120, 240, 250, 400, 500, 600, 800, 1000, 1200, 1500, 2000, 2500, 3000, 4000, 5000, 7500, 1e4, 2e4]
)
# A mode below this share of the rate is sampled well: the exposure attenuates it little, harmonics stay separated.
_COMFORTABLE = 0.4
# Cycles of the record between the apparent frequency of a mode and 0, half the rate, or another mode.
_CYCLES_APART = 20.0


def better_positions(request: PlanRequest) -> tuple[BetterPositions, ...]:
    """Better positions for each group of modes that is filmed with the same markers; none where there are no better.

    Information on a mode grows with the sum of its squared shape over the markers. Positions are chosen one by one
    and then exchanged to maximise the information on the worst mode, relative to its motion at the tip. Prints do not
    touch, stay on the beam, and keep half the distance of even spacing, so that they resolve the mode shape too.
    """
    groups: dict[Hashable, list[PlannedMode]] = {}
    for mode in request.modes:
        groups.setdefault((mode.positions_mm, mode.markers), []).append(mode)
    found = (_better(replace(request, modes=tuple(modes))) for modes in groups.values())
    return tuple(positions for positions in found if positions is not None)


def _better(request: PlanRequest) -> BetterPositions | None:
    first, length_mm = request.modes[0], 1e3 * request.beam.length_m
    reach = max(p.half_extent_mm for p in first.markers)
    inset = min(reach, 0.5 * length_mm)
    grid = np.linspace(inset, length_mm - inset, _GRID)
    power = _power(request, grid)
    count = len(first.positions_mm)
    chosen = _exchange(power, grid, count, max(2.0 * reach, 0.5 * length_mm / count))
    if chosen is None:
        return None
    now = _power(request, np.array(first.positions_mm)).sum(axis=0)
    if power[chosen].sum(axis=0).min() <= _WORTH_MOVING * now.min():
        return None
    positions = tuple(round(float(p), 1) for p in np.sort(grid[chosen]))
    moved = replace(request, modes=tuple(replace(m, positions_mm=positions) for m in request.modes))
    before, after = predict(request), predict(moved)
    factors = tuple(b.damping_sd / a.damping_sd for a, b in zip(before, after, strict=True))
    return BetterPositions(tuple(m.number for m in request.modes), positions, factors)


def _power(request: PlanRequest, positions_mm: FloatArray) -> FloatArray:
    """Squared shapes relative to the tip, shape (k, planned modes)."""
    return np.column_stack([way.shape**2 for way in motions(request, positions_mm)])


def _exchange(power: FloatArray, grid_mm: FloatArray, count: int, apart_mm: float) -> list[int] | None:
    """Grid points chosen one by one, then exchanged while that helps the worst mode; None where they do not fit."""
    chosen: list[int] = []
    for _ in range(count):
        best = _best_addition(power, grid_mm, chosen, apart_mm)
        if best is None:
            return None
        chosen.append(best)
    for _ in range(10 * count):
        worth = power[chosen].sum(axis=0).min()
        for k in range(count):
            others = chosen[:k] + chosen[k + 1 :]
            best = _best_addition(power, grid_mm, others, apart_mm)
            if best is not None and power[[*others, best]].sum(axis=0).min() > worth * (1.0 + 1e-9):
                chosen = [*others, best]
                break
        else:
            break
    return chosen


def _best_addition(power: FloatArray, grid_mm: FloatArray, chosen: list[int], apart_mm: float) -> int | None:
    free = np.ones(grid_mm.size, dtype=bool)
    for k in chosen:
        free &= np.abs(grid_mm - grid_mm[k]) >= apart_mm
    if not free.any():
        return None
    total = power[chosen].sum(axis=0) if chosen else np.zeros(power.shape[1])
    # The worst mode decides; the sum breaks ties.
    worth = (total + power).min(axis=1) + 1e-6 * power.sum(axis=1)
    return int(np.argmax(np.where(free, worth, -1.0)))


def frame_rates(modes: tuple[ModePlan, ...]) -> tuple[FrameRate, ...]:
    """Sufficient frame rate of each group of modes filmed at one rate, and a lower one at which aliases stay apart."""
    out = []
    for fps in dict.fromkeys(m.planned.fps for m in modes):
        group = tuple(m for m in modes if m.planned.fps == fps)
        highest = max(m.frequency_hz for m in group)
        slow = [r for r in _RATES.tolist() if r < 2.0 * highest and _all_apart(r, group)]
        full = next((r for r in _RATES.tolist() if highest < _COMFORTABLE * r), None)
        out += [_rate(r, group) for r in (*slow[-1:], full) if r is not None]
    return tuple(out)


def _rate(fps: float, modes: tuple[ModePlan, ...]) -> FrameRate:
    frequency = [m.frequency_hz for m in modes]
    seen = tuple(abs(f - fps * round(f / fps)) for f in frequency)
    return FrameRate(tuple(m.number for m in modes), fps, seen, max(frequency) > 0.5 * fps)


def _all_apart(fps: float, modes: tuple[ModePlan, ...]) -> bool:
    seen = _rate(fps, modes).seen_hz
    for k, (own, mode) in enumerate(zip(seen, modes, strict=True)):
        others = [0.0, 0.5 * fps, *seen[:k], *seen[k + 1 :]]
        if min(abs(own - o) for o in others) * mode.decay_s < _CYCLES_APART:
            return False
    return True
