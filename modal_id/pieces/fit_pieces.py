"""Fits of the pieces of a decay: one that free decays do not explain is divided at clicks, or where motion changes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from modal_id.curve import amplitude_curve, explains
from modal_id.data import MIN_SAMPLES, FitData, Prepared, Projection, reject_outliers, runs
from modal_id.fit import (
    ModalFit,
    Omissions,
    find_modes,
    refit,
    with_named,
    with_rounding_errors,
    with_scale_errors,
    without_repeating_errors,
)
from modal_id.modes import FittedDecay, moving_channels
from modal_id.posterior import noise_level
from modal_id.record import Onset, Segment, SegmentKind
from modal_id.segments import (
    Boundary,
    changed_onset,
    from_largest_deflection,
    likeliest_change,
    locate_boundary,
    no_line,
)
from modal_id.sentences import Note, Reason, Refusal
from modal_id.solve import LinearSolution, ModeColumns, frequency_hz, solve_linear
from tracker import BoolArray, DisplacementSeries, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Outliers that disturb the motion, misfit of a decay, pieces that a free decay explains."""

    #: [samples] most samples between two rejected ones that belong together
    gap: int = 4
    #: [1] probability, over the whole record, that as many single outliers lie together by chance
    #: statistics: One record in a thousand.
    false_alarm: float = 1e-3
    #: [1] number of parts of the record in which the rate of outliers is counted
    parts: int = 40
    #: [samples] fewest samples over which the residual before a click is averaged
    least: int = 32
    #: [1] mean square of the residual over the noise below which it is quiet
    #: statistics: By chance above at four standard deviations.
    quiet: float = 2.0

    #: [cycles] length of a window
    cycles: float = 2.0
    #: [samples] shortest window
    least_rows: int = 16
    #: [1] number of strongest modes on whose waves the residual is projected
    modes: int = 2
    #: [sd] errors of a codec that are no change of the motion
    #: convention: What it leaves out of small motions.
    omitted_sd: float = 2.0
    #: [1] power of the projection over that of the rest, for each degree of freedom, that noise may reach
    noise: float = 6.0
    #: [1] share of the power that a free decay may leave
    #: measurement: A few parts in ten thousand with a camera's errors, per cent with a hand, a pluck or driving.
    most_left: float = 0.003
    #: [1] residual power of an amplitude curve over the noise up to which it explains that
    explained: float = 3.0
    #: [cycles] shortest piece of a divided decay
    least_cycles: float = 6.0
    #: [samples] samples per cycle of the fastest mode in the search for the time of a change
    samples_per_cycle: float = 8.0
    #: [cycles] length from which a piece is long
    many_cycles: float = 12.0


TUNING = Tuning()


def without_clicks(model: ModalFit, weights: FloatArray) -> tuple[ModalFit, BoolArray]:
    """Leave out the stretches in which rejected samples cluster, until the disturbance has faded, and fit again.

    `weights`, shape (n, k), are those before any rejection. Returns the fit and the mask of these rows, shape (n,): of
    those in which at least half of the channels are rejected, since a fault of one channel is no click.
    """
    linear, used = model.fit.linear, weights > 0.0
    rejected = used & (model.data.weights == 0.0)
    count = np.count_nonzero(used, axis=1)
    bad = (count > 0) & (2 * np.count_nonzero(rejected, axis=1) >= count)
    square = np.sum(weights * linear.residual**2 / linear.noise_variance, axis=1) / np.maximum(count, 1)
    # Outliers are not part of the residual that is to fade.
    square[bad] = 1.0
    cycle = 1.0 / (float(np.min(frequency_hz(model.fit.poles))) * model.data.step_s)
    window = int(max(TUNING.least, cycle))
    rows = np.zeros(bad.size, dtype=bool)
    for first, last in _clusters(bad):
        before, end = square[max(first - window, 0) : first], _faded(square, last, window)
        if end + window < bad.size and before.size and np.mean(before) < TUNING.quiet:
            rows[first : end + 1] = True
    if not np.any(rows):
        return model, rows
    # A click distorts the fit, so that samples are rejected that are no outliers without it: they are found anew.
    left = np.where(rows[:, None], 0.0, weights)
    data = replace(model.data, weights=left)
    return refit(model, model.fit.poles, reject_outliers(data, left, linear.residual)), rows


