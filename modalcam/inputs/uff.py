"""Read the time responses (dataset 58) of a universal file (UFF), ASCII or binary."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from modalcam.common import InputError, readable_bytes, shown
from modalcam.inputs.series import TUNING, channel_positions, check_size, check_time
from modalcam.inputs.table import MAX_BYTES
from tracker import DisplacementSeries, FloatArray

_TIME_RESPONSE, _UNKNOWN_FUNCTION = 1, 0
_TIME_AXIS = 17
_KINDS = {8: "displacement", 11: "velocity", 12: "acceleration"}


def read_uff(
    path: Path, *, name: str, unit: str, positions_mm: tuple[float, ...] | None = None
) -> DisplacementSeries:
    """Time responses (dataset 58) of a universal file as one series, in `unit` if the file names none.

    A channel is named after its entity or node; it is NaN at times at which it has no sample. InputError if the file
    cannot be read, holds no time response, or its responses differ in unit or kind.
    """
    where = shown(str(path))
    responses = [one for one in _datasets(path) if _is_time_response(one)]
    if not responses:
        msg = f"{where}: expected a time response (dataset 58, function type 1), found none"
        raise InputError(msg)
    units = {_unit(one, unit) for one in responses}
    kinds = {int(one.get("ordinate_spec_data_type", 0)) for one in responses}
    if len(units) > 1 or len(kinds) > 1:
        found = ", ".join(sorted(units)) + "; " + ", ".join(sorted(_KINDS.get(k, f"type {k}") for k in kinds))
        msg = f"{where}: expected time responses of one unit and kind, found {found}; split the file"
        raise InputError(msg)
    positions = channel_positions(positions_mm, len(responses), f"{where}: {len(responses)} time responses")
    time_s, values = _joined([_samples(one, where) for one in responses], where)
    check_time(time_s, where)
    check_size(values, where)
    kind = _KINDS.get(kinds.pop(), "an unknown quantity")
    return DisplacementSeries(
        name=name,
        time_s=time_s,
        channels=_names(responses),
        values=values,
        sd=np.full(values.shape, np.nan),
        unit=units.pop(),
        positions_mm=positions,
        notes=(f"{len(responses)} time responses of {kind} were read from a universal file.",),
    )


def _datasets(path: Path) -> list[dict[str, Any]]:
    where = shown(str(path))
    try:
        import pyuff  # noqa: PLC0415 - optional
    except ImportError:
        msg = f"{where}: reading a universal file needs pyuff; install it with pip install pyuff"
        raise InputError(msg) from None
    readable_bytes(path, MAX_BYTES)
    try:
        file = pyuff.UFF(str(path))
        kinds = [int(kind) for kind in file.get_set_types()]
        return [dict(file.read_sets(index)) for index, kind in enumerate(kinds) if kind == 58]
    except Exception as error:
        msg = f"{where}: expected a universal file (UFF), found: {error}"
        raise InputError(msg) from error


def _is_time_response(dataset: dict[str, Any]) -> bool:
    kind = int(dataset.get("func_type", -1))
    on_time = int(dataset.get("abscissa_spec_data_type", 0)) == _TIME_AXIS
    return (kind == _TIME_RESPONSE or (kind == _UNKNOWN_FUNCTION and on_time)) and not np.iscomplexobj(
        dataset["data"]
    )


def _unit(dataset: dict[str, Any], otherwise: str) -> str:
    label = str(dataset.get("ordinate_axis_units_lab", "")).strip()
    return otherwise if label in ("", "NONE", "none") else label


def _names(responses: list[dict[str, Any]]) -> tuple[str, ...]:
    names: list[str] = []
    for one in responses:
        entity = str(one.get("rsp_ent_name", "")).strip()
        node, direction = int(one.get("rsp_node", 0)), int(one.get("rsp_dir", 0))
        name = entity if entity not in ("", "NONE") else f"node{node}"
        if name in names:
            name = f"{name}_{node}_{direction}"
        names.append(name if name not in names else f"{name}_{len(names) + 1}")
    return tuple(names)


def _samples(dataset: dict[str, Any], where: str) -> tuple[FloatArray, FloatArray]:
    time_s, values = np.asarray(dataset["x"], dtype=float), np.asarray(dataset["data"], dtype=float)
    if time_s.shape != values.shape or time_s.size < TUNING.least_samples:
        msg = f"{where}: expected at least {TUNING.least_samples} samples a channel, found {values.size}"
        raise InputError(msg)
    if not np.all(np.isfinite(time_s)) or np.any(np.diff(time_s) <= 0.0):
        msg = f"{where}: expected times that increase, found a time response whose times do not"
        raise InputError(msg)
    return time_s, values


def _joined(samples: list[tuple[FloatArray, FloatArray]], where: str) -> tuple[FloatArray, FloatArray]:
    """All channels on the union of their times; times closer than a thousandth of a step are merged."""
    step = min(float(np.min(np.diff(time_s))) for time_s, _ in samples)
    every = np.sort(np.concatenate([time_s for time_s, _ in samples]))
    first = np.concatenate([[True], np.diff(every) > 1e-3 * step])
    time_s = every[first]
    values = np.full((time_s.size, len(samples)), np.nan)
    for k, (own, y) in enumerate(samples):
        rows = np.searchsorted(time_s, own + 5e-4 * step, side="right") - 1
        if np.unique(rows).size != own.size:
            msg = f"{where}: the channels' times interleave more finely than a thousandth of their step"
            raise InputError(msg)
        values[rows, k] = y
    return time_s, values
