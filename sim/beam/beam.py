"""A beam in the units of a drawing, and its natural modes, linearised about static equilibrium under gravity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.beam.ancf import AncfBeam
from sim.beam.banded import decoupled, from_band
from sim.beam.properties import (
    STANDARD_GRAVITY_M_S2,
    BeamProperties,
    ElasticClamp,
    End,
    Orientation,
    PointMass,
    unit_problems,
)
from sim.beam.statics import static_equilibrium
from tracker import FloatArray, checked, data_frame

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class BeamModes:
    """Undamped bending modes in order of frequency, without the motions of a rigid beam that its ends allow.

    These are `beam.properties.rigid_body_motions`, and have no number. Under gravity the rotation about a pin is the
    swing of a pendulum.

    Attributes
    ----------
    equilibrium : array, shape (ndof,)
        State of linearisation.
    omega_rad_s : array, shape (m,)
    phi : array, shape (ndof, m)
        Mass-normalised shapes, ``phi^T M phi = 1``, positive at the antinode.
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

    def antinode_m(self, mode_number: int) -> FloatArray:
        """Distance to the tip or, where the second end cannot move, to the node that moves most, shape (1,)."""
        return _antinode_m(self.beam, self.phi[:, mode_number - 1])

    def first(self, count: int) -> BeamModes:
        """The lowest `count` of these modes."""
        return BeamModes(self.beam, self.equilibrium, self.omega_rad_s[:count], self.phi[:, :count])

    def base_participation(self) -> FloatArray:
        """``phi^T M r`` with r the unit translation of the whole beam across its axis, shape (m,)."""
        return self.phi.T @ self.beam.base_coupling_kg

    def to_dataframe(self) -> pd.DataFrame:
        """Columns ``mode`` and ``frequency_hz``, one row per mode."""
        values = {"mode": np.arange(1, self.count + 1), "frequency_hz": self.frequency_hz}
        return data_frame(values, {"frequency_hz": "Hz"})

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
        rigid = "".join(f", rigid-body {name}" for name in self.beam.properties.rigid_body_motions)
        return f"BeamModes({self.count} modes: {', '.join(f'{f:.3g}' for f in self.frequency_hz)} Hz{rigid})"

    def _repr_html_(self) -> str:
        return str(self.to_dataframe().to_html(index=False))


def beam_modes(beam: AncfBeam, count: int) -> BeamModes:
    """Lowest `count` bending modes: ``K(q_eq) phi = omega^2 M phi``.

    A mode counts as bending if less than half of its strain energy is axial; axial modes, which begin in the kHz range
    for such beams, are omitted.

    Raises
    ------
    ValueError
        If the mesh does not have that many bending modes, twice the number of elements for a cantilever.
    BuckledBeamError
        If a standing beam cannot carry its own weight.
    """
    rigid = len(beam.properties.rigid_body_motions)
    lowest = slice(rigid, rigid + count)
    limit = int(np.count_nonzero(beam.free % 2)) - rigid
    if not 1 <= count <= limit:
        msg = f"{beam.properties.elements} elements have 1 to {limit} bending modes, {count} were requested"
        raise ValueError(msg)
    q = static_equilibrium(beam)
    state = beam.elastic(q)
    straight = decoupled(state.tangent)
    # motion along the axis of a straight beam is left out: its stiffness is seven decades higher
    moving = beam.free - beam.held
    moving = moving[moving % 2 == 1] if straight else moving
    stiffness, mass, axial = (
        from_band(band)[np.newaxis, moving[:, np.newaxis], moving]
        for band in (state.tangent, beam.mass_kg, state.axial_tangent)
    )
    squares, shapes = eigenmodes(stiffness, mass, beam.dof_scale[moving], None if straight else axial)
    phi = np.zeros((beam.ndof, count))
    phi[moving] = shapes[0, :, lowest]
    padded = np.zeros((1 + count, beam.held + beam.ndof))
    padded[0, beam.held :], padded[1:, beam.held :] = q, phi.T
    square = beam.second_variation(padded[0], padded[1:])
    stretch = np.einsum("im,im->m", phi, from_band(state.axial_tangent) @ phi)
    bending = int(
        np.count_nonzero(
            (square > 0.0) & (squares[0, lowest] > 0.0) & (straight | (stretch < TUNING.axial_share * square))
        )
    )
    if bending < count:
        msg = f"the mesh of {beam.properties.elements} elements has only {bending} bending modes"
        raise ValueError(msg)
    largest = [beam.transverse_at(_antinode_m(beam, shape), shape)[0] for shape in phi.T]
    signs = np.where(np.array(largest) < 0.0, -1.0, 1.0)
    return BeamModes(beam=beam, equilibrium=q, omega_rad_s=np.sqrt(square), phi=phi * signs)


def _antinode_m(beam: AncfBeam, shape: FloatArray) -> FloatArray:
    length = beam.properties.length_m
    if beam.properties.ends[1] in ("free", "guided"):
        return np.array([length])
    nodes = np.linspace(0.0, length, beam.properties.elements + 1)
    # of the two equal ones of a symmetric shape the nearer to the second end
    moved = np.abs(beam.transverse_at(nodes, shape))
    return nodes[[np.flatnonzero(moved > (1.0 - TUNING.equal) * np.max(moved))[-1]]]


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
        order = np.argsort(axial >= TUNING.axial_share * square, axis=1, kind="stable")
        square = np.take_along_axis(square, order, axis=1)
        phi = np.take_along_axis(phi, order[:, np.newaxis, :], axis=2)
    return square, phi


