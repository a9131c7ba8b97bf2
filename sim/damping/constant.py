"""Constant loss factor: complex stiffness ``K (1 + i eta)``, damping ratio ``eta / 2`` at every frequency.

A complex stiffness is defined for harmonic motion; in time it is not causal and would need a rational approximation.
None is needed here: the simulation takes a damping ratio for each mode, which is exactly eta / 2.

References
----------
Crandall, "The role of damping in vibration theory", J. Sound Vib. 11 (1970) 3, doi:10.1016/S0022-460X(70)80105-5.
"""

from __future__ import annotations

from sim.damping.entry import law_entry
from sim.damping.law import PowerLaw

CONSTANT = law_entry(
    "constant",
    "constant loss factor",
    "Complex stiffness: all modes have the same damping ratio, half the loss factor.",
    ("#26734d", "#7ad6a8"),
    PowerLaw(0),
)
