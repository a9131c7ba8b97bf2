"""Damping laws: which one the paper's five damping ratios choose, and which one simulated sets name.

``python -m benchmarks.laws --sets 5000 --page docs/studies/laws.md`` writes the tables of the page.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from sim import MEASURED_DAMPING_RATIO, MEASURED_FREQUENCY_HZ, paper_beam
from sim.damping import (
    DAMPING_MODELS,
    LawComparison,
    MeasuredDamping,
    beam_section,
    compare_laws,
    thermoelastic_ratio,
    viscous_air_ratio,
)
from tracker import FloatArray

SECTION = beam_section(paper_beam(), "steel")
OMEGA = 2.0 * np.pi * np.array(MEASURED_FREQUENCY_HZ)
REFERENCE = float(np.exp(np.mean(np.log(OMEGA))))
LAWS = {key: entry.law for key, entry in DAMPING_MODELS.items() if entry.law is not None}
#: Laws that sets are drawn from: "caughey" has the evidence of "generic".
KEYS = tuple(key for key in LAWS if key != "caughey")
#: The exponents of the laws with a level, and those that are computed.
POWERS = {"mass": -1.0, "constant": 0.0, "kelvin_voigt": 1.0}
COMPUTED = {"viscous_air": viscous_air_ratio, "thermoelastic": thermoelastic_ratio}
#: Table 2 prints 0.01 %: a uniform error of half of that.
ROUNDING = 1e-4 / np.sqrt(12.0)
SURE = 0.9


def measured(zeta: FloatArray, sd: FloatArray) -> MeasuredDamping:
    """Modes 1 to n of the paper's beam with these damping ratios."""
    count = zeta.size
    return MeasuredDamping(
        tuple(range(1, count + 1)),
        MEASURED_FREQUENCY_HZ[:count],
        tuple(zeta.tolist()),
        damping_sd=tuple(sd.tolist()),
        section=SECTION,
    )


def paper(relative_sd: float = 0.0) -> MeasuredDamping:
    """Table 2 with its rounding and, if given, a relative error."""
    zeta = np.array(MEASURED_DAMPING_RATIO)
    return measured(zeta, np.hypot(ROUNDING, relative_sd * zeta))


def truth(key: str, rng: np.random.Generator) -> FloatArray:
    """Damping ratios of a law with parameters from its prior, before scatter."""
    level = 0.003 * np.exp(2.0 * rng.standard_normal())
    if key == "generic":
        return np.asarray(0.003 * np.exp(2.0 * rng.standard_normal(OMEGA.size)))
    if key == "fractional":
        return np.asarray(level * (OMEGA / REFERENCE) ** rng.uniform(-1.0, 1.0))
    parts = ("mass", "kelvin_voigt") if key == "rayleigh_all_modes" else key.split("_and_")
    powers = [(OMEGA / REFERENCE) ** POWERS[part] for part in parts if part in POWERS]
    share = np.array([1.0, 10.0 ** rng.standard_normal()]) if len(powers) == 2 else np.ones(1)
    found = level * np.tensordot(share / share.sum(), powers, 1) if powers else np.zeros_like(OMEGA)
    return np.asarray(found + sum(COMPUTED[part](OMEGA, SECTION) for part in parts if part in COMPUTED))


def drawn(
    key: str, rng: np.random.Generator, relative_sd: float = 0.02
) -> tuple[MeasuredDamping, FloatArray]:
    """A measured set under a law, with the true ratios: scatter from its prior, then errors of measurement."""
    scatter = 0.0 if key == "generic" else np.exp(rng.uniform(np.log(0.01), 0.0))
    zeta = truth(key, rng) * np.exp(scatter * rng.standard_normal(OMEGA.size))
    found = zeta * np.exp(relative_sd * rng.standard_normal(OMEGA.size))
    return measured(found, relative_sd * found), zeta


def probabilities(one: MeasuredDamping) -> FloatArray:
    """Of each of the `KEYS` by its evidence, shape (laws,)."""
    evidence = np.array([LAWS[key].log_evidence(one) for key in KEYS])
    share = np.exp(evidence - evidence.max())
    return np.asarray(share / share.sum())


def named(count: int, seed: int) -> list[tuple[str, str, float]]:
    """Of `count` sets per law: the law that made it, the most probable one, and its probability."""
    rng, rows = np.random.default_rng(seed), []
    for true in KEYS:
        for _ in range(count):
            share = probabilities(drawn(true, rng)[0])
            rows.append((true, KEYS[int(np.argmax(share))], float(share.max())))
    return rows


def without(one: MeasuredDamping, at: int) -> MeasuredDamping:
    """The measured modes but one."""
    fields = ("numbers", "frequency_hz", "damping_ratio", "damping_sd")
    kept = {name: tuple(v for k, v in enumerate(getattr(one, name)) if k != at) for name in fields}
    return replace(one, **kept)


