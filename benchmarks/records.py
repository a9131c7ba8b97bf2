"""Random records answered: ``python -m benchmarks.records --set parts --seeds 0 500 --out parts.jsonl``.

Each line is one record: what was listed, the parts of the record, flags, a reason where there is no mode, CPU time and
peak memory. ``--compare BEFORE.jsonl AFTER.jsonl`` prints the table of `docs/studies/records.md`.

Two sets: ``own`` (`benchmarks/random_records.py`, as people make them) and ``parts`` (`benchmarks/record_scenes.py`).
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.random_records import random_record
from benchmarks.record_scenes import RecordScene, TruePart, scene
from benchmarks.record_scores import table
from modal_id import Identification, identify
from tracker import Failure


def own(seed: int) -> RecordScene:
    """A record of the other generator, in the terms of this one; only its longest decay is told."""
    record = random_record(seed)
    rows = [int((record.series.time_s < limit).sum()) for limit in record.decay_s]
    return RecordScene(
        record.series,
        tuple(zip(record.frequency_hz, record.damping_ratio, strict=True)),
        (TruePart("decay", *rows),),
        (1.0,),
        len(record.frequency_hz),
        record.is_informative,
        frozenset(record.events),
    )


SETS: dict[str, Callable[[int], RecordScene]] = {"own": own, "parts": scene}


def answer(name: str, seed: int) -> dict[str, Any]:
    """Identify one record with the default settings."""
    given = SETS[name](seed).series
    begun = time.process_time()
    try:
        found: Identification | Failure = identify(given)
    except (ValueError, ArithmeticError, LookupError, AttributeError) as error:
        found = Failure(f"{type(error).__name__}: {error}", given.name)
        crashed = True
    else:
        crashed = False
    cpu_s = time.process_time() - begun
    line: dict[str, Any] = {
        "set": name,
        "seed": seed,
        "cpu_s": round(cpu_s, 3),
        # of this worker so far: it never falls
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
    }
    if not isinstance(found, Identification):
        kind = "crashed" if crashed else "refused"
        return line | {"kind": kind, "reason": found.reason, "modes": [], "parts": []}
    line["kind"] = "modes" if found.modes else "driven" if found.driven else "refused"
    line["reason"] = "; ".join(mode.reason for mode in found.failed)
    line["modes"] = [
        {
            "frequency_hz": mode.frequency_hz,
            "frequency_sd_hz": mode.frequency_sd_hz,
            "zeta": mode.damping_ratio,
            "zeta_sd": mode.damping_ratio_sd,
            "zeta_90": mode.damping_interval(),
            "small_zeta": mode.small_amplitude_damping,
            "target": mode.target,
            "amplitude": mode.amplitude,
            "flags": mode.flags,
            "wrong_flags": mode.wrong_flags,
        }
        for mode in found.modes
    ]
    line["parts"] = [(part.kind, part.start_s, part.end_s) for part in found.segments]
    line["onset"] = (found.onset.source, found.onset.time_s, found.onset.sd_s, found.onset.confidence)
    return line


def answers(name: str, seeds: Iterable[int], workers: int) -> Iterator[dict[str, Any]]:
    """In the order of the seeds, by several processes; each loads the kernels before its first record."""
    with ProcessPoolExecutor(workers, initializer=_load_kernels) as pool:
        yield from pool.map(partial(answer, name), seeds)


def _load_kernels() -> None:
    answer("own", 0)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--set", choices=SETS, default="parts")
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 500), metavar=("FIRST", "END"))
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--compare", type=Path, nargs="+", metavar="JSONL")
    given = parser.parse_args()
    if given.compare:
        runs = {path.stem: _read(path) for path in given.compare}
        sys.stdout.write(table(runs, {name: SETS[name] for name in SETS}))
        return
    with given.out.open("w") if given.out else sys.stdout as out:
        for line in answers(given.set, range(*given.seeds), given.workers):
            out.write(json.dumps(line) + "\n")
            out.flush()


def _read(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


if __name__ == "__main__":
    main()
