"""A beam described in the units of a drawing, for use from Python: `Beam` and its natural modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sim.beam.ancf import AncfBeam
from sim.beam.modes import BeamModes, beam_modes
from sim.beam.properties import STANDARD_GRAVITY_M_S2, BeamProperties, ElasticClamp, Orientation, PointMass
from tracker import FloatArray

# number of modes that the paper identifies
DEFAULT_MODES = 5
_POSITIVE = ("length_mm", "width_mm", "thickness_mm", "density_kg_m3", "elastic_modulus_mpa")


@dataclass(frozen=True, kw_only=True)
class Beam:
    """A cantilever of rectangular section, clamped at one end and free at the other.

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
    gravity_m_s2 : float

    Raises
    ------
    ValueError
        If a dimension is not finite and positive, or the values do not match each other.

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
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2

    def __post_init__(self) -> None:
        for name in _POSITIVE:
            values = np.asarray(getattr(self, name), dtype=np.float64)
            if not np.all(np.isfinite(values) & (values > 0.0)):
                msg = f"{name} must be finite and positive, got {getattr(self, name)}"
                raise ValueError(msg)
        if self.elements < 1:
            msg = f"elements must be at least 1, got {self.elements}"
            raise ValueError(msg)
        for name in ("width_mm", "thickness_mm"):
            if np.shape(getattr(self, name)) not in ((), (self.elements,)):
                msg = f"{name} must be one number or one per element ({self.elements}), got {getattr(self, name)}"
                raise ValueError(msg)
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


def natural_modes(beam: Beam | BeamProperties, count: int = DEFAULT_MODES) -> BeamModes:
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
