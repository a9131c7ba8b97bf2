"""Channels in files of arrays: NumPy and MATLAB."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modalcam.common import ARRAY_DAMAGE
from modalcam.inputs.hdf5 import read_hdf5
from modalcam.inputs.stated import MOST_VALUES, RATE_NAMES, REAL_KINDS, insert_times
from modalcam.inputs.time_axis import samples_by_channels

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
