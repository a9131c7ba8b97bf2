"""Table 2: measured natural frequencies and damping ratios beside the paper's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from modal_id.results import IdentifiedMode
from modalcam.paper.truth import Truth
from modalcam.paper.words import listed, modes_named, of_all, signed_percent, signed_range
from modalcam.report.style.format import MISSING, fixed, interval, significant, with_sd
from sim.reference import paper_tables as printed

_NAN = float("nan")


@dataclass(frozen=True)
class Quantity:
    """One measured value beside the printed one, in the unit of the table (Hz or per cent).

    Attributes
    ----------
    printed, rounding : float
        The paper's value and what its last digit leaves open.
    truth : float
        What was simulated; NaN where it is unknown.
    value, sd : float
        Measured; NaN where the mode was not.
    interval_90, interval_99 : tuple of float
    """

    printed: float
    rounding: float
    truth: float
    value: float
    sd: float
    interval_90: tuple[float, float]
    interval_99: tuple[float, float]

    @property
    def measured(self) -> bool:
        """Whether there is a measured value."""
        return self.value == self.value

    @property
    def difference(self) -> float:
        """Of the measured value from the printed one, relative."""
        return self.value / self.printed - 1.0

    def level_holding(self, value: float) -> float:
        """Level of the narrowest of the two intervals that holds `value`: 0.9, 0.99, or 1 for neither."""
        for level, (low, high) in ((0.9, self.interval_90), (0.99, self.interval_99)):
            if low <= value <= high:
                return level
        return 1.0

    @property
    def within_rounding(self) -> bool:
        """Whether the 99 % interval meets what the printed value may be before it was rounded."""
        low, high = self.interval_99
        return low <= self.printed + self.rounding and high >= self.printed - self.rounding


@dataclass(frozen=True)
class Row:
    """One mode of Table 2; `recording` is empty where it was not measured."""

    number: int
    recording: str
    frequency: Quantity
    damping: Quantity


@dataclass(frozen=True)
class Cells:
    """A quantity as the page shows it: `state` is "good", "care" or "none"."""

    printed: str
    truth: str
    ours: str
    interval: str
    verdict: str
    state: str
    value: float


def rows(measured: dict[int, tuple[str, IdentifiedMode]], truth: Truth) -> tuple[Row, ...]:
    """The paper's five modes; `measured` gives recording and mode by number."""
    out = []
    for i, (frequency_hz, ratio) in enumerate(
        zip(printed.TABLE_2_FREQUENCY_HZ, printed.TABLE_2_DAMPING_RATIO, strict=True)
    ):
        name, mode = measured.get(i + 1, ("", None))
        true = truth.modes.get(i + 1)
        out.append(
            Row(
                i + 1,
                name,
                _frequency(mode, frequency_hz, _NAN if true is None else true.frequency_hz),
                _damping(mode, ratio, _NAN if true is None else true.damping_ratio),
            )
        )
    return tuple(out)


def _frequency(mode: IdentifiedMode | None, printed_hz: float, truth_hz: float) -> Quantity:
    rounding = printed.FREQUENCY_ROUNDING_HZ
    if mode is None:
        return Quantity(printed_hz, rounding, truth_hz, _NAN, _NAN, (_NAN, _NAN), (_NAN, _NAN))
    return Quantity(
        printed=printed_hz,
        rounding=rounding,
        truth=truth_hz,
        value=mode.frequency_hz,
        sd=mode.frequency_sd_hz,
        interval_90=mode.frequency_interval_hz(0.9),
        interval_99=mode.frequency_interval_hz(0.99),
    )


def _damping(mode: IdentifiedMode | None, printed_ratio: float, truth: float) -> Quantity:
    values = (100.0 * printed_ratio, 100.0 * printed.DAMPING_ROUNDING, 100.0 * truth)
    if mode is None:
        return Quantity(*values, _NAN, _NAN, (_NAN, _NAN), (_NAN, _NAN))
    low_90, high_90 = mode.damping_interval(0.9)
    low_99, high_99 = mode.damping_interval(0.99)
    return Quantity(
        *values,
        value=100.0 * mode.damping_ratio,
        sd=100.0 * mode.damping_ratio_sd,
        interval_90=(100.0 * low_90, 100.0 * high_90),
        interval_99=(100.0 * low_99, 100.0 * high_99),
    )


