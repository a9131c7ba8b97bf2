"""Properties of a thin beam, element by element, its ends, its orientation relative to gravity, and units."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from tracker import FloatArray, checked


@dataclass(frozen=True)
class Tuning:
    """Properties beyond which a value is taken to be in another unit."""

    #: [kg/m3] a smaller density is refused
    #: physics: Foams for models begin there.
    least_density: float = 10.0
    #: [kg/m3] a larger density is refused
    #: physics: The densest metals end at 22 600 kg/m3.
    most_density: float = 30_000.0
    #: [MPa] a smaller modulus is refused
    #: physics: Soft rubber has 0.1 MPa.
    least_modulus: float = 1e-3
    #: [MPa] a larger modulus is refused
    #: physics: Diamond has 1.2e6 MPa.
    most_modulus: float = 2e6
    #: [kg/m3] from this density on the modulus is at least `softest_dense`
    #: physics: No material that is denser than light metals is softer.
    dense: float = 2500.0
    #: [MPa] a smaller modulus of a dense material is refused
    #: physics: As for `dense`.
    softest_dense: float = 1000.0
    #: [thicknesses] a shorter beam is refused
    #: physics: It is no thin beam.
    least_length: float = 3.0
    #: [thicknesses] a longer beam is refused
    #: physics: A tape of 1 m and 0.01 mm has 1e5.
    most_length: float = 3e5
    #: [thicknesses] a narrower beam is refused
    #: physics: It bends in the other plane.
    least_width: float = 0.05
    #: [thicknesses] a wider beam is refused
    #: physics: A foil of 0.3 m and 0.01 mm has 3e4.
    most_width: float = 3e4


TUNING = Tuning()

Orientation = Literal["hanging", "standing", "horizontal", "angled", "none"]
End = Literal["clamped", "pinned", "free", "guided"]
STANDARD_GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True)
class PointMass:
    """A small body fixed to the beam, such as a marker or a sensor.

    Attributes
    ----------
    position_m : float
        Distance from the clamp along the beam.
    mass_kg : float
    rotary_inertia_kg_m2 : float
        About the axis of bending at the point of attachment.
    """

    position_m: float
    mass_kg: float
    rotary_inertia_kg_m2: float = 0.0

    def __post_init__(self) -> None:
        for name in ("position_m", "mass_kg", "rotary_inertia_kg_m2"):
            checked(f"{name} of a point mass", getattr(self, name), at_least=0.0)

    def scaled(self, factor: float) -> PointMass:
        """A body of `factor` times this mass and rotary inertia."""
        return PointMass(self.position_m, factor * self.mass_kg, factor * self.rotary_inertia_kg_m2)


@dataclass(frozen=True)
class ElasticClamp:
    """An elastic clamp: springs between the first section of the beam and the base.

    Attributes
    ----------
    rotation_n_m_rad : float
        Stiffness k_r of the moment ``k_r sin(rotation)``.
    translation_n_m : float or None
        Force per displacement, along and across; None for a clamp that only rotates, for which a thousand times the
        axial stiffness of an element is used.
    """

    rotation_n_m_rad: float
    translation_n_m: float | None = None

    def __post_init__(self) -> None:
        checked("rotation_n_m_rad of an elastic clamp", self.rotation_n_m_rad, positive=True)
        if self.translation_n_m is not None:
            checked("translation_n_m of an elastic clamp", self.translation_n_m, positive=True)

    def scaled(self, factors: FloatArray) -> ElasticClamp:
        """The clamp with its stiffnesses multiplied by `factors`: translation, where it is given, and rotation."""
        across = None if self.translation_n_m is None else self.translation_n_m * float(factors[0])
        return ElasticClamp(self.rotation_n_m_rad * float(factors[1]), across)


@dataclass(frozen=True)
class BeamProperties:
    """A beam of rectangular section, by default a cantilever clamped at s = 0 and free at s = length, in SI units.

    Of the `ends`, at s = 0 and at s = length, "clamped" holds position and rotation, "pinned" the position, "guided"
    the rotation and the position along the beam; "free" holds nothing. Elements have equal length, each with constant
    width and thickness, arrays of shape (ne,) from the first end. The beam bends about its width: the second moment of
    area is ``width thickness^3 / 12``. Orientation "none" is a beam without weight, shown hanging; `angle_deg`, only of
    an angled beam, counts from hanging, counter-clockwise in the image (90 points right, 180 up). Without a `clamp`,
    which is that of the first end, a clamped end is rigid. The axial force `tension_n`, negative in compression, is
    that of the straight beam without weight between two ends that hold it, and the dimensions are those under it.

    Raises
    ------
    ValueError
        If a dimension is not finite and positive, the arrays do not match, a point mass is outside the beam, or `ends`,
        `clamp`, `tension_n` and weight contradict each other.
    """

    length_m: float
    width_m: FloatArray
    thickness_m: FloatArray
    density_kg_m3: float
    elastic_modulus_pa: float
    orientation: Orientation
    point_masses: tuple[PointMass, ...] = ()
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2
    angle_deg: float | None = None
    clamp: ElasticClamp | None = None
    ends: tuple[End, End] = ("clamped", "free")
    tension_n: float = 0.0

    def __post_init__(self) -> None:
        for name in ("length_m", "density_kg_m3", "elastic_modulus_pa"):
            checked(name, getattr(self, name), positive=True)
        checked("gravity_m_s2", self.gravity_m_s2, at_least=0.0)
        checked("tension_n", self.tension_n)
        if self.orientation not in get_args(Orientation):
            msg = f"orientation must be one of {', '.join(get_args(Orientation))}, got {self.orientation!r}"
            raise ValueError(msg)
        angled = self.orientation == "angled"
        if angled != (self.angle_deg is not None) or not np.isfinite(self.angle_deg or 0.0):
            msg = (
                'orientation "angled" needs a finite angle_deg, and no other orientation takes one; '
                f"got {self.angle_deg} with {self.orientation!r}"
            )
            raise ValueError(msg)
        for name in ("width_m", "thickness_m"):
            object.__setattr__(self, name, _positive_array(name, getattr(self, name)))
        if self.width_m.shape != self.thickness_m.shape:
            msg = (
                "width_m and thickness_m need one value per element, "
                f"got shapes {self.width_m.shape} and {self.thickness_m.shape}"
            )
            raise ValueError(msg)
        for point in self.point_masses:
            if point.position_m > self.length_m:
                msg = (
                    f"a point mass is {point.position_m} m from the clamp, but the beam is "
                    f"{self.length_m} m long"
                )
                raise ValueError(msg)
        self._check_ends()

    def _check_ends(self) -> None:
        ends, problem = " and ".join(map(repr, self.ends)), None
        if len(self.ends) != 2 or not set(self.ends) <= set(get_args(End)):
            problem = f"ends must be two of {', '.join(get_args(End))}"
        elif self.clamp is not None and self.ends[0] != "clamped":
            problem = "an elastic clamp is the first end of a beam and needs it clamped"
        elif self.tension_n != 0.0 and "free" in self.ends:
            problem = f"a tension of {self.tension_n} N needs two ends that hold the beam along its axis"
        elif self.orientation != "none" and self.gravity_m_s2 > 0.0 and self.rigid_body_motions:
            across = self.orientation in ("horizontal", "angled")
            if across or self.ends == ("free", "free"):
                problem = 'nothing holds this beam against its weight: neglect it with orientation "none"'
        if problem is not None:
            msg = f"{problem}; got the ends {ends} with orientation {self.orientation!r}"
            raise ValueError(msg)

    @classmethod
    def uniform(
        cls, *, width_m: float, thickness_m: float, elements: int = 20, **others: Any
    ) -> BeamProperties:
        """Build a beam with the same section in all `elements`; `others` are fields of the class."""
        if elements < 1:
            msg = f"elements must be at least 1, got {elements}"
            raise ValueError(msg)
        return cls(width_m=np.full(elements, width_m), thickness_m=np.full(elements, thickness_m), **others)

    @property
    def cantilever(self) -> bool:
        """Whether the first end is clamped, elastically or not, and the second one free."""
        return self.ends == ("clamped", "free")

    @property
    def one_section(self) -> bool:
        """Whether width and thickness are the same in all elements."""
        return bool(np.ptp(self.width_m) == 0.0 and np.ptp(self.thickness_m) == 0.0)

    @property
    def rigid_body_motions(self) -> tuple[str, ...]:
        """Motions across the beam that its ends allow without bending: "translation", "rotation"."""
        positions = sum(end in ("clamped", "pinned") for end in self.ends)
        rotations = sum(end in ("clamped", "guided") for end in self.ends)
        free = {"translation": positions == 0, "rotation": rotations == 0 and positions < 2}
        return tuple(name for name, moves in free.items() if moves)

    @property
    def elements(self) -> int:
        """Number of elements."""
        return int(self.width_m.size)

    @property
    def area_m2(self) -> FloatArray:
        """Area of the section of each element, shape (ne,)."""
        return self.width_m * self.thickness_m

    @property
    def second_moment_m4(self) -> FloatArray:
        """Second moment of area of each element, shape (ne,)."""
        return self.width_m * self.thickness_m**3 / 12.0

    @property
    def mass_kg(self) -> float:
        """Mass of the beam with its point masses."""
        own = self.density_kg_m3 * self.length_m * float(np.mean(self.area_m2))
        return own + sum(point.mass_kg for point in self.point_masses)

    def scaled(
        self,
        *,
        width: float | FloatArray = 1.0,
        thickness: float | FloatArray = 1.0,
        density: float = 1.0,
        elastic_modulus: float = 1.0,
        point_masses: float | FloatArray = 1.0,
        clamp: FloatArray | None = None,
    ) -> BeamProperties:
        """The beam with its properties multiplied by factors: one, or one per element or point mass.

        `clamp` has those of the clamp's translational and rotational stiffness, of which both must be given.
        """
        factors = np.broadcast_to(point_masses, len(self.point_masses))
        return replace(
            self,
            width_m=self.width_m * width,
            thickness_m=self.thickness_m * thickness,
            density_kg_m3=self.density_kg_m3 * density,
            elastic_modulus_pa=self.elastic_modulus_pa * elastic_modulus,
            point_masses=tuple(p.scaled(float(f)) for p, f in zip(self.point_masses, factors, strict=True)),
            clamp=self.clamp if clamp is None or self.clamp is None else self.clamp.scaled(clamp),
        )


def _positive_array(name: str, values: FloatArray) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    if array.ndim != 1 or array.size == 0:
        msg = f"{name} must have one value per element, shape (ne,); got shape {array.shape}"
        raise ValueError(msg)
    if not np.all(np.isfinite(array) & (array > 0.0)):
        msg = f"{name} must be finite and positive in every element; the smallest is {np.min(array)}"
        raise ValueError(msg)
    array.setflags(write=False)
    return array


def unit_problems(
    length_mm: float | None,
    width_mm: float | None,
    thickness_mm: float | None,
    density_kg_m3: float | None,
    elastic_modulus_mpa: float | None,
) -> Iterator[str]:
    """Sentences about properties of a beam that cannot be in the units of their keys, with the likely ones."""
    yield from _of_material(density_kg_m3, elastic_modulus_mpa)
    for name, value, (least, most) in (
        ("length_mm", length_mm, (TUNING.least_length, TUNING.most_length)),
        ("width_mm", width_mm, (TUNING.least_width, TUNING.most_width)),
    ):
        if value is None or thickness_mm is None or least <= value / thickness_mm <= most:
            continue
        small, large = (name, "thickness_mm") if value < least * thickness_mm else ("thickness_mm", name)
        size = {name: value, "thickness_mm": thickness_mm}
        yield (
            f"{name} = {value:g} and thickness_mm = {thickness_mm:g} are not those of a beam that bends; if {small} is "
            f"in metres, write {1e3 * size[small]:g}; if {large} is in micrometres, write {1e-3 * size[large]:g}"
        )


def _of_material(density_kg_m3: float | None, elastic_modulus_mpa: float | None) -> Iterator[str]:
    if density_kg_m3 is not None and not TUNING.least_density <= density_kg_m3 <= TUNING.most_density:
        unit, factor = ("g/cm3", 1e3) if density_kg_m3 < TUNING.least_density else ("g/m3", 1e-3)
        density_kg_m3, found = factor * density_kg_m3, density_kg_m3
        yield (
            f"density_kg_m3 = {found:g} is that of no material of beams; if it is in {unit}, write {density_kg_m3:g}"
        )
    if elastic_modulus_mpa is None:
        return
    if elastic_modulus_mpa > TUNING.most_modulus:
        yield (
            f"elastic_modulus_mpa = {elastic_modulus_mpa:g} is that of no material; if it is in Pa, write "
            f"{1e-6 * elastic_modulus_mpa:g}"
        )
    dense = density_kg_m3 is not None and density_kg_m3 >= TUNING.dense
    if elastic_modulus_mpa < (TUNING.softest_dense if dense else TUNING.least_modulus):
        yield (
            f"elastic_modulus_mpa = {elastic_modulus_mpa:g} is that of no material"
            f"{f' of {density_kg_m3:g} kg/m3' if dense else ''}; if it is in GPa, write {1e3 * elastic_modulus_mpa:g}"
        )
