"""Every threshold of the packages: their page, and what changes when one is 0.7 or 1.4 times as large.

``python -m benchmarks.tuning --page docs/tuning.md`` writes the page; `benchmarks/tuning_measured.py` adds the effects
that are missing in its table.
"""

from __future__ import annotations

import argparse
import ast
import csv
import dataclasses
import importlib
import json
import re
from collections import Counter
from dataclasses import asdict, dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PACKAGES = ("tracker", "modal_id", "sim", "modalcam")
EFFECTS = ROOT / "benchmarks" / "tuning_effects.csv"
FACTORS = (0.7, 1.4)
SOURCES = ("physics", "statistics", "measurement", "convention")
_CHOSEN = "convention: chosen; effect not measured"
COLUMNS = (
    "module",
    "name",
    "value",
    "factor",
    "frequency_sd",
    "damping_sd",
    "positions_px",
    "lost",
    "failures",
    "effect",
)
# changes of less are those of the last digits
_SMALLEST = 1e-3

_HEAD = """# Thresholds

Each threshold of an algorithm stands in a `Tuning` dataclass of its module with unit, meaning and source: *physics*
(a derivation), *statistics* (an error rate), *measurement* (a benchmark or test), or *convention* (a choice). This
page is made from them by `python -m benchmarks.tuning --page docs/tuning.md`.

The last two columns hold what 0.7 and 1.4 times the value change in the fastest parts, of those that read it, of
a battery of records, films, simulations, updates and comparisons (`benchmarks/tuning_battery.py`;
`python -m benchmarks.tuning_measured` adds what is missing), 24 for `modal_id.segments`, `fit_decays`, `modes.decays`
and `fit.spread`, seven for the others: the largest change of a frequency (f) and of a damping
ratio (ζ) in their standard deviations, of positions in px (rms), frames more or fewer, and parts that fail. *None* is
the same to the last bit; *digits* changes nothing by a thousandth of its standard deviation. Counts change by one at
least. The battery is too short to judge a threshold that rare recordings need.
"""


@dataclass(frozen=True)
class Constant:
    """One field of a ``Tuning``."""

    module: str
    name: str
    value: float
    unit: str
    meaning: str
    source: str
    why: str

    def changed(self, factor: float) -> float:
        """The value times a factor; a count changes by one at least."""
        if not isinstance(self.value, int):
            return factor * self.value
        near = round(factor * self.value)
        return near if near != self.value else self.value + (1 if factor > 1.0 else -1)


def modules() -> list[str]:
    """Names of the modules that define a ``Tuning``."""
    paths = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
    found = [path for path in paths if "\nclass Tuning:" in path.read_text(encoding="utf-8")]
    return [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in found]


@cache
def constants(module: str) -> tuple[Constant, ...]:
    """Thresholds of one module in their order."""
    defined = importlib.import_module(module)
    # `inspect.getsource` would parse each module: a second for all, in every process of the tests.
    source = Path(str(defined.__file__)).read_text(encoding="utf-8").partition("\nclass Tuning:")[2]
    said = stated(re.split(r"\n(?=\S)", source, maxsplit=1)[0])
    return tuple(Constant(module, f.name, f.default, *said[f.name]) for f in fields(defined.Tuning))


def stated(source: str) -> dict[str, tuple[str, str, str, str]]:
    """Unit, meaning, source and reason of each field of a class, from the lines ``#:`` above it.

    The first line begins with the unit in brackets; a later one with the kind of source. Without the latter the value
    was chosen.
    """
    found, lines = {}, []
    for line in map(str.strip, source.splitlines()):
        if line.startswith("#: "):
            lines.append(line.removeprefix("#: "))
        elif lines:
            first = next(
                (k for k, said in enumerate(lines) if said.partition(": ")[0] in SOURCES), len(lines)
            )
            unit, _, meaning = " ".join(lines[:first]).removeprefix("[").partition("] ")
            kind, _, why = " ".join(lines[first:] or [_CHOSEN]).partition(": ")
            found[line.partition(":")[0]] = unit, meaning, kind, why
            lines = []
    return found


