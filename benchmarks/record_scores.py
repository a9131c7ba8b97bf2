"""Scores of answers to random records, the same for every version of the program, and their table.

Truth is the small-amplitude value of a mode; where damping grows with the amplitude, it is compared with what the
answer states for small amplitude. *Wrong*: a listed mode differs from the nearest true mode by more than four stated
standard deviations and by more than 1 %; a mode of a record that is driven throughout; a record called driven that
never is, or whose decay determines mode 1 to 1 %. *Confident*: a mode that is wrong without a flag of severity WRONG.
*Small*: a mode whose value at small amplitude is wrong, in a record of any damping.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.record_scenes import RecordScene

_MOST_SD, _LEAST_SHARE = 4.0, 0.01
_KINDS = {"at rest": "rest", "driven": "driven", "decay": "decay"}
_CLASSES = ("plain", "only drive", "drive", "hand", "plucks", "zeta(A)", "close", "coloured noise", "drift")

Answer = dict[str, Any]
Score = dict[str, Any]


def score(answer: Answer, truth: RecordScene) -> Score:
    """What is right and wrong in one answer."""
    only_drive = "only drive" in truth.traits
    modes = (
        [_at_small_amplitude(m) for m in answer["modes"]] if "zeta(A)" in truth.traits else answer["modes"]
    )
    wrong = [mode for mode in modes if only_drive or _is_wrong(mode, truth.modes)]
    never = all(part.kind != "driven" for part in truth.parts) and "drive" not in truth.traits
    misled = answer["kind"] == "driven" and not only_drive and (never or truth.informative)
    found: Score = {
        "cpu_s": answer["cpu_s"],
        "peak_mb": answer["peak_mb"],
        "crashed": answer["kind"] == "crashed",
        "wrong": bool(wrong) or misled,
        "confident": any(not mode["wrong_flags"] for mode in wrong),
        "small": any(_is_wrong(_at_small_amplitude(mode), truth.modes) for mode in answer["modes"]),
        "false": len(modes),
    }
    if only_drive:
        return found
    found |= _of_first_mode(modes, truth)
    found["false"], found["listed"] = _false_modes(modes, truth.modes)
    found["excited"] = truth.excited
    if truth.informative:
        found["refused"] = not found["first"]
    if answer["set"] == "parts":
        found |= _of_parts(answer["parts"], truth)
    return found


def _at_small_amplitude(mode: Mapping[str, Any]) -> dict[str, Any]:
    value, sd = mode["small_zeta"]
    return {**mode, "zeta": value, "zeta_sd": sd, "zeta_90": (value - 1.6448536 * sd, value + 1.6448536 * sd)}


def _is_wrong(mode: Mapping[str, Any], true: Sequence[tuple[float, float]]) -> bool:
    frequency, zeta = min(true, key=lambda pair: abs(math.log(pair[0] / mode["frequency_hz"])))
    pairs = (
        (mode["frequency_hz"], mode["frequency_sd_hz"], frequency),
        (mode["zeta"], mode["zeta_sd"], zeta),
    )
    return any(
        abs(value - correct) > max(_MOST_SD * sd, _LEAST_SHARE * correct) for value, sd, correct in pairs
    )


def _is_near(mode: Mapping[str, Any], frequency: float, share: float) -> bool:
    distance = abs(mode["frequency_hz"] / frequency - 1)
    sd = mode["frequency_sd_hz"]
    within = abs(mode["frequency_hz"] - frequency) < 5 * sd and sd < 0.05 * frequency
    return distance < share or (distance < 0.1 and within)


def _of_first_mode(modes: Sequence[Mapping[str, Any]], truth: RecordScene) -> Score:
    """Errors of mode 1, the one of amplitude 1."""
    (frequency, zeta), others = truth.modes[0], [pair[0] for pair in truth.modes]
    own = [
        mode
        for mode in modes
        if _is_near(mode, frequency, 0.01)
        and min(abs(mode["frequency_hz"] - f) for f in others) == abs(mode["frequency_hz"] - frequency)
    ]
    if not own:
        return {"first": False, "far": True}
    mode = next((m for m in own if m["target"]), None) or max(own, key=lambda m: float(m["amplitude"]))
    low, high = mode["zeta_90"]
    reach = 1.6448536 * mode["frequency_sd_hz"]
    return {
        "first": True,
        "far": not abs(mode["zeta"] / zeta - 1) < 0.2,
        "zeta_error": abs(mode["zeta"] / zeta - 1),
        "z_frequency": (mode["frequency_hz"] - frequency) / mode["frequency_sd_hz"],
        "z_zeta": (mode["zeta"] - zeta) / mode["zeta_sd"],
        "in_frequency": abs(mode["frequency_hz"] - frequency) < reach,
        "in_zeta": low <= zeta <= high,
    }


def _false_modes(modes: Sequence[Mapping[str, Any]], true: Sequence[tuple[float, float]]) -> tuple[int, int]:
    """Number of listed modes that are none of the record, and of true modes listed to 0.5 %."""
    left, missing = list(modes), []
    for frequency, _ in true:
        close = [mode for mode in left if abs(mode["frequency_hz"] / frequency - 1) < 0.005]
        if close:
            left.remove(min(close, key=lambda mode: abs(float(mode["frequency_hz"]) - frequency)))
        else:
            missing.append(frequency)
    listed = len(true) - len(missing)
    false = 0
    for mode in left:
        # within five sd of a mode that nothing else is: coarse, not false
        own = [frequency for frequency in missing if _is_near(mode, frequency, 0.0)]
        if own:
            missing.remove(own[0])
        else:
            false += 1
    return false, listed


def _of_parts(parts: Sequence[tuple[str, float, float]], truth: RecordScene) -> Score:
    time_s = truth.series.time_s
    frequency = truth.modes[0][0]
    edges = [part.start for part in truth.parts[1:]]
    stated = np.array(sorted({start for _, start, _ in parts} | {end for _, _, end in parts}))
    # the record's own limits are no boundary
    step = time_s[1] - time_s[0]
    stated = stated[(stated > time_s[0] + step) & (stated < time_s[-1] - step)]
    distance = [float(np.min(np.abs(stated - time_s[row]), initial=np.inf)) * frequency for row in edges]
    true_s = time_s[edges]
    extra = sum(float(np.min(np.abs(true_s - s), initial=np.inf)) * frequency > 2 for s in stated)
    score: Score = {"edges": distance, "extra_edges": extra, "kinds": _kinds(parts, truth)}
    decays = [
        (part, energy) for part, energy in zip(truth.parts, truth.energy, strict=True) if part.kind == "decay"
    ]
    largest = max(decays, key=lambda pair: pair[1])[0]
    stated_decays = [part for part in parts if part[0] == "decay"]
    if len(truth.parts) > 1:
        score["start"] = any(abs(s - time_s[largest.start]) * frequency < 2 for _, s, _ in stated_decays)
    held = [part for part in truth.parts if part.kind == "held"]
    if held:
        begin, end = time_s[held[0].start], time_s[held[0].end - 1]
        score["hand"] = all((min(e, end) - max(s, begin)) * frequency <= 2 for _, s, e in stated_decays)
    return score


def _kinds(parts: Sequence[tuple[str, float, float]], truth: RecordScene) -> dict[str, float]:
    """Shares of the record by "true kind > stated kind"."""
    shares: dict[str, float] = {}
    time_s = truth.series.time_s
    for row in np.linspace(0, time_s.size - 1, 400).astype(int):
        true = next(part.kind for part in truth.parts if part.start <= row < part.end)
        inside = [kind for kind, start, end in parts if start <= time_s[row] <= end]
        stated = _KINDS.get(inside[0], "other") if inside else "none"
        shares[f"{true} > {stated}"] = shares.get(f"{true} > {stated}", 0.0) + 1 / 400
    return shares


def _row(scores: Sequence[Score]) -> dict[str, str]:
    """Each measure over some records."""

    def all_of(name: str) -> list[Any]:
        return [s[name] for s in scores if name in s]

    def count(name: str) -> str:
        return str(sum(all_of(name)))

    def percent(name: str) -> str:
        values = all_of(name)
        return f"{100 * np.mean(values):.0f}" if values else ""

    def rms(name: str) -> str:
        values = np.clip(np.array(all_of(name), dtype=float), -10, 10)
        values = values[np.isfinite(values)]
        return f"{np.sqrt(np.mean(values**2)):.2f}" if values.size else ""

    edges = [d for s in scores for d in s.get("edges", ())]
    excited, extra = sum(all_of("excited")), all_of("extra_edges")
    return {
        "records": str(len(scores)),
        "crashes": count("crashed"),
        "wrong": count("wrong"),
        "of these without a flag": count("confident"),
        "wrong at small amplitude": count("small"),
        "informative": str(len(all_of("refused"))),
        "of these without mode 1": count("refused"),
        "mode 1 found, %": percent("first"),
        "zeta off by 20 % or lost, %": percent("far"),
        "median error of zeta, %": f"{100 * np.median(all_of('zeta_error') or [np.nan]):.2f}",
        "rms z of frequency": rms("z_frequency"),
        "rms z of zeta": rms("z_zeta"),
        "frequency in 90 % interval, %": percent("in_frequency"),
        "zeta in 90 % interval, %": percent("in_zeta"),
        "boundaries, median distance in cycles": f"{np.median(edges):.2f}" if edges else "",
        "boundaries within half a cycle, %": f"{100 * np.mean(np.array(edges) < 0.5):.0f}" if edges else "",
        "false boundaries a record": f"{np.mean(extra):.2f}" if extra else "",
        "start of the decay right, %": percent("start"),
        "hand recognised, %": percent("hand"),
        "true modes listed, %": f"{100 * sum(all_of('listed')) / excited:.0f}" if excited else "",
        "false modes a record": f"{np.mean(all_of('false')):.2f}",
        "CPU a record, s": f"{np.mean(all_of('cpu_s')):.2f}",
        "longest CPU, s": f"{max(all_of('cpu_s')):.1f}",
        "peak memory, MB": str(max(all_of("peak_mb"))),
    }


def table(runs: Mapping[str, Sequence[Answer]], sets: Mapping[str, Callable[[int], RecordScene]]) -> str:
    """Markdown: the measures of each run side by side over the records that all of them answered, classes, kinds."""
    shared = set.intersection(*({(a["set"], a["seed"]) for a in run} for run in runs.values()))
    truths = {key: sets[key[0]](key[1]) for key in sorted(shared)}
    scored = {
        name: {key: score(a, truths[key]) for a in run if (key := (a["set"], a["seed"])) in shared}
        for name, run in runs.items()
    }
    text = _side_by_side({name: _row(list(s.values())) for name, s in scored.items()})
    text += "\n| class | " + " | ".join(f"wrong, far, records: {name}" for name in runs) + " |\n"
    text += "| --- |" + " --- |" * len(runs) + "\n"
    for trait in _CLASSES:
        keys = [key for key, truth in truths.items() if trait in truth.traits]
        cells = (
            f"{sum(s[k]['wrong'] for k in keys)}, {sum(s[k].get('far', False) for k in keys)}, {len(keys)}"
            for s in scored.values()
        )
        text += f"| {trait} | " + " | ".join(cells) + " |\n"
    text += "\n" + _confusion(scored)
    return text + "\n" + _discordant(scored)


def _side_by_side(rows: Mapping[str, Mapping[str, str]]) -> str:
    first = next(iter(rows.values()))
    text = "| | " + " | ".join(rows) + " |\n| --- |" + " --- |" * len(rows) + "\n"
    shown = [name for name in first if any(row[name] for row in rows.values())]
    return text + "".join(
        f"| {name} | " + " | ".join(r[name] for r in rows.values()) + " |\n" for name in shown
    )


def _confusion(scored: Mapping[str, Mapping[Any, Score]]) -> str:
    """Shares of the time of all records, in %, by true and stated kind."""
    shares: dict[str, dict[str, float]] = {}
    for name, scores in scored.items():
        kinds = [s["kinds"] for s in scores.values() if "kinds" in s]
        for entry in kinds:
            for pair, share in entry.items():
                row = shares.setdefault(pair, dict.fromkeys(scored, 0.0))
                row[name] += 100 * share / len(kinds)
    rows = (
        f"| {pair} | " + " | ".join(f"{v:.1f}" for v in shares[pair].values()) + " |\n"
        for pair in sorted(shares)
    )
    head = (
        "| time by true > stated kind, % | "
        + " | ".join(scored)
        + " |\n| --- |"
        + " --- |" * len(scored)
        + "\n"
    )
    return head + "".join(rows)


def _discordant(scored: Mapping[str, Mapping[Any, Score]]) -> str:
    """Records that only the first or only the last run answers wrongly.

    McNemar's test: a difference is significant (5 %, one-sided) above 1.64 sqrt(b + c).
    """
    runs = list(scored.values())
    first, last = runs[0], runs[-1]
    text = ""
    for measure in ("wrong", "confident", "refused", "far"):
        only_first = [k[1] for k in first if first[k].get(measure) and not last[k].get(measure)]
        only_last = [k[1] for k in first if last[k].get(measure) and not first[k].get(measure)]
        text += f"{measure}: only before {len(only_first)} {only_first}, only after {len(only_last)} {only_last}\n\n"
    return text
