"""Static equilibrium under weight and further dead loads, by Newton's method with load stepping."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.beam.ancf import AncfBeam
from sim.beam.banded import PAD, from_band
from tracker import FloatArray

# q L^3 / EI at which a uniform standing cantilever buckles under its weight (Greenhill 1881)
GREENHILL_LOAD = 7.8373


@dataclass(frozen=True)
class Tuning:
    """Convergence of the static equilibrium."""

    #: [1] Newton iterations of one load step before it counts as failed
    #: convention: Load steps that converge take 3 to 15, the latter bent to a full circle; the rest is reserve.
    iterations: int = 40
    #: [1] vertical component of the axis above which an inclined beam counts as standing, in messages
    #: convention: Within 0.8 degrees of upright an instability is reported as buckling.
    upright: float = 0.9999
    #: [1] share of the load below which a step is not halved again: no equilibrium
    #: convention: Ten halvings; a moment that bends the beam to a full circle needs steps of 1/16.
    smallest_load_step: float = 1.0 / 1024.0
    #: [lengths] an increment above it ends the iteration as diverged
    #: physics: No point of a clamped beam moves by more than two lengths.
    lost: float = 10.0
    #: [1] iterations during which increments may grow
    #: convention: Increments grow while a large rotation is found; converging steps have ended after 15.
    patience: int = 12
    #: [1] growth of an increment per iteration that counts as divergence after them
    #: convention: Chosen; a converging iteration shrinks.
    growth: float = 4.0
    #: [lengths] largest increment at convergence; a hundred times as much where it no longer halves
    #: physics: Four decades above rounding, which EA times the strain raises in a bent slender beam.
    settled: float = 1e-12


TUNING = Tuning()


class NoEquilibriumError(ArithmeticError):
    """No static equilibrium was found for the given load."""


class BuckledBeamError(ArithmeticError):
    """The straight equilibrium of the beam is unstable: it buckles under its own weight."""


def static_equilibrium(
    beam: AncfBeam,
    load: FloatArray | None = None,
    *,
    tip_moment_n_m: float = 0.0,
    start: FloatArray | None = None,
) -> FloatArray:
    """Displacement at which elastic forces balance weight, `load` and a moment at the tip.

    Parameters
    ----------
    load : array, shape (ndof,), optional
        Dead generalised load in addition to the weight, N for displacements.
    tip_moment_n_m : float
        Moment at the free end, positive from the axial to the transverse direction; conjugate to the rotation of the
        tip, however large.
    start : array, shape (ndof,), optional
        Starting point; the whole load is then tried at once first.

    Returns
    -------
    array, shape (ndof,)
        Stable equilibrium, accurate to 1e-12 of the length.

    Raises
    ------
    BuckledBeamError
        If a standing beam cannot carry its own weight upright.
    NoEquilibriumError
        If load steps of 1/1024 do not converge, or the result is not stable.
    """
    extra = np.zeros(beam.ndof) if load is None else np.asarray(load, dtype=np.float64)
    if extra.shape != (beam.ndof,):
        msg = f"load must have shape ({beam.ndof},), one value per free coordinate; got {extra.shape}"
        raise ValueError(msg)
    q = np.zeros(beam.ndof)
    if start is not None:
        solved = _newton(beam, extra, tip_moment_n_m, 1.0, np.array(start, dtype=np.float64))
        if solved is not None:
            return _stable(beam, solved, tip_moment_n_m)
    done, step = 0.0, 1.0
    while done < 1.0:
        target = min(1.0, done + step)
        solved = _newton(beam, extra, tip_moment_n_m, target, q)
        if solved is None:
            step *= 0.5
            if step < TUNING.smallest_load_step:
                msg = (
                    f"no static equilibrium beyond {100 * done:.3g} % of the load: Newton's method failed with "
                    "load steps of 0.1 %. Check the load's size, or use more elements."
                )
                raise NoEquilibriumError(msg)
            continue
        q, done, step = solved, target, 2.0 * step
    return _stable(beam, q, tip_moment_n_m)


def stiffness(beam: AncfBeam, q: FloatArray) -> FloatArray:
    """Tangent of the static equilibrium at the state `q`, rigid-body motions anchored; shape (ndof, ndof)."""
    return from_band(beam.elastic(q).tangent) + beam.anchor_n_m


def _newton(
    beam: AncfBeam, extra: FloatArray, moment: float, share: float, start: FloatArray
) -> FloatArray | None:
    """Equilibrium under `share` of the loads, or None where the iteration does not converge."""
    q = start.copy()
    length = beam.properties.length_m
    scale = beam.dof_scale
    previous = np.inf
    for iteration in range(TUNING.iterations):
        state = beam.elastic(q)
        residual = share * (beam.weight_load_n + extra) - state.force_n - beam.anchor_n_m @ q
        tangent = state.tangent
        if moment != 0.0:
            residual[-2:], tangent = _with_moment(q, residual[-2:], tangent, share * moment)
        try:
            delta = np.linalg.solve(from_band(tangent) + beam.anchor_n_m, residual)
        except np.linalg.LinAlgError:
            return None
        size = float(np.max(np.abs(delta * scale)))
        if (
            not np.isfinite(size)
            or size > TUNING.lost * length
            or (iteration > TUNING.patience and size > TUNING.growth * previous)
        ):
            return None
        q += delta
        if size < TUNING.settled * length or (
            size < 100.0 * TUNING.settled * length and size > 0.5 * previous
        ):
            return q
        previous = size
    return None


def _with_moment(
    q: FloatArray, residual: FloatArray, tangent: FloatArray, moment: float
) -> tuple[FloatArray, FloatArray]:
    """Add the work-conjugate force M d(theta)/d(r') at the tip and its derivative."""
    tx, ty = 1.0 + q[-2], q[-1]
    square = tx * tx + ty * ty
    load = moment * np.array([-ty, tx]) / square
    stiffness = (
        moment
        * np.array([[2.0 * tx * ty, ty * ty - tx * tx], [ty * ty - tx * tx, -2.0 * tx * ty]])
        / square**2
    )
    out = tangent.copy()
    for i in range(2):
        for j in range(2):
            out[i - 2, PAD + j - i] -= stiffness[i, j]
    return residual + load, out


def _stable(beam: AncfBeam, q: FloatArray, moment: float) -> FloatArray:
    """`q` if it is stable; raises otherwise."""
    if moment != 0.0:
        # the elastic tangent alone does not decide stability: the moment adds stiffness
        return q
    scale = beam.dof_scale
    try:
        np.linalg.cholesky(stiffness(beam, q) * np.outer(scale, scale))
    except np.linalg.LinAlgError as error:
        upright = beam.properties.orientation == "angled" and beam.axis[1] > TUNING.upright
        if beam.properties.orientation == "standing" or upright:
            raise BuckledBeamError(_buckling_message(beam)) from error
        msg = "the static equilibrium is unstable; check the direction and size of load and tension"
        raise NoEquilibriumError(msg) from error
    return q


def _buckling_message(beam: AncfBeam) -> str:
    p = beam.properties
    stiffness = p.elastic_modulus_pa * float(np.mean(p.second_moment_m4))
    ratio = p.mass_kg * p.gravity_m_s2 * p.length_m**2 / stiffness
    return (
        "the standing beam buckles under its own weight: weight times length squared over bending stiffness is "
        f"{ratio:.3g}, and a uniform beam stays upright below {GREENHILL_LOAD:.4g}. Check dimensions and modulus; "
        'if the beam was hanging during the measurement, set orientation = "hanging".'
    )
