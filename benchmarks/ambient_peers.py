"""pyOMA2 on ambient records with known modes: errors, coverage of its intervals, computing time.

``python -m benchmarks.ambient_peers --first 1600 --records 40 --jsonl peers.jsonl`` writes one line per record and
tool and prints the table of docs/studies/comparison.md; ``--summary peers.jsonl`` prints it again.

pyOMA2 is given the true frequencies, as a user reads them off its diagrams. Settings are those of its documentation
(Example 2, sampled at 20 Hz, lowest mode 1.9 Hz): SSI-cov with 50 block rows up to order 50, read at order 40, and EFDD
with half-overlapping segments of 2048 samples, 102 s, and a MAC limit of 0.95. The records here have 100 Hz, which
their modes of up to 30 Hz need: segments have the same length in seconds, and 170 block rows span as many cycles of
the lowest mode as its 50.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import logging
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.ambient_scenes import Truth, ambient_record
from modal_id import Identification, IdentifySettings, identify
from modal_id.ambient import log_sds
from tracker import DisplacementSeries, FloatArray

#: Frequency, damping ratio and the sd of the latter (NaN where none is stated) of each true mode, shape (m, 3); NaN
#: where none was found.
Peer = Callable[[DisplacementSeries, Truth], FloatArray]
_NORMAL_90 = 1.6448536269514722
SEGMENT_S, BLOCK_ROWS, LONG_BLOCK_ROWS, ORDER, MOST_ORDER = 102.4, 50, 170, 40, 50


def modalcam(series: DisplacementSeries, truth: Truth) -> FloatArray:
    """Modes found without the true frequencies; the nearest of each."""
    found = identify(series, IdentifySettings(excitation="ambient"))
    modes = found.modes if isinstance(found, Identification) else ()
    values = [(m.frequency_hz, m.damping_ratio, m.damping_ratio_sd) for m in modes]
    return _nearest(np.array(values).reshape(-1, 3), truth)


def ssi_cov(block_rows: int, *, with_sd: bool) -> Peer:
    """Covariance-driven subspace identification; with its own uncertainty where that is asked for."""

    def found(series: DisplacementSeries, truth: Truth) -> FloatArray:
        from pyoma2.algorithms import SSI  # noqa: PLC0415 - optional dependency

        result = _run(
            series, SSI(name="peer", method="cov", br=block_rows, ordmax=MOST_ORDER, calc_unc=with_sd)
        ).result
        hz, zeta = result.Fn_poles[:, ORDER], result.Xi_poles[:, ORDER]
        sd = result.Xi_poles_std[:, ORDER] if with_sd else np.full(zeta.shape, np.nan)
        return _nearest(np.column_stack([hz, zeta, sd]), truth)

    return found


def efdd(series: DisplacementSeries, truth: Truth) -> FloatArray:
    """Enhanced frequency domain decomposition, at each true frequency."""
    from pyoma2.algorithms import EFDD  # noqa: PLC0415 - optional dependency

    size = round(SEGMENT_S / float(series.time_s[1] - series.time_s[0]))
    done = _run(series, EFDD(name="peer", nxseg=size, method_SD="per", pov=0.5))
    values = []
    for hz in truth.frequency_hz.tolist():
        # It refuses a mode of whose autocorrelation it sees too few peaks.
        with contextlib.suppress(ValueError):
            done.mpe(sel_freq=[hz], MAClim=0.95)
            values.append((float(done.result.Fn[0]), float(done.result.Xi[0].item()), float("nan")))
    return _nearest(np.array(values).reshape(-1, 3), truth)


def _run(series: DisplacementSeries, algorithm: Any) -> Any:
    from pyoma2.setup import SingleSetup  # noqa: PLC0415 - optional dependency

    logging.disable(logging.WARNING)
    setup = SingleSetup(series.values, fs=1.0 / float(series.time_s[1] - series.time_s[0]))
    setup.detrend_data()
    setup.add_algorithms(algorithm)
    with contextlib.redirect_stderr(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        setup.run_by_name("peer")
    return setup["peer"]


def _nearest(values: FloatArray, truth: Truth) -> FloatArray:
    """The nearest of these modes for each true one, each taken once; within 1 % or two half-widths."""
    matched = np.full((truth.frequency_hz.size, 3), np.nan)
    distance = np.abs(np.log(values[:, :1] / truth.frequency_hz))
    distance[~np.isfinite(distance) | (distance > np.maximum(0.01, 2.0 * truth.damping_ratio))] = np.inf
    while np.isfinite(distance).any():
        row, mode = np.unravel_index(int(np.argmin(distance)), distance.shape)
        matched[mode] = values[row]
        distance[row], distance[:, mode] = np.inf, np.inf
    return matched


PEERS: dict[str, Peer] = {
    "modalcam": modalcam,
    f"SSI-cov, {BLOCK_ROWS} block rows": ssi_cov(BLOCK_ROWS, with_sd=True),
    f"SSI-cov, {LONG_BLOCK_ROWS} block rows": ssi_cov(LONG_BLOCK_ROWS, with_sd=False),
    "EFDD": efdd,
}


def record_line(seed: int, name: str) -> dict[str, Any]:
    """What one tool finds in one record."""
    series, truth = ambient_record(seed)
    start = time.process_time()
    found = PEERS[name](series, truth)
    cpu_s = time.process_time() - start
    true = np.column_stack([truth.frequency_hz, truth.damping_ratio])
    # NaN is no JSON.
    as_text = [[None if np.isnan(x) else float(x) for x in row] for row in found]
    return {"seed": seed, "tool": name, "cpu_s": cpu_s, "true": true.tolist(), "found": as_text}


def summary(lines: list[dict[str, Any]]) -> str:
    """One row per tool."""
    out = [
        "| tool | modes found | rms of f, sd of law | rms of ln zeta, same | median error of zeta | in 90 % | CPU |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for tool in dict.fromkeys(line["tool"] for line in lines):
        own = [line for line in lines if line["tool"] == tool]
        found = np.array([row for line in own for row in line["found"]], dtype=float)
        true = np.array([row for line in own for row in line["true"]])
        seen = np.isfinite(found[:, 0])
        f, (true_hz, true_zeta) = found[seen], true[seen].T
        span_s = 600.0
        from_law = np.array([log_sds(hz, z, span_s, 1e6) for hz, z in zip(true_hz, true_zeta, strict=True)])
        errors = np.log(np.maximum(f[:, :2], 1e-12) / true[seen]) / from_law
        sd, ratio = f[:, 2], f[:, 1] / true_zeta - 1.0
        inside = np.abs(f[:, 1] - true_zeta) < _NORMAL_90 * sd
        stated = f"{100 * inside[np.isfinite(sd)].mean():.0f} %" if np.isfinite(sd).any() else "none stated"
        rms = np.sqrt(np.mean(np.minimum(errors**2, 1e4), axis=0))
        out.append(
            f"| {tool} | {seen.sum()} of {seen.size} | {rms[0]:.2g} | {rms[1]:.2g} | "
            f"{100 * np.median(np.abs(ratio)):.1f} % | {stated} | {np.mean([x['cpu_s'] for x in own]):.1f} s |"
        )
    return "\n".join(out)


def main() -> None:
    """Run or summarise."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=40)
    parser.add_argument("--first", type=int, default=1600)
    parser.add_argument("--jsonl", type=Path)
    parser.add_argument("--summary", type=Path)
    parser.add_argument("--tools", nargs="*", default=list(PEERS))
    given = parser.parse_args()
    if given.summary is not None:
        lines = [json.loads(text) for text in given.summary.read_text("utf-8").splitlines()]
        sys.stdout.write(summary(lines) + "\n")
        return
    lines = []
    for seed in range(given.first, given.first + given.records):
        for tool in given.tools:
            lines.append(record_line(seed, tool))
            if given.jsonl is not None:
                with given.jsonl.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(lines[-1]) + "\n")
    sys.stdout.write(summary(lines) + "\n")


if __name__ == "__main__":
    main()