def name(key: str) -> str:
    """Of a law in a table."""
    return "Rayleigh damping" if key == "rayleigh_all_modes" else DAMPING_MODELS[key].name


def evidence_rows(found: LawComparison) -> Iterator[tuple[str, ...]]:
    """Every law: probability, scatter, score, and prediction of each mode left out."""
    for key, fit, share in zip(found.keys, found.fits, found.probability, strict=True):
        scatter = "" if np.isnan(fit.scatter[0]) else f"{100 * fit.scatter[0]:.0f}"
        predicted = [f"{100 * one.damping_ratio:.2f}" for one in fit.left_out]
        score = sum(one.log_density for one in fit.left_out)
        yield name(key), str(fit.parameters), f"{100 * share:.1f}", scatter, f"{score:.1f}", *predicted


def left_out_rows(found: LawComparison) -> Iterator[tuple[str, ...]]:
    """Every mode left out: the law most probable by the other four, and the one that predicts the mode best."""
    shares = found.left_out_probability
    for at, number in enumerate(found.measured.numbers):
        four = probabilities(without(found.measured, at))
        first = int(np.argmax(four))
        of_first = found.fits[found.keys.index(KEYS[first])].left_out[at]
        order = np.argsort(-shares[:, at])
        best = found.fits[order[0]].left_out[at]
        yield (
            str(number),
            f"{100 * found.measured.damping_ratio[at]:.2f}",
            f"{name(KEYS[first])} ({100 * four[first]:.0f} %)",
            f"{100 * of_first.damping_ratio:.2f} ({100 * of_first.q05:.2f} to {100 * of_first.q95:.2f})",
            f"{name(found.keys[order[0]])} ({100 * shares[order[0], at]:.0f} %)",
            f"{100 * best.damping_ratio:.2f}",
            f"{name(found.keys[order[1]])}, {shares[order[0], at] / shares[order[1], at]:.1f} : 1",
        )


def part_rows(found: LawComparison) -> Iterator[tuple[str, ...]]:
    """Every mode: measured, thermoelastic, viscous air, remainder."""
    for k, number in enumerate(found.parts.numbers):
        cells = [
            f"{100 * v:.3f} ± {100 * s:.3f}"
            for v, s in zip(found.parts.value[:, k], found.parts.sd[:, k], strict=True)
        ]
        yield str(number), *cells


def named_rows(rows: list[tuple[str, str, float]]) -> Iterator[tuple[str, ...]]:
    """Every law: its sets that decide and name it, and the sets of all laws that name it."""
    sure = [(true, best) for true, best, share in rows if share > SURE]

    def cells(pairs: list[tuple[str, str]]) -> tuple[str, str]:
        right, count = sum(true == best for true, best in pairs), len(pairs)
        # of the share, never 0: by the mean of its posterior
        sd = np.sqrt((right + 1) * (count - right + 1) / (count + 2) ** 2 / max(count, 1))
        return str(count), f"{100 * right / max(count, 1):.1f} ± {100 * sd:.1f}"

    for key in KEYS:
        own = [pair for pair in sure if pair[0] == key]
        yield name(key), *cells(own), *cells([pair for pair in sure if pair[1] == key])
    yield "all", *cells(sure), *cells(sure)


def table(header: str, rows: Iterator[tuple[str, ...]]) -> str:
    """A table in Markdown."""
    heads = [head.strip() for head in header.split("|")]
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def tables() -> dict[str, str]:
    """The tables of the paper's five modes by their names on the page."""
    found = compare_laws(paper())
    if not isinstance(found, LawComparison):
        raise TypeError(found.reason)
    modes = " | ".join(f"mode {number}" for number in found.measured.numbers)
    return {
        "laws": table(
            f"law | parameters | probability, % | scatter, % | score | {modes}", evidence_rows(found)
        ),
        "left out": table(
            "mode | ζ, % | most probable by the other four | its prediction, 90 %, % | best prediction | %"
            " | next, odds",
            left_out_rows(found),
        ),
        "parts": table(
            "mode | measured, % | thermoelastic, % | viscous air, % | remainder, %", part_rows(found)
        ),
    }


def main() -> None:
    """Write the tables into the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=0, help="simulated sets per law; 0 leaves their table")
    parser.add_argument("--page", type=Path, required=True)
    options = parser.parse_args()
    found = tables()
    if options.sets:
        header = "law | its sets that decide | right, % | sets that name it | right, %"
        found["sets"] = table(header, named_rows(named(options.sets, 33)))
    text = options.page.read_text(encoding="utf-8")
    for key, lines in found.items():
        mark = rf"(<!-- {key}: begin -->\n).*?(<!-- {key}: end -->)"
        text = re.sub(
            mark, lambda match, lines=lines: f"{match[1]}{lines}\n{match[2]}", text, flags=re.DOTALL
        )
    options.page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
