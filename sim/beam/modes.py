"""Natural modes of the beam, linearised about its static equilibrium under gravity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.beam.ancf import AncfBeam, from_band
from sim.beam.banded import decoupled
from sim.beam.statics import static_equilibrium
from tracker import FloatArray

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
    straight = decoupled(state.tangent)
    # motion along the axis of a straight beam is left out: its stiffness is seven decades higher
    moving = slice(1, None, 2) if straight else slice(None)
    stiffness, mass, axial = (
        from_band(band)[np.newaxis, moving, moving]
        for band in (state.tangent, beam.mass_kg, state.axial_tangent)
    )
    squares, shapes = eigenmodes(stiffness, mass, beam.dof_scale[moving], None if straight else axial)
    phi = np.zeros((beam.ndof, count))
    phi[moving] = shapes[0, :, :count]
    padded = np.zeros((1 + count, beam.held + beam.ndof))
    padded[0, beam.held :], padded[1:, beam.held :] = q, phi.T
    square = beam.second_variation(padded[0], padded[1:])
    stretch = np.einsum("im,im->m", phi, from_band(state.axial_tangent) @ phi)
    bending = int(
        np.count_nonzero((square > 0.0) & (squares[0, :count] > 0.0) & (straight | (stretch < 0.5 * square)))
    )
    if bending < count:
        msg = f"the mesh of {beam.properties.elements} elements has only {bending} bending modes"
        raise ValueError(msg)
    tip = beam.transverse_at(np.array([beam.properties.length_m]), phi.T)[:, 0]
    return BeamModes(
        beam=beam, equilibrium=q, omega_rad_s=np.sqrt(square), phi=phi * np.where(tip < 0.0, -1.0, 1.0)
    )


def eigenmodes(
    stiffness: FloatArray, mass: FloatArray, scale: FloatArray, stretch: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues and mass-normalised eigenvectors of n pencils, bending modes first, each in ascending order.

    Rounding leaves an error of an eigenvalue of 1e-16 times the highest; `AncfBeam.second_variation` of the vectors
    removes it.

    Parameters
    ----------
    stiffness, mass : array, shape (n, d, d)
    scale : array, shape (d,)
        Displacement in m of one unit of each coordinate, so that slopes and displacements have the same magnitude.
    stretch : array, shape (n, d, d), optional
        Axial part of the stiffness. A mode counts as bending if less than half of its energy is axial.

    Returns
    -------
    square, phi : array, shape (n, d) and (n, d, d)
    """
    outer = np.outer(scale, scale)
    inverse = np.linalg.inv(np.linalg.cholesky(mass / outer))
    square, vectors = np.linalg.eigh(inverse @ (stiffness / outer) @ np.swapaxes(inverse, 1, 2))
    phi = np.swapaxes(inverse, 1, 2) @ vectors / scale[:, np.newaxis]
    if stretch is not None:
        axial = np.einsum("nim,nij,njm->nm", phi, stretch, phi, optimize=True)
        order = np.argsort(axial >= 0.5 * square, axis=1, kind="stable")
        square = np.take_along_axis(square, order, axis=1)
        phi = np.take_along_axis(phi, order[:, np.newaxis, :], axis=2)
    return square, phi
