"""Ambient records with known modes: what is found, coverage of the intervals, and sd against the uncertainty law.

``python -m benchmarks.ambient --records 200 --jsonl ambient.jsonl`` writes one line per record;
``--summary ambient.jsonl`` prints the table of docs/validation.md; ``--noise`` makes records without modes.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.ambient_scenes import Truth, ambient_record, noise_record
from modal_id import Identification, IdentifySettings, identify
from modal_id.ambient import log_sds
from modal_id.modes import mac


def record_line(seed: int, *, noise: bool) -> dict[str, Any]:
    """Outcome of one record: its true modes, each with the mode found nearest, and how many were false."""
    if noise:
        series, truth = noise_record(seed), None
    else:
        series, truth = ambient_record(seed)
    start = time.process_time()
    found = identify(series, IdentifySettings(excitation="ambient", seed=seed))
    line: dict[str, Any] = {"seed": seed, "cpu_s": round(time.process_time() - start, 3)}
    modes = list(found.modes) if isinstance(found, Identification) else []
    line["reason"] = "" if found else str(found)
    line["modes"] = []
    matched = {} if truth is None else matches(truth, [mode.frequency_hz for mode in modes])
    for index in range(0 if truth is None else truth.frequency_hz.size):
        true_hz, true_zeta = float(truth.frequency_hz[index]), float(truth.damping_ratio[index])
        row: dict[str, Any] = {"true_hz": true_hz, "true_zeta": true_zeta, "found": False}
        if index in matched:
            k = matched[index]
            mode = modes[k]
            law = log_sds(true_hz, true_zeta, float(series.time_s[-1]), 1e6)
            row |= {
                "found": True,
                "hz": mode.frequency_hz,
                "zeta": mode.damping_ratio,
                "z_hz": (mode.frequency_hz - true_hz) / mode.frequency_sd_hz,
                "z_zeta": float(
                    np.log(mode.damping_ratio / true_zeta) / np.std(np.log(mode.posterior.damping_ratio))
                ),
                "in_hz": mode.frequency_interval_hz()[0] < true_hz < mode.frequency_interval_hz()[1],
                "in_zeta": mode.damping_interval()[0] < true_zeta < mode.damping_interval()[1],
                "log_sd": float(np.std(np.log(mode.posterior.damping_ratio))),
                "law_sd": law[1],
                "mac": mac(mode.shape, truth.shapes[:, index]),
                "unresolved": "UNRESOLVED" in mode.flags,
                "confirmed": "NOT_CONFIRMED" not in mode.flags,
            }
        line["modes"].append(row)
    line["false"] = [m.frequency_hz for k, m in enumerate(modes) if k not in matched.values()]
    return line


def matches(truth: Truth, found_hz: list[float]) -> dict[int, int]:
    """Index of the mode found for each true one that was found, nearest first: of two modes 3 % apart, one that was
    found is not taken for the other.
    """
    pairs = sorted(
        (abs(np.log(hz / true_hz)), index, k)
        for index, true_hz in enumerate(truth.frequency_hz.tolist())
        for k, hz in enumerate(found_hz)
    )
    matched: dict[int, int] = {}
    for distance, index, k in pairs:
        near = distance < max(0.01, 2.0 * float(truth.damping_ratio[index]))
        if near and index not in matched and k not in matched.values():
            matched[index] = k
    return matched


def summary(lines: list[dict[str, Any]]) -> str:
    """Table of the records of a file."""
    rows = [row for line in lines for row in line["modes"]]
    found = [row for row in rows if row["found"]]
    false = sum(len(line["false"]) for line in lines)
    out = [
        f"records {len(lines)}, modes {len(rows)}, found {100 * len(found) / max(len(rows), 1):.1f} %, false {false}",
        f"CPU {np.mean([line['cpu_s'] for line in lines]):.2f} s, at most {max(line['cpu_s'] for line in lines):.1f} s",
    ]
    if found:

        def of(name: str) -> np.ndarray:
            return np.array([row[name] for row in found], dtype=float)

        wrong = of("unresolved")[np.abs(of("z_hz")) > 3.5]
        out += [
            *(
                f"{name}: {100 * of('in_' + name).mean():.1f} % in the 90 % interval, z mean "
                f"{of('z_' + name).mean():+.2f} rms {np.sqrt((of('z_' + name) ** 2).mean()):.2f}"
                for name in ("hz", "zeta")
            ),
            f"sd of zeta over that of the law: median {np.median(of('log_sd') / of('law_sd')):.2f}",
            f"error of zeta: median {100 * np.median(np.abs(of('zeta') / of('true_zeta') - 1)):.1f} %",
            f"MAC: 5 % quantile {np.quantile(of('mac'), 0.05):.4f}",
            f"flagged as perhaps two modes: {int(of('unresolved').sum())}",
            f"|z| of f above 3.5: {len(wrong)}, without that flag: {int(np.sum(wrong == 0.0))}",
            f"confirmed by SSI: {100 * of('confirmed').mean():.0f} %",
        ]
    return "\n".join(out)


def arguments(description: str | None, records: int, first: int) -> argparse.ArgumentParser:
    """Which records, and the file of lines to write or to read."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--records", type=int, default=records)
    parser.add_argument("--first", type=int, default=first)
    parser.add_argument("--jsonl", type=Path)
    parser.add_argument("--summary", type=Path)
    return parser


def lines_of(
    given: argparse.Namespace, answer: Callable[[int], Iterable[dict[str, Any]]]
) -> list[dict[str, Any]]:
    """Lines of a file, or those of each record, which are added to a file as they are made."""
    if given.summary is not None:
        return [json.loads(text) for text in given.summary.read_text("utf-8").splitlines()]
    lines = []
    for seed in range(given.first, given.first + given.records):
        for line in answer(seed):
            lines.append(line)
            if given.jsonl is not None:
                with given.jsonl.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(line) + "\n")
    return lines


def main() -> None:
    """Run or summarise."""
    parser = arguments(__doc__, 200, 0)
    parser.add_argument("--noise", action="store_true")
    given = parser.parse_args()
    lines = lines_of(given, lambda seed: [record_line(seed, noise=given.noise)])
    sys.stdout.write(summary(lines) + "\n")


if __name__ == "__main__":
    main()
