"""What changes when a threshold is 0.7 or 1.4 times as large.

``python -m benchmarks.tuning_measured [--module sim.dynamics] [--out benchmarks/tuning_effects.csv]`` adds the effects
that are missing in the table. A threshold is tried on the parts of the battery that read it.
"""

from __future__ import annotations

import argparse
import csv
import functools
import gc
import importlib
import json
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import cv2

from benchmarks.tuning import (
    COLUMNS,
    EFFECTS,
    FACTORS,
    ROOT,
    Constant,
    constants,
    effect,
    effects,
    frozen,
    modules,
)
from benchmarks.tuning_battery import PARTS, Difference, Found, affected, difference

_LONGEST_S = 900.0
# parts, the fastest first, on which a threshold is tried
_MOST = 24


def measure(out: Path, chosen: str) -> None:
    """Add the effects that the table lacks for modules whose names begin with `chosen`."""
    wanted = [
        (c, f)
        for module in modules()
        if module.startswith(chosen)
        for c in constants(module)
        for f in FACTORS
    ]
    known = effects(out)
    todo = [
        (c, f)
        for c, f in wanted
        if (c.module, c.name, f) not in known or float(known[c.module, c.name, f]["value"]) != c.value
    ]
    readers = _Readers.of({part for c, _ in todo for part in affected(c.module)})
    for k, (constant, factor) in enumerate(todo, 1):
        start = time.perf_counter()
        row = readers.row(constant, factor)
        if row is None:
            continue
        known[constant.module, constant.name, factor] = row
        with out.open("w", encoding="utf-8", newline="") as file:
            table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            table.writeheader()
            table.writerows(known[key] for key in sorted(known))
        what = f"{constant.module}.{constant.name} x {factor}: {effect(row, constant.value)}"
        print(f"{k}/{len(todo)} {what}, {time.perf_counter() - start:.0f} s", flush=True)


@dataclass(frozen=True)
class _Readers:
    """Parts of the battery, the fastest first, with what they find and the thresholds that they read."""

    unchanged: dict[str, Found]
    reads: dict[str, frozenset[tuple[str, str]]]

    @classmethod
    def of(cls, parts: Iterable[str]) -> _Readers:
        """Run each part; kernels are then loaded, for every process that this one is copied to."""
        unchanged, reads, seconds = {}, {}, {}
        for part in sorted(parts):
            start = time.perf_counter()
            with _noted() as found:
                unchanged[part] = PARTS[part]()
            seconds[part], reads[part] = time.perf_counter() - start, frozenset(found)
            _forget()
        order = sorted(unchanged, key=lambda part: seconds[part])
        return cls({part: unchanged[part] for part in order}, reads)

    def row(self, constant: Constant, factor: float) -> dict[str, str] | None:
        """Effect on the first parts that read the threshold; None where none does."""
        held = frozen(constant)
        key = (constant.module, constant.name)
        known = affected(constant.module)
        read = [part for part in self.unchanged if part in known and (held or key in self.reads[part])]
        total, text = Difference(0.0, 0.0, 0.0, 0, 0, identical=True), ""
        value = constant.changed(factor)
        for found in (
            _compiled(read[:_MOST], constant, value) if held else _copied_run(read[:_MOST], constant, value)
        ):
            if isinstance(found, str):
                text = found
                break
            part, changed = found
            total = total.with_worse(difference(self.unchanged[part], changed))
        if not read:
            return None
        values = {
            k: v if isinstance(v, int) else f"{v:.3g}" for k, v in asdict(total).items() if k in COLUMNS
        }
        seen = text or ("none" if total.identical else "changed")
        return {
            "module": constant.module,
            "name": constant.name,
            "value": repr(constant.value),
            "factor": str(factor),
            **values,
            "effect": seen,
        }


@contextmanager
def _noted() -> Iterator[set[tuple[str, str]]]:
    """The thresholds that are read, as (module, name)."""
    found: set[tuple[str, str]] = set()
    classes = [(name, importlib.import_module(name).Tuning) for name in modules()]
    for module, cls in classes:
        names = {f.name for f in fields(cls)}

        def read(self: Any, name: str, module: str = module, names: set[str] = names) -> Any:
            if name in names:
                found.add((module, name))
            return object.__getattribute__(self, name)

        cls.__getattribute__ = read
    yield found
    for _, cls in classes:
        del cls.__getattribute__


def _forget() -> None:
    """Empty all caches: what they hold depends on thresholds."""
    for one in gc.get_objects():
        if isinstance(one, functools._lru_cache_wrapper):  # noqa: SLF001 - the only way to find them all
            one.cache_clear()


def _copied_run(parts: list[str], constant: Constant, value: float) -> Iterator[tuple[str, Found] | str]:
    """What parts find in a copy of this process in which one threshold has another value, or how that ended."""
    context = multiprocessing.get_context("fork")
    receiving, sending = context.Pipe(duplex=False)
    process = context.Process(target=_changed_parts, args=(parts, constant, value, sending))
    process.start()
    sending.close()
    try:
        for _ in parts:
            if not receiving.poll(_LONGEST_S):
                yield "does not end"
                break
            yield receiving.recv()
    except EOFError:
        yield "stops"
    finally:
        process.kill()
        process.join()


def _changed_parts(parts: list[str], constant: Constant, value: float, sending: Connection) -> None:
    _forget()
    object.__setattr__(importlib.import_module(constant.module).TUNING, constant.name, value)
    for part in parts:
        try:
            sending.send((part, PARTS[part]()))
        except Exception as error:  # noqa: BLE001 - how it ended is the result
            sending.send(f"stops: {type(error).__name__}")


def _compiled(parts: list[str], constant: Constant, value: float) -> Iterator[tuple[str, Found] | str]:
    """The same of a threshold that kernels hold: each part in a new process that compiles them."""
    for part in parts:
        found = _run(part, constant, value)
        yield found if isinstance(found, str) else (part, Found(**found))


def _run(part: str, constant: Constant, value: float) -> dict[str, Any] | str:
    """What a part finds in another process with one constant changed, or how that ended."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "found.json"
        environment = os.environ | {"OMP_NUM_THREADS": "1", "NUMBA_CACHE_DIR": folder}
        changed = [constant.module, constant.name, repr(value)]
        command = [
            sys.executable,
            "-m",
            "benchmarks.tuning",
            "--part",
            part,
            "--out",
            str(out),
            "--changed",
            *changed,
        ]
        try:
            done = subprocess.run(  # noqa: S603 - this file
                command,
                cwd=ROOT,
                env=environment,
                capture_output=True,
                text=True,
                check=False,
                timeout=_LONGEST_S,
            )
        except subprocess.TimeoutExpired:
            return "does not end"
        if done.returncode != 0:
            return f"stops: {done.stderr.strip().splitlines()[-1].split(':')[0]}"
        found: dict[str, Any] = json.loads(out.read_text(encoding="utf-8"))
        return found


def main() -> None:
    """Run as a command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--module", default="")
    parser.add_argument("--out", type=Path, default=EFFECTS)
    given = parser.parse_args()
    # threads do not survive in the copies of this process
    cv2.setNumThreads(1)
    measure(given.out, given.module)


if __name__ == "__main__":
    main()
