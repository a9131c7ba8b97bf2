"""Saved results: a tree of frozen dataclasses in one .npz file, read back to equal values.

The tree is JSON (floats in Python's shortest exact form); its arrays are members of the archive. A dataclass is stored
under its module and name, and only frozen dataclasses (and configurations) of our packages and of loaded plugins are
ever made from a file. NumPy reads with ``allow_pickle=False``: a file cannot run code.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import importlib
import json
import math
import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar, cast
from zipfile import BadZipFile, ZipFile

import numpy as np
from pydantic import BaseModel

from modalcam.common import ARRAY_DAMAGE, InputError, readable_bytes
from modalcam.pipeline.atomic import replacing
from modalcam.plugins import is_ours

_FORMAT = "modalcam-result-2"
_MOST_BYTES = 10_000_000_000


@dataclass(frozen=True)
class Tuning:
    """Which file of results is refused before it is read."""

    #: [bytes] an archive may expand to this size in any case
    #: convention: It fits into the memory of any machine.
    small: int = 100_000_000
    #: [1] beyond, an archive that expands more than by this factor is refused
    #: measurement: Measured numbers hardly shrink: a film of a million frames is compressed to 0.6 of its size.
    expansion: int = 20


TUNING = Tuning()
# What reading raises for a file that is damaged or not ours.
_DAMAGE = (
    *ARRAY_DAMAGE,
    OSError,
    LookupError,
    ImportError,
    AttributeError,
    MemoryError,
    NotImplementedError,
    BadZipFile,
    zlib.error,
)
_PLAIN: dict[str, tuple[type, ...]] = {
    "None": (type(None),),
    "bool": (bool,),
    "int": (int,),
    "float": (float, int),
    "str": (str,),
    "tuple": (tuple,),
    "dict": (dict,),
    "list": (list,),
}
Value = TypeVar("Value")


class Cache:
    """Values in a folder, each under the hash of all that it was made from."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._used: set[str] = set()

    def cached(self, key: str, make: Callable[[], Value]) -> Value:
        """Value stored under `key`; if there is none or it is damaged, the one that `make` returns, which is stored."""
        self._used.add(key)
        path = self._path(key)
        with suppress(InputError):
            found = load(path, key)
            if found is not None:
                return cast("Value", found)
        value = make()
        save(path, key, value)
        return value

    def holds(self, key: str) -> bool:
        """Whether there is a value under `key`, which may be damaged."""
        return self._path(key).exists()

    def drop_unused(self) -> None:
        """Delete the entries that were neither read nor written through this object."""
        for path in self._folder.glob("*.npz"):
            if path.stem not in self._used:
                path.unlink()

    def _path(self, key: str) -> Path:
        return self._folder / f"{key}.npz"


def save(path: Path, key: str, value: object) -> None:
    """Write `value` under `key`, the hash of all that it was computed from; TypeError if it cannot be stored."""
    arrays: dict[str, np.ndarray] = {}
    tree = {"format": _FORMAT, "key": key, "value": _pack(value, arrays)}
    text = json.dumps(tree, ensure_ascii=True, separators=(",", ":"))
    arrays["tree"] = np.frombuffer(text.encode("ascii"), dtype=np.uint8)
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def digest(value: object) -> str:
    """SHA-256 of everything that `save` would write of `value`, in hex."""
    arrays: dict[str, np.ndarray] = {}
    text = json.dumps(_pack(value, arrays), separators=(",", ":"))
    parts = hashlib.sha256(text.encode("ascii"))
    for array in arrays.values():
        parts.update(str((array.shape, array.dtype)).encode())
        parts.update(np.ascontiguousarray(array).tobytes())
    return parts.hexdigest()


def load(path: Path, key: str | None = None) -> Any:
    """Read what `save` wrote; None when there is none, or when it has another key or format.

    Without `key` any is accepted. InputError if the file is damaged or was not written by `save`.
    """
    if not path.exists():
        return None
    size = readable_bytes(path, _MOST_BYTES)
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            _check_expansion(archive.zip, size)
            tree = json.loads(archive["tree"].tobytes().decode("ascii"))
            if tree["format"] != _FORMAT or key not in (None, tree["key"]):
                return None
            return _unpack(tree["value"], cast("dict[str, np.ndarray]", archive))
    except _DAMAGE as error:
        msg = f"{path}: damaged result, or one of another version ({error}); remove it or run again with --force"
        raise InputError(msg) from error


