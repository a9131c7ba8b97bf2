"""Channels in files of arrays: NumPy, MATLAB, HDF5 with NetCDF; which axis of an array without names is time."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modalcam.common import ARRAY_DAMAGE
from modalcam.inputs.stated import MOST_VALUES, RATE_NAMES, REAL_KINDS, TIME_NAMES, insert_times, note_unit


@dataclass(frozen=True)
class Tuning:
    """Axes of an array."""

    #: [channels] number below which the shorter axis is that of the channels
    #: convention: Records with fewer samples than this hold few cycles.
    few: int = 64
    #: [lines] lines along an axis that are examined
    lines: int = 64
    #: [cycles] fewest in a line of samples that oscillates
    #: physics: A mode shape has at most half as many as its number.
    cycles: int = 5
    #: [1] least share of the power of such a line within two bins of its maximum
    #: statistics: Channels in any order, as noise, have 5 bins of at least 32.
    share: float = 0.3
    #: [samples] of a column without the name of a time, from which on it is time where it always increases
    #: physics: No vibration increases with every one of so many.
    least_times: int = 16


TUNING = Tuning()


def samples_by_channels(array: NDArray[np.float64]) -> tuple[NDArray[np.float64], str]:
    """An array of two axes with time along the first, and a sentence on what was taken for time.

    The longer axis is time where the shorter one has few lines. Otherwise it is the axis whose first line increases in
    even steps; or the one along which the values oscillate. ValueError where that is neither or both.
    """
    rows, columns = array.shape
    if min(rows, columns) < TUNING.few:
        return (array if rows >= columns else array.T), "the longer axis is time."
    down, across = _is_even(array[:, 0]), _is_even(array[0])
    if down == across:
        down, across = _oscillates(array), _oscillates(array.T)
    if down == across:
        msg = (
            f"an array of {rows} by {columns} values, where either axis may be time; add the times as the "
            "first column, with a column for each channel"
        )
        raise ValueError(msg)
    return (array, "the first axis is time.") if down else (array.T, "the second axis is time.")


def _is_even(line: NDArray[np.float64]) -> bool:
    steps = np.diff(line)
    return bool(np.all(np.isfinite(steps)) and np.min(steps) > 0.0 and np.ptp(steps) < 0.5 * np.mean(steps))


def _oscillates(array: NDArray[np.float64]) -> bool:
    """Whether lines along the first axis oscillate at one frequency, for several cycles."""
    chosen = np.unique(np.linspace(0, array.shape[1] - 1, TUNING.lines).astype(int))
    lines = np.nan_to_num(array[:, chosen] - np.nanmean(array[:, chosen], axis=0))
    power = np.sum(np.abs(np.fft.rfft(lines * np.hanning(lines.shape[0])[:, None], axis=0)) ** 2, axis=1)
    most = int(np.argmax(power))
    share = float(np.sum(power[max(most - 2, 0) : most + 3])) / max(float(np.sum(power)), 1e-300)
    return most >= TUNING.cycles and share > TUNING.share


# Vectors and matrices.
_AXES = 2
_PLAIN_KINDS = {"double", "single", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}


def read_npy(path: Path) -> tuple[pd.DataFrame, list[str]]:
    """Columns of an array of one or two axes; ValueError for any other content, or where either may be time."""
    # A map takes no memory for what the header only claims, and refuses a shape that the file is too short for.
    try:
        array = np.lib.format.open_memmap(path, mode="r")
    except ARRAY_DAMAGE as error:
        msg = f"no NumPy array ({error})"
        raise ValueError(msg) from error
    if array.dtype.names:
        return pd.DataFrame({name: _real(array[name]) for name in array.dtype.names}), []
    columns, taken = _columns(_real(array))
    return columns, [f"The array has the shape {array.shape}: {taken}"]


def read_mat(path: Path) -> tuple[pd.DataFrame, list[str]]:
    """Columns from the numeric variables of a MATLAB file that are as long as the longest.

    A scalar called fs, rate or fps gives the times if no variable does. ValueError if there is no such variable.
    """
    try:
        arrays = _mat_arrays(path)
    except NotImplementedError:
        # Version 7.3 is HDF5.
        return read_hdf5(path)
    vectors = {name: np.atleast_1d(value) for name, value in arrays.items() if value.size > 1}
    if not vectors:
        msg = "no numeric variable with more than one value"
        raise ValueError(msg)
    length = max(max(value.shape) for value in vectors.values())
    used = {n: _columns(_real(v)) for n, v in vectors.items() if v.ndim <= _AXES and length in v.shape}
    parts = {name: part for name, (part, _) in used.items()}
    columns = pd.concat(
        [part.set_axis(_numbered(name, part.shape[1]), axis=1) for name, part in parts.items()], axis=1
    )
    notes = [f"Variables {', '.join(list(parts)[:8])} of the MATLAB file are used."]
    turned = [f"{name} {vectors[name].shape}" for name in parts if vectors[name].shape[0] < length]
    notes += [f"Of {', '.join(turned)} the longer axis is time."] if turned else []
    scalars = {name.lower(): float(value) for name, value in arrays.items() if value.size == 1}
    rate = next((scalars[name] for name in RATE_NAMES if name in scalars), 0.0)
    insert_times(columns, notes, {rate} if rate > 0.0 else set())
    return columns, notes


def _mat_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Numeric variables of a MATLAB file; NotImplementedError for version 7.3."""
    from scipy.io import loadmat, whosmat  # noqa: PLC0415 - heavy
    from scipy.io.matlab import MatReadError  # noqa: PLC0415

    try:
        # Structures, cells and sparse matrices, which hold any number of values, are not read.
        plain = {name: shape for name, shape, kind in whosmat(path) if kind in _PLAIN_KINDS}
        if sum(int(np.prod(shape, dtype=object)) for shape in plain.values()) > MOST_VALUES:
            msg = f"more than {MOST_VALUES} values"
            raise ValueError(msg)
        found = loadmat(path, squeeze_me=True, variable_names=list(plain))
    except (MatReadError, TypeError, LookupError, OverflowError, zlib.error, struct.error) as error:
        msg = f"no readable MATLAB file ({error})"
        raise ValueError(msg) from error
    arrays = {name: np.asarray(value) for name, value in found.items() if not name.startswith("__")}
    return {name: array for name, array in arrays.items() if array.dtype.kind in REAL_KINDS}


