"""True frequencies of lines that may be aliases: what recordings at several rates, or uneven times, tell about them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from modal_id.data import BEYOND_SD, MIN_SAMPLES, FitData
from modal_id.fit import EVEN_STEPS
from modal_id.mode_values import Table, axes_or_new, damped_hz
from modal_id.results import Identification, IdentifiedMode
from modal_id.sentences import ModeFlag, Note
from modal_id.solve import Problem, gauss_newton, objective, pole
from tracker import BoolArray, Column, FloatArray, checked, data_frame

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Tuning:
    """Odds of aliases."""

    #: [1] relative scale of the difference between recordings of one mode, beyond their standard deviations
    #: measurement: 4e-4 between three films of a tuning fork, 5e-4 between two releases of an aluminium strip.
    scatter: float = 1e-3
    #: [1] degrees of freedom of the Student density of that difference
    #: measurement: From large to small amplitudes, the frequency of the strip changes by 4 times the scale.
    scatter_dof: float = 4.0
    #: [1] probability that a mode of one recording is a line of another one, too
    #: convention: Each recording may have been made for another mode.
    seen: float = 0.5
    #: [1] prior probability that a line without the flag ALIASED_POSSIBLE is no alias
    #: convention: Rates are usually sufficient.
    resolved: float = 0.9
    #: [1] highest frequency considered over the highest sampling rate
    #: physics: A shutter that is always open averages a vibration at twice the rate to zero, and leaves 13 % above it.
    highest: float = 2.0
    #: [1] highest frequency considered over the sampling rate of the line
    #: physics: An exposure of 2 % of the frame interval averages a vibration at 50 times the rate to zero.
    periods: float = 50.0
    #: [1] probability from which one frequency is stated
    #: convention: Odds of nine to one.
    decided: float = 0.9
    #: [samples] the first ones of a record, where the decay is largest, from which its times are judged
    #: physics: At half the rate and above they span 1000 cycles, and 1 % of a step is 1.8 degrees or more of the phase.
    most_samples: int = 2048


TUNING = Tuning()
DECIDED, MOST_SAMPLES = TUNING.decided, TUNING.most_samples


def apparent_hz(frequency_hz: float, rate_hz: float) -> float:
    """Frequency at which a vibration appears in samples at an even rate: between 0 and half of it."""
    return float(abs(frequency_hz - rate_hz * round(frequency_hz / rate_hz)))


def alias_frequencies(frequency_hz: float, rate_hz: float, highest_hz: float) -> FloatArray:
    """The frequency f, then all others ``|k rate +- f|`` up to a limit, ascending: alike in samples at an even rate."""
    periods = np.arange(1, int(highest_hz / rate_hz) + 2) * rate_hz
    found = np.setdiff1d(
        np.abs(np.concatenate([periods - frequency_hz, periods + frequency_hz])), frequency_hz
    )
    return np.append(frequency_hz, found[found <= highest_hz])


@dataclass(frozen=True, eq=False)
class Line:
    """A mode as one recording shows it.

    ValueError where a value is not finite, a rate or frequency not positive, or a damping ratio above 1.

    Attributes
    ----------
    recording : str
    rate_hz : float
        Sampling rate.
    frequency_hz, frequency_sd_hz : float
        Identified, below half the rate; the standard deviation is without the error of the rate.
    damping_ratio : float
    number : int or None
        Number of the beam's mode.
    rate_sd_ppm : float
        Relative standard deviation of the rate.
    amplitude : float
        Compared with other lines of the recording only.
    doubtful : bool
        Whether the recording itself, or theory, says that the line may be an alias.
    log_likelihood : callable or None
        Where times are uneven: of frequencies, shape (m,), what the record tells about each; shape (m,).
    """

    recording: str
    rate_hz: float
    frequency_hz: float
    frequency_sd_hz: float
    damping_ratio: float = 0.0
    number: int | None = None
    rate_sd_ppm: float = 0.0
    amplitude: float = 1.0
    doubtful: bool = False
    log_likelihood: Callable[[FloatArray], FloatArray] | None = None

    def __post_init__(self) -> None:
        for name in ("rate_hz", "frequency_hz"):
            checked(f"{self.recording}: {name}", getattr(self, name), positive=True)
        checked(f"{self.recording}: frequency_sd_hz", self.frequency_sd_hz, at_least=0.0)
        checked(f"{self.recording}: damping_ratio", self.damping_ratio, at_least=0.0, at_most=1.0)

    @property
    def damped_hz(self) -> float:
        """Damped frequency, which sampling folds; the decay rate stays."""
        return damped_hz(self.frequency_hz, self.damping_ratio)

    def variance_hz2(self, true_hz: FloatArray) -> FloatArray:
        """Of the true frequency, for each that the line may stand for: an error of the rate grows with it."""
        return self.frequency_sd_hz**2 + (1e-6 * self.rate_sd_ppm * true_hz) ** 2


@dataclass(frozen=True)
class Alias:
    """A frequency that a line may stand for.

    Attributes
    ----------
    frequency_hz, frequency_sd_hz, damping_ratio : float
        Of the mode, if this is its frequency: sampling keeps the decay rate, so that the damping ratio falls as the
        frequency rises.
    probability : float
        Of all frequencies up to the limit.
    recordings : tuple of str
        Others, at other rates, with a line where this frequency would appear.
    """

    frequency_hz: float
    frequency_sd_hz: float
    damping_ratio: float
    probability: float
    recordings: tuple[str, ...]


@dataclass(frozen=True)
class LineAliases:
    """What is known of the true frequency of one line.

    Attributes
    ----------
    line : Line
    aliases : tuple of Alias
        In order of frequency: the identified one is the first.
    limit_hz : float
        Highest frequency considered.
    informed : bool
        Whether another recording, or uneven times, tells the aliases apart.
    """

    line: Line
    aliases: tuple[Alias, ...]
    limit_hz: float
    informed: bool

    @property
    def best(self) -> Alias:
        """The most probable one."""
        return max(self.aliases, key=lambda alias: alias.probability)

    @property
    def odds(self) -> float:
        """Odds of the most probable one against all others."""
        others = math.fsum(alias.probability for alias in self.aliases if alias is not self.best)
        return self.best.probability / others if others > 0.0 else math.inf

    @property
    def decided(self) -> bool:
        """Whether one frequency can be stated."""
        return self.informed and self.best.probability >= DECIDED

    @property
    def applies(self) -> bool:
        """Whether there is something to say: the line may be an alias by itself, or by other recordings."""
        return self.line.doubtful or (self.informed and self.aliases[0].probability < DECIDED)

    def __str__(self) -> str:
        hz, up_to = self.line.frequency_hz, Note.UP_TO(limit_hz=self.limit_hz)
        if not self.informed:
            others = ", ".join(f"{alias.frequency_hz:.5g}" for alias in self.aliases[1:])
            return Note.NOT_TOLD_APART(hz=hz, up_to=up_to, others=others, rate_hz=self.line.rate_hz)
        if not self.decided:
            most = sorted(self.aliases, key=lambda alias: -alias.probability)[:3]
            likely = ", ".join(Note.LIKELY(hz=one.frequency_hz, probability=one.probability) for one in most)
            return Note.UNDECIDED(hz=hz, up_to=up_to, likely=likely)
        odds = "above 1000" if self.odds > 1000.0 else f"{self.odds:.0f}"
        if self.best is self.aliases[0]:
            return Note.NO_ALIAS(hz=hz, odds=odds, up_to=up_to)
        return Note.IS_ALIAS(true_hz=self.best.frequency_hz, odds=odds, up_to=up_to, hz=hz)


#: Of a pair of `LineAliases` and one of its `Alias`.
ALIAS_COLUMNS = (
    Column("recording", "", "name of the recording", lambda row: row[0].line.recording),
    Column("mode", "", "number of the beam's mode; empty where unknown", lambda row: row[0].line.number),
    Column("identified_hz", "Hz", "`frequency_hz` of `modes.csv`", lambda row: row[0].line.frequency_hz),
    Column("rate_hz", "Hz", "sampling rate", lambda row: row[0].line.rate_hz),
    Column("frequency_hz", "Hz", "natural frequency, if it is this one", lambda row: row[1].frequency_hz),
    Column("frequency_sd_hz", "Hz", "its standard deviation", lambda row: row[1].frequency_sd_hz),
    Column("damping_ratio", "1", "damping ratio at this frequency", lambda row: row[1].damping_ratio),
    Column("probability", "1", "of this frequency, up to `limit_hz`", lambda row: row[1].probability),
    Column("limit_hz", "Hz", "highest frequency considered", lambda row: row[0].limit_hz),
    Column(
        "informed", "", "whether other rates or uneven times tell them apart", lambda row: row[0].informed
    ),
    Column(
        "shown_by",
        "",
        "recordings at other rates with a line where this frequency would appear, joined by `|`",
        lambda row: "|".join(row[1].recordings),
    ),
)


@dataclass(frozen=True, repr=False, eq=False)
class Aliases(Table):
    """True frequencies of the lines of several recordings of one structure; `lines` in the order of the recordings."""

    lines: tuple[LineAliases, ...]

    def to_dataframe(self) -> pd.DataFrame:
        """One row per line and frequency: the columns of ``aliases.csv``."""
        rows = [(line, alias) for line in self.lines for alias in line.aliases]
        return data_frame({one.name: [one.of(row) for row in rows] for one in ALIAS_COLUMNS}, ALIAS_COLUMNS)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Probability of each frequency, one colour a line."""
        axes = axes_or_new(ax)
        for k, line in enumerate(self.lines):
            hz, probability = zip(*((one.frequency_hz, one.probability) for one in line.aliases), strict=True)
            axes.vlines(hz, 0.0, probability, color=f"C{k}", label=f"{line.line.recording}: {hz[0]:.5g} Hz")
        axes.set(xlabel="natural frequency (Hz)", ylabel="probability", ylim=(0.0, 1.05))
        if self.lines:
            axes.legend()
        return axes

    def __repr__(self) -> str:
        return "\n".join(f"{one.line.recording}: {one}" for one in self.lines) or "no lines"


