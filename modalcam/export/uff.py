"""Universal files (UFF): time series as dataset 58 and mode shapes as dataset 55, in ASCII.

Missing samples have no place in a universal file: a channel with gaps is written with uneven abscissa and without them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyuff

from modal_id.fit.decay import pole
from modal_id.results import Identification, IdentifiedMode
from modalcam.errors import InputError
from modalcam.inputs.series import MAX_BYTES, MIN_SAMPLES
from modalcam.names import shown
from modalcam.storage.atomic import replacing
from tracker.arrays import FloatArray
from tracker.results import DisplacementSeries

ENDINGS = (".uff", ".unv", ".u58", ".uf")
_TIME_RESPONSE, _UNKNOWN_FUNCTION = 1, 0
_TIME_AXIS = 17
_KINDS = {8: "displacement", 11: "velocity", 12: "acceleration"}
# Dimension of the ordinate in powers of length; time is always in seconds.
_LENGTH_EXPONENT = 1
_COMPLEX_MODE, _TRANSLATIONS, _STRUCTURAL = 3, 2, 1
_DISPLACEMENT = 8
# Times that an even abscissa's start and increment, as written, do not give within this share of a step are written
# one by one.
_EVEN = 1e-4


def write_uff(path: Path, found: Identification) -> None:
    """Write the channels of a series (dataset 58) and its modes' shapes (dataset 55).

    Nodes count the channels from 1; the direction of response is that of the picture's axis along which the markers
    move (1: x, 2: y), 0 (scalar) where it is neither. Shapes are complex eigenvectors of first order, translations
    in x, y, z at `Onset.fit_from_s`, with the eigenvalue ``lambda``; channels that were never seen are left out.
    """
    functions = "".join(_function(found.series, k) for k in range(len(found.series.channels)))
    shapes = [_shape(found, mode, index) for index, mode in enumerate(found.modes)]
    with replacing(path) as beside:
        # Written here: pyuff gives abscissae six digits, which is too coarse for frequencies.
        beside.write_text(functions, encoding="ascii", newline="\n")
        if shapes:
            pyuff.UFF(str(beside)).write_sets(shapes, "add")


def read_uff(
    path: Path, *, name: str, unit: str, positions_mm: tuple[float, ...] | None = None
) -> DisplacementSeries:
    """Time responses (dataset 58) of a universal file as one series.

    Parameters
    ----------
    path : Path
    name : str
    unit : str
        Taken where the file names none.
    positions_mm : tuple of float or None
        Of the channels along the beam.

    Returns
    -------
    DisplacementSeries
        A channel a time response, by its entity and node; samples at times that a channel does not have are NaN.

    Raises
    ------
    InputError
        If the file cannot be read, holds no time response, or its responses differ in unit or kind.
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
    if positions_mm is not None and len(positions_mm) != len(responses):
        msg = f"{where}: {len(responses)} time responses but {len(positions_mm)} markers.positions_mm"
        raise InputError(msg)
    time_s, values = _joined([_samples(one, where) for one in responses], where)
    kind = _KINDS.get(kinds.pop(), "a quantity without a name")
    return DisplacementSeries(
        name=name,
        time_s=time_s,
        channels=_names(responses),
        values=values,
        sd=np.full(values.shape, np.nan),
        unit=units.pop(),
        positions_mm=np.full(len(responses), np.nan) if positions_mm is None else np.array(positions_mm),
        notes=(f"{len(responses)} time responses of {kind} were read from a universal file.",),
    )


def _function(series: DisplacementSeries, k: int) -> str:
    """Dataset 58 of a channel; empty where it has fewer than two samples."""
    seen = np.isfinite(series.values[:, k])
    time_s, values = series.time_s[seen], series.values[seen, k]
    if time_s.size < 2:
        return ""
    even, position = _is_even(time_s), series.positions_mm[k]
    step = time_s[1] - time_s[0]
    entity = _text(series.channels[k], 10)
    axis = (_real13(time_s[0]), _real13(step)) if even else (_real13(0.0), _real13(0.0))
    lines = [
        f"{-1:6d}",
        f"{58:6d}",
        _text(f"{series.channels[k]} of {series.name}", 80),
        _text(f"displacement in {series.unit} along the direction of motion", 80),
        "NONE",
        f"{position:g} mm from the clamp" if np.isfinite(position) else "NONE",
        "NONE",
        f"{1:5d}{k + 1:10d}{0:5d}{0:10d} {entity:<10s}{k + 1:10d}{_direction(series):4d} {'NONE':<10s}{0:10d}{0:4d}",
        f"{4:10d}{values.size:10d}{int(even):10d}{axis[0]}{axis[1]}{_real13(0.0)}",
        _axis(_TIME_AXIS, 0, "Time", "s"),
        _axis(_DISPLACEMENT, _LENGTH_EXPONENT, "Displacement", _text(series.unit, 20)),
        _axis(0, 0, "NONE", "NONE"),
        _axis(0, 0, "NONE", "NONE"),
    ]
    if even:
        lines += ["".join(f"{v:20.12E}" for v in values[row : row + 4]) for row in range(0, values.size, 4)]
    else:
        pairs = [f"{_real13(t)}{v:20.12E}" for t, v in zip(time_s, values, strict=True)]
        lines += ["".join(pairs[row : row + 2]) for row in range(0, len(pairs), 2)]
    return "\n".join([*lines, f"{-1:6d}", ""])


