"""modalcam's beam and Exudyn's ANCFCable2D: CPU time per step, at equal error, and for base motion.

``python -m benchmarks.simulation [--json] [--quick]``, from the repository's root. Times are CPU seconds of one thread,
the shortest of several runs. An error is the largest deviation of the tip from the same code's run at a much smaller
step, relative to the amplitude. The finest runs of the two codes are compared at the same integration order.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from benchmarks.simulation_cases import (
    EQUAL_ERROR,
    PER_STEP,
    SAMPLE_S,
    Decay,
    acceleration_m_s2,
    base_run,
    beam_and_modes,
    modal_damping_matrix,
)
from benchmarks.simulation_ours import base_decay, decay
from benchmarks.simulation_peers import TOLERANCES, ExudynBeam, PeerMissingError, load
from sim.dynamics import State
from tracker import FloatArray

_TARGETS = (1e-2, 1e-3)
# CPU time for repetitions of a short run
_SPENT_S = 0.6


@dataclass(frozen=True)
class Run:
    """One run of one code; the error is NaN for the finest run of a series, which is the reference."""

    case: str
    code: str
    step_s: float
    cpu_s: float
    cpu_per_step_us: float
    error: float
    note: str = ""


class Bench:
    """Both codes on the same beam.

    Parameters
    ----------
    repeats : int
        Minimum number of runs, of which the fastest counts. Short runs are repeated more often, to exclude other
        load; runs longer than 2 s are not repeated.
    """

    def __init__(self, repeats: int) -> None:
        self.beam, self.modes = beam_and_modes()
        self.matrix = modal_damping_matrix(self.beam, self.modes)
        self.repeats = repeats
        self.note = ""
        try:
            self.exu: Any = load()
        except PeerMissingError as error:
            self.exu, self.note = None, str(error)

    def ours(self, case: Decay, step_s: float, duration_s: float) -> tuple[float, FloatArray]:
        """CPU seconds and the transverse displacement of the tip, from modalcam."""
        state = case.state(self.beam, self.modes)
        return self._quickest(
            lambda: decay(self.beam, self.modes, state, step_s, duration_s, max(step_s, case.sample_s))
        )

    def theirs(
        self, case: Decay, step_s: float, duration_s: float, tolerance: tuple[float, float] = TOLERANCES[0]
    ) -> tuple[float, FloatArray]:
        """CPU seconds and the transverse displacement of the tip, from Exudyn."""
        state = case.state(self.beam, self.modes)

        def run(*, matrix_in_tangent: bool) -> tuple[float, FloatArray]:
            peer = ExudynBeam(
                self.exu, self.beam, state, self.matrix,
                matrix_in_tangent=matrix_in_tangent, exact_integration=False,
            )  # fmt: skip
            relative, absolute = tolerance
            cpu_s, tip = peer.run(
                duration_s, step_s, max(step_s, case.sample_s), relative=relative, absolute=absolute
            )
            return cpu_s, tip[:, 1]

        try:
            return self._quickest(partial(run, matrix_in_tangent=False))
        except ArithmeticError:
            return self._quickest(partial(run, matrix_in_tangent=True))

    def _quickest(self, run: Any) -> tuple[float, FloatArray]:
        best, tip = run()
        spent_s, count = best, 1
        while best < 2.0 and (count < self.repeats or (spent_s < _SPENT_S and count < 30 * self.repeats)):
            cpu_s, _ = run()
            best, spent_s, count = min(best, cpu_s), spent_s + cpu_s, count + 1
        return best, tip

    def series(self, case: Decay, code: str, duration_s: float) -> tuple[list[list[Run]], FloatArray]:
        """Runs at every step, the finest last, for each tolerance; and the tip displacement of the finest run."""
        ways = (
            {"": self.ours}
            if code == "modalcam"
            else {f"tolerance {one[0]:g}": partial(self.theirs, tolerance=one) for one in TOLERANCES}
        )
        duration_s = round(max(duration_s, case.least_s) / case.sample_s) * case.sample_s
        reference: FloatArray | None = None
        series = []
        for note, function in ways.items():
            runs = []
            # the finest run of the tightest tolerance is the reference of all
            for step_s in sorted(case.steps_s)[reference is not None :]:
                missing = float("nan")
                try:
                    cpu_s, tip = function(case, step_s, duration_s)
                except ArithmeticError as failure:
                    runs.append(Run(case.name, code, step_s, missing, missing, missing, f"{note}: {failure}"))
                    continue
                error = missing if reference is None else float(np.abs(tip - reference).max() / case.tip_m)
                reference = tip if reference is None else reference
                per_step_us = 1e6 * cpu_s / round(duration_s / step_s)
                runs.append(Run(case.name, code, step_s, cpu_s, per_step_us, error, note))
            series.append(runs[::-1])
        if reference is None:
            msg = f"{code} failed at every step of {case.name}"
            raise ArithmeticError(msg)
        return series, reference

    def per_step(self, duration_s: float) -> list[Run]:
        """Runs of both codes at equal steps."""
        runs = []
        for case in PER_STEP:
            for step_s in case.steps_s:
                for code in ("modalcam", "Exudyn") if self.exu else ("modalcam",):
                    count = round(duration_s / step_s)
                    try:
                        cpu_s, _ = (self.ours if code == "modalcam" else self.theirs)(
                            case, step_s, duration_s
                        )
                    except ArithmeticError as failure:
                        missing = float("nan")
                        runs.append(Run(case.name, code, step_s, missing, missing, missing, str(failure)))
                        continue
                    runs.append(Run(case.name, code, step_s, cpu_s, 1e6 * cpu_s / count, float("nan")))
        return runs

    def base_motion(self, shake_s: float, decay_s: float) -> list[Run]:
        """Runs of mode 3 driven from rest, stopped and left to decay; the error covers the whole run."""
        motion = base_run(self.modes, shake_s=shake_s)
        total_s = round((shake_s + decay_s) / SAMPLE_S) * SAMPLE_S
        reference, runs = None, []
        for step_s in (1e-4, 1e-3):
            cpu_s, tip = self._quickest(
                lambda step_s=step_s: base_decay(self.beam, self.modes, motion, step_s, total_s, SAMPLE_S)
            )
            error = _relative(tip, reference)
            reference = tip if reference is None else reference
            runs.append(Run("base", "modalcam", step_s, cpu_s, 1e6 * cpu_s / round(total_s / step_s), error))
        coupling = self.beam.base_coupling_kg
        rest = State(self.modes.equilibrium, np.zeros(self.beam.ndof))
        for step_s in (1e-3, 5e-4, 2e-4, 1e-4, 5e-5) if self.exu else ():
            peer = ExudynBeam(
                self.exu, self.beam, rest, self.matrix, lambda t: -coupling * acceleration_m_s2(motion, t),
                exact_integration=False,
            )  # fmt: skip
            cpu_s, tip = peer.run(total_s, step_s, SAMPLE_S)
            runs.append(
                Run(
                    "base", "Exudyn", step_s, cpu_s, 1e6 * cpu_s / round(total_s / step_s),
                    _relative(tip[:, 1], reference),
                )
            )  # fmt: skip
        return runs


def _relative(tip: FloatArray, reference: FloatArray | None) -> float:
    if reference is None:
        return float("nan")
    return float(np.abs(tip - reference).max() / np.abs(reference).max())


def shortest_cpu_s(series: list[list[Run]], target: float) -> float:
    """Shortest CPU time at which one of several series reaches an error."""
    return float(np.nanmin([cpu_at_error(runs, target) for runs in series]))


def cpu_at_error(runs: list[Run], target: float) -> float:
    """Shortest CPU time at which a series reaches an error, interpolated between runs on logarithmic scales.

    If the coarsest run is already more accurate, the fastest sufficiently accurate run counts.
    """
    exact = [run for run in runs if np.isfinite(run.cpu_s) and np.isfinite(run.error)]
    good = [run.cpu_s for run in exact if run.error <= target]
    best = min(good, default=float("nan"))
    for coarse, fine in pairwise(exact):
        if coarse.error > target >= fine.error:
            share = np.log(coarse.error / target) / np.log(coarse.error / fine.error)
            cpu_s = float(coarse.cpu_s * (fine.cpu_s / coarse.cpu_s) ** share)
            best = min(best, cpu_s) if np.isfinite(best) else cpu_s
    return best


def run(*, duration_s: float, repeats: int, shake_s: float) -> dict[str, Any]:
    """Run all comparisons; returns a dictionary for JSON."""
    bench = Bench(repeats)
    decay(bench.beam, bench.modes, PER_STEP[0].state(bench.beam, bench.modes), 1e-3, 0.02, 1e-3)  # compiles
    result: dict[str, Any] = {"exudyn": bench.note or "run"}
    per_step = bench.per_step(duration_s)
    rows = list(per_step)
    if bench.exu:
        ratios = {
            f"{ours.case}, {1e3 * ours.step_s:g} ms": theirs.cpu_s / ours.cpu_s
            for ours, theirs in zip(per_step[::2], per_step[1::2], strict=True)
            if np.isfinite(theirs.cpu_s)
        }
        result["exudyn_cpu_per_step_ratio_by_case"] = ratios
        result["exudyn_cpu_per_step_ratio"] = min(ratios.values())
    equal: dict[str, float] = {}
    apart: dict[str, float] = {}
    for case in EQUAL_ERROR:
        ours, our_tip = bench.series(case, "modalcam", duration_s)
        rows += ours[0]
        if not bench.exu:
            continue
        theirs, their_tip = bench.series(case, "Exudyn", duration_s)
        rows += [run for runs in theirs for run in runs]
        apart[case.name] = float(np.abs(our_tip - their_tip).max() / case.tip_m)
        for target in _TARGETS:
            equal[f"{case.name}, {target:g}"] = shortest_cpu_s(theirs, target) / shortest_cpu_s(ours, target)
    if bench.exu:
        result["exudyn_cpu_equal_error_ratio_by_case"] = equal
        result["exudyn_cpu_equal_error_ratio"] = equal["mode 3, 1 mm, 0.001"]
        result["finest_runs_apart"] = apart
    based = bench.base_motion(shake_s, duration_s)
    rows += based
    # modalcam's coarse run against Exudyn's first run of equal accuracy, or its finest
    mine = based[1]
    peers = [r for r in based if r.code == "Exudyn"]
    if peers:
        match = next((r for r in peers if r.error <= mine.error), peers[-1])
        result["exudyn_cpu_base_ratio"] = match.cpu_s / mine.cpu_s
        result["exudyn_base_step_s"] = match.step_s
        result["exudyn_base_as_exact"] = bool(match.error <= mine.error)
    result["rows"] = [asdict(r) for r in rows]
    return result


def table(result: dict[str, Any]) -> str:
    """Format the result as text."""
    lines = [f"{'case':16} {'code':9} {'step ms':>8} {'CPU s':>9} {'us/step':>8} {'error':>9}"]
    lines += [
        f"{r['case']:16} {r['code']:9} {1e3 * r['step_s']:8.3f} {r['cpu_s']:9.4f} {r['cpu_per_step_us']:8.1f} "
        f"{r['error']:9.1e} {r['note']}"
        for r in result["rows"]
    ]
    lines.append("")
    for key, value in result.items():
        if isinstance(value, dict):
            lines += [f"{key}:", *(f"    {name:28} {number:.3g}" for name, number in value.items())]
        elif key != "rows":
            lines.append(f"{key}: {value:.4g}" if isinstance(value, float) else f"{key}: {value}")
    return "\n".join(lines)


def main() -> None:
    """Run the benchmark and print the result."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.simulation", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print JSON instead of the table")
    parser.add_argument("--quick", action="store_true", help="run a small version to check the installation")
    options = parser.parse_args()
    if options.quick:
        result = run(duration_s=0.2, repeats=1, shake_s=0.4)
    else:
        result = run(duration_s=1.0, repeats=4, shake_s=4.0)
    print(json.dumps(result, indent=1) if options.json else table(result))


if __name__ == "__main__":
    main()
