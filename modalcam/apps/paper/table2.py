"""Table 2: measured natural frequencies and damping ratios against the printed ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id import IdentifiedMode
from modalcam.apps.paper.recomputed import Truth
from sim import reference as printed
from tracker import FloatArray

_NAN = float("nan")


@dataclass(frozen=True)
class Quantity:
    """A printed value of a mode and the measured one, in the unit of the table (Hz or per cent); unknown ones are NaN.

    `rounding` is half of the last digit printed, `truth` the simulated value.
    """

    number: int
    printed: float
    rounding: float
    truth: float
    value: float = _NAN
    sd: float = _NAN
    interval_90: tuple[float, float] = (_NAN, _NAN)
    interval_99: tuple[float, float] = (_NAN, _NAN)

    @property
    def difference(self) -> float:
        """Relative difference of the measured value from the printed one."""
        return self.value / self.printed - 1.0

    @property
    def apart(self) -> float:
        """Relative difference of the simulated value from the printed one."""
        return self.truth / self.printed - 1.0

    @property
    def level(self) -> float:
        """Level of the narrower interval that contains the printed value: 0.9, 0.99, or 1 for neither."""
        return self._level_of(self.printed)

    @property
    def truth_level(self) -> float:
        """The same for the simulated value."""
        return self._level_of(self.truth)

    def _level_of(self, value: float) -> float:
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
    """One mode of Table 2; without a recording and a mode if it was not measured."""

    number: int
    recording: str
    mode: IdentifiedMode | None
    frequency: Quantity
    damping: Quantity


def rows(measured: dict[int, tuple[str, IdentifiedMode]], truth: Truth) -> tuple[Row, ...]:
    """The paper's five modes; `measured` gives recording and mode by number."""
    out = []
    values = zip(printed.TABLE_2_FREQUENCY_HZ, printed.TABLE_2_DAMPING_RATIO, strict=True)
    for number, (frequency_hz, ratio) in enumerate(values, 1):
        name, mode = measured.get(number, ("", None))
        f_draws, z_draws = (
            (mode.posterior.frequency_hz, mode.posterior.damping_ratio) if mode else (None, None)
        )
        true_hz, true_ratio = truth.modes.get(number, (_NAN, _NAN))
        frequency = _quantity(number, frequency_hz, printed.FREQUENCY_ROUNDING_HZ, true_hz, f_draws)
        damping = _quantity(number, ratio, printed.DAMPING_ROUNDING, true_ratio, z_draws, scale=100.0)
        out.append(Row(number, name, mode, frequency, damping))
    return tuple(out)


def _quantity(
    number: int, value: float, rounding: float, truth: float, draws: FloatArray | None, *, scale: float = 1.0
) -> Quantity:
    """Printed, simulated and measured value, all multiplied by `scale`."""
    given = (number, scale * value, scale * rounding, scale * truth)
    if draws is None:
        return Quantity(*given)
    # As the intervals of an identified mode.
    low_99, low_90, median, high_90, high_99 = scale * np.quantile(draws, (0.005, 0.05, 0.5, 0.95, 0.995))
    return Quantity(*given, median, scale * float(np.std(draws)), (low_90, high_90), (low_99, high_99))
