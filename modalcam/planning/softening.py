"""Shift of the natural frequencies with amplitude, by the theory of a single mode."""

from __future__ import annotations

import numpy as np
from scipy.integrate import cumulative_trapezoid, trapezoid

from sim.beam import BeamModes, BeamProperties
from tracker import FloatArray

_POINTS = 2001


def frequency_per_amplitude_squared(beam: BeamProperties, modes: BeamModes) -> FloatArray:
    """Relative change of each mode's natural frequency over the tip's amplitude squared, 1 / m^2.

    Negative where the mode softens, as all but the first of a uniform cantilever do; the first is nearly neutral.

    Notes
    -----
    One mode ``q(t) w(s)``, w(L) = 1, of a beam that does not stretch (Crespo da Silva & Glynn, J. Struct. Mech. 6,
    1978, doi:10.1080/03601217808907348): bending energy grows by ``q^4 / 2 int EI w''^2 w'^2 ds``, and points move
    along the beam by ``u = -q^2 / 2 int_0^s w'^2``. Harmonic balance gives
    ``d omega / omega = (3/4 K4 / K - 1/4 M4 / M) q^2`` with ``K4 = int EI w''^2 w'^2``,
    ``M4 = int m (int_0^s w'^2)^2``. A hanging beam is lifted by ``q^4 / 8 int_0^s w'^4`` more than in linear theory,
    which adds ``g / 4 int m int_0^s w'^4`` to K4. Axial strain and sag are neglected.
    """
    s = np.linspace(0.0, beam.length_m, _POINTS)
    tip = modes.transverse_at(np.array([beam.length_m]))[0]
    shape = modes.transverse_at(s) / tip
    slope = np.gradient(shape, s, axis=0)
    bend = np.gradient(slope, s, axis=0)
    element = np.minimum((s / beam.length_m * beam.elements).astype(int), beam.elements - 1)
    width, thickness = beam.width_m[element, None], beam.thickness_m[element, None]
    stiffness = beam.elastic_modulus_pa * width * thickness**3 / 12.0
    along = cumulative_trapezoid(slope**2, s, axis=0, initial=0.0)
    # Modal mass for unit amplitude at the tip; modes are mass-normalised.
    mass = 1.0 / tip**2
    mass_per_m = beam.density_kg_m3 * width * thickness

    def weighed(values: FloatArray) -> FloatArray:
        """Integral of `values`, shape (points, modes), over the mass of the beam and its point masses."""
        bodies = [body.mass_kg * values[np.argmin(np.abs(s - body.position_m))] for body in beam.point_masses]
        return np.asarray(sum(bodies, trapezoid(mass_per_m * values, s, axis=0)))

    inertia = weighed(along**2)
    bending = trapezoid(stiffness * bend**2 * slope**2, s, axis=0)
    lifted = cumulative_trapezoid(slope**4, s, axis=0, initial=0.0)
    bending = bending + 0.25 * _gravity_along(beam) * weighed(lifted)
    return np.asarray(0.75 * bending / (mass * modes.omega_rad_s**2) - 0.25 * inertia / mass)


def _gravity_along(beam: BeamProperties) -> float:
    """Component of gravity along the beam, positive if it puts the beam under tension."""
    angle_deg = {"hanging": 0.0, "standing": 180.0}.get(beam.orientation, beam.angle_deg)
    return 0.0 if angle_deg is None else beam.gravity_m_s2 * float(np.cos(np.radians(angle_deg)))
