"""Saved results: a tree of frozen dataclasses in one .npz file, read back to equal values.

The tree is JSON (floats in Python's shortest exact form), its arrays are members of the archive. Only classes
of the list below are ever made, and NumPy reads with ``allow_pickle=False``: a file cannot run code.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any, cast
from zipfile import BadZipFile

import numpy as np

import modal_id.results
import modalcam.paper.recomputed
import modalcam.video.results
import sim.beam.modes
import sim.beam.properties
import sim.comparison
import sim.updating
import tracker.results
from modalcam.errors import InputError
from modalcam.storage.atomic import replacing

_MODULES = (
    tracker.results,
    modal_id.results,
    sim.beam.properties,
    sim.beam.modes,
    sim.updating,
    sim.comparison,
    modalcam.video.results,
    modalcam.paper.recomputed,
)
_FORMAT = "modalcam-result-1"


def _storable() -> Iterator[tuple[str, type]]:
    for module in _MODULES:
        for value in vars(module).values():
            if isinstance(value, type) and dataclasses.is_dataclass(value):
                yield value.__name__, value


_CLASSES: dict[str, type] = dict(_storable())


def save(path: Path, key: str, value: object) -> None:
    """Write `value` under `key`, the hash of all that it was computed from.

    Raises
    ------
    TypeError
        If the tree holds a value that cannot be stored.
    """
    arrays: dict[str, np.ndarray] = {}
    tree = {"format": _FORMAT, "key": key, "value": _pack(value, arrays)}
    text = json.dumps(tree, ensure_ascii=True, separators=(",", ":"))
    arrays["tree"] = np.frombuffer(text.encode("ascii"), dtype=np.uint8)
    with replacing(path) as beside, beside.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def digest(value: object) -> str:
    """Hash of everything that `save` would write of `value`."""
    arrays: dict[str, np.ndarray] = {}
    text = json.dumps(_pack(value, arrays), separators=(",", ":"))
    parts = hashlib.sha256(text.encode("ascii"))
    for array in arrays.values():
        parts.update(str((array.shape, array.dtype)).encode())
        parts.update(np.ascontiguousarray(array).tobytes())
    return parts.hexdigest()


def load(path: Path, key: str | None = None) -> Any:
    """Read what `save` wrote; None when there is none, or when it was computed from something else.

    Parameters
    ----------
    key : str or None
        The key expected; None takes whatever is there.

    Raises
    ------
    InputError
        If the file is damaged or not one of ours.
    """
    if not path.exists():
        return None
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            tree = json.loads(archive["tree"].tobytes().decode("ascii"))
            if tree["format"] != _FORMAT:
                msg = f"{path}: expected {_FORMAT}, found {tree['format']!r}; run again with --force"
                raise InputError(msg)
            if key is not None and tree["key"] != key:
                return None
            return _unpack(tree["value"], cast("dict[str, np.ndarray]", archive))
    except (OSError, EOFError, ValueError, KeyError, TypeError, BadZipFile) as error:
        msg = f"{path}: damaged result ({error}); remove it or run again with --force"
        raise InputError(msg) from error


def _pack(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {"float": repr(value)}
    if isinstance(value, np.ndarray):
        name = f"a{len(arrays)}"
        arrays[name] = value
        return {"array": name}
    if isinstance(value, np.generic):
        return _pack(value.item(), arrays)
    if isinstance(value, Fraction):
        return {"fraction": str(value)}
    if isinstance(value, tuple):
        return {"tuple": [_pack(item, arrays) for item in value]}
    if isinstance(value, dict):
        return {"dict": [[_pack(k, arrays), _pack(v, arrays)] for k, v in value.items()]}
    if dataclasses.is_dataclass(value) and _CLASSES.get(type(value).__name__) is type(value):
        fields = {f.name: _pack(getattr(value, f.name), arrays) for f in dataclasses.fields(value)}
        return {"class": type(value).__name__, "fields": fields}
    msg = f"cannot store a {type(value).__name__}"
    raise TypeError(msg)


def _unpack(tree: Any, arrays: dict[str, np.ndarray]) -> Any:
    if not isinstance(tree, dict):
        return tree
    if "class" in tree:
        fields = {name: _unpack(item, arrays) for name, item in tree["fields"].items()}
        return _CLASSES[tree["class"]](**fields)
    if "array" in tree:
        return arrays[tree["array"]]
    if "tuple" in tree:
        return tuple(_unpack(item, arrays) for item in tree["tuple"])
    if "dict" in tree:
        return {_unpack(k, arrays): _unpack(v, arrays) for k, v in tree["dict"]}
    if "fraction" in tree:
        return Fraction(tree["fraction"])
    return float(tree["float"])
