"""Compute the values in `verification.md` and write them: ``python docs/studies/verification.py``, from the root."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT)]

from docs.reference_solutions import (  # noqa: E402
    damping_and_frequency_error,
    damping_over_a_decay,
    dissipated_damping_ratio,
    elastica_tip,
    energy_above_rest,
    energy_damping_ratio,
    euler_bernoulli_hz,
    log_energy_slope,
    rayleigh_ritz_hz,
    small_decay,
)
from sim import MEASURED_DAMPING_RATIO, MEASURED_FREQUENCY_HZ, paper_beam  # noqa: E402
from sim.beam import (  # noqa: E402
    AncfBeam,
    beam_modes,
    static_equilibrium,
)
from sim.damping import DampingModel, GenericDamping, NoDamping, RayleighDamping  # noqa: E402
from sim.dynamics import (  # noqa: E402
    FailedSimulation,
    Trajectory,
    released_state,
    simulate,
)

PAGE = Path(__file__).with_name("verification.md")
L, EI = 0.5, 210e9 * 5e-3 * 0.5e-3**3 / 12.0
TIP = np.array([L])
GENERIC = GenericDamping(MEASURED_DAMPING_RATIO)


@dataclass(frozen=True)
class Figure:
    """A computed value of the page.

    `spread` is the factor allowed for rounding differences between machines; `bound` is the upper limit of the value.
    """

    name: str
    value: float
    bound: float | None = None
    spread: float = 1.02

    @property
    def printed(self) -> str:
        return f"{self.value:.6g}"


def completed(run: Trajectory | FailedSimulation) -> Trajectory:
    """Return the run; fails if the simulation failed."""
    if isinstance(run, FailedSimulation):
        raise TypeError(run.reason)
    return run


def statics() -> list[Figure]:
    free = {ne: beam_modes(AncfBeam(paper_beam("none", ne)), 5).frequency_hz for ne in (12, 20, 24)}
    theory = euler_bernoulli_hz(paper_beam("none"), 5)
    errors = {ne: np.abs(f / theory - 1.0) for ne, f in free.items()}
    order = np.log2(errors[12][1:] / errors[24][1:])
    figures = [
        Figure("Frequencies 1 to 5 against Euler-Bernoulli, 20 elements, largest", errors[20].max(), 2e-4),
        Figure("Their order of convergence in the element's length, smallest", order.min()),
    ]
    hanging = beam_modes(AncfBeam(paper_beam()), 5).frequency_hz
    figures += [Figure(f"Hanging, mode {k + 1} (Hz)", f, spread=1.00002) for k, f in enumerate(hanging)]
    ritz = rayleigh_ritz_hz(paper_beam(), 5, tension_sign=1.0)
    standing = beam_modes(AncfBeam(paper_beam("standing")), 1).frequency_hz[0]
    figures += [
        Figure("Hanging against a Rayleigh-Ritz solution, largest", np.abs(hanging / ritz - 1.0).max(), 2e-4),
        Figure("Standing, mode 1 (Hz)", standing, spread=1.00002),
    ]
    for elements, roll, bend in ((20, 1e-4, 5e-4), (40, 5e-6, 5e-5)):
        beam = AncfBeam(paper_beam("none", elements))
        q = static_equilibrium(beam, tip_moment_n_m=2.0 * np.pi * EI / L)
        tip = float(np.hypot(q[-4] + L, q[-3]) / L)
        figures.append(
            Figure(
                f"Bent to a full circle, {elements} elements: distance of the tip from the clamp, over L",
                tip,
                roll,
            )
        )
        worst = 0.0
        for load in (1, 2, 5, 10):
            force = np.zeros(beam.ndof)
            force[-3] = load * EI / L**2
            q = static_equilibrium(beam, force)
            worst = max(
                worst, np.abs(np.array([q[-3], -q[-4]]) / L / np.array(elastica_tip(load)) - 1.0).max()
            )
        figures.append(
            Figure(f"Elastica, P L^2 / EI = 1, 2, 5, 10, {elements} elements, largest", worst, bend)
        )
    return figures


def small_vibration() -> list[Figure]:
    beam = AncfBeam(paper_beam())
    modes = beam_modes(beam, 8)
    zeta, omega, added = [], [], []
    for k in range(5):
        run = small_decay(beam, modes, GENERIC, k + 1, 5e-4)
        errors = damping_and_frequency_error(run, modes.omega_rad_s[k], MEASURED_DAMPING_RATIO[k])
        zeta.append(abs(errors[0]))
        omega.append(abs(errors[1]))
        free = small_decay(beam, modes, NoDamping(), k + 1, 5e-4)
        added.append(abs(damping_and_frequency_error(free, modes.omega_rad_s[k], 0.0)[0]))
    table_2 = tuple(2.0 * np.pi * f for f in MEASURED_FREQUENCY_HZ)
    rayleigh = RayleighDamping.from_modes(table_2[:2], MEASURED_DAMPING_RATIO[:2])
    curve = 100.0 * rayleigh.damping_ratio(np.array(table_2))
    return [
        Figure(
            "Prescribed damping ratio, modes 1 to 5 at 0.5 ms, largest relative error", max(zeta), 1e-5, 5.0
        ),
        Figure("Frequency, modes 1 to 5 at 0.5 ms, largest relative error", max(omega), 1e-5, 5.0),
        Figure("Damping ratio of the scheme itself, modes 1 to 5 at 0.5 ms, largest", max(added), 1e-6, 10.0),
        *(Figure(f"Rayleigh damping from Table 2, mode {k} (%)", curve[k - 1]) for k in (3, 4, 5)),
    ]


def order_in_time() -> list[Figure]:
    """Mode 1 from 50 mm with Rayleigh damping: tip after 0.256 s with steps halved successively from 2 ms."""
    beam = AncfBeam(paper_beam())
    modes = beam_modes(beam, 8)
    damping = RayleighDamping.from_modes(tuple(modes.omega_rad_s[:2]), MEASURED_DAMPING_RATIO[:2])
    start = released_state(beam, modes, 1, 0.05)

    def end(step_s: float, fitted: int) -> float:
        run = simulate(
            beam, damping, state=start, duration_s=0.256, step_s=step_s, output_positions_m=TIP,
            modes=modes.first(fitted), axial_relaxation_s=1e-4,
        )  # fmt: skip
        return float(completed(run).transverse_m[-1, 0])

    ends = np.array([end(2e-3 / 2**k, 8) for k in range(5)])
    change = np.abs(np.diff(ends))
    order = np.log2(change[:-1] / change[1:])
    return [
        Figure("Observed order in time, 2, 1 and 0.5 ms", order[0]),
        Figure("Observed order in time, 1, 0.5 and 0.25 ms", order[1]),
        Figure("Observed order in time, 0.5, 0.25 and 0.125 ms", order[2]),
        Figure("Change of the tip from 1 to 0.5 ms, over the amplitude", change[1] / 0.05, 1e-6),
    ]


def large_motion() -> list[Figure]:
    beam = AncfBeam(paper_beam())
    modes = beam_modes(beam, 8)
    start = released_state(beam, modes, 1, 0.2)

    def run(damping: DampingModel, duration_s: float) -> Any:
        return simulate(
            beam,
            damping,
            state=start,
            duration_s=duration_s,
            step_s=1e-3,
            output_positions_m=TIP,
            modes=modes,
            output_every=5,
        )

    drift = np.abs((energy := run(NoDamping(), 60.0).energy_j) / energy[0] - 1.0).max()
    rayleigh = RayleighDamping.from_modes(tuple(modes.omega_rad_s[:2]), MEASURED_DAMPING_RATIO[:2])
    decay = run(rayleigh, 12.0)
    square, ratio = damping_over_a_decay(decay, beam, modes, 3.2)
    limit = np.polyfit(square, ratio, 1)[1]
    double = 2.0 * modes.omega_rad_s[0]
    mean = log_energy_slope(decay.time_s, energy_above_rest(decay, beam, modes)) / double
    weak = run(RayleighDamping(0.01 * rayleigh.alpha_1_s, 0.01 * rayleigh.beta_s), 8.0)
    large = 100.0 * log_energy_slope(weak.time_s, energy_above_rest(weak, beam, modes)) / double
    generic = energy_damping_ratio(run(GENERIC, 1.1), beam, modes, modes.frequency_hz[0])
    return [
        Figure("Energy drift in 60 s from 200 mm at 1 ms", drift, 5e-9, 20.0),
        Figure(
            "Rayleigh damping with K(q), prescribed 1 %: mean over 12 s from 200 mm (%)",
            100 * mean,
            spread=1.0001,
        ),
        Figure("The same, extrapolated to amplitude 0 as zeta0 + zeta2 A^2 (%)", 100 * limit, 1.001, 1.0001),
        Figure("The same, at 200 mm, from a hundredth of the damping (%)", 100 * large, spread=1.0001),
        Figure(
            "Dissipation of C in the undamped motion at 200 mm, by quadrature (%)",
            100 * dissipated_damping_ratio(beam, modes, rayleigh, start),
            spread=1.001,
        ),
        Figure("Generic damping, mode 1 from 200 mm, prescribed 1 % (%)", 100 * generic),
    ]


def figures() -> list[Figure]:
    """All values of the page."""
    return [*statics(), *small_vibration(), *order_in_time(), *large_motion()]


def table(computed: list[Figure]) -> str:
    lines = ["| figure | computed | bound |", "| --- | --- | --- |"]
    lines += [f"| {f.name} | {f.printed} | {'' if f.bound is None else f'{f.bound:g}'} |" for f in computed]
    return "\n".join(lines)


def main() -> None:
    """Write the table into the page."""
    text = PAGE.read_text(encoding="utf-8")
    head, rest = text.split("<!-- table -->\n", 1)
    _, tail = rest.split("<!-- end of table -->", 1)
    body = f"{table(figures())}\n<!-- end of table -->"
    PAGE.write_text(f"{head}<!-- table -->\n{body}{tail}", encoding="utf-8")


if __name__ == "__main__":
    main()
