"""modalcam: natural frequencies and damping ratios of thin beams from high-speed recordings.

The names in `__all__` are the public API; everything else may change between versions. They are loaded when first
used, so that ``import modalcam`` is fast.

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
    from modalcam.api import displacement as displacement
    from modalcam.api import identify as identify
    from modalcam.api import load_run as load_run
    from modalcam.api import modes as modes
    from modalcam.api import plan as plan
    from modalcam.api import run as run
    from modalcam.api import simulate as simulate
    from modalcam.api import track as track
    from modalcam.errors import IdentificationError as IdentificationError
    from modalcam.errors import SimulationError as SimulationError
    from modalcam.errors import TrackingError as TrackingError
    from sim.beam.beam import Beam as Beam
    from sim.damping import GenericDamping as GenericDamping
    from sim.damping import RayleighDamping as RayleighDamping

__version__ = "0.1.0"

# public name: module that defines it
_SOURCES = {
    "track": "modalcam.api",
    "displacement": "modalcam.api",
    "identify": "modalcam.api",
    "Beam": "sim.beam.beam",
    "modes": "modalcam.api",
    "GenericDamping": "sim.damping",
    "RayleighDamping": "sim.damping",
    "simulate": "modalcam.api",
    "run": "modalcam.api",
    "load_run": "modalcam.api",
    "plan": "modalcam.api",
    "TrackingError": "modalcam.errors",
    "IdentificationError": "modalcam.errors",
    "SimulationError": "modalcam.errors",
}
__all__ = [*_SOURCES, "__version__"]  # noqa: PLE0604 - the names are strings


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used (PEP 562)."""
    if name not in _SOURCES:
        msg = f"module 'modalcam' has no attribute {name!r}; public names: {', '.join(_SOURCES)}"
        raise AttributeError(msg)
    value = getattr(importlib.import_module(_SOURCES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def _check_siblings() -> None:
    """Refuse to start when Python finds another `tracker`, `modal_id` or `sim` than the ones installed with this one."""
    root = Path(__file__).resolve().parent.parent
    for name in ("tracker", "modal_id", "sim"):
        spec = importlib.util.find_spec(name)
        found = None if spec is None or spec.origin is None else Path(spec.origin).resolve()
        if found == root / name / "__init__.py":
            continue
        where = "nothing of that name" if found is None else str(found)
        msg = (
            f"modalcam needs its own package '{name}' at {root / name}, but Python finds {where}. "
            "Rename that file or folder, or start Python from another folder; if it belongs to another "
            "installed project, install modalcam in an environment of its own."
        )
        raise ImportError(msg)


_check_siblings()
