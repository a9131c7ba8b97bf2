"""Plugins: modules that add to a registry when they are imported.

A plugin is a Python module that registers what it brings (docs/extending.md) at import. It
is loaded when its distribution declares an entry point of the group "modalcam.plugins", or when it is named:
``modalcam run --plugin MODULE``. The process that runs a command and every worker process load the same plugins before
the first task, and the names and source of all plugins are part of what every saved result is checked against.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.metadata
import importlib.util
from collections.abc import Iterable
from pathlib import Path

from modalcam.common import InputError

GROUP = "modalcam.plugins"
OUR_PACKAGES = ("tracker", "modal_id", "sim", "modalcam")

# What a result or the report may depend on; not compiled code, which lies beside its source.
_SOURCES = frozenset({".py", ".j2", ".css", ".js", ".toml"})
# names of the loaded plugins with the SHA-256 of their source
_LOADED: dict[str, str] = {}
# Functions that apps add to the public names of `modalcam`: the module that defines each and its name there.
FUNCTIONS: dict[str, tuple[str, str]] = {}


def register_function(name: str, module: str) -> None:
    """Offer the function `name` of a module as ``modalcam.NAME``; the module is imported when it is first used."""
    FUNCTIONS[name] = module, name


def load_apps(file: str) -> None:
    """Import `file` of each app in `modalcam.apps` that has one.

    The file "cli" registers commands, "public" functions, "plugin" what a run uses, as a plugin does. Without
    `modalcam.apps` there are none.
    """
    for path in sorted((Path(__file__).parent / "apps").glob(f"*/{file}.py")):
        importlib.import_module(f"modalcam.apps.{path.parent.name}.{file}")


def load_entry_points(group: str) -> None:
    """Import the modules that installed distributions declare in a group of entry points; InputError if one fails."""
    for entry in importlib.metadata.entry_points(group=group):
        try:
            importlib.import_module(entry.module)
        except Exception as error:
            msg = f"plugin {entry.module}: cannot be imported ({type(error).__name__}: {error}); mend or uninstall it"
            raise InputError(msg) from error


def load_plugins(names: Iterable[str] = ()) -> tuple[tuple[str, str], ...]:
    """Import the plugins of installed distributions, the modules `names` and the apps; returns `loaded_plugins`.

    InputError if a plugin cannot be imported.
    """
    load_apps("plugin")
    installed = (entry.module for entry in importlib.metadata.entry_points(group=GROUP))
    for name in (*installed, *names):
        if name not in _LOADED:
            try:
                importlib.import_module(name)
                _LOADED[name] = source_sha256(name)
            except Exception as error:
                msg = f"plugin {name}: cannot be imported ({type(error).__name__}: {error}); mend or leave out --plugin"
                raise InputError(msg) from error
    return loaded_plugins()


def loaded_plugins() -> tuple[tuple[str, str], ...]:
    """Name and SHA-256 of the source of each plugin that this process has loaded, sorted by name."""
    return tuple(sorted(_LOADED.items()))


def is_ours(module: str) -> bool:
    """Whether a module belongs to one of the four packages or to a loaded plugin."""
    return any(module == name or module.startswith(f"{name}.") for name in (*OUR_PACKAGES, *_LOADED))


def source_sha256(*modules: str) -> str:
    """SHA-256 of the source of modules, and of the code, templates and tables in packages among them."""
    digest = hashlib.sha256()
    for name in modules:
        spec = importlib.util.find_spec(name)
        if spec is None or spec.origin is None:
            msg = f"there is no package or module {name}"
            raise ValueError(msg)
        origin = Path(spec.origin)
        is_package = spec.submodule_search_locations is not None
        inside = (path for path in origin.parent.rglob("*.*") if path.suffix in _SOURCES)
        for path in sorted(inside) if is_package else [origin]:
            digest.update(path.relative_to(origin.parent).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