def cells(quantity: Quantity) -> Cells:
    """The quantity as text."""
    q = quantity
    if not q.measured:
        return Cells(fixed(q.printed, 2), _truth_text(q), MISSING, "", "not measured", "none", _NAN)
    level = q.level_holding(q.printed)
    if level < 1.0:
        verdict, state = f"in the {100 * level:.0f} % interval", "good"
    elif q.within_rounding:
        verdict, state = "within its rounding", "good"
    else:
        verdict, state = f"ours differs by {signed_percent(q.difference)}", "care"
    return Cells(
        printed=fixed(q.printed, 2),
        truth=_truth_text(q),
        ours=with_sd(q.value, q.sd),
        interval=interval(*q.interval_90, q.sd),
        verdict=verdict,
        state=state,
        value=q.value,
    )


def _truth_text(quantity: Quantity) -> str:
    return "" if quantity.truth != quantity.truth else f"{quantity.truth:.6g}"


def sentences(table: Sequence[Row], truth: Truth) -> tuple[str, ...]:
    """What the table shows, from its numbers."""
    found = [row for row in table if row.recording]
    if not found:
        return ("No mode of Table 2 was measured in this folder.", *_note(truth))
    out = [
        _agreement("damping ratio", found, lambda row: row.damping),
        _agreement("natural frequency", found, lambda row: row.frequency),
    ]
    absent = [row.number for row in table if not row.recording]
    if absent:
        verb = "was" if len(absent) == 1 else "were"
        out.append(f"{modes_named(absent).capitalize()} of the paper {verb} not measured here.")
    return (*out, *_against_truth(found), *_note(truth))


def _note(truth: Truth) -> tuple[str, ...]:
    return (truth.note,) if truth.note else ()


def _agreement(name: str, found: Sequence[Row], of: Callable[[Row], Quantity]) -> str:
    """For how many modes the printed value lies in the intervals, and how far the others are off."""
    levels = [of(row).level_holding(of(row).printed) for row in found]
    narrow, wide = (sum(level <= limit for level in levels) for limit in (0.9, 0.99))
    text = (
        f"The paper’s {name} lies in our 90 % interval for {of_all(narrow, len(found))} of the modes measured"
    )
    if wide > narrow:
        text += f", in the 99 % interval for {of_all(wide, len(found))}"
    off = [row for row, level in zip(found, levels, strict=True) if level == 1.0]
    if not off:
        return text + "."
    differences = [of(row).difference for row in off]
    times = [abs(of(row).value - of(row).printed) / of(row).sd for row in off if of(row).sd > 0.0]
    text += f"; for {modes_named([row.number for row in off])} ours differs by {signed_range(differences)}"
    if times:
        text += f", at least {significant(min(times), 2)} of our standard deviations"
    rounded = sum(of(row).within_rounding for row in off)
    text += (
        f", and the rounding of the printed value explains {of_all(rounded, len(off))} of these differences."
        if rounded
        else ", which the rounding of the printed values does not explain."
    )
    return text


def _against_truth(found: Sequence[Row]) -> tuple[str, ...]:
    """What simulated recordings were simulated with, beside the paper and beside our intervals."""
    known = [row for row in found if row.frequency.truth == row.frequency.truth]
    if not known:
        return ()
    same = [row for row in known if abs(row.damping.truth / row.damping.printed - 1.0) < 1e-9]
    apart = [row.frequency.truth / row.frequency.printed - 1.0 for row in known]
    parts = [f"Table 2’s damping ratio in {of_all(len(same), len(known))} of these modes"]
    if max(abs(a) for a in apart) > 1e-9:
        parts.append(
            f"frequencies that differ from Table 2’s by {signed_range(apart)}, because the beam simulated is "
            "not exactly the paper’s"
        )
    else:
        parts.append("Table 2’s frequencies")
    quantities = [q for row in known for q in (row.frequency, row.damping)]
    narrow = sum(q.level_holding(q.truth) <= 0.9 for q in quantities)
    wide = sum(q.level_holding(q.truth) <= 0.99 for q in quantities)
    return (
        f"The folder tells what was simulated: {listed(parts)}.",
        (
            f"What was simulated lies in our 90 % interval in {narrow} of {len(quantities)} cases "
            f"({0.9 * len(quantities):.0f} expected) and in our 99 % interval in {of_all(wide, len(quantities))}."
        ),
    )