def _clusters(bad: BoolArray) -> list[tuple[int, int]]:
    """First and last row of each group of marked rows that cluster more than by chance."""
    places = np.flatnonzero(bad)
    if not places.size:
        return []
    groups = np.split(places, np.flatnonzero(np.diff(places) > TUNING.gap + 1) + 1)
    # Single outliers are independent: `follows` is the probability that the next one follows within the gap. Where they
    # are many, they cluster by chance, but then in most parts of the record; clicks fill few parts.
    parts = np.array_split(bad, min(TUNING.parts, bad.size))
    alone = sum(group.size == 1 for group in groups) / bad.size
    single = max(alone, float(np.median([np.mean(part) for part in parts])))
    follows = -np.expm1((TUNING.gap + 1) * np.log1p(-min(max(single, 1.0 / bad.size), 0.5)))
    return [
        (int(group[0]), int(group[-1]))
        for group in groups
        if (group.size - 1) * np.log(follows) + np.log(places.size) < np.log(TUNING.false_alarm)
    ]


def _faded(square: FloatArray, last: int, window: int) -> int:
    """First row from `last` on after which the residuals are quiet; the number of rows where they never are."""
    sums = np.cumsum(np.concatenate([[0.0], square]))
    ends = np.arange(last, square.size - window)
    quiet = (
        sums[ends + 1 + window] - sums[ends + 1] < TUNING.quiet * window
        if ends.size
        else np.zeros(0, dtype=bool)
    )
    return int(ends[np.argmax(quiet)]) if np.any(quiet) else square.size


def click_segments(time_s: FloatArray, rows: BoolArray) -> tuple[Segment, ...]:
    """A segment for each run of the mask `rows`; both arrays have shape (n,)."""
    return tuple(
        Segment("disturbed", float(time_s[first]), float(time_s[last - 1]), Note.CLICK())
        for first, last in runs(rows)
    )


# Samples at a time.
_BLOCK = 65536


@dataclass(frozen=True)
class Misfit:
    """Unexplained motion of a fit.

    Attributes
    ----------
    share : float
        Power at the frequencies of the strongest modes that the fit leaves beyond noise, as a share of the power of the
        motion.
    start_s, end_s : float
        Window with the largest unexplained power, in the time of the fit's data.
    """

    share: float
    start_s: float
    end_s: float


def misfit(model: ModalFit, omissions: Omissions | None = None) -> Misfit:
    """Unexplained motion of a fit: where its poles fit but amplitudes or phases do not.

    `omissions` of a codec may explain it.

    Bursts of noise raise the power at all frequencies, and are none. Where a mode stands for an unresolved pair, the
    pair explains what one mode does not.
    """
    found = _misfit(model, model.fit.linear, omissions)
    if not model.unresolved:
        return found
    poles = list(model.fit.poles)
    for pair in model.unresolved:
        del poles[int(np.argmin(np.abs(np.array(poles) - pair[0])))]
        poles += list(pair)
    columns = ModeColumns(model.data.time_s, np.array(poles))
    both = _misfit(model, solve_linear(model.problem, columns), omissions)
    return min(found, both, key=lambda one: one.share)