def lines_of(recording: str, found: Identification) -> tuple[Line, ...]:
    """Lines of the modes of one recording, at the mean rate of the samples of its fit; overdamped modes have none."""
    time_s = found.series.time_s[np.any(found.used, axis=1)]
    if time_s.size < 2:
        return ()
    grid_s, step_s = _even_times(time_s)
    is_uneven = found.has_decay and float(np.max(np.abs(time_s - grid_s))) > EVEN_STEPS * step_s
    return tuple(
        Line(
            recording,
            1.0 / step_s,
            mode.frequency_hz,
            float(np.std(mode.posterior.frequency_in_record_hz)),
            mode.damping_ratio,
            mode.number,
            mode.posterior.rate_sd_ppm,
            mode.amplitude,
            ModeFlag.ALIASED_POSSIBLE.name in mode.flags,
            partial(_of_uneven_times, found, mode) if is_uneven and mode.in_fit else None,
        )
        for mode in found.modes
        if mode.damping_ratio < 1.0
    )


def resolve_aliases(lines: Iterable[Line]) -> Aliases:
    """What recordings of one structure tell about the true frequency of each line.

    Parameters
    ----------
    lines : iterable of Line
        Of all recordings, at one rate or several.

    Returns
    -------
    Aliases
        One `LineAliases` for each line, in their order.

    Notes
    -----
    A line at f, sampled at the rate r, stands for one of ``|k r +- f|``. The n lines at another rate s contain the mode
    with the probability p (`Tuning.seen`): one of them then lies where the true frequency F would appear, a(F); the
    others are of other modes, anywhere up to s / 2. The likelihood of F, over that of lines of other modes only, is

        (1 - p) + p / n sum_j t(f_j - a(F)) s / 2,

    with the Student density t, whose scale has the standard deviations of both lines and of both rates, and the scatter
    between recordings. A line that is the image of a stronger one, mirrored by errors that alternate from frame to
    frame, does not count: at rates of 1:2 it lies at the alias. Nor does one with the number of another mode. Lines at
    one rate count once, however many recordings show them: a coincidence with another mode returns in each. Uneven
    times in the record of the line give it a likelihood of its own. All frequencies are equally probable before;
    without the flag ALIASED_POSSIBLE, that identified has the probability `Tuning.resolved`.

    Frequencies are considered up to half the rate at which the aliases in all recordings that show the mode repeat
    (250 Hz for 250 and 500 Hz), at most `Tuning.highest` times the highest rate and `Tuning.periods` times that of the
    line; a higher one is mistaken for one below the limit. The standard deviation of the line counts at each other
    rate: where it exceeds the scatter, the odds from several are too large. Aliasing: Shannon (1949),
    doi:10.1109/JRPROC.1949.232969; choice and tests of the likelihood: docs/decisions/0031-aliases.md.
    """
    lines = tuple(lines)
    by_rate: list[list[Line]] = []
    for line in sorted(lines, key=lambda one: one.rate_hz):
        if by_rate and line.rate_hz / by_rate[-1][0].rate_hz - 1.0 < TUNING.scatter:
            by_rate[-1].append(line)
        else:
            by_rate.append([line])
    images = _images(lines)
    modes = [[line for line in one if line not in images] for one in by_rate]
    others = {line: modes[:k] + modes[k + 1 :] for k, one in enumerate(by_rate) for line in one}
    return Aliases(tuple(_of_line(line, others[line]) for line in lines))