def effects(path: Path) -> dict[tuple[str, str, float], dict[str, str]]:
    """Rows of the table by module, name and factor."""
    if not path.is_file():
        return {}
    with path.open(encoding="utf-8", newline="") as file:
        return {(row["module"], row["name"], float(row["factor"])): row for row in csv.DictReader(file)}


def effect(row: dict[str, str] | None, value: float) -> str:
    """The effect in words; empty where it is not known for this value."""
    if row is None or float(row["value"]) != value:
        return ""
    if row["effect"] != "changed":
        return row["effect"]
    names = (("frequency_sd", "f {:.2g} sd"), ("damping_sd", "ζ {:.2g} sd"), ("positions_px", "{:.2g} px"))
    parts = [text.format(float(row[name])) for name, text in names if float(row[name]) >= _SMALLEST]
    parts += [
        f"{int(row[name]):+d} {text}"
        for name, text in (("lost", "lost"), ("failures", "failed"))
        if int(row[name])
    ]
    return ", ".join(parts) or "digits"


def page(measured: dict[tuple[str, str, float], dict[str, str]]) -> str:
    """docs/tuning.md."""
    tables, sources, known = [], Counter[str](), 0
    for module in modules():
        rows = []
        for c in constants(module):
            found = [effect(measured.get((module, c.name, factor)), c.value) for factor in FACTORS]
            sources[c.source] += 1
            known += all(found)
            cells = (f"`{c.name}`", f"{c.value:g}", c.unit, c.meaning, f"{c.source}: {c.why}", *found)
            rows.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
        about = (importlib.import_module(module).Tuning.__doc__ or "").strip()
        head = "| name | value | unit | meaning | source | × 0.7 | × 1.4 |\n| --- | --- | --- | --- | --- | --- | --- |"
        tables.append("\n".join([f"## {module}", "", about, "", head, *rows]))
    count = ", ".join(f"{sources[name]} {name}" for name in SOURCES)
    total = f"{sources.total()} thresholds: {count}. The effect of {known} is measured."
    return "\n".join([_HEAD, total, "", "\n\n".join(tables), ""])


@cache
def _copied(module: str) -> frozenset[str]:
    """Fields of a `Tuning` that the module copies at its own level; a module is read once for all of its fields."""
    tree = ast.parse((ROOT / (module.replace(".", "/") + ".py")).read_text(encoding="utf-8"))
    copied = (node for node in tree.body if isinstance(node, ast.Assign))
    parts = (part for node in copied for part in ast.walk(node.value))
    return frozenset(part.attr for part in parts if isinstance(part, ast.Attribute))


def frozen(constant: Constant) -> bool:
    """Whether a compiled kernel holds the value: it is then copied at the module's level."""
    return constant.name in _copied(constant.module)


def change(module: str, name: str, value: float) -> None:
    """Let a module that is not imported yet have another value of one of its thresholds."""
    original = dataclasses.dataclass

    def decorated(cls: Any = None, /, **options: Any) -> Any:
        if cls is None:
            return lambda given: decorated(given, **options)
        if (cls.__module__, cls.__name__) == (module, "Tuning"):
            setattr(cls, name, value)
        return original(cls, **options)

    dataclasses.dataclass = decorated  # type: ignore[assignment]  # replaced to see every Tuning as it is made


def _part(name: str, changed: list[str], out: Path) -> None:
    if changed:
        change(changed[0], changed[1], ast.literal_eval(changed[2]))
    from benchmarks.tuning_battery import PARTS  # noqa: PLC0415 - after the change

    out.write_text(json.dumps(asdict(PARTS[name]())), encoding="utf-8")


def main() -> None:
    """Run as a command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path)
    parser.add_argument("--out", type=Path, default=EFFECTS)
    parser.add_argument("--part", help=argparse.SUPPRESS)
    parser.add_argument("--changed", nargs="*", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.part:
        _part(given.part, given.changed or [], given.out)
    if given.page:
        given.page.write_text(page(effects(given.out)), encoding="utf-8")


if __name__ == "__main__":
    main()
