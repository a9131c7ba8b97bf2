"""Result of a check of the residual against what the fitted model would leave."""

from __future__ import annotations

from dataclasses import dataclass

ALARM = 0.01


@dataclass(frozen=True)
class Check:
    """One statistic of the residual, with the likely cause of a small p-value and what to do, a sentence each.

    ``typical`` is the median of the replicates; ``p_value`` is the share of values at least as large, among the
    replicates and the record itself. ``frequency_hz`` is that of the line which the statistic measures, else NaN.
    """

    name: str
    value: float
    typical: float
    p_value: float
    cause: str
    remedy: str
    frequency_hz: float = float("nan")

    @property
    def holds(self) -> bool:
        """Whether the record is not among the most extreme 1 %."""
        return self.p_value > ALARM
