"""Changes of single options in the text of an `experiment.toml`, whose comments and order stay."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import tomlkit
import tomlkit.exceptions

from modalcam.config import CameraConfig
from modalcam.errors import ConfigError

Value = str | int | float | list[Any]


def with_option(text: str, section: str, key: str, value: Value | None) -> str:
    """The text with an option of ``[section]`` set, or removed where `value` is None."""
    document = _document(text)
    _set(_section(document, section) if value is not None else document.get(section), key, value)
    return str(tomlkit.dumps(document))


def with_options_of(text: str, file: str, values: Mapping[str, Value | None]) -> str:
    """The text with options of the ``[[recordings]]`` entry of a file set, or removed where they are None.

    An entry is added for a file without one.
    """
    document = _document(text)
    entry = _entry(document, file)
    if entry is None:
        if all(value is None for value in values.values()):
            return text
        entry = _added_entry(document, file)
    for key, value in values.items():
        _set(entry, key, value)
    return str(tomlkit.dumps(document))


def section_of(key: str) -> str:
    """Section that holds an option for all recordings: that of the camera, or that of the markers."""
    return "camera" if key in CameraConfig.model_fields else "markers"


def entry_of(text: str, file: str) -> dict[str, Any]:
    """Options of the ``[[recordings]]`` entry of a file; empty without one."""
    entry = _entry(_document(text), file)
    return {} if entry is None else dict(entry.unwrap())


def _document(text: str) -> Any:
    try:
        return tomlkit.parse(text)
    except (tomlkit.exceptions.TOMLKitError, RecursionError) as error:
        msg = f"the configuration cannot be edited: {error}; correct it in a text editor"
        raise ConfigError(msg) from None


def _section(document: Any, name: str) -> Any:
    if name not in document:
        document[name] = tomlkit.table()
    return document[name]


def _entry(document: Any, file: str) -> Any:
    recordings = document.get("recordings", ())
    return next((entry for entry in recordings if entry.get("file") == file), None)


def _added_entry(document: Any, file: str) -> Any:
    inline = "recordings" in document and isinstance(document["recordings"], tomlkit.items.Array)
    entry: Any = tomlkit.inline_table() if inline else tomlkit.table()
    entry["file"] = file
    if "recordings" in document:
        document["recordings"].append(entry)
    else:
        entries = tomlkit.aot()
        entries.append(entry)
        document["recordings"] = entries
    return document["recordings"][-1]


def _append(table: Any, key: str, value: Value) -> None:
    """Add an option after the last one: comments at the end of a table are those of the table that follows."""
    body = table.value.body if isinstance(table, tomlkit.items.Table) else []
    last = max((k for k, (own, _) in enumerate(body) if own is not None), default=len(body) - 1)
    after = body[last + 1 :]
    del body[last + 1 :]
    table[key] = value
    body.extend(after)


def _set(table: Any, key: str, value: Value | None) -> None:
    if value is not None:
        if key not in table:
            _append(table, key, value)
        elif table[key] != value:
            table[key] = value
    elif table is not None and key in table:
        del table[key]
