"""Input and output of a simulation: states, base motion, trajectories, failures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tracker import FloatArray

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class State:
    """Displacement and velocity of the free coordinates relative to the clamp, each of shape (ndof,)."""

    q: FloatArray
    v: FloatArray


@dataclass(frozen=True)
class BaseMotion:
    """Transverse motion of the clamp, sampled at every step of a simulation.

    Attributes
    ----------
    displacement_m, velocity_m_s : array, shape (steps + 1,)
        The mean acceleration over a step is the difference of the velocities.
    """

    displacement_m: FloatArray
    velocity_m_s: FloatArray

    def __post_init__(self) -> None:
        if self.displacement_m.ndim != 1 or self.displacement_m.shape != self.velocity_m_s.shape:
            msg = (
                "displacement_m and velocity_m_s need one value per step each, got shapes "
                f"{self.displacement_m.shape} and {self.velocity_m_s.shape}"
            )
            raise ValueError(msg)
        if not (np.all(np.isfinite(self.displacement_m)) and np.all(np.isfinite(self.velocity_m_s))):
            msg = "a base motion must be finite at every step"
            raise ValueError(msg)

    @classmethod
    def sample(
        cls, motion: Callable[[FloatArray], tuple[FloatArray, FloatArray]], step_s: float, steps: int
    ) -> BaseMotion:
        """Evaluate ``motion(time_s) -> (displacement_m, velocity_m_s)`` on the grid of `steps` steps."""
        displacement, velocity = motion(np.arange(steps + 1, dtype=np.float64) * step_s)
        return cls(displacement, velocity)


@dataclass(frozen=True)
class SolverCounts:
    """Work of the integrator."""

    steps: int
    iterations: int
    factorisations: int
    halvings: int


@dataclass(frozen=True)
class Trajectory:
    """Motion of n instants, from 0, of k material points of a simulated beam.

    Attributes
    ----------
    positions_m : array, shape (k,)
        Distances of the points from the clamp along the undeformed beam.
    x_m, y_m, angle_rad : array, shape (n, k)
        In the image, right and up, with the clamp at rest at the origin and the motion of the base included; rotation
        from the undeformed direction, counter-clockwise.
    axial_m, transverse_m : array, shape (n, k)
        Displacement along the undeformed beam and across it, relative to the clamp.
    base_m, energy_j : array, shape (n,)
        Transverse displacement of the clamp; kinetic (relative to the clamp), strain and gravitational energy.
    """

    time_s: FloatArray
    positions_m: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    angle_rad: FloatArray
    axial_m: FloatArray
    transverse_m: FloatArray
    base_m: FloatArray
    energy_j: FloatArray
    final: State
    counts: SolverCounts

    def to_dataframe(self) -> pd.DataFrame:
        """One row per time and point: ``time_s, position_mm, x_mm, y_mm, angle_rad, transverse_mm``."""
        import pandas as pd  # noqa: PLC0415

        n, k = self.x_m.shape
        return pd.DataFrame(
            {
                "time_s": np.repeat(self.time_s, k),
                "position_mm": np.tile(1e3 * self.positions_m, n),
                "x_mm": 1e3 * self.x_m.ravel(),
                "y_mm": 1e3 * self.y_m.ravel(),
                "angle_rad": self.angle_rad.ravel(),
                "transverse_mm": 1e3 * self.transverse_m.ravel(),
            }
        )

    def plot(self, ax: Any = None) -> Any:
        """Transverse displacement of each point against time; returns the matplotlib Axes."""
        import matplotlib.pyplot as plt  # noqa: PLC0415

        ax = plt.figure().add_subplot() if ax is None else ax
        for position_m, moved_m in zip(self.positions_m, self.transverse_m.T, strict=True):
            ax.plot(self.time_s, 1e3 * moved_m, linewidth=0.8, label=f"{1e3 * position_m:g} mm")
        ax.set(xlabel="time (s)", ylabel="transverse displacement (mm)")
        ax.legend(title="from the clamp")
        return ax

    def __repr__(self) -> str:
        return (
            f"Trajectory({self.positions_m.size} points, {self.time_s.size} times to {self.time_s[-1]:.4g} s)"
        )

    def _repr_html_(self) -> str:
        return str(self.to_dataframe().to_html(index=False, max_rows=10))


@dataclass(frozen=True)
class FailedSimulation:
    """A simulation that did not reach its end: falsy, with the time and the reason."""

    time_s: float
    step: int
    reason: str

    def __bool__(self) -> bool:
        return False
