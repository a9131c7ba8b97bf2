"""Registry of the damping models that a run compares with each recording.

A new model needs one `DampingModelEntry`: the configuration (``[damping] models``), the comparison, the tables and the
figures of the report all read the registry.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim.damping.entry import DampingModelEntry, MeasuredDamping
from sim.damping.law import ThroughAllModes
from sim.damping.laws import (
    CAUGHEY,
    CONSTANT,
    FRACTIONAL,
    KELVIN_VOIGT,
    MASS,
    MASS_AND_STIFFNESS,
    SUMS,
    THERMOELASTIC,
    VISCOUS_AIR,
)
from sim.damping.models import GenericDamping, RayleighDamping
from tracker import FloatArray

DAMPING_MODELS: dict[str, DampingModelEntry] = {}


def register_damping_model(entry: DampingModelEntry) -> None:
    """Add a damping model.

    Raises
    ------
    ValueError
        If its key or its colour is taken.
    """
    for other in DAMPING_MODELS.values():
        if entry.key == other.key or entry.colour == other.colour:
            msg = (
                f"damping model {entry.key!r}: its key or its colour {entry.colour} is that of {other.key!r}"
            )
            raise ValueError(msg)
    DAMPING_MODELS[entry.key] = entry


def selectable_damping_models() -> tuple[str, ...]:
    """Keys that ``[damping] models`` may name."""
    return tuple(key for key, entry in DAMPING_MODELS.items() if entry.build is not None)


def skipped_damping_models(keys: Sequence[str], measured: MeasuredDamping) -> tuple[str, ...]:
    """Sentences on the models that cannot be built from these modes."""
    reasons = [
        f"{reason}: not simulated." for key in keys if (reason := DAMPING_MODELS[key].missing(measured))
    ]
    return tuple(dict.fromkeys(reasons))


def generic_from(measured: MeasuredDamping, omega_rad_s: FloatArray) -> GenericDamping:
    """Generic damping (Eq. 5, 6) of all modes up to the highest measured one.

    A mode that was not measured takes the damping ratio interpolated over frequency between its neighbours.
    """
    at = np.array(measured.numbers) - 1
    ratios = np.interp(omega_rad_s, omega_rad_s[at], np.array(measured.damping_ratio))
    return GenericDamping(tuple(float(r) for r in ratios))


def rayleigh_from(measured: MeasuredDamping, *, constant_stiffness: bool = False) -> RayleighDamping:
    """Rayleigh damping (Eq. 3, 4) through the two lowest measured modes."""
    w1, w2 = (2.0 * np.pi * f for f in measured.frequency_hz[:2])
    z1, z2 = measured.damping_ratio[:2]
    return RayleighDamping.from_modes((w1, w2), (z1, z2), constant_stiffness=constant_stiffness)


def rayleigh_to_all(measured: MeasuredDamping) -> RayleighDamping:
    """Rayleigh damping (Eq. 3) with alpha, beta >= 0 by least squares over the damping ratios of all measured modes."""
    from scipy.optimize import nnls  # noqa: PLC0415 - a run that is up to date loads none of SciPy

    omega = 2.0 * np.pi * np.array(measured.frequency_hz)
    columns = 0.5 * np.column_stack([1.0 / omega, omega])
    # comparable columns: the solution does not depend on the units
    scale = np.linalg.norm(columns, axis=0)
    found = nnls(columns / scale, np.array(measured.damping_ratio))[0] / scale
    return RayleighDamping(float(found[0]), float(found[1]))


_TOO_FEW = "Rayleigh damping (Eq. 4) needs two identified modes"
# fitted to each recording by `sim.comparison.drag`
AIR_DRAG = "air_drag"

for _entry in (
    DampingModelEntry(
        key="generic",
        name="generic damping",
        description="Each measured mode has its own damping ratio (Eq. 5, 6).",
        colour="#0067a5",
        dark_colour="#5db4ee",
        marker="s",
        line_style="-",
        build=generic_from,
        law=ThroughAllModes(),
    ),
    DampingModelEntry(
        key="rayleigh",
        name="Rayleigh damping",
        description="α M + β K(q) through the two lowest measured modes (Eq. 3, 4).",
        colour="#cc4f00",
        dark_colour="#ff8f4d",
        marker="^",
        line_style="--",
        build=lambda measured, _: rayleigh_from(measured),
        least_modes=2,
        too_few=_TOO_FEW,
    ),
    DampingModelEntry(
        key="rayleigh_constant_k",
        name="Rayleigh damping with constant K",
        description="α M + β K with the stiffness K of the undeformed beam, which overestimates damping "
        "wherever elements rotate.",
        colour="#8a6d00",
        dark_colour="#d9bc4a",
        marker="v",
        build=lambda measured, _: rayleigh_from(measured, constant_stiffness=True),
        least_modes=2,
        too_few=_TOO_FEW,
        draw_stride=4,
        variant_of="rayleigh",
        difference="The stiffness matrix of the undeformed beam treats rotation of the elements as axial strain, which "
        "βK damps.",
    ),
    DampingModelEntry(
        key="rayleigh_all_modes",
        name="Rayleigh damping fitted to all modes",
        description="α M + β K(q) by least squares over the damping ratios of all measured modes (Eq. 3).",
        colour="#7a3e9d",
        dark_colour="#d3a0f0",
        marker="P",
        line_style="-.",
        build=lambda measured, _: rayleigh_to_all(measured),
        least_modes=3,
        too_few="Rayleigh damping fitted to all modes needs three identified modes",
        draw_stride=4,
        law=MASS_AND_STIFFNESS,
    ),
    DampingModelEntry(
        key=AIR_DRAG,
        name="generic damping with air drag",
        description="Generic damping with the quadratic drag of still air, fitted to each recording ([air]).",
        colour="#5a4fb0",
        dark_colour="#b3a9ff",
        marker="o",
        build=None,
    ),
    CONSTANT,
    KELVIN_VOIGT,
    MASS,
    FRACTIONAL,
    THERMOELASTIC,
    VISCOUS_AIR,
    CAUGHEY,
    *SUMS,
):
    register_damping_model(_entry)
