r"""Planar thin beam in the absolute nodal coordinate formulation (ANCF): the cable element of Berzeri and Shabana.

Each node carries its position and the derivative of position along the beam, four coordinates; an element has eight
and cubic shape functions. With r' and r'' the derivatives of the position along the undeformed axis,

.. math::  U = \tfrac12 \int EA\,\varepsilon^2 + EI\,|r''|^2 \; dx, \qquad \varepsilon = (r' \cdot r' - 1)/2 .

The bending energy uses \|r''\|^2 instead of the squared curvature, kappa = \|r' x r''\| / \|r'\|^3. For a thin beam
\|r'\| - 1 is of the order of 1e-6, so the two agree far within the error of the mesh, while the bending matrix is
constant and the only nonlinear term is a polynomial. The difference is EI (d eps/dx)^2 / 2, relative to the axial
energy of the order of (thickness / element length)^2.

Five Gauss points integrate the axial energy exactly; the default is three. They soften the axial strain that the cubic
shapes cannot relax, which makes large bending slightly more accurate: bent to a full circle with 20 elements, the tip
is off by 3e-5 of the length instead of 7e-5; of the paper's beam, horizontal and sagging, mode 5 is off by 1.7e-3
instead of 2.4e-3. The frequencies of a straight beam change by less than 1e-7.

Frame: x along the undeformed axis from the clamp, y across it ("transverse"). In the image (x right, y up) the axis of
a hanging beam points down and transverse is right, of a standing one up and right, of a horizontal one right and up.
The four coordinates of a rigid clamp at x = 0 are eliminated; those that another end holds stay in a state, held by
springs, and are left out of modes. A moving clamp translates the whole frame, which does not affect the elastic forces
and enters as inertia only.

The unknowns are displacements from the straight unstrained beam, not positions: the axial strain is then a sum of small
numbers, so that round-off affects neither the stiff axial force nor small vibrations.

References
----------
Berzeri, Shabana, "Development of simple models for the elastic forces in the absolute nodal coordinate formulation",
J. Sound Vib. 235 (2000) 539-565, doi:10.1006/jsvi.1999.2935 (models L1 of bending and S of stretch).
Gerstmayr, Shabana, "Analysis of thin beams and cables using the absolute nodal co-ordinate formulation",
Nonlinear Dyn. 45 (2006) 109-130, doi:10.1007/s11071-006-1856-1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim.beam.banded import BAND, from_band, to_band
from sim.beam.elastic import elastic
from sim.beam.properties import BeamProperties, End, Orientation, PointMass
from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """Choices of the element."""

    #: [1] Gauss points of the axial strain energy of an element where the caller names none; 5 are exact
    #: measurement: Bent to a full circle the tip is off by 3e-5 (5: 7e-5), mode 5 of a sagging beam by 1.7e-3 (5:
    #: 2.4e-3).
    gauss_points: int = 3
    #: [1] translational stiffness of a clamp that only rotates, over EA / h of an element
    #: physics: In series with 3 EI / L^3 it adds (t / L)^2 h / (4000 L) of the compliance: 1e-11 for the paper's beam.
    held_by: float = 1e3
    #: [1] stiffness that holds a coordinate of a pinned, guided or second clamped end in a state, over EA / h
    #: physics: In series with EA / L of the beam it adds 1e-9 h / L of the compliance along the axis; less across it.
    fixed_by: float = 1e9
    #: [EI / (m L^3)] square of the angular frequency that rigid-body motions have in the static equilibrium
    #: measurement: From 0.2 mm the decay of the paper's beam, pinned and free, is off by 3e-4 of that, with or without
    #: weight; with 1e-3 without weight by 3e-2 (loads that turn), with 1 hanging by 2e-3 (the pendulum).
    anchored_by: float = 0.1
    #: [lengths] a point this far beyond an end still lies on the beam; beyond, it is an error
    #: physics: Above the rounding of positions converted from mm, 1e-16, below what can be measured, 1e-5.
    slack: float = 1e-9


TUNING = Tuning()

# direction of the undeformed axis and of the transverse displacement in the image (x right, y up)
_AXES: dict[Orientation, tuple[tuple[float, float], tuple[float, float]]] = {
    "hanging": ((0.0, -1.0), (1.0, 0.0)),
    "none": ((0.0, -1.0), (1.0, 0.0)),
    "standing": ((0.0, 1.0), (1.0, 0.0)),
    "horizontal": ((1.0, 0.0), (0.0, 1.0)),
}

# coordinates of a node that an end holds
_FIXED: dict[End, tuple[int, ...]] = {
    "clamped": (0, 1, 2, 3),
    "pinned": (0, 1),
    "guided": (0, 2, 3),
    "free": (),
}


def shape_functions(xi: FloatArray, length_m: float, derivative: int = 0) -> FloatArray:
    """Cubic shape functions of the element, or a derivative (0, 1, 2) along the beam; (g,) to (g, 4).

    `xi` is the position within the element, 0 to 1; columns are for position and slope of the first node, then of the
    second.
    """
    x, h = np.asarray(xi, dtype=np.float64), length_m
    if derivative == 0:
        columns = (1 - 3 * x**2 + 2 * x**3, h * (x - 2 * x**2 + x**3), 3 * x**2 - 2 * x**3, h * (x**3 - x**2))
    elif derivative == 1:
        columns = ((6 * x**2 - 6 * x) / h, 1 - 4 * x + 3 * x**2, (6 * x - 6 * x**2) / h, 3 * x**2 - 2 * x)
    else:
        columns = ((12 * x - 6) / h**2, (6 * x - 4) / h, (6 - 12 * x) / h**2, (6 * x - 2) / h)
    return np.ascontiguousarray(np.array(columns).T)


@dataclass(frozen=True)
class ElasticState:
    """Elastic response at one state.

    Generalised force, (ndof,), its derivative in band form, (ndof, 15), the part of that which stretches the axis, and
    the strain energy.
    """

    force_n: FloatArray
    tangent: FloatArray
    axial_tangent: FloatArray
    energy_j: float


@dataclass(frozen=True)
class AncfBeam:
    """Assembled arrays of a beam, with 4 coordinates per element, and 4 more unless the first end is a rigid clamp.

    A state holds the displacements of these coordinates from the straight unstrained beam, node by node: (axial,
    transverse, axial slope, transverse slope), relative to the clamp. Of the `gauss_points` for the axial strain energy
    5 are exact and 3 the default (see above).
    """

    properties: BeamProperties
    gauss_points: int = field(default_factory=lambda: TUNING.gauss_points)

    def __post_init__(self) -> None:
        if not 2 <= self.gauss_points <= 10:
            msg = f"gauss_points must lie between 2 and 10, got {self.gauss_points}"
            raise ValueError(msg)

    @cached_property
    def element_length_m(self) -> float:
        """Length of each element."""
        return self.properties.length_m / self.properties.elements

    @cached_property
    def axial_stiffness_n(self) -> FloatArray:
        """EA of each element, shape (ne,)."""
        return self.properties.elastic_modulus_pa * self.properties.area_m2

    @cached_property
    def dshape(self) -> FloatArray:
        """First derivatives of the shape functions at the Gauss points, shape (g, 4)."""
        nodes, _ = np.polynomial.legendre.leggauss(self.gauss_points)
        return shape_functions(0.5 * (nodes + 1.0), self.element_length_m, 1)

    @cached_property
    def curvature(self) -> FloatArray:
        """Second derivatives of the shape functions at two Gauss points, which are exact for bending, shape (2, 4)."""
        nodes, _ = np.polynomial.legendre.leggauss(2)
        return shape_functions(0.5 * (nodes + 1.0), self.element_length_m, 2)

    @cached_property
    def weight_m(self) -> FloatArray:
        """Gauss weights times half the length of an element, shape (g,)."""
        _, weights = np.polynomial.legendre.leggauss(self.gauss_points)
        return np.asarray(0.5 * self.element_length_m * weights)

    @cached_property
    def mass_kg(self) -> FloatArray:
        """Consistent mass matrix with the point masses, band form, shape (ndof, 15)."""
        return to_band(self._mass_with_clamp[self.held :, self.held :])

    @cached_property
    def bending_n_m(self) -> FloatArray:
        """Constant stiffness of bending, tension and elastic or held ends, band form, shape (ndof, 15)."""
        p = self.properties
        # two Gauss points are exact for bending
        bending = self._assembled(
            p.elastic_modulus_pa * p.second_moment_m4, self.integral(2, 2), self.tensioned_n_m
        )
        stiffness = (bending + self._clamp_springs())[self.held :, self.held :]
        held = TUNING.fixed_by * np.max(self.axial_stiffness_n) / self.element_length_m
        stiffness[self.fixed, self.fixed] += held * self.dof_scale[self.fixed] ** 2
        return to_band(stiffness)

    @cached_property
    def weight_load_n(self) -> FloatArray:
        """Generalised weight, shape (ndof,)."""
        return self._translation_kg @ self.gravity_m_s2

    @cached_property
    def base_coupling_kg(self) -> FloatArray:
        """Inertia force on the free coordinates for a unit transverse acceleration of the clamp, shape (ndof,)."""
        return self._translation_kg[:, 1].copy()

    @property
    def ndof(self) -> int:
        """Number of coordinates of a state."""
        return 4 * (self.properties.elements + 1) - self.held

    @property
    def held(self) -> int:
        """Number of coordinates that a rigid clamp at the first end eliminates."""
        return 4 if self.properties.clamp is None and self.properties.ends[0] == "clamped" else 0

    @cached_property
    def fixed(self) -> NDArray[np.int64]:
        """Indices of the held coordinates within a state, which are zero in every mode."""
        first, last = (np.array(_FIXED[end], dtype=np.int64) for end in self.properties.ends)
        if self.properties.ends[0] == "clamped":
            first = first[:0]
        return np.concatenate([first, self.ndof - 4 + last])

    @cached_property
    def free(self) -> NDArray[np.int64]:
        """Indices of the coordinates that can move, counted with those of a rigid clamp."""
        return self.held + np.setdiff1d(np.arange(self.ndof), self.fixed)

    @cached_property
    def anchor_n_m(self) -> FloatArray:
        """Stiffness that keeps rigid-body motions from making a static equilibrium singular, shape (ndof, ndof).

        Zero for a beam that its ends hold. A load that does no work on these motions does not depend on it.
        """
        p, motions = self.properties, self.properties.rigid_body_motions
        rigid = np.zeros((self.ndof // 4, 4, len(motions) + (p.ends == ("free", "free"))))
        along = np.linspace(0.0, p.length_m, self.ndof // 4)
        for k, motion in enumerate(motions):
            pivot = 0.5 if p.ends == ("free", "free") else float(p.ends[1] == "pinned")
            rigid[:, 1, k] = 1.0 if motion == "translation" else along - pivot * p.length_m
            rigid[:, 3, k] = motion == "rotation"
        rigid[:, 0, len(motions) :] = 1.0
        shapes = rigid.reshape(self.ndof, -1)
        momentum = self.mass_matrix() @ shapes
        square = p.elastic_modulus_pa * np.mean(p.second_moment_m4) / (p.mass_kg * p.length_m**3)
        return np.asarray(
            TUNING.anchored_by * square * momentum @ np.linalg.solve(shapes.T @ momentum, momentum.T)
        )

    @property
    def axis(self) -> tuple[float, float]:
        """Direction of the undeformed beam in the image (x right, y up)."""
        return self._axes[0]

    @property
    def transverse(self) -> tuple[float, float]:
        """Direction of positive transverse displacement in the image (x right, y up)."""
        return self._axes[1]

    @property
    def _axes(self) -> tuple[tuple[float, float], tuple[float, float]]:
        p = self.properties
        if p.angle_deg is None:
            return _AXES[p.orientation]
        sine, cosine = np.sin(np.radians(p.angle_deg)), np.cos(np.radians(p.angle_deg))
        return (float(sine), -float(cosine)), (float(cosine), float(sine))

    @cached_property
    def dof_scale(self) -> FloatArray:
        """Displacement in m that corresponds to one unit of each coordinate, shape (ndof,)."""
        h = self.element_length_m
        return np.tile([1.0, 1.0, h, h], self.ndof // 4)

    def elastic(self, q: FloatArray) -> ElasticState:
        """Elastic force, tangent and energy at the state `q`, shape (ndof,)."""
        n = self.ndof
        force, tangent, axial = np.empty(n), np.empty((n, BAND)), np.empty((n, BAND))
        energy = elastic(
            np.ascontiguousarray(q, dtype=np.float64),
            self.dshape,
            self.weight_m,
            self.axial_stiffness_n,
            self.bending_n_m,
            force,
            tangent,
            axial,
        )
        return ElasticState(force, tangent, axial, float(energy))

    def second_variation(
        self,
        q: FloatArray,
        v: FloatArray,
        bend: FloatArray | None = None,
        axial: FloatArray | None = None,
        grip: FloatArray | float = 1.0,
    ) -> FloatArray:
        """``v^T K(q) v`` as a sum over the strains and curvatures of the elements, shape (..., f).

        K holds axial and bending stiffness seven decades apart, and its rounding hides the energy of a low mode. The
        sum does not: for modes of relative error e it is in error by the order of e squared.

        Parameters
        ----------
        q, v : array, shape (..., 4 (ne + 1)) and (..., f, 4 (ne + 1))
            States and motions over all coordinates, those of the clamp first; NaN where `q` is NaN.
        bend, axial : array, shape (..., ne), optional
            EI in N m2 and EA in N of the elements, for beams that differ from this one in them.
        grip : array, shape (..., 2), optional
            Factors on the stiffness of an elastic clamp against translation and rotation.
        """
        p = self.properties
        bend = p.elastic_modulus_pa * p.second_moment_m4 if bend is None else bend
        axial = self.axial_stiffness_n if axial is None else axial
        by_element = self.elements(v)
        strain, turned = self.strained(q)
        slope, curve = by_element @ self.dshape.T, by_element @ self.curvature.T
        stretch, square = (
            np.sum(slope * turned[..., np.newaxis, :, :, :], axis=-2) ** 2,
            np.sum(slope**2, axis=-2),
        )
        stretch = (stretch + strain[..., np.newaxis, :, :] * square) @ self.weight_m
        bending = 0.5 * self.element_length_m * np.sum(curve**2, axis=(-2, -1))
        energy = np.sum(stretch * axial[..., np.newaxis, :] + bending * bend[..., np.newaxis, :], axis=-1)
        energy = energy + p.tension_n * np.sum(square @ self.weight_m, axis=-1)
        springs = np.stack(np.broadcast_arrays(*self.springs(axial)), axis=-1) * grip
        root = np.sum(by_element[..., 0, :, :2] ** 2, axis=-2)
        return np.asarray(energy + np.sum(springs[..., np.newaxis, :] * root, axis=-1))

    def elements(self, full: NDArray[Any]) -> NDArray[Any]:
        """Coordinates by element, direction and shape function, (..., 4 (ne + 1)) to (..., ne, 2, 4)."""
        return np.asarray(full[..., self.element_indices])

    @cached_property
    def element_indices(self) -> NDArray[np.int64]:
        """Indices of each element's coordinates among all, shape (ne, 2, 4)."""
        first = 4 * np.arange(self.properties.elements)[:, np.newaxis, np.newaxis]
        return np.asarray(first + np.arange(8).reshape(4, 2).T)

    def strained(self, q: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Green strain at the Gauss points, (..., ne, g), and the tangent vector r' there, (..., ne, 2, g)."""
        slope = self.elements(q) @ self.dshape.T
        strain = slope[..., 0, :] + 0.5 * np.sum(slope * slope, axis=-2)
        return strain, slope + np.array([[1.0], [0.0]])

    def mass_matrix(self) -> FloatArray:
        """Dense `mass_kg`, shape (ndof, ndof)."""
        return from_band(self.mass_kg)

    def interpolation(self, s_m: FloatArray, derivative: int = 0) -> FloatArray:
        """Matrix from nodal values of one direction to values, or derivatives, at the points `s_m`; shape (k, 2 ne).

        Columns are displacement and slope of each free node in turn.

        Raises
        ------
        ValueError
            If a point does not lie on the beam.
        """
        p, h = self.properties, self.element_length_m
        s = np.atleast_1d(np.asarray(s_m, dtype=np.float64))
        slack = TUNING.slack * p.length_m
        if not np.all((s >= -slack) & (s <= p.length_m + slack)):
            msg = f"points must lie between 0 and {p.length_m} m from the clamp, got {s.tolist()}"
            raise ValueError(msg)
        # truncated towards zero: a point before the clamp is in the first element
        element = np.minimum((s / h).astype(np.int64), p.elements - 1)[:, np.newaxis]
        full = np.zeros((s.size, 2 * (p.elements + 1)))
        columns = 2 * element + np.arange(4)
        full[np.arange(s.size)[:, np.newaxis], columns] = shape_functions(
            s / h - element[:, 0], h, derivative
        )
        return full[:, self.held // 2 :]

    def transverse_at(self, s_m: FloatArray, q: FloatArray) -> FloatArray:
        """Transverse displacement at `s_m`, relative to the clamp; (..., ndof) to (..., k)."""
        return _direction(q, 1) @ self.interpolation(s_m).T

    def points(
        self, s_m: FloatArray, q: FloatArray, base_m: FloatArray | float = 0.0
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position and rotation of the points `s_m`, (k,), in the image, with the clamp at rest at the origin.

        For `q` of shape (ndof,) or (n, ndof) and the transverse displacement of the clamp: x (right), y (up) and the
        rotation from the undeformed direction, counter-clockwise, each (k,) or (n, k).
        """
        return self.moved(s_m, q, base_m)[:3]

    def moved(
        self, s_m: FloatArray, q: FloatArray, base_m: FloatArray | float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """`points`, and the displacements along and across the beam relative to the clamp."""
        shapes = self.interpolation(s_m).T
        axial_m, transverse_m = _direction(q, 0) @ shapes, _direction(q, 1) @ shapes
        along = s_m + axial_m
        across = transverse_m + np.asarray(base_m)[..., np.newaxis]
        slopes = self.interpolation(s_m, 1).T
        angle = np.arctan2(_direction(q, 1) @ slopes, 1.0 + _direction(q, 0) @ slopes)
        (ax, ay), (tx, ty) = self.axis, self.transverse
        handed = np.sign(ax * ty - ay * tx)
        return ax * along + tx * across, ay * along + ty * across, handed * angle, axial_m, transverse_m

    @cached_property
    def gravity_m_s2(self) -> FloatArray:
        """Gravity along and across the beam, shape (2,)."""
        if self.properties.orientation == "none":
            return np.zeros(2)
        return -self.properties.gravity_m_s2 * np.array([self.axis[1], self.transverse[1]])

    def integral(self, derivative: int, points: int) -> FloatArray:
        """Products of the shape functions, or of a derivative, integrated over an element; shape (4, 4)."""
        nodes, weights = np.polynomial.legendre.leggauss(points)
        shapes = shape_functions(0.5 * (nodes + 1.0), self.element_length_m, derivative)
        return np.asarray(np.einsum("g,gk,gl->kl", 0.5 * self.element_length_m * weights, shapes, shapes))

    def bodies_kg(self, points: Sequence[PointMass]) -> FloatArray:
        """Inertia of point masses in one direction over all nodes, (displacement, slope) each."""
        mass = np.zeros((2 * (self.properties.elements + 1),) * 2)
        for point in points:
            # |dr'/dt| is the rate of rotation, apart from the rate of strain
            for inertia, derivative in ((point.mass_kg, 0), (point.rotary_inertia_kg_m2, 1)):
                at = np.zeros(mass.shape[0])
                at[self.held // 2 :] = self.interpolation(np.array([point.position_m]), derivative)[0]
                mass += inertia * np.outer(at, at)
        return mass

    @cached_property
    def tensioned_n_m(self) -> FloatArray:
        """Stiffness of the tension at rest in one direction over all nodes, (displacement, slope) each.

        Of its work ``T int eps dx`` the ends carry what is linear in the displacement.
        """
        p = self.properties
        return self._assembled(np.full(p.elements, p.tension_n), self.integral(1, 3))[::2, ::2]

    def _assembled(
        self, values: FloatArray, unit: FloatArray, constant: FloatArray | float = 0.0
    ) -> FloatArray:
        """Matrix over all coordinates, both directions alike, of multiples of an element's matrix, (ne,) and (4, 4)."""
        one = np.zeros((2 * (self.properties.elements + 1),) * 2)
        for e, value in enumerate(values):
            one[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += value * unit
        return np.asarray(np.kron(one + constant, np.eye(2)), dtype=np.float64)

    @cached_property
    def _mass_with_clamp(self) -> FloatArray:
        p = self.properties
        bodies = self.bodies_kg(p.point_masses)
        return self._assembled(p.density_kg_m3 * p.area_m2, self.integral(0, 4), bodies)

    @cached_property
    def _translation_kg(self) -> FloatArray:
        """Inertia of the free coordinates for a unit translation along and across the beam, shape (ndof, 2)."""
        mass = self._mass_with_clamp
        rigid = np.zeros((mass.shape[0], 2))
        rigid[0::4, 0] = 1.0
        rigid[1::4, 1] = 1.0
        return np.asarray((mass @ rigid)[self.held :])

    def _clamp_springs(self) -> FloatArray:
        """Stiffness of an elastic clamp over all coordinates, those of the clamp included; zero for a rigid clamp."""
        springs = np.zeros((4 * (self.properties.elements + 1),) * 2)
        displacement, rotation = self.springs(self.axial_stiffness_n)
        springs[[0, 1], [0, 1]] = displacement
        # k |r' - e|^2 / 2 = k (1 - cos) for an unstretched section
        springs[[2, 3], [2, 3]] = rotation
        return springs

    def springs(self, axial: NDArray[Any]) -> tuple[NDArray[Any], float]:
        """Stiffness of the clamp, N/m and N m/rad, for EA of the elements, shape (..., ne); zero for a rigid one."""
        clamp = self.properties.clamp
        if clamp is None:
            return np.zeros(axial.shape[:-1]), 0.0
        held = TUNING.held_by * axial[..., 0] / self.element_length_m
        return (held if clamp.translation_n_m is None else np.full_like(held, clamp.translation_n_m)), (
            clamp.rotation_n_m_rad
        )


def _direction(q: FloatArray, component: int) -> FloatArray:
    """Values (displacement, slope) of each free node in one direction; (..., 4 ne) to (..., 2 ne)."""
    return np.asarray(q, dtype=np.float64)[..., component::2]