def _numbered(name: str, count: int) -> list[str]:
    return [name] if count == 1 else [f"{name} {k + 1}" for k in range(count)]


def _real(array: NDArray[Any]) -> NDArray[np.float64]:
    if array.dtype.kind not in REAL_KINDS:
        msg = f"values of type {array.dtype}; save real numbers"
        raise ValueError(msg)
    return np.asarray(array, dtype=np.float64)


def _columns(array: NDArray[np.float64]) -> tuple[pd.DataFrame, str]:
    if not 1 <= array.ndim <= _AXES or array.size == 0:
        msg = f"an array of shape {array.shape}; save samples by channels"
        raise ValueError(msg)
    rows, taken = samples_by_channels(array[:, None] if array.ndim == 1 else array)
    return pd.DataFrame(rows, columns=[f"column {k + 1}" for k in range(rows.shape[1])]), taken


def read_hdf5(path: Path) -> tuple[pd.DataFrame, list[str]]:
    """Columns from all datasets with an axis as long as the dataset ``time``, or as the longest axis of the file.

    The other axes are columns, with the names of their coordinates in NetCDF. Packed and missing values follow the CF
    conventions (https://cfconventions.org, sections 2.5.1 and 8.1), and ``time`` its attribute ``units``; without it,
    a number ``fs``, ``rate`` or ``fps`` gives the times. Links, values in other files, and the confidence of the
    positions of movement are not read. ValueError for another file, two rates, or where two axes may be time.
    """
    try:
        import h5py  # noqa: PLC0415 - optional
    except ImportError:
        msg = "a file in HDF5, which needs h5py; install it with pip install h5py"
        raise ValueError(msg) from None
    nodes: dict[str, Any] = {}
    columns: dict[str, np.ndarray] = {}
    try:
        with h5py.File(path, "r") as file:
            file.visititems(nodes.__setitem__)
            used = _used({n: v for n, v in nodes.items() if _is_real(n, v)})
            for name, (dataset, axis) in used.items():
                columns |= _columns_of(name, dataset, axis)
            if _text(file.attrs, "time_unit") == "frames":
                columns = {"frame" if n == "time" else n: v for n, v in columns.items()}
            units = {_text(v.attrs, "units") for n, (v, _) in used.items() if not _is_time(n)}
            held = [(n, v[()]) for n, v in nodes.items() if getattr(v, "size", 0) == 1 and _is_held(v)]
            stated = held + [pair for node in (file, *nodes.values()) for pair in node.attrs.items()]
    except Exception as error:
        msg = f"no readable file in HDF5 ({error})"
        raise ValueError(msg) from error
    table = pd.DataFrame(columns)
    notes = [f"Datasets {', '.join(list(used)[:8])} of the file in HDF5 are used."]
    insert_times(table, notes, {float(np.ravel(v)[0]) for n, v in stated if _last(n).lower() in RATE_NAMES})
    note_unit(table, notes, units)
    return table, notes