def _images(lines: Iterable[Line]) -> set[Line]:
    """Lines where errors that alternate from frame to frame, as in compressed films, mirror a stronger one."""
    by_recording: dict[str, list[Line]] = {}
    for line in lines:
        by_recording.setdefault(line.recording, []).append(line)
    return {
        weak
        for one in by_recording.values()
        for weak in one
        for strong in one
        if weak.amplitude < strong.amplitude
        and abs(weak.damped_hz + strong.damped_hz - 0.5 * weak.rate_hz)
        < BEYOND_SD * math.hypot(weak.frequency_sd_hz, strong.frequency_sd_hz)
    }


def _of_line(line: Line, others: Sequence[Sequence[Line]]) -> LineAliases:
    """Odds of one line from those at each other rate."""
    others = [one for one in others if one]
    fastest_hz = max([line.rate_hz, *(one[0].rate_hz for one in others)])
    highest_hz = min(TUNING.highest * fastest_hz, TUNING.periods * line.rate_hz)
    hz = alias_frequencies(line.damped_hz, line.rate_hz, highest_hz)

    def considered(limit_hz: float) -> BoolArray:
        return np.asarray((hz <= limit_hz) | (hz == hz[0]))

    def tells(one: Sequence[Line], ratio: FloatArray) -> bool:
        # Where no frequency is more likely than a mode that is not seen, the lines tell nothing.
        up_to = considered(_limit_hz([line.rate_hz, one[0].rate_hz]))
        return bool(np.count_nonzero(up_to) > 1 and np.max(np.mean(ratio, axis=0)[up_to]) > 1.0)

    ratios = [(one, _ratios(line, hz, one)) for one in others]
    seen = [(one, ratio) for one, ratio in ratios if tells(one, ratio)]
    limit_hz = _limit_hz([line.rate_hz, *(one[0].rate_hz for one, _ in seen)])
    kept = considered(limit_hz)
    seen = [(one, ratio[:, kept]) for one, ratio in seen]
    hz = hz[kept]
    own = np.zeros(hz.size) if line.log_likelihood is None else line.log_likelihood(hz)
    log_odds = own.copy()
    for _, ratio in seen:
        log_odds += np.log(1.0 - TUNING.seen + TUNING.seen * np.mean(ratio, axis=0))
    prior = np.full(hz.size, 1.0 / hz.size)
    if not line.doubtful:
        prior[0], prior[1:] = TUNING.resolved, (1.0 - TUNING.resolved) / max(hz.size - 1, 1)
    weight = prior * np.exp(log_odds - np.max(log_odds))
    natural_hz = np.hypot(hz, line.damping_ratio * line.frequency_hz)
    aliases = tuple(
        Alias(
            float(natural_hz[k]),
            math.sqrt(float(line.variance_hz2(hz[k]))),
            float(line.damping_ratio * line.frequency_hz / natural_hz[k]),
            float(weight[k] / np.sum(weight)),
            tuple(
                {
                    one.recording: None
                    for at, ratio in seen
                    for one, r in zip(at, ratio, strict=True)
                    if r[k] > 1.0
                }
            ),
        )
        for k in range(hz.size)
    )
    return LineAliases(line, aliases, limit_hz, bool(seen) or float(np.ptp(own)) > 0.0)


