"""Error relative to the Cramer-Rao bound, coverage, run time and memory of identification, compared with other tools.

``python -m benchmarks.identification [--json] [--quick]``, from the repository's root.
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from benchmarks.identification_cost import SIZES, costs, lines
from benchmarks.identification_peers import PEERS, Answer, Peer, filled
from benchmarks.identification_samplers import Sampling, naive, ours
from benchmarks.identification_scenes import MODES, NOISE, Decay, real, synthetic
from modal_id import Identification, IdentifySettings, identify

# A damping ratio with a larger relative error counts as gross failure and is excluded from the rms.
_GROSS = 0.5


@dataclass(frozen=True)
class Row:
    """One tool on one kind of noise; lists are ordered by mode, 1 to 5.

    ``rms_over_bound`` is relative to the Cramer-Rao bound for white noise and ``rms_percent`` to zeta. ``coverage`` is
    that of the tool's own 90 % interval, NaN if it reports none. ``gross`` is the fraction of results that are missing
    or have an error above 50 %.
    """

    noise: str
    tool: str
    rms_over_bound: tuple[float, ...]
    rms_percent: tuple[float, ...]
    coverage: tuple[float, ...]
    gross: tuple[float, ...]
    cpu_s: float
    note: str = ""


def _ours(decay: Decay) -> Answer:
    # Every tool is given the onset of the decay and the target frequency.
    settings = IdentifySettings(target_frequency_hz=decay.frequency_hz, onset_s=0.0, max_modes=4)
    found = identify(decay.series, settings)
    if not isinstance(found, Identification) or found.target is None:
        reason = found.failed[0].reason if isinstance(found, Identification) else found.reason
        raise ValueError(reason)
    mode = found.target
    return Answer(mode.frequency_hz, mode.damping_ratio, mode.damping_interval())


def _peer(peer: Peer, decay: Decay) -> Answer:
    time_s, values = filled(decay.time_s, decay.values)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # failed fits are counted from their results
        return peer(time_s, values, decay.frequency_hz)


def _answer(tool: str, peer: Peer | None, decay: Decay) -> tuple[Answer | None, float, str]:
    start = time.process_time()
    try:
        answer = _ours(decay) if peer is None else _peer(peer, decay)
    except Exception as error:  # noqa: BLE001 - whatever stops a tool is shown in its line
        return None, time.process_time() - start, f"{tool}: {error!r:.70}"
    return answer, time.process_time() - start, ""


def _row(noise: str, tool: str, peer: Peer | None, sets: int) -> Row:
    rms, percent, coverage, gross, cpu, note = [], [], [], [], [], ""
    _answer(tool, peer, synthetic(noise, 2, 10_000))  # compiles
    for mode in MODES:
        # Each error relative to the bound and to the damping ratio of its own decay, which differ from seed to seed.
        errors, inside, lost = [], [], 0
        for seed in range(sets):
            decay = synthetic(noise, mode, seed)
            answer, seconds, said = _answer(tool, peer, decay)
            cpu.append(seconds)
            if answer is None or not abs(answer.zeta / decay.zeta - 1.0) < _GROSS:
                lost += 1
                note = said or note
                continue
            error = answer.zeta - decay.zeta
            errors.append((error / decay.bound_zeta, 100.0 * error / decay.zeta))
            low, high = answer.interval
            inside.append(float(low < decay.zeta < high) if np.isfinite(low) else float("nan"))
        over_bound, of_zeta = np.sqrt(np.mean(np.square(errors), axis=0)) if errors else (np.nan, np.nan)
        rms.append(float(over_bound))
        percent.append(float(of_zeta))
        coverage.append(float(np.mean(inside)) if inside else float("nan"))
        gross.append(lost / sets)
    if min(gross) == 1.0:
        note = f"not run: {note}"
    return Row(
        noise, tool, tuple(rms), tuple(percent), tuple(coverage), tuple(gross), float(np.median(cpu)), note
    )


def _real_rows() -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for decay in real():
        for tool, peer in (("modalcam", None), *PEERS):
            answer, seconds, note = _answer(tool, peer, decay)
            rows.append(
                {
                    "recording": decay.name,
                    "tool": tool,
                    "expected_hz": decay.frequency_hz,
                    "answer": None if answer is None else asdict(answer),
                    "cpu_s": seconds,
                    "note": note,
                }
            )
    return rows


def _samplers(steps: int) -> list[Sampling]:
    decay = synthetic("white", 2, 0)
    ours(decay)  # compiles
    mine = [ours(decay) for _ in range(3)]
    return [max(mine, key=lambda one: one.per_second), naive(decay, steps)]


def run(*, sets: int, steps: int, sizes: tuple[int, ...]) -> dict[str, Any]:
    """Run all comparisons; returns a dictionary for JSON."""
    rows = []
    for noise in NOISE:
        tools: tuple[tuple[str, Peer | None], ...] = (("modalcam", None), *PEERS)
        rows += [_row(noise, tool, peer, sets) for tool, peer in tools]
    samplers = _samplers(steps)
    results = {row.noise: row for row in rows if row.tool == "modalcam"}
    return {
        "sets": sets,
        "rms_over_bound": list(results["white"].rms_over_bound),
        "coverage": {noise: list(row.coverage) for noise, row in results.items()},
        "ess_per_second_ratio": samplers[0].per_second / samplers[1].per_second,
        "rows": [asdict(row) for row in rows],
        "samplers": [{**asdict(one), "per_second": one.per_second} for one in samplers],
        "real": _real_rows(),
        "cost": [{**asdict(one), "ratio": one.ratio} for one in costs(sizes)],
    }


def _numbers(values: list[float], form: str) -> str:
    return " ".join(f"{'-':>5}" if np.isnan(v) else f"{v:{form}}" for v in values)


def table(result: dict[str, Any]) -> str:
    """Format the result as text."""
    text = [
        f"zeta of modes 1 to 5, {result['sets']} decays each of 10 s at 1000 fps and 40 dB",
        f"{'noise':10} {'tool':20} {'rms / bound':>29}  {'rms %':>29}  {'90 % covers, %':>29}  {'lost %':>29}   CPU s",
    ]
    for row in result["rows"]:
        share = [100.0 * v for v in row["coverage"]]
        lost = [100.0 * v for v in row["gross"]]
        text.append(
            f"{row['noise']:10} {row['tool']:20} {_numbers(list(row['rms_over_bound']), '5.1f')}  "
            f"{_numbers(list(row['rms_percent']), '5.2f')}  {_numbers(share, '5.0f')}  {_numbers(lost, '5.0f')} "
            f"{row['cpu_s']:7.3f}  {row['note']}"
        )
    text.append("")
    for one in result["samplers"]:
        low, high = one["interval"]
        text.append(
            f"{one['tool']:24} {one['per_second']:10.0f} effective samples per CPU second; 90 %: {100 * low:.4f} to "
            f"{100 * high:.4f} %  {one['note']}"
        )
    text += [f"ratio {result['ess_per_second_ratio']:.0f}", ""]
    if not result["real"]:
        text.append("Real recordings were not found.")
    for row in result["real"]:
        answer = row["answer"]
        said = (
            "                    "
            if answer is None
            else f"{answer['frequency_hz']:9.4f} Hz {100 * answer['zeta']:7.4f} %"
        )
        text.append(
            f"{row['recording'][:40]:40} {row['tool']:20} {said} {row['cpu_s']:7.3f} s  {row['note']}"
        )
    return "\n".join([*text, "", *lines(result["cost"])])


def main() -> None:
    """Run the benchmark and print the result."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.identification", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print JSON instead of the table")
    parser.add_argument("--quick", action="store_true", help="run a small version to check the installation")
    options = parser.parse_args()
    result = (
        run(sets=3, steps=300, sizes=(20000,)) if options.quick else run(sets=20, steps=4000, sizes=SIZES)
    )
    print(json.dumps(result, indent=1) if options.json else table(result))


if __name__ == "__main__":
    main()
