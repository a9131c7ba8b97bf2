r"""Planar thin beam in the absolute nodal coordinate formulation (ANCF): the cable element of Berzeri and Shabana.

Each node carries its position and the derivative of position along the beam, four coordinates; an element has eight
and cubic shape functions. With r' and r'' the derivatives of the position along the undeformed axis,

.. math::  U = \tfrac12 \int EA\,\varepsilon^2 + EI\,|r''|^2 \; dx, \qquad \varepsilon = (r' \cdot r' - 1)/2 .

The bending energy uses \|r''\|^2 in place of the curvature squared, kappa = \|r' x r''\| / \|r'\|^3: for a thin beam
\|r'\| - 1 is of the order 1e-6, so both agree far below the error of the mesh, while the bending matrix is constant
and the only non-linear part is a polynomial. What the substitution adds is EI (d eps/dx)^2 / 2, small as (thickness /
element length)^2 beside the axial energy.

Five Gauss points integrate the axial energy exactly, three are the default: they soften the axial strain that the cubic
shapes cannot relax, which makes large bending slightly more accurate (rolled up to a circle by 20 elements,
the tip is off by 3e-5 of the length instead of 7e-5) and moves the frequencies of small vibration by less than 1e-7.

Frame: x along the undeformed axis from the clamp, y across it ("transverse"). In the picture (x right, y up) the
axis of a hanging beam points down and transverse is right, of a standing one up and right, of a horizontal one
right and up. The clamp's four coordinates are eliminated; a moving clamp is a translation of the whole frame, which
the elastic forces do not see and which enters as inertia only.

References
----------
Berzeri, Shabana, "Development of simple models for the elastic forces in the absolute nodal coordinate formulation",
J. Sound Vib. 235 (2000) 539-565, doi:10.1006/jsvi.1999.2935 (models L1 of bending and S of stretch).
Gerstmayr, Shabana, "Analysis of thin beams and cables using the absolute nodal co-ordinate formulation",
Nonlinear Dyn. 45 (2006) 109-130, doi:10.1007/s11071-006-1856-1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from sim.beam.ancf_kernels import elastic
from sim.beam.banded import BAND, PAD
from sim.beam.exact_curvature import assembled_bending
from sim.beam.properties import BeamProperties, Orientation
from tracker.arrays import FloatArray

DEFAULT_GAUSS_POINTS = 3
_EXACT_GAUSS_POINTS = 5
# multiple of an element's axial stiffness that holds an elastic clamp's translation where it is not given
HELD_BY = 1e3

# direction of the undeformed axis and of the transverse displacement in the picture (x right, y up)
_AXES: dict[Orientation, tuple[tuple[float, float], tuple[float, float]]] = {
    "hanging": ((0.0, -1.0), (1.0, 0.0)),
    "none": ((0.0, -1.0), (1.0, 0.0)),
    "standing": ((0.0, 1.0), (1.0, 0.0)),
    "horizontal": ((1.0, 0.0), (0.0, 1.0)),
}


def shape_functions(xi: FloatArray, length_m: float, derivative: int = 0) -> FloatArray:
    """Cubic shape functions of the element, or a derivative of them along the beam.

    Parameters
    ----------
    xi : array, shape (g,)
        Place within the element, 0 to 1.
    length_m : float
        Length of the element.
    derivative : {0, 1, 2}

    Returns
    -------
    array, shape (g, 4)
        For position and slope of the first node, then of the second.
    """
    x, h = np.asarray(xi, dtype=np.float64), length_m
    if derivative == 0:
        columns = (1 - 3 * x**2 + 2 * x**3, h * (x - 2 * x**2 + x**3), 3 * x**2 - 2 * x**3, h * (x**3 - x**2))
    elif derivative == 1:
        columns = ((6 * x**2 - 6 * x) / h, 1 - 4 * x + 3 * x**2, (6 * x - 6 * x**2) / h, 3 * x**2 - 2 * x)
    else:
        columns = ((12 * x - 6) / h**2, (6 * x - 4) / h, (6 - 12 * x) / h**2, (6 * x - 2) / h)
    return np.stack(columns, axis=-1)


@dataclass(frozen=True)
class ElasticState:
    """Elastic response at one state.

    Attributes
    ----------
    force_n : array, shape (ndof,)
        Generalised elastic force (gradient of the strain energy).
    tangent : array, shape (ndof, 15)
        Its derivative, in the band form of `sim.beam.banded`.
    axial_tangent : array, shape (ndof, 15)
        The part of `tangent` that stretches the axis.
    energy_j : float
    """

    force_n: FloatArray
    tangent: FloatArray
    axial_tangent: FloatArray
    energy_j: float


@dataclass(frozen=True)
class AncfBeam:
    """Assembled arrays of a beam: ndof = 4 elements, or 4 more where the clamp is elastic; a rigid one is eliminated.

    A state is the displacement of the free coordinates from the straight unstrained beam, node by node:
    (axial, transverse, axial slope, transverse slope), relative to the clamp.

    Attributes
    ----------
    properties : BeamProperties
    gauss_points : int
        For the axial strain energy; five integrate it exactly, three are the default (see above).
    curvature : {"simple", "exact"}
        Of the bending energy; the exact one is for checks of statics and modes, the time stepping does not have it.
    """

    properties: BeamProperties
    gauss_points: int = DEFAULT_GAUSS_POINTS
    curvature: Literal["simple", "exact"] = "simple"

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
    def weight_m(self) -> FloatArray:
        """Gauss weights times half the element's length, shape (g,)."""
        _, weights = np.polynomial.legendre.leggauss(self.gauss_points)
        return np.asarray(0.5 * self.element_length_m * weights)

    @cached_property
    def mass_kg(self) -> FloatArray:
        """Constant consistent mass matrix with the point masses, band form, shape (ndof, 15)."""
        return to_band(self._mass_with_clamp[self.held :, self.held :])

    @cached_property
    def bending_n_m(self) -> FloatArray:
        """Constant stiffness of bending with the simple curvature, and of an elastic clamp; band form, (ndof, 15)."""
        return to_band((self._assemble_bending() + self._clamp_springs())[self.held :, self.held :])

    @cached_property
    def weight_load_n(self) -> FloatArray:
        """Generalised weight, shape (ndof,)."""
        return self._translation_kg @ self._gravity_m_s2()

    @cached_property
    def base_coupling_kg(self) -> FloatArray:
        """Inertia of the free coordinates against a unit transverse acceleration of the clamp, shape (ndof,)."""
        return self._translation_kg[:, 1].copy()

    @property
    def ndof(self) -> int:
        """Number of free coordinates."""
        return 4 * (self.properties.elements + 1) - self.held

    @property
    def held(self) -> int:
        """Coordinates that a rigid clamp takes away."""
        return 4 if self.properties.clamp is None else 0

    @property
    def axis(self) -> tuple[float, float]:
        """Direction of the undeformed beam in the picture (x right, y up)."""
        return self._axes[0]

    @property
    def transverse(self) -> tuple[float, float]:
        """Direction of positive transverse displacement in the picture (x right, y up)."""
        return self._axes[1]

    @property
    def _axes(self) -> tuple[tuple[float, float], tuple[float, float]]:
        p = self.properties
        if p.angle_deg is None:
            return _AXES[p.orientation]
        sine, cosine = np.sin(np.radians(p.angle_deg)), np.cos(np.radians(p.angle_deg))
        return (float(sine), -float(cosine)), (float(cosine), float(sine))

    @property
    def dof_scale(self) -> FloatArray:
        """Metres of displacement by which one unit of each coordinate counts, shape (ndof,)."""
        h = self.element_length_m
        return np.tile([1.0, 1.0, h, h], self.ndof // 4)

    def elastic(self, q: FloatArray) -> ElasticState:
        """Elastic force, tangent and energy at the state `q`, shape (ndof,)."""
        n = self.ndof
        force, tangent, axial = np.empty(n), np.empty((n, BAND)), np.empty((n, BAND))
        exact = self.curvature == "exact"
        constant = to_band(self._clamp_springs()[self.held :, self.held :]) if exact else self.bending_n_m
        energy = elastic(
            np.ascontiguousarray(q, dtype=np.float64),
            self.dshape,
            self.weight_m,
            self.axial_stiffness_n,
            constant,
            force,
            tangent,
            axial,
        )
        if exact:
            bent_j, bent_n, bent_tangent = self._exact_bending(q)
            energy, force, tangent = energy + bent_j, force + bent_n, tangent + bent_tangent
        return ElasticState(force, tangent, axial, float(energy))

    def mass_matrix(self) -> FloatArray:
        """Constant consistent mass matrix with the point masses, shape (ndof, ndof)."""
        return from_band(self.mass_kg)

    def interpolation(self, s_m: FloatArray, derivative: int = 0) -> FloatArray:
        """Matrix that takes one direction's nodal values to the points `s_m`.

        Parameters
        ----------
        s_m : array, shape (k,)
            Distance from the clamp along the undeformed beam.
        derivative : {0, 1, 2}

        Returns
        -------
        array, shape (k, 2 ne)
            For the values (displacement, slope) of each free node in turn.

        Raises
        ------
        ValueError
            If a point does not lie on the beam.
        """
        p, h = self.properties, self.element_length_m
        s = np.atleast_1d(np.asarray(s_m, dtype=np.float64))
        slack = 1e-9 * p.length_m
        if not np.all((s >= -slack) & (s <= p.length_m + slack)):
            msg = f"points must lie between 0 and {p.length_m} m from the clamp, got {s.tolist()}"
            raise ValueError(msg)
        element = np.clip((s / h).astype(np.int64), 0, p.elements - 1)
        shapes = shape_functions(s / h - element, h, derivative)
        full = np.zeros((s.size, 2 * (p.elements + 1)))
        for k in range(4):
            full[np.arange(s.size), 2 * element + k] = shapes[:, k]
        return full[:, self.held // 2 :]

    def transverse_at(self, s_m: FloatArray, q: FloatArray) -> FloatArray:
        """Transverse displacement at `s_m`, relative to the clamp; (..., ndof) to (..., k)."""
        return _direction(q, 1) @ self.interpolation(s_m).T

    def axial_at(self, s_m: FloatArray, q: FloatArray) -> FloatArray:
        """Displacement along the undeformed beam at `s_m`, relative to the clamp; (..., ndof) to (..., k)."""
        return _direction(q, 0) @ self.interpolation(s_m).T

    def points(
        self, s_m: FloatArray, q: FloatArray, base_m: FloatArray | float = 0.0
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Place and rotation of material points in the picture, the clamp at rest at its origin.

        Parameters
        ----------
        s_m : array, shape (k,)
        q : array, shape (ndof,) or (n, ndof)
        base_m : float or array, shape (n,)
            Transverse displacement of the clamp.

        Returns
        -------
        x_m, y_m, angle_rad : array, shape (k,) or (n, k)
            Right and up; rotation from the undeformed direction, counter-clockwise in the picture.
        """
        s = np.atleast_1d(np.asarray(s_m, dtype=np.float64))
        shapes = self.interpolation(s).T
        return self.placed(s, _direction(q, 0) @ shapes, _direction(q, 1) @ shapes, q, base_m)

    def placed(
        self,
        s_m: FloatArray,
        axial_m: FloatArray,
        transverse_m: FloatArray,
        q: FloatArray,
        base_m: FloatArray | float,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """`points` whose displacements are known already."""
        along = s_m + axial_m
        across = transverse_m + np.asarray(base_m)[..., np.newaxis]
        slopes = self.interpolation(s_m, 1).T
        turn = np.arctan2(_direction(q, 1) @ slopes, 1.0 + _direction(q, 0) @ slopes)
        (ax, ay), (tx, ty) = self.axis, self.transverse
        handed = np.sign(ax * ty - ay * tx)
        return ax * along + tx * across, ay * along + ty * across, handed * turn

    def _gravity_m_s2(self) -> FloatArray:
        g = self.properties.gravity_m_s2
        if self.properties.orientation == "none":
            return np.zeros(2)
        return -g * np.array([self.axis[1], self.transverse[1]])

    @cached_property
    def _mass_with_clamp(self) -> FloatArray:
        p, h = self.properties, self.element_length_m
        nodes, weights = np.polynomial.legendre.leggauss(4)
        shapes = shape_functions(0.5 * (nodes + 1.0), h)
        unit = np.einsum("g,gk,gl->kl", 0.5 * h * weights, shapes, shapes)
        one = np.zeros((2 * (p.elements + 1),) * 2)
        for e, area in enumerate(p.area_m2):
            one[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += p.density_kg_m3 * area * unit
        for point in p.point_masses:
            e = min(int(point.position_m / h), p.elements - 1)
            at = shape_functions(np.array([point.position_m / h - e]), h)[0]
            one[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += point.mass_kg * np.outer(at, at)
            # |dr'/dt| is the rate of rotation, but for that of the strain
            turn = shape_functions(np.array([point.position_m / h - e]), h, 1)[0]
            one[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += point.rotary_inertia_kg_m2 * np.outer(turn, turn)
        return np.asarray(np.kron(one, np.eye(2)), dtype=np.float64)

    @cached_property
    def _translation_kg(self) -> FloatArray:
        """Inertia of the free coordinates against a unit translation along and across, shape (ndof, 2)."""
        mass = self._mass_with_clamp
        rigid = np.zeros((mass.shape[0], 2))
        rigid[0::4, 0] = 1.0
        rigid[1::4, 1] = 1.0
        return np.asarray((mass @ rigid)[self.held :])

    def _assemble_bending(self) -> FloatArray:
        p, h = self.properties, self.element_length_m
        nodes, weights = np.polynomial.legendre.leggauss(2)
        curves = shape_functions(0.5 * (nodes + 1.0), h, 2)
        unit = np.einsum("g,gk,gl->kl", 0.5 * h * weights, curves, curves)
        one = np.zeros((2 * (p.elements + 1),) * 2)
        for e, inertia in enumerate(p.second_moment_m4):
            one[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += p.elastic_modulus_pa * inertia * unit
        return np.asarray(np.kron(one, np.eye(2)), dtype=np.float64)

    def _clamp_springs(self) -> FloatArray:
        """Stiffness of an elastic clamp, with the clamp's coordinates; zero where it is rigid."""
        p = self.properties
        springs = np.zeros((4 * (p.elements + 1),) * 2)
        if p.clamp is not None:
            held = HELD_BY * float(self.axial_stiffness_n[0]) / self.element_length_m
            stiffness = held if p.clamp.translation_n_m is None else p.clamp.translation_n_m
            springs[[0, 1], [0, 1]] = stiffness
            # k |r' - e|^2 / 2 = k (1 - cos) for a section that does not stretch
            springs[[2, 3], [2, 3]] = p.clamp.rotation_n_m_rad
        return springs

    def _exact_bending(self, q: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Energy, force and band tangent of bending with the exact curvature."""
        p, h = self.properties, self.element_length_m
        nodes, weights = np.polynomial.legendre.leggauss(_EXACT_GAUSS_POINTS)
        at = 0.5 * (nodes + 1.0)
        full = np.concatenate([np.zeros(self.held), np.asarray(q, dtype=np.float64)])
        stiffness = np.outer(p.elastic_modulus_pa * p.second_moment_m4, 0.5 * h * weights)
        energy, force, tangent = assembled_bending(
            full, shape_functions(at, h, 1), shape_functions(at, h, 2), stiffness
        )
        return energy, force[self.held :], to_band(tangent[self.held :, self.held :])


def _direction(q: FloatArray, component: int) -> FloatArray:
    """Values (displacement, slope) of each free node in one direction; (..., 4 ne) to (..., 2 ne)."""
    return np.asarray(q, dtype=np.float64)[..., component::2]


def to_band(dense: FloatArray) -> FloatArray:
    """Band form, shape (n, 15), of a matrix with half bandwidth 7."""
    n = dense.shape[0]
    band = np.zeros((n, BAND))
    for k in range(BAND):
        diagonal = np.diagonal(dense, k - PAD)
        start = max(0, PAD - k)
        band[start : start + diagonal.size, k] = diagonal
    return band


def from_band(band: FloatArray) -> FloatArray:
    """Dense matrix, shape (n, n), of a band form."""
    n = band.shape[0]
    dense = np.zeros((n, n))
    for k in range(BAND):
        offset = k - PAD
        size = n - abs(offset)
        if size <= 0:
            continue
        rows = np.arange(size) + max(0, -offset)
        dense[rows, rows + offset] = band[rows, k]
    return dense