@dataclass(frozen=True)
class Tuning:
    """What counts as bending."""

    #: [1] axial share of a mode's strain energy from which it is no bending mode
    #: measurement: The modes of the horizontal paper's beam have below 0.05 or above 0.93.
    axial_share: float = 0.5
    #: [1] difference of two amplitudes along a mode below which they count as equal
    #: physics: Above the rounding of a symmetric mode, far below the difference of its antinodes where it has none.
    equal: float = 1e-6


TUNING = Tuning()
_POSITIVE = ("length_mm", "width_mm", "thickness_mm", "density_kg_m3", "elastic_modulus_mpa")


@dataclass(frozen=True, kw_only=True)
class Beam:
    """A beam of rectangular section, clamped at the first end and free at the other unless `ends` says otherwise.

    Parameters
    ----------
    length_mm : float
    width_mm, thickness_mm : float or sequence of float
        One value, or one per element from the clamp to the tip. The beam bends about its width: the second moment of
        area is ``width thickness^3 / 12``.
    density_kg_m3, elastic_modulus_mpa : float
    orientation : {"hanging", "standing", "horizontal", "angled", "none"}
        Direction of the beam relative to gravity; "none" is a beam without weight.
    elements : int
        Number of finite elements, all of equal length.
    point_masses : tuple of PointMass
    angle_deg : float, optional
        For ``orientation="angled"``: from hanging, counter-clockwise in the image; 90 points right, 180 up.
    clamp : ElasticClamp, optional
        Rigid when absent.
    ends : tuple of {"clamped", "pinned", "free", "guided"}
        At s = 0 and at s = length.
    tension_n : float
        Axial force at rest without weight, between two ends that are not free.
    gravity_m_s2 : float

    Raises
    ------
    ValueError
        If a dimension is not finite and positive, cannot be in the unit of its name, or the values do not match each
        other.

    Examples
    --------
    >>> from sim.beam.beam import Beam
    >>> Beam(length_mm=500, width_mm=5, thickness_mm=0.5, density_kg_m3=8000, elastic_modulus_mpa=210_000)
    Beam(500 x 5 x 0.5 mm, 8000 kg/m3, 210000 MPa, hanging, 20 elements)
    """

    length_mm: float
    width_mm: float | Sequence[float] | FloatArray
    thickness_mm: float | Sequence[float] | FloatArray
    density_kg_m3: float
    elastic_modulus_mpa: float
    orientation: Orientation = "hanging"
    elements: int = 20
    point_masses: tuple[PointMass, ...] = ()
    angle_deg: float | None = None
    clamp: ElasticClamp | None = None
    ends: tuple[End, End] = ("clamped", "free")
    tension_n: float = 0.0
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2

    def __post_init__(self) -> None:
        for name in _POSITIVE:
            for value in np.ravel(getattr(self, name)):
                checked(name, float(value), positive=True)
        if self.elements < 1:
            msg = f"elements must be at least 1, got {self.elements}"
            raise ValueError(msg)
        for name in ("width_mm", "thickness_mm"):
            if np.shape(getattr(self, name)) not in ((), (self.elements,)):
                msg = f"{name} must be one number or one per element ({self.elements}), got {getattr(self, name)}"
                raise ValueError(msg)
        width, thickness = float(np.max(self.width_mm)), float(np.max(self.thickness_mm))
        problems = unit_problems(
            self.length_mm, width, thickness, self.density_kg_m3, self.elastic_modulus_mpa
        )
        if found := "; ".join(problems):
            raise ValueError(found)
        # the remaining checks are those of the properties
        self.properties  # noqa: B018

    @cached_property
    def properties(self) -> BeamProperties:
        """The beam in SI units, element by element."""
        return BeamProperties(
            length_m=self.length_mm * 1e-3,
            width_m=np.full(self.elements, np.multiply(self.width_mm, 1e-3)),
            thickness_m=np.full(self.elements, np.multiply(self.thickness_mm, 1e-3)),
            density_kg_m3=float(self.density_kg_m3),
            elastic_modulus_pa=self.elastic_modulus_mpa * 1e6,
            orientation=self.orientation,
            point_masses=tuple(self.point_masses),
            gravity_m_s2=self.gravity_m_s2,
            angle_deg=self.angle_deg,
            clamp=self.clamp,
            ends=self.ends,
            tension_n=self.tension_n,
        )

    def __repr__(self) -> str:
        width, thickness = (f"{np.mean(value):g}" for value in (self.width_mm, self.thickness_mm))
        return (
            f"Beam({self.length_mm:g} x {width} x {thickness} mm, {self.density_kg_m3:g} kg/m3, "
            f"{self.elastic_modulus_mpa:g} MPa, {self.orientation}, {self.elements} elements)"
        )


def ancf_beam(beam: Beam | BeamProperties | AncfBeam) -> AncfBeam:
    """The assembled beam of any description of it."""
    if isinstance(beam, AncfBeam):
        return beam
    return AncfBeam(beam.properties if isinstance(beam, Beam) else beam)


def natural_modes(beam: Beam | BeamProperties, count: int = 5) -> BeamModes:
    """Lowest bending modes of a beam about its static equilibrium under gravity.

    Parameters
    ----------
    beam : Beam
    count : int
        At most twice the number of elements.

    Returns
    -------
    BeamModes

    Raises
    ------
    ValueError
        If the mesh does not have that many bending modes.
    BuckledBeamError
        If a standing beam cannot carry its own weight.

    Examples
    --------
    >>> from sim.beam.beam import Beam, natural_modes
    >>> beam = Beam(length_mm=500, width_mm=5, thickness_mm=0.5, density_kg_m3=8000, elastic_modulus_mpa=210_000)
    >>> natural_modes(beam, 3)
    BeamModes(3 modes: 1.88, 10.6, 29.3 Hz)
    """
    return beam_modes(ancf_beam(beam), count)
