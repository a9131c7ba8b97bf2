"""modalcam: natural frequencies and damping ratios of thin beams from high-speed recordings.

The names below are the public API; everything else may change between versions. They are loaded when first used, so
that ``import modalcam`` is fast.

>>> import modalcam as mc
>>> beam = mc.Beam(length_mm=500, width_mm=5, thickness_mm=0.5, density_kg_m3=8000, elastic_modulus_mpa=210e3)
>>> mc.modes(beam, 3).frequency_hz.round(2)
array([ 1.88, 10.58, 29.26])
"""

from __future__ import annotations

import importlib
import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from modalcam.api import aliases as aliases
    from modalcam.api import displacement as displacement
    from modalcam.api import frf as frf
    from modalcam.api import identify as identify
    from modalcam.api import run as run
    from modalcam.api import track as track
    from modalcam.common import IdentificationError as IdentificationError
    from modalcam.common import InputError as InputError
    from modalcam.common import TrackingError as TrackingError
    from modalcam.pipeline import load_run as load_run
    from sim.beam import Beam as Beam
    from sim.beam import natural_modes as modes
    from sim.damping import GenericDamping as GenericDamping
    from sim.damping import RayleighDamping as RayleighDamping
    from sim.dynamics import SimulationError as SimulationError
    from sim.dynamics import simulate_free_decay as simulate

__version__ = "1.0.0"

__all__ = [
    "Beam",
    "GenericDamping",
    "IdentificationError",
    "InputError",
    "RayleighDamping",
    "SimulationError",
    "TrackingError",
    "__version__",
    "aliases",
    "displacement",
    "frf",
    "identify",
    "load_run",
    "modes",
    "run",
    "simulate",
    "track",
]

# public name: the module that defines it and its name there
_SOURCES = {
    "track": ("modalcam.api", "track"),
    "displacement": ("modalcam.api", "displacement"),
    "identify": ("modalcam.api", "identify"),
    "aliases": ("modalcam.api", "aliases"),
    "frf": ("modalcam.api", "frf"),
    "Beam": ("sim.beam.beam", "Beam"),
    "modes": ("sim.beam.beam", "natural_modes"),
    "GenericDamping": ("sim.damping.models", "GenericDamping"),
    "RayleighDamping": ("sim.damping.models", "RayleighDamping"),
    "simulate": ("sim.dynamics.excitation", "simulate_free_decay"),
    "run": ("modalcam.api", "run"),
    "load_run": ("modalcam.pipeline.saved", "load_run"),
    "TrackingError": ("modalcam.common", "TrackingError"),
    "IdentificationError": ("modalcam.common", "IdentificationError"),
    "InputError": ("modalcam.common", "InputError"),
    "SimulationError": ("sim.dynamics.excitation", "SimulationError"),
}


def __getattr__(name: str) -> Any:
    """Load a public name, of the core or of an app, when it is first used (PEP 562)."""
    sources = _SOURCES if name in _SOURCES or name[0] == "_" else _with_apps()
    if name not in sources:
        msg = f"module 'modalcam' has no attribute {name!r}; public names: {', '.join(sources)}"
        raise AttributeError(msg)
    module, attribute = sources[name]
    value = getattr(importlib.import_module(module), attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, *_with_apps(), "__all__", "__doc__", "__version__"})


def _with_apps() -> dict[str, tuple[str, str]]:
    from modalcam.plugins import FUNCTIONS, load_apps  # noqa: PLC0415 - needs this module

    load_apps("public")
    return _SOURCES | FUNCTIONS


def _check_siblings() -> None:
    """Refuse to start if Python finds another `tracker`, `modal_id` or `sim` than those installed with this package."""
    root = Path(__file__).resolve().parent.parent
    for name in ("tracker", "modal_id", "sim"):
        spec = importlib.util.find_spec(name)
        found = None if spec is None or spec.origin is None else Path(spec.origin).resolve()
        if found == root / name / "__init__.py":
            continue
        where = "no package of that name" if found is None else str(found)
        msg = (
            f"modalcam needs its own package '{name}' at {root / name}, but Python finds {where}. "
            "Rename that file or folder, or start Python from another folder; if it belongs to another "
            "installed project, install modalcam in a separate environment."
        )
        raise ImportError(msg)


_check_siblings()
