"""Independence proposal for the sampler: constant in each cell of a polar grid about the best fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from emcee.moves import Move
from emcee.state import State

from tracker import BoolArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Cells of the proposal density."""

    #: [sd] width of a cell near the mode
    width: float = 0.1
    #: [sd] distance up to which cells have that width
    fine: float = 4.0
    #: [1] ratio of successive widths further out
    growth: float = 1.1
    #: [1] number of sectors in a ring
    sectors: int = 32
    #: [1] number of rings added at a time
    rings: int = 8
    #: [1] log density below the largest from which no further ring is added
    #: physics: exp(-16) = 1e-7.
    negligible: float = 16.0
    #: [1] least density of a cell over the largest
    #: physics: A cell whose corners all lie outside may contain a sliver.
    least: float = 1e-6
    #: [1] number of steps whose proposals are drawn together
    #: convention: Limits the computing time.
    steps: int = 20


TUNING = Tuning()


@dataclass(frozen=True)
class PolarProposal:
    """Density that is constant in each cell, with the mean of the density to be sampled at the cell's corners.

    Attributes
    ----------
    factor : array, shape (2, 2)
        Lower triangular; positions are ``factor @ (radius cos(angle), radius sin(angle))``.
    squares : array, shape (rings + 1,)
        Squared radii of the edges, from 0.
    log_density : array, shape (rings, sectors)
        Of each cell, up to a constant.
    cumulative : array, shape (rings * sectors,)
        Probability of all cells up to each one; the last is 1.
    """

    factor: FloatArray
    squares: FloatArray
    log_density: FloatArray
    cumulative: FloatArray

    def draw(self, numbers: FloatArray) -> FloatArray:
        """Positions, shape (w, 2), from uniform random numbers below 1, shape (w, 3)."""
        cell = np.searchsorted(self.cumulative[:-1], numbers[:, 0], side="right")
        ring, sector = np.divmod(cell, TUNING.sectors)
        radius = np.sqrt(self.squares[ring] + numbers[:, 1] * np.diff(self.squares)[ring])
        return _positions(radius, 2.0 * np.pi / TUNING.sectors * (sector + numbers[:, 2]), self.factor)

    def __call__(self, position: FloatArray) -> FloatArray:
        """Log density up to a constant, shape (w,), at positions, shape (w, 2), from `draw`."""
        x = position[:, 0] / self.factor[0, 0]
        y = (position[:, 1] - self.factor[1, 0] * x) / self.factor[1, 1]
        ring = np.searchsorted(self.squares, x**2 + y**2, side="right") - 1
        sector = (np.arctan2(y, x) * (TUNING.sectors / (2.0 * np.pi))) % TUNING.sectors
        ring, sector = np.minimum(ring, self.log_density.shape[0] - 1), np.minimum(sector, TUNING.sectors - 1)
        return np.asarray(self.log_density[ring, sector.astype(np.intp)])


def polar_proposal(
    log_density: Callable[[FloatArray], FloatArray], correlation: float, reach: float
) -> PolarProposal | None:
    """Proposal for a density of two parameters in units of about a standard deviation.

    Parameters
    ----------
    log_density : callable
        Log density, shape (w,), of positions, shape (w, 2); -inf further than `reach` from 0.
    correlation : float
        Of the parameters near the largest density: it shapes the cells.

    Returns
    -------
    PolarProposal or None
        None where the density is 0 or undefined at all corners.
    """
    factor = np.linalg.cholesky(np.array([[1.0, correlation], [correlation, 1.0]]))
    fine = np.arange(0.0, TUNING.fine, TUNING.width)
    # `factor` shortens no vector by more than this.
    furthest = reach / np.sqrt(1.0 - abs(correlation))
    edges = np.append(
        fine,
        np.geomspace(TUNING.fine, furthest, 1 + int(np.log(furthest / TUNING.fine) / np.log(TUNING.growth))),
    )
    angle = 2.0 * np.pi / TUNING.sectors * np.arange(TUNING.sectors)
    values = np.empty((0, TUNING.sectors))
    while values.shape[0] < edges.size:
        more = edges[values.shape[0] : values.shape[0] + TUNING.rings]
        corners = _positions(np.repeat(more, TUNING.sectors), np.tile(angle, more.size), factor)
        values = np.concatenate([values, log_density(corners).reshape(more.size, TUNING.sectors)])
        if np.max(values[-more.size :]) < np.max(values) - TUNING.negligible:
            break
    largest = float(np.max(values))
    if not np.isfinite(largest):
        return None
    density = np.exp(values - largest)
    # Corners of a cell: two edges, two angles.
    density = density[1:] + density[:-1]
    density = np.maximum(0.25 * (density + np.roll(density, -1, axis=1)), TUNING.least)
    squares = edges[: values.shape[0]] ** 2
    mass = np.cumsum((density * np.diff(squares)[:, None]).ravel())
    return PolarProposal(factor, squares, np.log(density), mass / mass[-1])


class IndependenceMove(Move):  # type: ignore[misc]  # emcee has no types
    """Metropolis-Hastings with proposals that do not depend on the walkers: an autocorrelation time of about one step.

    The stretch move has one of about 30 steps. Two parameters can be tabulated; the proposals are drawn from the table.

    The walkers are those of several independent ensembles, one after the other, each with the random stream of the same
    index: they share the calls of the likelihood and nothing else. For samplers with ``vectorize=True``.
    """

    def __init__(self, proposal: PolarProposal, streams: Sequence[np.random.Generator]) -> None:
        self._proposal, self._streams = proposal, tuple(streams)
        self._waiting: list[tuple[FloatArray, FloatArray, FloatArray, FloatArray]] = []

    def propose(self, model: Any, state: State) -> tuple[State, BoolArray]:
        """Move each walker once; returns the new state and a mask of the walkers that moved."""
        if not self._waiting:
            self._waiting = self._steps(model, state.coords.shape[0] // len(self._streams))
        proposed, value, log_q, log_chance = self._waiting.pop()
        gain = value - log_q - (state.log_prob - self._proposal(state.coords))
        accepted = gain > log_chance
        state.coords[accepted], state.log_prob[accepted] = proposed[accepted], value[accepted]
        return state, np.asarray(accepted)

    def _steps(self, model: Any, walkers: int) -> list[tuple[FloatArray, FloatArray, FloatArray, FloatArray]]:
        """Positions, log densities, log densities of the proposal, logarithms of random numbers, for each step.

        They do not depend on the walkers: many steps in one call take less time.
        """
        numbers = np.concatenate(
            [stream.random((TUNING.steps, walkers, 4)) for stream in self._streams], axis=1
        )
        proposed = self._proposal.draw(numbers[..., :3].reshape(-1, 3))
        value, log_q = model.log_prob_fn(proposed), self._proposal(proposed)
        count = numbers.shape[1]
        parts = (
            proposed.reshape(TUNING.steps, count, 2),
            value.reshape(TUNING.steps, count),
            log_q.reshape(TUNING.steps, count),
        )
        return list(zip(*parts, np.log1p(-numbers[..., 3]), strict=True))


def _positions(radius: FloatArray, angle: FloatArray, factor: FloatArray) -> FloatArray:
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1) @ factor.T