def _ratios(line: Line, hz: FloatArray, others: Sequence[Line]) -> FloatArray:
    """Likelihood of each other line as this one at each frequency, over that as any other mode; shape (lines, hz)."""
    nu, rate_hz = TUNING.scatter_dof, others[0].rate_hz
    peak = math.gamma(0.5 * (nu + 1.0)) / (math.gamma(0.5 * nu) * math.sqrt(nu * math.pi))
    apparent = np.abs(hz - rate_hz * np.rint(hz / rate_hz))
    variance = (
        np.array([line.variance_hz2(hz) + one.variance_hz2(hz) for one in others])
        + (TUNING.scatter * hz) ** 2
    )
    distance = np.array([one.damped_hz for one in others])[:, None] - apparent
    density = peak * (1.0 + distance**2 / variance / nu) ** (-0.5 * (nu + 1.0)) / np.sqrt(variance)
    # Lines with numbers of two modes are not one.
    apart = [None not in (line.number, one.number) and one.number != line.number for one in others]
    return np.where(np.array(apart)[:, None], 0.0, density * 0.5 * rate_hz)


def _limit_hz(rates_hz: Sequence[float]) -> float:
    """Highest frequency considered for a line at the first of these rates.

    Half the least common multiple of the rates, at which aliases repeat, where it is below the limits of `Tuning`.
    """
    limit_hz = min(TUNING.highest * max(rates_hz), TUNING.periods * rates_hz[0])
    for multiple in range(1, int(2.0 * TUNING.highest) if len(rates_hz) > 1 else 1):
        periods = multiple * max(rates_hz) / np.array(rates_hz)
        if np.all(np.abs(periods - np.rint(periods)) < TUNING.scatter * periods):
            return min(0.5 * multiple * max(rates_hz), limit_hz)
    return limit_hz


