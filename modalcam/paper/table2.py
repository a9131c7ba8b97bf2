"""Table 2: measured natural frequencies and damping ratios against the printed ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from modal_id.results import IdentifiedMode
from modalcam.paper.measured import Truth
from sim.reference import paper_tables as printed

_NAN = float("nan")


@dataclass(frozen=True)
class Quantity:
    """A printed value and the measured one, in the unit of the table (Hz or per cent).

    Attributes
    ----------
    printed, rounding : float
        The paper's value, and half of its last digit.
    truth : float
        Simulated value; NaN if unknown.
    value, sd : float
        Measured; NaN if the mode was not measured.
    interval_90, interval_99 : tuple of float
    """

    printed: float
    rounding: float
    truth: float
    value: float = _NAN
    sd: float = _NAN
    interval_90: tuple[float, float] = (_NAN, _NAN)
    interval_99: tuple[float, float] = (_NAN, _NAN)

    @property
    def measured(self) -> bool:
        """Whether there is a measured value."""
        return self.value == self.value

    @property
    def simulated(self) -> bool:
        """Whether the simulated value is known."""
        return self.truth == self.truth

    @property
    def difference(self) -> float:
        """Relative difference of the measured value from the printed one."""
        return self.value / self.printed - 1.0

    @property
    def deviations(self) -> float | None:
        """Difference from the printed value in our standard deviations; None without one."""
        return abs(self.value - self.printed) / self.sd if self.sd > 0.0 else None

    @property
    def apart(self) -> float:
        """Relative difference of the simulated value from the printed one."""
        return self.truth / self.printed - 1.0

    @property
    def level(self) -> float:
        """Level of the narrower interval that contains the printed value: 0.9, 0.99, or 1 for neither."""
        return self.level_containing(self.printed)

    def level_containing(self, value: float) -> float:
        """Level of the narrower interval that contains `value`: 0.9, 0.99, or 1 for neither."""
        for level, (low, high) in ((0.9, self.interval_90), (0.99, self.interval_99)):
            if low <= value <= high:
                return level
        return 1.0

    @property
    def within_rounding(self) -> bool:
        """Whether the 99 % interval overlaps the range of values that are rounded to the printed one."""
        low, high = self.interval_99
        return low <= self.printed + self.rounding and high >= self.printed - self.rounding


@dataclass(frozen=True)
class Row:
    """One mode of Table 2; `recording` is empty if it was not measured."""

    number: int
    recording: str
    frequency: Quantity
    damping: Quantity


@dataclass(frozen=True)
class Agreement:
    """Printed values of one quantity against our intervals.

    Attributes
    ----------
    count, narrow, wide : int
        Modes measured, and those whose printed value lies in the 90 % and in the 99 % interval.
    off : tuple of (int, Quantity)
        The others, with the number of the mode.
    """

    count: int
    narrow: int
    wide: int
    off: tuple[tuple[int, Quantity], ...]

    @property
    def rounded(self) -> int:
        """Number of these that rounding explains."""
        return sum(q.within_rounding for _, q in self.off)


def rows(measured: dict[int, tuple[str, IdentifiedMode]], truth: Truth) -> tuple[Row, ...]:
    """The paper's five modes; `measured` gives recording and mode by number."""
    out = []
    values = zip(printed.TABLE_2_FREQUENCY_HZ, printed.TABLE_2_DAMPING_RATIO, strict=True)
    for number, (frequency_hz, ratio) in enumerate(values, 1):
        name, mode = measured.get(number, ("", None))
        true = truth.modes.get(number)
        frequency = Quantity(
            frequency_hz, printed.FREQUENCY_ROUNDING_HZ, _NAN if true is None else true.frequency_hz
        )
        damping = Quantity(
            100.0 * ratio,
            100.0 * printed.DAMPING_ROUNDING,
            _NAN if true is None else 100.0 * true.damping_ratio,
        )
        if mode is not None:
            frequency = replace(
                frequency,
                value=mode.frequency_hz,
                sd=mode.frequency_sd_hz,
                interval_90=mode.frequency_interval_hz(0.9),
                interval_99=mode.frequency_interval_hz(0.99),
            )
            damping = replace(
                damping,
                value=100.0 * mode.damping_ratio,
                sd=100.0 * mode.damping_ratio_sd,
                interval_90=_percent(mode.damping_interval(0.9)),
                interval_99=_percent(mode.damping_interval(0.99)),
            )
        out.append(Row(number, name, frequency, damping))
    return tuple(out)


def _percent(interval: tuple[float, float]) -> tuple[float, float]:
    return 100.0 * interval[0], 100.0 * interval[1]


def agreement(quantities: Sequence[tuple[int, Quantity]]) -> Agreement:
    """Agreement of the printed values with the intervals, for the measured modes among `quantities`."""
    found = [(number, q) for number, q in quantities if q.measured]
    return Agreement(
        count=len(found),
        narrow=sum(q.level <= 0.9 for _, q in found),
        wide=sum(q.level <= 0.99 for _, q in found),
        off=tuple((number, q) for number, q in found if q.level == 1.0),
    )


def simulated(table: Sequence[Row]) -> tuple[Quantity, ...]:
    """Measured quantities whose simulated value is known."""
    return tuple(q for row in table for q in (row.frequency, row.damping) if q.measured and q.simulated)
