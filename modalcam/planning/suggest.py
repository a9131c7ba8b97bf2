"""Marker positions and frame rates that would make the planned intervals smaller."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modalcam.planning.predict import motions, predict
from modalcam.planning.request import PlanRequest, decay_length_s
from tracker.arrays import FloatArray

_GRID = 101
# Information of the worst mode by which new places must be better: a tenth off its standard deviation.
_WORTH_MOVING = 1.25
# Rates that high-speed cameras offer.
_RATES = (
    60,
    120,
    240,
    250,
    400,
    500,
    600,
    800,
    1000,
    1200,
    1500,
    2000,
    2500,
    3000,
    4000,
    5000,
    7500,
    10_000,
    20_000,
)
# A mode below this share of the rate is sampled well: the exposure does not eat it and its harmonics stay apart.
_COMFORTABLE = 0.4
# Cycles of the record that must lie between a mode as it is seen and 0, half the rate, or another mode.
_CYCLES_APART = 20.0


@dataclass(frozen=True)
class Places:
    """Positions along the beam, and what each mode's standard deviation would be multiplied by."""

    positions_mm: tuple[float, ...]
    factors: tuple[float, ...]


@dataclass(frozen=True)
class Rate:
    """A frame rate, and where each planned mode appears at it.

    Attributes
    ----------
    aliased : bool
        Whether a mode lies above half the rate.
    """

    fps: float
    seen_hz: tuple[float, ...]
    aliased: bool


def better_places(request: PlanRequest) -> Places | None:
    """As many positions as there are markers that make the worst mode as good as can be; None when no better ones.

    Information on a mode grows with the sum of its squared shape over the markers. Positions are chosen one by one
    and then exchanged until the mode that fares worst, relative to its motion at the tip, fares best; prints do not
    touch, stay on the beam, and stand apart so that they show the shape too: by half of what even spacing would give.
    """
    length_mm = 1e3 * request.beam.length_m
    reach = max(p.half_extent_mm for p in request.prints)
    inset = min(reach, 0.5 * length_mm)
    grid = np.linspace(inset, length_mm - inset, _GRID)
    power = _power(request, grid)
    count = len(request.positions_mm)
    chosen = _exchange(power, grid, count, max(2.0 * reach, 0.5 * length_mm / count))
    if chosen is None:
        return None
    now = _power(request, np.array(request.positions_mm)).sum(axis=0)
    then = power[chosen].sum(axis=0)
    if then.min() <= _WORTH_MOVING * now.min():
        return None
    places = tuple(round(float(p), 1) for p in np.sort(grid[chosen]))
    before, after = predict(request), predict(replace(request, positions_mm=places))
    return Places(places, tuple(b.damping_sd / a.damping_sd for a, b in zip(before, after, strict=True)))


def _power(request: PlanRequest, places_mm: FloatArray) -> FloatArray:
    """Squared shapes relative to the tip, shape (k, planned modes)."""
    return np.column_stack([way.shape**2 for way in motions(request, places_mm)])


def _exchange(power: FloatArray, grid_mm: FloatArray, count: int, apart_mm: float) -> list[int] | None:
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
            return chosen
    return chosen


def _best_addition(power: FloatArray, grid_mm: FloatArray, chosen: list[int], apart_mm: float) -> int | None:
    free = np.ones(grid_mm.size, dtype=bool)
    for k in chosen:
        free &= np.abs(grid_mm - grid_mm[k]) >= apart_mm
    if not free.any():
        return None
    total = power[chosen].sum(axis=0) if chosen else np.zeros(power.shape[1])
    # The worst mode decides; the sum tells equals apart.
    worth = (total + power).min(axis=1) + 1e-6 * power.sum(axis=1)
    return int(np.argmax(np.where(free, worth, -1.0)))


def rates(request: PlanRequest, frequency_hz: tuple[float, ...]) -> tuple[Rate, ...]:
    """The lowest usual rate at which no mode is aliased, and the highest below it at which aliases stay apart."""
    spans = [decay_length_s(m, f) for m, f in zip(request.modes, frequency_hz, strict=True)]
    full = next((r for r in _RATES if max(frequency_hz) < _COMFORTABLE * r), None)
    out = []
    slow = [r for r in _RATES if r < 2.0 * max(frequency_hz) and _all_apart(float(r), frequency_hz, spans)]
    if slow:
        out.append(_rate(float(slow[-1]), frequency_hz))
    if full is not None:
        out.append(_rate(float(full), frequency_hz))
    return tuple(out)


def _rate(fps: float, frequency_hz: tuple[float, ...]) -> Rate:
    seen = tuple(abs(f - fps * round(f / fps)) for f in frequency_hz)
    return Rate(fps, seen, max(frequency_hz) > 0.5 * fps)


def _all_apart(fps: float, frequency_hz: tuple[float, ...], spans_s: list[float]) -> bool:
    seen = _rate(fps, frequency_hz).seen_hz
    for k, (here, span) in enumerate(zip(seen, spans_s, strict=True)):
        others = [0.0, 0.5 * fps, *seen[:k], *seen[k + 1 :]]
        if min(abs(here - o) for o in others) * span < _CYCLES_APART:
            return False
    return True