def _misfit(model: ModalFit, linear: LinearSolution, omissions: Omissions | None) -> Misfit:
    data = model.data
    length = max(TUNING.least_rows, int(np.ceil(TUNING.cycles / (_strongest_hz(model)[0] * data.step_s))))
    count = data.time_s.size // length
    if count < 2:
        return Misfit(0.0, 0.0, 0.0)
    time_s = data.time_s[: count * length].reshape(count, length)
    # Coloured noise has more power at the modes than white noise.
    coloured = max(1.0, *(model.spectrum.level_aside(hz) for hz in _strongest_hz(model).tolist()))
    excess, moved = np.zeros(count), np.zeros(count)
    for first in range(0, count, max(1, _BLOCK // length)):
        block = slice(first, min(first + max(1, _BLOCK // length), count))
        rows = slice(block.start * length, block.stop * length)
        waves = np.exp(2j * np.pi * time_s[block, :, None] * _strongest_hz(model))
        baseline = linear.splines[rows] @ linear.slow
        columns = np.concatenate([np.ones((*waves.shape[:2], 1)), waves.real, waves.imag], axis=2)
        omitted = _power(omissions, rows, length, linear.noise_variance.size)
        for channel, variance in enumerate(linear.noise_variance):
            w, r, y = (
                values[:, channel].reshape(-1, length)
                for values in (data.weights[rows], linear.residual[rows], data.values[rows] - baseline)
            )
            inside, total = _projected(columns, w, r)
            freedom = np.maximum(np.count_nonzero(w, axis=1) - columns.shape[2], 1)
            noise = (total - inside) / freedom
            own = np.maximum(
                inside - TUNING.noise * coloured * (columns.shape[2] - 1) * noise - omitted[:, channel], 0.0
            )
            excess[block] += np.where(freedom > 1, own, 0.0) / variance
            moved[block] += np.maximum(np.sum(w * y**2, axis=1) - length * noise, 0.0) / variance
    worst = int(np.argmax(excess))
    share = float(np.sum(excess)) / max(float(np.sum(moved)), 1e-300)
    return Misfit(share, float(time_s[worst, 0]), float(time_s[worst, -1]))


def _power(omissions: Omissions | None, rows: slice, length: int, channels: int) -> FloatArray:
    """Power in each window, shape (windows, k), that a codec may have left out."""
    count = (rows.stop - rows.start) // length
    if omissions is None:
        return np.zeros((count, channels))
    squares = 0.5 * (TUNING.omitted_sd * omissions.sd(rows)) ** 2
    return np.asarray(np.sum(squares.reshape(count, length, channels), axis=1))


def _strongest_hz(model: ModalFit) -> FloatArray:
    """Frequencies of the modes with most energy, strongest first."""
    return np.asarray(frequency_hz(model.fit.poles)[np.argsort(-model.energy, kind="stable")[: TUNING.modes]])


def _projected(columns: FloatArray, weights: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Power of the projection of each window on the waves, offset removed, and of the window less its offset."""
    weighted = columns * weights[..., None]
    gram = np.swapaxes(weighted, 1, 2) @ columns
    ridge = 1e-6 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-300
    moment = np.einsum("clp,cl->cp", weighted, values)
    solved = np.linalg.solve(gram + ridge * np.eye(columns.shape[2]), moment[..., None])[..., 0]
    offset = moment[:, 0] ** 2 / np.maximum(gram[:, 0, 0], 1e-300)
    total = np.sum(weights * values**2, axis=1)
    return np.maximum(np.sum(moment * solved, axis=1) - offset, 0.0), np.maximum(total - offset, 0.0)


@dataclass(frozen=True)
class Piece:
    """A piece of a decay: its segment, and its fit or the reason why there is none (None for a short piece)."""

    segment: Segment
    fit: FittedDecay | None = None
    why: Refusal | None = None


@dataclass(frozen=True)
class PieceFitter:
    """Fits of pieces of one series.

    Attributes
    ----------
    series : DisplacementSeries
    used : Prepared
        Its samples.
    disturbed : bool array, shape (n,)
        Samples to leave out.
    max_modes : int
    lowest_hz : float
        Lower end of the search for modes.
    named_hz : tuple of float
        Frequencies at which a mode is fitted even where the search finds none.
    rough : list of (float, FittedDecay)
        Fits that do not explain their piece, with the share of the motion that they leave.
    """

    series: DisplacementSeries
    used: Prepared
    disturbed: BoolArray
    max_modes: int
    lowest_hz: float
    named_hz: tuple[float, ...] = ()
    rough: list[tuple[float, FittedDecay]] = field(default_factory=list)

    def pieces(self, onset: Onset, end_s: float, splits: int) -> Iterator[Piece]:
        """Pieces of a decay that free decays explain, and reasons for the others.

        At most `splits` times, the first piece that they do not explain is divided.
        """
        waiting: list[tuple[Onset, float, SegmentKind]] = [(onset, end_s, "decay")]
        while waiting:
            onset, end_s, otherwise = waiting.pop()
            one = self.fit(onset, end_s)
            if isinstance(one, Refusal) and isinstance(released := self._released(onset, end_s), FittedDecay):
                held = Segment("disturbed", onset.time_s, released.onset.time_s, Note.HELD_UNTIL_RELEASE())
                yield Piece(held)
                onset, one = released.onset, released
            if isinstance(one, Refusal):
                note = onset.note if otherwise == "decay" else ""
                yield Piece(Segment(otherwise, onset.time_s, end_s, note), None, one)
                continue
            left = misfit(one.model, self._omissions(one.model, one.moving))
            if left.share < TUNING.most_left or _is_one_curve(one.model):
                yield Piece(Segment("decay", one.onset.time_s, one.end_s, one.onset.note), one)
                continue
            self.rough.append((left.share, one))
            change = self._change(one) if splits > 0 else None
            splits -= 1
            if change is None:
                start_s, percent = onset.fit_from_s, 100.0 * left.share
                most_s = start_s + 0.5 * (left.start_s + left.end_s)
                why = Reason.NOT_FREE_DECAYS(start_s=start_s, end_s=end_s, percent=percent, most_s=most_s)
                yield Piece(Segment("disturbed", onset.time_s, end_s, f"{why.reason}."), None, why)
                continue
            before, after = _divided(one, change)
            for begin, end in (after, before):
                if end - begin.fit_from_s > TUNING.least_cycles * _cycle_s(one):
                    waiting.append((begin, end, "disturbed"))
                else:
                    yield Piece(Segment("disturbed", begin.time_s, end, Note.CHANGES_AROUND()))

    def _change(self, one: FittedDecay) -> Boundary | None:
        """Where the motion changes, relative to the fit's data; None where these are too few."""
        cycle_s, fastest_hz = _cycle_s(one), float(np.max(frequency_hz(one.model.fit.poles)))
        # A pluck may have been taken for a click of the motion as a whole.
        rows = one.rows - self.used.first_row
        unused = (self.disturbed | self.used.repeated)[rows]
        data = _without(replace(one.data, weights=self.used.data.weights[rows]), unused)
        thin = data.averaged(max(1, int(1.0 / (TUNING.samples_per_cycle * fastest_hz * data.step_s))))
        change = likeliest_change(thin, (1.0 / cycle_s,))
        if change is None:
            return None
        limits = change.low_s, change.high_s
        found = locate_boundary(thin, 0.0, limits, float(thin.time_s[-1]), cycle_s, self.lowest_hz)
        return found or Boundary(*limits, change.place.sd_s)

    def _released(self, onset: Onset, end_s: float) -> FittedDecay | Refusal | None:
        """Fit from a release within a decay of few cycles that begins with the record."""
        if onset.source != "record start":
            return None
        start_s = float(self.series.time_s[self.used.first_row])
        found = from_largest_deflection(self.used.data.between(onset.time_s - start_s, end_s - start_s))
        if found is None:
            return None
        when = found.time_s + onset.time_s
        return self.fit(replace(found, time_s=when, fit_from_s=when), end_s)

    def fit(self, onset: Onset, end_s: float) -> FittedDecay | Refusal:
        """Fit of one piece, or the reason why there is none."""
        series, used = self.series, self.used
        time_s = series.time_s[used.first_row : used.first_row + used.data.time_s.size]
        inside = slice(
            *np.searchsorted(time_s, (onset.fit_from_s - 1e-12, np.nextafter(end_s + 1e-12, np.inf)))
        )
        found = inside.stop - inside.start
        if found < MIN_SAMPLES:
            return Reason.FEW_AFTER_ONSET(found=max(found, 0), onset_s=onset.time_s, end_s=end_s)
        # A view of the values, and of the weights where none becomes 0: no fit changes them.
        data = used.data.rows(inside)
        left_out = (self.disturbed | used.repeated)[inside]
        data = _without(replace(data, time_s=time_s[inside] - onset.fit_from_s), left_out)
        model = with_named(find_modes(data, self.max_modes, self.lowest_hz), data, self.named_hz)
        if model is None:
            names = [series.channels[i] for i in used.channels]
            if used.projection is not None:
                names = [f"component {q + 1}" for q in range(data.values.shape[1])]
            return no_line(data, names, series.unit, (onset.fit_from_s, end_s))
        model, clicks = without_clicks(model, data.weights)
        data = _without(data, clicks)
        left_out |= clicks
        model, moving = _without_still_channels(model)
        mixed = self._mixed(moving)
        if series.position_errors is not None:
            own = used.channels[moving] if mixed is None else used.channels
            level = (
                noise_level(model, None, model.strongest).factor if series.position_errors.predicted else 1.0
            )
            model = without_repeating_errors(model, series.position_errors, own, mixed, level=max(level, 1.0))
        elif mixed is None:
            model = with_rounding_errors(model, series, used.channels[moving])
        if series.scale_change is not None:
            model = with_scale_errors(model, series.scale_change, onset.fit_from_s)
        rows = used.first_row + np.arange(inside.start, inside.stop, dtype=np.int32)
        clicked = click_segments(series.time_s[rows], clicks)
        channels = None if mixed is None else mixed.to_channels
        count = int(np.count_nonzero(left_out))
        return FittedDecay(onset, end_s, rows, count, data, model, moving, clicked, channels)

    def _mixed(self, moving: BoolArray) -> Projection | None:
        """The channels on the components that move; None where channels are fitted."""
        return None if self.used.projection is None else self.used.projection.of_components(moving)

    def _omissions(self, model: ModalFit, moving: BoolArray) -> Omissions | None:
        """What a codec may have left out of the fitted channels or components."""
        errors, mixed = self.series.position_errors, self._mixed(moving)
        if errors is None or not errors.predicted:
            return None
        channels = self.used.channels[moving] if mixed is None else self.used.channels
        return Omissions(model, errors, channels, mixed)


def _without(data: FitData, rows: BoolArray) -> FitData:
    """The data with these rows at weight 0."""
    return replace(data, weights=np.where(rows[:, None], 0.0, data.weights)) if np.any(rows) else data


def _cycle_s(one: FittedDecay) -> float:
    """Cycle of the strongest mode; of those with many cycles in the piece, where there are any."""
    hz = frequency_hz(one.model.fit.poles)
    many = hz * one.model.data.span_s >= TUNING.many_cycles
    energy = np.where(many, one.model.energy, 0.0) if np.any(many) else one.model.energy
    return 1.0 / float(hz[np.argmax(energy)])


def _divided(one: FittedDecay, change: Boundary) -> list[tuple[Onset, float]]:
    """Onset and end of the pieces before and after a change, given in the time of the fit's data."""
    origin_s = one.onset.fit_from_s
    after = changed_onset(origin_s + change.start_s, change.sd_s)
    return [(one.onset, origin_s + change.end_s), (after, one.end_s)]


def _is_one_curve(model: ModalFit) -> bool:
    """Whether a dependence on amplitude explains what constant poles leave of the strongest mode."""
    curve = amplitude_curve(model, model.strongest)
    if curve is None or not curve.constant_residual_power > TUNING.explained:
        return False
    return explains(curve, TUNING.explained)


def _without_still_channels(model: ModalFit) -> tuple[ModalFit, BoolArray]:
    """Exclude channels without motion from the fit of the poles; at least one channel is kept."""
    moving = moving_channels(model.data, model.fit.linear)
    if np.all(moving):
        return model, moving
    return refit(model, model.fit.poles, model.data.channels(moving)), moving
