"""Failed checks, ranked by their effect on the results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from modal_id import Check, DrivenMotion, IdentifiedMode, ModeFlag, quoted_note
from modal_id.modes import line_effect
from modalcam.pipeline import MeasuredMode, RecordingResult, RunResult
from modalcam.report.signals import best_modes, main_modes
from modalcam.report.style import count, fixed, listed, mode_name, p_value, percent, significant
from tracker import REGISTRY, MarkerTracks, Severity


@dataclass(frozen=True)
class Tuning:
    """What is listed as a failed check."""

    #: [1] chains with a larger R-hat have not converged
    #: convention: Between 1.1 (Gelman and Rubin 1992) and 1.01 (Vehtari et al. 2021), beyond which the trace is shown.
    r_hat: float = 1.05
    #: [1] markers of a smaller modal phase collinearity do not move as in a normal mode
    #: convention: Proportional damping gives 1; no reference states a limit.
    mpc: float = 0.95
    #: [1] factor on an interval from which on it is stated
    #: convention: A smaller factor is not worth a line.
    wider: float = 1.05
    #: [sd] a line that changes frequency and damping ratio by less is no failed check
    #: convention: Added in quadrature, it widens an interval by 4 %.
    slight: float = 0.3
    #: [sd] distance of an updated property from the configured one, in sd of its prior, from which on it is stated
    #: statistics: One of 42 normal values is that far out in 2 % of beams.
    strain: float = 3.5
    #: [1] relative distance from a measured mode within which a line of a residual is named after it
    #: convention: Modes of a beam are factors apart.
    near: float = 0.02


TUNING = Tuning()
# Kinds of checks, those with the largest effect first.
KINDS = (
    "playback",
    "rate",
    "cut",
    "wrong",
    "failed",
    "sampler",
    "repeats",
    "damaged",
    "undetected",
    "lossy",
    "interval",
    "fit",
    "phase",
    "beam",
    # These change no result.
    "slight",
    "other",
)
PASSED = ("slight", "other")
# Severities of the flags listed as failed checks, and the largest number of places named with each.
_SHOWN = (Severity.WRONG, Severity.INTERVAL)
MOST_PLACES = 6


@dataclass(frozen=True)
class Alert:
    """One failed check.

    Attributes
    ----------
    kind : str
        One of `KINDS`.
    places : tuple of (str, str)
        Anchor and text of each recording, mode or marker concerned.
    name, meaning, remedy, effect : str
        Flag or statistic, what it means, what to do and how much the results change; empty where the template says it.
    brief : tuple of str
        The places in fewer words, for the first screen; empty where `places` are short.
    largest : str
        A sentence on the largest effect of all places.
    """

    kind: str
    places: tuple[tuple[str, str], ...]
    name: str = ""
    meaning: str = ""
    remedy: str = ""
    effect: str = ""
    brief: tuple[str, ...] = ()
    largest: str = ""


def alerts(
    result: RunResult,
    views: Sequence[dict[str, Any]] = (),
    repeats: Iterable[MeasuredMode] = (),
    updating: Mapping[str, Any] | None = None,
) -> list[Alert]:
    """Failed checks in order of their effect.

    Parameters
    ----------
    views : sequence of dict
        Of `recording_view`: checks of the residuals and of the shapes.
    repeats : iterable of MeasuredMode
        Modes that several recordings have.
    updating : mapping or None
        Of `updating_numbers`; None or empty where nothing was updated.
    """
    kinds: dict[str, Callable[[RecordingResult], bool]] = {
        "playback": lambda r: _tracked(r, lambda tracks: tracks.time_axis.is_playback_guess),
        "failed": lambda r: bool(r.failure),
        "damaged": lambda r: _tracked(r, lambda tracks: tracks.decode.frames_corrupt > 0),
        "undetected": lambda r: _tracked(r, lambda tracks: not tracks.decode.shows_damage),
        # Errors of frames coded one by one are little above the noise; those of predicted frames follow the motion.
        "lossy": lambda r: _tracked(r, lambda tracks: tracks.decode.lossy and tracks.decode.predictive),
        "sampler": _not_converged,
    }
    found = [
        Alert(kind, tuple((anchor_of(i), r.file) for i, r in enumerate(result.recordings) if holds(r)))
        for kind, holds in kinds.items()
    ]
    modes_hz = {number: mode.frequency_hz for number, (_, mode) in best_modes(result).items()}
    found += [*_flagged(result), *_of_fits(views, modes_hz)]
    found.append(Alert("rate", tuple(_other_rates(result))))
    found.append(Alert("cut", tuple(_cut_files(result))))
    found.append(Alert("beam", tuple(_strained(updating or {}))))
    found.append(Alert("repeats", tuple(("modes", _disagreement(m)) for m in repeats if _disagrees(m))))
    return sorted((alert for alert in found if alert.places), key=lambda alert: KINDS.index(alert.kind))


def _other_rates(result: RunResult) -> Iterator[tuple[str, str]]:
    """Recordings whose lines would be modes of the beam at another rate, with that rate."""
    for i, recording in enumerate(result.recordings):
        fitting = recording.identified and recording.identified.fitting_rate
        if fitting:
            ratio = f"a ratio of {fitting.ratio:.3g} ({recording.name})"
            yield anchor_of(i), f"{fitting.rate} fits, not {fitting.recorded_hz:.4g} Hz: {ratio}"


def _cut_files(result: RunResult) -> Iterator[tuple[str, str]]:
    """Recordings whose files have fewer frames than they declare, with both numbers."""
    for i, recording in enumerate(result.recordings):
        if isinstance(recording.tracks, MarkerTracks):
            cut = recording.tracks.decode.cut_off(recording.tracks.time_axis.known_fps)
            if cut:
                yield anchor_of(i), f"{cut.partition(': ')[2]} ({recording.name})"


def _strained(numbers: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """The property that updating changes most, where its prior hardly allows that."""
    if numbers and numbers["strain"] >= TUNING.strain:
        by = f"{significant(numbers['strained_change'], 2)} %, {significant(numbers['strain'], 2)} standard deviations"
        yield "updating", f"{numbers['strained']} changes by {by} of the prior"


def _disagrees(mode: MeasuredMode) -> bool:
    return mode.frequency.disagree or mode.damping.disagree


def _disagreement(mode: MeasuredMode) -> str:
    """Which values of a mode differ between recordings, and by how much."""
    parts = [
        f"{name} (χ² = {significant(one.chi_square)}, {count(one.dof, 'degree')} of freedom; standard deviation "
        f"between recordings {significant(scale * one.between_sd, 2)} {unit})"
        for name, one, scale, unit in (
            ("frequencies", mode.frequency, 1.0, "Hz"),
            ("damping ratios", mode.damping, 100.0, "%"),
        )
        if one.disagree
    ]
    return f"mode {mode.number}: {listed(parts)}"


class _Line(NamedTuple):
    """Line that a statistic of a residual measures: its frequency, what is near it, its effect on the mode in sd."""

    frequency: str
    near: str = ""
    effect_sd: tuple[float, float] | None = None

    @property
    def effect(self) -> str:
        if self.effect_sd is None:
            return ""
        largest = max(self.effect_sd)
        if largest < 1.0:
            most = significant(max(largest, 0.01), 1)
            return f"shifts frequency and damping ratio by less than {most} of their standard deviations"
        of_frequency, of_damping = (significant(value, 2) for value in self.effect_sd)
        return f"may change the frequency by {of_frequency} sd and the damping ratio by {of_damping} sd"


def _line(view: dict[str, Any], check: Check, modes_hz: Mapping[int, float]) -> _Line | None:
    hz, mode = check.frequency_hz, view.get("mode")
    if not np.isfinite(hz):
        return None
    known = {f"mode {number}": own for number, own in modes_hz.items()}
    if mode is not None and mode.number is not None:
        known[f"twice mode {mode.number}"] = 2.0 * mode.frequency_hz
    near = min(known, key=lambda name: abs(known[name] - hz), default="")
    close = bool(near) and abs(known[near] / hz - 1.0) < TUNING.near
    effect = None
    if mode is not None:
        changed = line_effect(view["found"], mode, hz)
        effect = (changed.frequency_hz / mode.frequency_sd_hz, changed.damping_ratio / mode.damping_ratio_sd)
    return _Line(f"{significant(hz)} Hz", f"near {near}" if close else "", effect)


def _fit_alert(
    name: str, ones: Sequence[tuple[dict[str, Any], Check]], modes_hz: Mapping[int, float]
) -> Alert:
    """One statistic that fails in some recordings."""
    found = [(view, check, _line(view, check, modes_hz)) for view, check in ones]
    places, brief = [], []
    for view, check, line in found:
        parts = [part for part in (line.frequency, line.near, line.effect) if part] if line else []
        inside = "; ".join([*([", ".join(parts)] if parts else []), f"p {p_value(check.p_value, 0.003)}"])
        places.append((view["anchor"], f"{view['recording'].name} ({inside})"))
        at = ", ".join(part for part in (line.frequency, line.near) if part) if line else ""
        brief.append(f"recording {view['recording'].name}" + (f" (line at {at})" if at else ""))
    lines = [line for _, _, line in found if line and line.effect_sd]
    worst = max(lines, key=lambda line: max(line.effect_sd or (0.0,)), default=None)
    check = ones[0][1]
    slight = len(lines) == len(found) and worst and max(worst.effect_sd or (0.0,)) < TUNING.slight
    return Alert(
        "slight" if slight else "fit",
        tuple(places),
        name[0].upper() + name[1:],
        check.cause,
        check.remedy,
        brief=tuple(brief),
        largest=f"{'It' if len(lines) == 1 else 'The line with the largest effect'} {worst.effect}."
        if worst
        else "",
    )


def _of_fits(views: Sequence[dict[str, Any]], modes_hz: Mapping[int, float]) -> list[Alert]:
    """Statistics of residuals that the fitted model does not explain, the least probable first; travelling waves.

    `modes_hz` gives the measured frequency of each mode of the beam.
    """
    failed: dict[str, list[tuple[dict[str, Any], Check]]] = {}
    for view in views:
        for check in view["checks"]:
            if not check.holds:
                failed.setdefault(check.name, []).append((view, check))
    ranked = sorted(failed.items(), key=lambda item: min(check.p_value for _, check in item[1]))
    out = [_fit_alert(name, ones, modes_hz) for name, ones in ranked]
    waves = [
        (v["anchor"], f"{v['recording'].name} ({fixed(v['mpc'], 4)})")
        for v in views
        if v["mpc"] <= TUNING.mpc
    ]
    return [*out, Alert("phase", tuple(waves))]


def _flagged(result: RunResult) -> list[Alert]:
    """Flags of the modes shown and of markers; those of secondary modes together in one."""
    places: dict[tuple[Severity, str], list[tuple[str, str]]] = {}
    widened: dict[str, list[IdentifiedMode]] = {}
    others: list[tuple[str, str]] = []
    for i, recording in enumerate(result.recordings):
        found, anchor = recording.identified, anchor_of(i)
        main = [] if found is None else main_modes(found)
        flagged: list[IdentifiedMode | DrivenMotion] = [*found.modes, *found.driven] if found else []
        for mode in flagged:
            matter = [flag for flag in mode.flags if mode.severity_of(flag) in _SHOWN]
            if isinstance(mode, IdentifiedMode) and mode not in main:
                others += (
                    [(anchor, f"{recording.name}, {_name(mode)}: {', '.join(matter)}")] if matter else []
                )
                continue
            for flag in matter:
                text = f"{recording.name}, {_name(mode)}"
                if note := quoted_note(ModeFlag[flag], mode.notes):
                    text = f"{text}: {note.rstrip('.')}"
                place = (anchor, text)
                places.setdefault((mode.severity_of(flag), flag), []).append(place)
                if isinstance(mode, IdentifiedMode):
                    widened.setdefault(flag, []).append(mode)
        if isinstance(recording.tracks, MarkerTracks):
            for severity, name, text in _of_markers(recording.tracks):
                places.setdefault((severity, name), []).append((anchor, f"{recording.name}, {text}"))
    ranked = sorted(
        places.items(), key=lambda item: (_SHOWN.index(item[0][0]), -_widest(widened, item[0][1]))
    )
    meaning = flag_meanings()
    # The meaning of a flag is given once, where its effect is largest.
    flags = [
        Alert(
            severity.name.lower(),
            tuple(named),
            flag,
            meaning.pop(flag, ""),
            "",
            _wider(widened.get(flag, [])),
        )
        for (severity, flag), named in ranked
    ]
    return [*flags, Alert("other", tuple(others))]


def flag_meanings() -> dict[str, str]:
    """Descriptions of the flags of modes, then of those of markers in frames."""
    return {flag.name: flag.value for flag in ModeFlag} | {flag.name: flag.description for flag in REGISTRY}


def _factor(mode: IdentifiedMode) -> float:
    """Standard deviation of the damping ratio over that for white noise alone; NaN where that is unknown."""
    white = mode.posterior.laplace_sd[1]
    return mode.damping_ratio_sd / white if white > 0.0 else float("nan")


def _widest(widened: dict[str, list[IdentifiedMode]], flag: str) -> float:
    return max((f for mode in widened.get(flag, []) if np.isfinite(f := _factor(mode))), default=0.0)


def _wider(modes: Sequence[IdentifiedMode]) -> str:
    """``1.2 to 3.4``: factors by which the intervals of the damping ratios are wider than for white noise."""
    factors = [significant(f, 2) for f in sorted(map(_factor, modes)) if f >= TUNING.wider]
    return " to ".join(dict.fromkeys((factors[0], factors[-1]))) if factors else ""


def flag_counts(tracks: MarkerTracks, k: int) -> list[tuple[str, int, Severity]]:
    """Flags of a marker, with the number of frames that have each and its severity there."""
    counts = [(flag, int(np.count_nonzero(tracks.flags[:, k] & flag.value))) for flag in REGISTRY]
    return [(flag.name, n, flag.severity_in(n / tracks.frame.size)) for flag, n in counts if n]


def _name(mode: IdentifiedMode | DrivenMotion) -> str:
    return f"{significant(mode.frequency_hz, 4)} Hz" if isinstance(mode, DrivenMotion) else mode_name(mode)


def _of_markers(tracks: MarkerTracks) -> list[tuple[Severity, str, str]]:
    """Severity and name of each flag that matters, with marker and share of the frames."""
    return [
        (severity, name, f"marker {tracks.markers[k]} ({percent(n / tracks.frame.size)} of its frames)")
        for k in range(len(tracks.markers))
        for name, n, severity in flag_counts(tracks, k)
        if severity in _SHOWN
    ]


def anchor_of(index: int) -> str:
    """Anchor of the section of the recording at `index`, 0 first."""
    return f"r{index + 1}"


def _tracked(recording: RecordingResult, holds: Callable[[MarkerTracks], bool]) -> bool:
    return isinstance(recording.tracks, MarkerTracks) and holds(recording.tracks)


def _not_converged(recording: RecordingResult) -> bool:
    found = recording.identified
    # A NaN is not above the limit.
    return found is not None and any(r > TUNING.r_hat for m in found.modes for r in m.posterior.r_hat)
