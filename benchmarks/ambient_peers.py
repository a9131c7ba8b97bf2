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

import contextlib
import io
import logging
import sys
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.ambient import arguments, lines_of, matches
from benchmarks.ambient_scenes import Truth, ambient_record
from modal_id import Identification, IdentifySettings, identify
from modal_id.ambient import log_sds
from tracker import INTERVAL_SD, DisplacementSeries, FloatArray

#: Frequency in Hz, damping ratio and the sd of the latter (NaN where none is stated) of each mode found, shape (k, 3).
Peer = Callable[[DisplacementSeries, Truth], FloatArray]
SEGMENT_S, BLOCK_ROWS, LONG_BLOCK_ROWS, ORDER, MOST_ORDER = 102.4, 50, 170, 40, 50


def modalcam(series: DisplacementSeries, _truth: Truth) -> FloatArray:
    """Modes found without the true frequencies."""
    found = identify(series, IdentifySettings(excitation="ambient"))
    modes = found.modes if isinstance(found, Identification) else ()
    values = [(m.frequency_hz, m.damping_ratio, m.damping_ratio_sd) for m in modes]
    return np.array(values).reshape(-1, 3)


def ssi_cov(block_rows: int, *, with_sd: bool) -> Peer:
    """Covariance-driven subspace identification; with its own uncertainty where that is asked for."""

    def found(series: DisplacementSeries, _truth: Truth) -> FloatArray:
        from pyoma2.algorithms import SSI  # noqa: PLC0415 - optional dependency

        result = _run(
            series, SSI(name="peer", method="cov", br=block_rows, ordmax=MOST_ORDER, calc_unc=with_sd)
        ).result
        hz, zeta = result.Fn_poles[:, ORDER], result.Xi_poles[:, ORDER]
        sd = result.Xi_poles_std[:, ORDER] if with_sd else np.full(zeta.shape, np.nan)
        return np.column_stack([hz, zeta, sd])[np.isfinite(hz)]

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
    return np.array(values).reshape(-1, 3)


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
    taken = matches(truth, found[:, 0].tolist())
    rows = [
        found[taken[index]].tolist() if index in taken else [np.nan] * 3
        for index in range(len(truth.frequency_hz))
    ]
    # NaN is no JSON.
    as_text = [[None if np.isnan(x) else x for x in row] for row in rows]
    true = np.column_stack([truth.frequency_hz, truth.damping_ratio]).tolist()
    span_s = float(series.time_s[-1])
    return {"seed": seed, "tool": name, "cpu_s": cpu_s, "span_s": span_s, "true": true, "found": as_text}


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
        span_s = own[0]["span_s"]
        from_law = np.array([log_sds(hz, z, span_s, 1e6) for hz, z in zip(true_hz, true_zeta, strict=True)])
        errors = np.log(np.maximum(f[:, :2], 1e-12) / true[seen]) / from_law
        sd, ratio = f[:, 2], f[:, 1] / true_zeta - 1.0
        inside = np.abs(f[:, 1] - true_zeta) < INTERVAL_SD * sd
        stated = f"{100 * inside[np.isfinite(sd)].mean():.0f} %" if np.isfinite(sd).any() else "none stated"
        rms = np.sqrt(np.mean(np.minimum(errors**2, 1e4), axis=0))
        out.append(
            f"| {tool} | {seen.sum()} of {seen.size} | {rms[0]:.2g} | {rms[1]:.2g} | "
            f"{100 * np.median(np.abs(ratio)):.1f} % | {stated} | {np.mean([x['cpu_s'] for x in own]):.1f} s |"
        )
    return "\n".join(out)


def main() -> None:
    """Run or summarise."""
    given = arguments(__doc__, 40, 1600).parse_args()
    lines = lines_of(given, lambda seed: (record_line(seed, name) for name in PEERS))
    sys.stdout.write(summary(lines) + "\n")


if __name__ == "__main__":
    main()
