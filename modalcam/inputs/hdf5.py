"""Channels of a file in HDF5: NetCDF, MATLAB 7.3, and files of other programs."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from modalcam.inputs.stated import MOST_VALUES, RATE_NAMES, REAL_KINDS, TIME_NAMES, insert_times, note_unit


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
                columns |= _columns(name, dataset, axis)
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


def _columns(name: str, dataset: Any, axis: int) -> dict[str, np.ndarray]:
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