def _even_times(time_s: FloatArray) -> tuple[FloatArray, float]:
    """Even times with these ends, gaps being whole steps, and their step."""
    steps = np.diff(time_s)
    index = np.concatenate([[0.0], np.cumsum(np.maximum(np.rint(steps / np.median(steps)), 1.0))])
    step_s = float((time_s[-1] - time_s[0]) / index[-1])
    return time_s[0] + step_s * index, step_s


def _of_uneven_times(found: Identification, mode: IdentifiedMode, frequencies_hz: FloatArray) -> FloatArray:
    """Log-likelihood of a decay near each frequency, the largest 0, with the noise at its level near the mode.

    All 0 where even times fit better than those stated: their unevenness, such as that of rounded times, is not that of
    the samples.
    """
    channels = found.channels_used & np.isfinite(mode.shape)
    rows = np.flatnonzero(np.all(found.used[:, channels], axis=1))[:MOST_SAMPLES]
    if not np.any(channels) or rows.size < MIN_SAMPLES:
        return np.zeros(frequencies_hz.size)
    since_s, part = found.series.time_s[rows] - found.onset.fit_from_s, np.ix_(rows, channels)
    own_pole = pole(mode.omega_n_rad_s, mode.damping_ratio)
    own = np.real(np.exp(own_pole * since_s)[:, None] * mode.shape[channels])
    own += found.series.values[part] - found.fitted[part]

    def least(time_s: FloatArray, frequency_hz: float) -> float:
        problem = Problem(FitData(time_s, own, np.ones(own.shape)), np.ones((rows.size, 1)))
        start = np.array([own_pole.real + 2j * np.pi * frequency_hz])
        return objective(problem.data, gauss_newton(problem, start).linear)

    left = np.array([least(since_s, hz) for hz in frequencies_hz.tolist()])
    if least(_even_times(since_s)[0], float(frequencies_hz[0])) < np.min(left):
        return np.zeros(frequencies_hz.size)
    return np.asarray((np.min(left) - left) / mode.posterior.noise_factor**2)