def _used(found: dict[str, Any]) -> dict[str, tuple[Any, int]]:
    """Datasets by their names, shortest that are unique, each with its axis of time."""
    clocks = [v.size for n, v in found.items() if _is_time(n) and v.ndim == 1]
    length = max(clocks or [size for v in found.values() for size in v.shape], default=0)
    used = {n: v for n, v in found.items() if length in v.shape and (_is_time(n) or not v.is_scale)}
    if any(_last(n) == "position" for n in used):
        used = {n: v for n, v in used.items() if _last(n) != "confidence"}
    if not 0 < (count := sum(v.size for v in used.values())) <= MOST_VALUES:
        msg = f"{count} numbers in its datasets, expected 1 to {MOST_VALUES}"
        raise ValueError(msg)
    names, placed = [_last(n) for n in used], {}
    for path, dataset in used.items():
        axes = [k for k, size in enumerate(dataset.shape) if size == length]
        named = [k for k in axes if any(_is_time(s.name) for s in dataset.dims[k].values())]
        if len(named or axes) > 1:
            msg = f"dataset {path}: any axis of {dataset.shape} may be time; add a dataset time"
            raise ValueError(msg)
        placed[path if names.count(_last(path)) > 1 else _last(path)] = (dataset, (named or axes)[0])
    return placed


def _columns_of(name: str, dataset: Any, axis: int) -> dict[str, np.ndarray]:
    """Values of a dataset as columns, of which the name of each further axis is part."""
    values, attrs = np.asarray(dataset[()], dtype=np.float64), dataset.attrs
    for missing in {"_FillValue", "missing_value"} & set(attrs):
        values[values == np.ravel(attrs[missing])[0]] = np.nan
    values = values * np.ravel(attrs.get("scale_factor", 1.0))[0] + np.ravel(attrs.get("add_offset", 0.0))[0]
    if _is_time(name) and (unit := _text(attrs, "units").split(" since ")[0]):
        name = f"time ({unit})"
    labels = []
    for k, size in enumerate(dataset.shape):
        if k != axis and size > 1:
            scales = [s[()] for s in dataset.dims[k].values() if s.shape == (size,)]
            names = scales[0] if scales else np.arange(1, size + 1)
            labels.append([v.decode("utf-8", "replace") if isinstance(v, bytes) else f"{v:g}" for v in names])
    columns = np.moveaxis(values, axis, 0).reshape(values.shape[axis], -1)
    return {" ".join((name, *label)): columns[:, k] for k, label in enumerate(product(*labels))}


def _is_real(name: str, node: Any) -> bool:
    """Whether it is a dataset of numbers; text of MATLAB is stored as numbers, its references under ``#``."""
    if getattr(node, "shape", None) in (None, ()) or node.dtype.kind not in REAL_KINDS or name[0] == "#":
        return False
    return _is_held(node) and _text(node.attrs, "MATLAB_class") != "char"


def _is_held(dataset: Any) -> bool:
    """Whether the values are in this file."""
    return not (dataset.is_virtual or dataset.external)


def _is_time(path: str) -> bool:
    return _last(path).lower() in TIME_NAMES


def _last(path: str) -> str:
    return path.rpartition("/")[2]


def _text(attributes: Any, name: str) -> str:
    value = attributes.get(name, "")
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
