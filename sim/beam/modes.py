"""Natural modes of the beam, linearised about its static equilibrium under gravity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import eigh

from sim.beam.ancf import AncfBeam, from_band
from sim.beam.statics import static_equilibrium
from tracker.arrays import FloatArray

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class BeamModes:
    """Undamped bending modes in order of frequency.

    Attributes
    ----------
    equilibrium : array, shape (ndof,)
        State of linearisation.
    omega_rad_s : array, shape (m,)
    phi : array, shape (ndof, m)
        Mass-normalised shapes, ``phi^T M phi = 1``, positive at the tip.
    """

    beam: AncfBeam
    equilibrium: FloatArray
    omega_rad_s: FloatArray
    phi: FloatArray

    @property
    def frequency_hz(self) -> FloatArray:
        """Natural frequencies, shape (m,)."""
        return self.omega_rad_s / (2.0 * np.pi)

    @property
    def count(self) -> int:
        """Number of modes."""
        return int(self.omega_rad_s.size)

    def transverse_at(self, s_m: FloatArray) -> FloatArray:
        """Transverse part of the mass-normalised shapes at `s_m`, shape (k, m), in kg^-1/2."""
        return self.beam.transverse_at(s_m, self.phi.T).T

    def first(self, count: int) -> BeamModes:
        """The lowest `count` of these modes."""
        return BeamModes(self.beam, self.equilibrium, self.omega_rad_s[:count], self.phi[:, :count])

    def base_participation(self) -> FloatArray:
        """``phi^T M r`` with r the unit translation of the whole beam across its axis, shape (m,)."""
        return self.phi.T @ self.beam.base_coupling_kg

    def to_dataframe(self) -> pd.DataFrame:
        """Columns ``mode`` and ``frequency_hz``, one row per mode."""
        import pandas as pd  # noqa: PLC0415

        return pd.DataFrame({"mode": np.arange(1, self.count + 1), "frequency_hz": self.frequency_hz})

    def plot(self, ax: Any = None) -> Any:
        """Shapes along the beam, scaled to 1 at their largest displacement; returns the matplotlib Axes."""
        import matplotlib.pyplot as plt  # noqa: PLC0415

        ax = plt.figure().add_subplot() if ax is None else ax
        along_m = np.linspace(0.0, self.beam.properties.length_m, 201)
        shapes = self.transverse_at(along_m)
        for number, (frequency, shape) in enumerate(zip(self.frequency_hz, shapes.T, strict=True), 1):
            ax.plot(1e3 * along_m, shape / np.max(np.abs(shape)), label=f"mode {number}, {frequency:.4g} Hz")
        ax.set(xlabel="distance from the clamp (mm)", ylabel="transverse shape", title="Natural modes")
        ax.legend()
        return ax

    def __repr__(self) -> str:
        return f"BeamModes({self.count} modes: {', '.join(f'{f:.3g}' for f in self.frequency_hz)} Hz)"

    def _repr_html_(self) -> str:
        return str(self.to_dataframe().to_html(index=False))


def beam_modes(beam: AncfBeam, count: int, equilibrium: FloatArray | None = None) -> BeamModes:
    """Lowest `count` bending modes: ``K(q_eq) phi = omega^2 M phi``.

    A mode counts as bending if less than half of its strain energy is axial; axial modes, which begin in the kHz range
    for such beams, are omitted. The equilibrium is computed when absent.

    Raises
    ------
    ValueError
        If the mesh does not have that many bending modes, twice the number of elements.
    BuckledBeamError
        If a standing beam cannot carry its own weight.
    """
    limit = 2 * beam.properties.elements
    if not 1 <= count <= limit:
        msg = f"{beam.properties.elements} elements have 1 to {limit} bending modes, {count} were requested"
        raise ValueError(msg)
    q = static_equilibrium(beam) if equilibrium is None else np.asarray(equilibrium, dtype=np.float64)
    state = beam.elastic(q)
    # scaled to metres, so that slopes and displacements have the same magnitude for the eigensolver
    scale = beam.dof_scale
    outer = np.outer(scale, scale)
    stiffness = from_band(state.tangent) / outer
    square, shapes = eigh(stiffness, from_band(beam.mass_kg) / outer)
    phi = shapes / scale[:, np.newaxis]
    stretch = np.einsum("im,im->m", phi, from_band(state.axial_tangent) @ phi)
    bending = np.flatnonzero((stretch < 0.5 * square) & (square > 0.0))[:count]
    if bending.size < count:
        msg = f"the mesh of {beam.properties.elements} elements has only {bending.size} bending modes"
        raise ValueError(msg)
    phi = phi[:, bending]
    tip = beam.transverse_at(np.array([beam.properties.length_m]), phi.T)[:, 0]
    return BeamModes(
        beam=beam,
        equilibrium=q,
        omega_rad_s=np.sqrt(square[bending]),
        phi=np.ascontiguousarray(phi * np.where(tip < 0.0, -1.0, 1.0)),
    )