def _axis(kind: int, length_exponent: int, label: str, unit: str) -> str:
    return f"{kind:10d}{length_exponent:5d}{0:5d}{0:5d} {label:<20s} {unit:<20s}"


def _real13(value: float) -> str:
    """A real in the 13 columns of format E13.5 with all the digits they can hold: a decimal point given wins."""
    texts = [f"{value:.{d}f}" for d in range(10, 0, -1)] + [f"{value:.{d}E}" for d in range(6, 0, -1)]
    fitting = [text for text in texts if len(text) <= 12]
    return f"{min(fitting, key=lambda text: abs(float(text) - value)):>13s}"


def _text(text: str, longest: int) -> str:
    """ASCII of one line, no longer than its field."""
    plain = text.encode("ascii", "replace").decode("ascii")
    return "".join(c if c.isprintable() else "?" for c in plain)[:longest] or "NONE"


def _direction(series: DisplacementSeries) -> int:
    x, y = series.direction
    if abs(y) < 1e-2 and abs(x) > 0.5:
        return 1 if x > 0.0 else -1
    if abs(x) < 1e-2 and abs(y) > 0.5:
        return 2 if y > 0.0 else -2
    return 0


def _is_even(time_s: FloatArray) -> bool:
    step = time_s[1] - time_s[0]
    again = float(_real13(time_s[0])) + float(_real13(step)) * np.arange(time_s.size)
    return bool(np.all(np.abs(again - time_s) <= _EVEN * step))


def _shape(found: Identification, mode: IdentifiedMode, index: int) -> dict[str, Any]:
    seen = np.flatnonzero(np.isfinite(mode.shape))
    x, y = found.series.direction
    if not (np.isfinite(x) and np.isfinite(y)):
        x, y = 1.0, 0.0
    shape = mode.shape[seen]
    eigenvalue = complex(pole(mode.omega_n_rad_s, mode.damping_ratio))
    return dict(
        pyuff.prepare_55(
            id1=_text(found.series.name, 80),
            id2=f"{mode.frequency_hz:.9g} Hz, sd {mode.frequency_sd_hz:.3g} Hz"[:80],
            id3=f"damping ratio {mode.damping_ratio:.9g}, sd {mode.damping_ratio_sd:.3g}"[:80],
            id4=f"amplitudes in {_text(mode.amplitude_unit, 20)} at {found.onset.fit_from_s:.6f} s",
            model_type=_STRUCTURAL,
            analysis_type=_COMPLEX_MODE,
            data_ch=_TRANSLATIONS,
            spec_data_type=_DISPLACEMENT,
            data_type=5,
            n_data_per_node=3,
            r1=x * shape,
            r2=y * shape,
            r3=np.zeros(shape.size, dtype=complex),
            load_case=0,
            mode_n=mode.number or index + 1,
            eig=eigenvalue,
            modal_a=0.0 + 0.0j,
            modal_b=0.0 + 0.0j,
            node_nums=[int(k) + 1 for k in seen],
        )
    )


def _datasets(path: Path) -> list[dict[str, Any]]:
    where = shown(str(path))
    try:
        size = path.stat().st_size
    except OSError as error:
        msg = f"{where}: cannot be read ({error.strerror})"
        raise InputError(msg) from error
    if size > MAX_BYTES:
        msg = f"{where}: expected at most {MAX_BYTES} bytes, found {size}"
        raise InputError(msg)
    try:
        file = pyuff.UFF(str(path))
        kinds = [int(kind) for kind in file.get_set_types()]
        return [dict(file.read_sets(index)) for index, kind in enumerate(kinds) if kind == 58]
    except Exception as error:
        msg = f"{where}: expected a universal file (UFF); pyuff says: {error}"
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
    if time_s.shape != values.shape or time_s.size < MIN_SAMPLES:
        msg = f"{where}: expected at least {MIN_SAMPLES} samples a channel, found {values.size}"
        raise InputError(msg)
    if not np.all(np.isfinite(time_s)) or np.any(np.diff(time_s) <= 0.0):
        msg = f"{where}: expected times that increase, found a time response whose times do not"
        raise InputError(msg)
    return time_s, values


def _joined(samples: list[tuple[FloatArray, FloatArray]], where: str) -> tuple[FloatArray, FloatArray]:
    """All channels on the union of their times; times nearer than a thousandth of a step are one."""
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
