"""Extensions from outside: modules that add to a registry when they are imported.

A plugin is a Python module that registers what it brings (a damping model, a kind of marker, a writer...) at import. It
is loaded when its distribution declares an entry point of the group "modalcam.plugins", or when it is named:
``modalcam run --plugin MODULE``. The process that runs a command and every worker process load the same plugins before
the first task, and the names and source of all plugins are part of what every saved result is checked against.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.metadata
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

from modalcam.errors import InputError

GROUP = "modalcam.plugins"
OUR_PACKAGES = ("tracker", "modal_id", "sim", "modalcam")

# names of the loaded plugins with the SHA-256 of their source
_LOADED: dict[str, str] = {}


def load_plugins(names: Iterable[str] = ()) -> tuple[tuple[str, str], ...]:
    """Import the plugins of installed distributions and those named; a plugin that is already loaded is left alone.

    Parameters
    ----------
    names : iterable of str
        Modules that can be imported, with or without an entry point.

    Returns
    -------
    tuple of (str, str)
        Name and SHA-256 of the source of every plugin loaded so far, sorted by name.

    Raises
    ------
    InputError
        If a plugin cannot be imported.
    """
    installed = (entry.module for entry in importlib.metadata.entry_points(group=GROUP))
    for name in (*installed, *names):
        if name not in _LOADED:
            try:
                module = importlib.import_module(name)
            except Exception as error:
                msg = f"plugin {name}: cannot be imported ({type(error).__name__}: {error}); mend or leave out --plugin"
                raise InputError(msg) from error
            _LOADED[name] = _source_sha256(module)
    return loaded_plugins()


def loaded_plugins() -> tuple[tuple[str, str], ...]:
    """Name and SHA-256 of the source of each plugin that this process has loaded, sorted by name."""
    return tuple(sorted(_LOADED.items()))


def is_ours(module: str) -> bool:
    """Whether a module belongs to one of the four packages or to a loaded plugin."""
    return any(module == name or module.startswith(f"{name}.") for name in (*OUR_PACKAGES, *_LOADED))


def _source_sha256(module: ModuleType) -> str:
    """Hash of a module's file, or of all Python files of a package."""
    files = [] if module.__file__ is None else [Path(module.__file__)]
    for folder in getattr(module, "__path__", ()):
        files = sorted(Path(folder).rglob("*.py"))
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()
