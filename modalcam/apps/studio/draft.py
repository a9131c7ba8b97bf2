"""Draft of an `experiment.toml`: edited with undo, kept in OUT until it is saved beside the recordings.

A change of one option keeps the comments and the order of the text.
"""

from __future__ import annotations

import difflib
import hashlib
import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import tomlkit
import tomlkit.exceptions

from modalcam.common import ConfigError, OutputError
from modalcam.config import (
    CONFIG_NAME,
    CameraConfig,
    ExperimentConfig,
    RecordingConfig,
    config_of_text,
    config_text,
)
from modalcam.pipeline import write_json, write_text

Value = str | int | float | list[Any]


def with_section(text: str, section: str, values: Mapping[str, Value | None] | None) -> str:
    """The text with options of ``[section]`` set, or removed where they are None; without it where `values` is None."""
    document = _document(text)
    if values is None:
        document.pop(section, None)
    for key, value in (values or {}).items():
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


_BOM = "\ufeff"
# Older versions are forgotten.
_MOST_UNDONE = 500


class Draft:
    """Text of a configuration as edited so far.

    Every version is a valid configuration: an edit that is not is refused with the reason, and changes nothing.

    Parameters
    ----------
    path : Path or None
        The configuration, which need not exist; None for one that begins empty and cannot be saved.
    store : Path or None
        File in OUT that keeps the draft until it is saved; None to keep it in memory only.

    Attributes
    ----------
    notes : list of str
        What the user must know about an earlier draft, each a full sentence.
    version : int
        Grows with every change.
    can_be_saved : bool
        Whether there is a file to save it in.
    """

    def __init__(self, path: Path | None, store: Path | None = None) -> None:
        self.path = path or Path(CONFIG_NAME)
        self.can_be_saved = path is not None
        self.notes: list[str] = []
        self.version = 0
        self._store = store
        self._saved = self._on_disk()
        self._texts = [self._saved]
        self._resume()

    @property
    def text(self) -> str:
        """The configuration as it would be saved."""
        return self._texts[-1]

    @property
    def config(self) -> ExperimentConfig:
        """The configuration, checked."""
        return config_of_text(self.text, self.path)

    def recording(self, file: str) -> RecordingConfig:
        """Options of one recording."""
        return self.config.for_recording(file)

    @property
    def is_changed(self) -> bool:
        """Whether there is anything to save."""
        return self.text != self._saved

    @property
    def can_undo(self) -> bool:
        """Whether there is an edit to undo."""
        return len(self._texts) > 1

    def set_section(self, section: str, values: Mapping[str, Value | None] | None) -> None:
        """Set options of a section, remove those that are None, or it with all in it; ConfigError if not valid then."""
        self._edit(lambda text: with_section(text, section, values))

    def set_for(self, file: str, values: Mapping[str, Value | None]) -> None:
        """Set options of one recording, or remove those that are None; ConfigError as in `set_section`.

        An option that `[camera]` or `[markers]` gives is set there if no other recording is listed.
        """

        def edit(text: str) -> str:
            own = entry_of(text, file)
            others = any(recording.file != file for recording in self.config.recordings)
            inherited = {
                key: value
                for key, value in values.items()
                if not others and key not in own and self._is_given(section_of(key), key)
            }
            for key, value in inherited.items():
                text = with_section(text, section_of(key), {key: value})
            return with_options_of(
                text, file, {k: value for k, value in values.items() if k not in inherited}
            )

        self._edit(edit)

    def undo(self) -> None:
        """Take back the last edit, if there is one."""
        if self.can_undo:
            self._texts.pop()
            self._changed()

    def difference(self) -> str:
        """Lines to be removed and added by saving, in the form of ``diff -u``; empty without changes."""
        before, after = self._saved.splitlines(), self.text.splitlines()
        lines = difflib.unified_diff(
            before, after, self.path.name, f"{self.path.name} to be saved", lineterm=""
        )
        return "\n".join(lines)

    def save(self) -> None:
        """Write the configuration under a temporary name and rename it; OutputError if the file was changed since."""
        if self._on_disk() != self._saved:
            msg = (
                f"{self.path.name} was changed by another program since it was read: nothing was saved; press Start "
                "over to continue with the file as it is, or undo the other change"
            )
            raise OutputError(msg)
        mark = _BOM if self._has_mark() else ""
        write_text(self.path, mark + self.text)
        self._saved = self.text
        self._changed()

    def begin_again(self) -> None:
        """Drop the draft and read the file as it is; the dropped text can be undone."""
        self._saved = self._on_disk()
        self._texts.append(self._saved)
        self._changed()

    def _is_given(self, section: str, key: str) -> bool:
        return key in getattr(self.config, section).model_fields_set

    def _edit(self, edit: Callable[[str], str]) -> None:
        text = edit(self.text)
        if text == self.text:
            return
        config_of_text(text, self.path)
        self._texts = [*self._texts[-_MOST_UNDONE:], text]
        self._changed()

    def _changed(self) -> None:
        self.version += 1
        if self._store is None:
            return
        if self.is_changed:
            write_json(self._store, {"base": _sha256(self._saved), "text": self.text})
        else:
            self._store.unlink(missing_ok=True)

    def _resume(self) -> None:
        """Continue with the draft in OUT, if it was made from the configuration as it is now."""
        if self._store is None or not self._store.is_file():
            return
        with suppress(ConfigError, OSError, ValueError, KeyError, TypeError):
            kept = json.loads(self._store.read_text("utf-8"))
            base, text = str(kept["base"]), str(kept["text"])
            if base == _sha256(self._saved):
                config_of_text(text, self.path)
                self._texts.append(text)
                self.notes.append("Unsaved changes of an earlier session were restored; undo removes them.")
                return
        aside = self._store.with_suffix(".old.json")
        self._store.replace(aside)
        self.notes.append(
            f"{self.path.name} has changed since the unsaved changes of an earlier session, or these are damaged: they "
            f"are not used, and kept in {aside.name} in the folder of the results."
        )

    def _on_disk(self) -> str:
        # Line ends as they are: a text editor of another system may have written them.
        if not (self.can_be_saved and self.path.exists()):
            return ""
        text = config_text(self.path)
        try:
            config_of_text(text, self.path)
        except ConfigError as error:
            msg = f"{error}; correct it in a text editor first"
            raise ConfigError(msg) from None
        return text

    def _has_mark(self) -> bool:
        return self.path.exists() and self.path.read_bytes().startswith(_BOM.encode())


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()
