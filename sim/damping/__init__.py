"""Damping models and the registry of those that a run compares."""

from sim.damping.models import (
    DampingCoefficients,
    DampingModel,
    GenericDamping,
    NoDamping,
    RayleighDamping,
    StillAir,
    WithAirDrag,
)
from sim.damping.registry import (
    AIR_DRAG,
    DAMPING_MODELS,
    DampingModelEntry,
    MeasuredDamping,
    generic_from,
    rayleigh_from,
    rayleigh_to_all,
    register_damping_model,
    selectable_damping_models,
    skipped_damping_models,
)

__all__ = [
    "AIR_DRAG",
    "DAMPING_MODELS",
    "DampingCoefficients",
    "DampingModel",
    "DampingModelEntry",
    "GenericDamping",
    "MeasuredDamping",
    "NoDamping",
    "RayleighDamping",
    "StillAir",
    "WithAirDrag",
    "generic_from",
    "rayleigh_from",
    "rayleigh_to_all",
    "register_damping_model",
    "selectable_damping_models",
    "skipped_damping_models",
]