def _check_expansion(archive: ZipFile | None, size: int) -> None:
    """ValueError for an archive that fills the memory from a small file; numbers that were measured hardly shrink."""
    expanded = sum(member.file_size for member in archive.infolist()) if archive is not None else 0
    if expanded > TUNING.small + TUNING.expansion * size:
        msg = f"{size} bytes that expand to {expanded}"
        raise ValueError(msg)


def _pack(value: Any, arrays: dict[str, np.ndarray]) -> Any:  # noqa: PLR0911 - one line for each type
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
    if isinstance(value, bytes):
        return {"bytes": base64.b64encode(value).decode("ascii")}
    if isinstance(value, tuple | list):
        kind_of_sequence = "list" if isinstance(value, list) else "tuple"
        return {kind_of_sequence: [_pack(item, arrays) for item in value]}
    if isinstance(value, dict):
        return {"dict": [[_pack(k, arrays), _pack(v, arrays)] for k, v in value.items()]}
    kind = type(value)
    if is_ours(kind.__module__) and _is_storable(kind):
        fields = {name: _pack(getattr(value, name), arrays) for name in _field_names(kind)}
        return {"class": f"{kind.__module__}:{kind.__qualname__}", "fields": fields}
    expected = "numbers, text, arrays, tuples, lists, dicts or frozen dataclasses of ours"
    msg = f"cannot store a {kind.__name__}: expected {expected}"
    raise TypeError(msg)


def _unpack(tree: Any, arrays: dict[str, np.ndarray]) -> Any:  # noqa: PLR0911 - as many as there are types
    if not isinstance(tree, dict):
        return tree
    if "class" in tree:
        kind = _class(tree["class"])
        fields = {name: _unpack(item, arrays) for name, item in tree["fields"].items()}
        for name, value in fields.items():
            _check_type(kind, name, value)
        return kind(**fields)
    if "array" in tree:
        array = arrays[tree["array"]]
        if not isinstance(array, np.ndarray):  # NumPy gives the bytes of a member that is no array
            msg = f"member {tree['array']} is not an array"
            raise TypeError(msg)
        return array
    if "tuple" in tree:
        return tuple(_unpack(item, arrays) for item in tree["tuple"])
    if "list" in tree:
        return [_unpack(item, arrays) for item in tree["list"]]
    if "dict" in tree:
        return {_unpack(k, arrays): _unpack(v, arrays) for k, v in tree["dict"]}
    if "fraction" in tree:
        return Fraction(tree["fraction"])
    if "bytes" in tree:
        return base64.b64decode(tree["bytes"])
    return float(tree["float"])


def _check_type(kind: Any, name: str, value: Any) -> None:
    """TypeError for a field of a dataclass whose annotation is of plain types, none of which is that of the value."""
    field = getattr(kind, "__dataclass_fields__", {}).get(name)
    annotation = None if field is None else field.type
    if not isinstance(annotation, str):
        return
    nested, _, _ = annotation.partition("[")
    allowed = [nested] if nested != annotation and annotation.endswith("]") else annotation.split(" | ")
    types = [_PLAIN.get(one) for one in allowed]
    if None not in types and not any(isinstance(value, one) for one in types if one is not None):
        msg = f"{kind.__qualname__}.{name}: expected {annotation}, found {type(value).__name__}"
        raise TypeError(msg)


def _class(name: str) -> Any:
    """The class stored as "module:name", if it is one that may be made."""
    module, _, qualname = name.partition(":")
    if not is_ours(module) or module.endswith("__main__"):
        msg = f"{name} is not a class of modalcam or of a loaded plugin"
        raise ValueError(msg)
    kind: Any = importlib.import_module(module)
    for part in qualname.split("."):
        kind = getattr(kind, part)
    if not isinstance(kind, type) or not _is_storable(kind):
        msg = f"{name} is not a frozen dataclass"
        raise TypeError(msg)
    return kind


def _is_storable(kind: type) -> bool:
    """Whether a class is a frozen dataclass or a configuration."""
    if dataclasses.is_dataclass(kind):
        return bool(kind.__dataclass_params__.frozen)  # type: ignore[attr-defined]  # absent from typeshed
    return issubclass(kind, BaseModel)


def _field_names(kind: Any) -> list[str]:
    """Names of the fields that make an instance; one that does not count in comparisons does not count here either."""
    if issubclass(kind, BaseModel):
        return list(kind.model_fields)
    return [field.name for field in dataclasses.fields(kind) if field.init and field.compare]
