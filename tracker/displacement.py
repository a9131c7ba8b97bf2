"""Displacement from tracks: along one direction common to all markers, references subtracted.

A marker lost at the same phase of every cycle is reported: the rest of its track fits wrong frequencies as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker import flags
from tracker.arrays import BoolArray, FloatArray
from tracker.geometry import Positions, median_over_time, row_delay_s, to_common_time
from tracker.markers import kind_of
from tracker.position_errors import position_errors
from tracker.results import DisplacementSeries, KnownInput, MarkerTracks
from tracker.scale_change import MarkersInFrames, ScaleChange, possible_zoom, scale_change
from tracker.template import largest_sd
from tracker.vibration_direction import component, stronger_across, vibration_direction


@dataclass(frozen=True)
class Tuning:
    """Losses that follow the motion, and the points about which markers grow."""

    #: [1] share of lost frames below which the rest determines the motion
    least_lost: float = 0.25
    #: [1] largest line of the spectral window at which the frequency is unambiguous
    #: physics: that of a marker seen in two thirds of each cycle is sin(2 pi / 3) / (2 pi / 3) = 0.41; one seen in a
    #: third of each has 0.83
    largest_line: float = 0.45
    #: [1] slower patterns, fewer than this many times in the record, are single losses
    least_cycles: int = 5
    #: [1] longer steps, in median steps, divide the record
    #: convention: the window of hours without a frame would fill memory: that of the longest part is evaluated
    longest_step: int = 100
    #: [1] the spectral window is evaluated this much finer than the resolution of the record
    #: physics: a line between two bins then loses at most 3 %
    finer: int = 4
    #: [1] relative error of the points about which markers seem to grow
    #: measurement: codes and dots in rendered films
    fixed_point_share: float = 0.1
    #: [px] error of these points
    #: measurement: codes and dots in rendered films
    fixed_point_sd_px: float = 0.1
    #: [1] of the image, distance from its middle about which a zoom is assumed, at least
    nearest_middle: float = 0.25


TUNING = Tuning()


def misleading_lost_markers(tracks: MarkerTracks) -> tuple[tuple[str, str], ...]:
    """Markers whose lost frames follow the motion, each with the reason why its track cannot be fitted.

    The fit of a record with gaps is ambiguous by the lines of its spectral window (the Fourier transform of the times
    with a value): a marker that is seen only at the same phase of each cycle fits frequencies that differ from the true
    one by multiples of the line (VanderPlas 2018, doi:10.3847/1538-4365/aab766, section 7). Frames that no marker can
    be measured in (damaged, repeated, recorded at another rate) count neither as found nor as lost.
    """
    unusable = flags.LEFT_OUT | flags.DECODE_CORRUPT.value
    found: list[tuple[str, str]] = []
    for k, name in enumerate(tracks.markers):
        available = (tracks.flags[:, k] & unusable) == 0
        seen = available & np.isfinite(tracks.x_px[:, k])
        lost = 1.0 - float(seen.sum()) / max(float(available.sum()), 1.0)
        if lost < TUNING.least_lost or not seen.any():
            continue
        line, frequency_hz = _largest_line(tracks.time_s, seen, available)
        if line > TUNING.largest_line:
            reason = (
                f"it was not found in {100.0 * lost:.0f} % of the frames, and the others repeat {frequency_hz:.4g} "
                "times a second: found only at the same phase of its motion, it has an ambiguous frequency; use a "
                "shorter exposure or a marker that is found throughout"
            )
            found.append((name, reason))
    return tuple(found)


def _largest_line(time_s: FloatArray, seen: BoolArray, available: BoolArray) -> tuple[float, float]:
    """Largest line of the spectral window that is not one of the available frames, 0 to 1, and its frequency in Hz."""
    step_s = float(np.median(np.diff(time_s)))
    pauses = np.flatnonzero(np.diff(time_s) > TUNING.longest_step * step_s) + 1
    part = max(np.split(np.arange(time_s.size), pauses), key=np.size)
    time_s, seen, available = time_s[part], seen[part], available[part]
    slots = np.rint((time_s - time_s[0]) / step_s).astype(np.int64)
    length = TUNING.finer * (int(slots[-1]) + 1)
    windows = []
    for mask in (seen, available):
        comb = np.bincount(slots[mask], minlength=length).astype(np.float64)
        windows.append(np.abs(np.fft.rfft(comb, length)) / max(float(mask.sum()), 1.0))
    lines = np.where(windows[1] < 0.5 * windows[0], windows[0], 0.0)
    lines[: TUNING.finer * TUNING.least_cycles] = 0.0
    best = int(np.argmax(lines))
    return float(lines[best]), best / (length * step_s)


def displacement_series(
    tracks: MarkerTracks, *, direction: tuple[float, float] | None = None, unit: str | None = None
) -> DisplacementSeries:
    """Displacement of the markers along the direction in which they move most.

    Lens distortion, in mm also an oblique view, the row delays of a rolling shutter, and slow changes of the image's
    scale that the spacing of the markers shows are corrected. Reference markers are averaged (weighted by inverse
    variance), subtracted from the others and omitted; a frame in which all references are missing is NaN. Each marker's
    displacement is relative to its median. Markers of `MarkerTracks.input` are averaged alike, and their motion is the
    measured input of the others, from which it is not subtracted.

    Parameters
    ----------
    direction : tuple of float or None
        Unit vector in the image, x right, y up; the direction of the vibration of all markers when None,
        with its larger component positive.
    unit : str or None
        "mm" or "px"; when None, mm if there is a scale.

    Returns
    -------
    DisplacementSeries
        NaN is kept; frames that repeat the previous image, or have another rate than the rest, are NaN. The standard
        deviations are projected and include those of the references, but not the common error of the scale.
        `rate_sd_ppm` is that of the tracks.

    Raises
    ------
    ValueError
        If a reference or input is not one of the markers or is both, no marker is left, or mm are requested without
        scale.
    """
    # Loads SciPy's interpolation, which a report whose figures are kept does without.
    from tracker.line import codec_skipped  # noqa: PLC0415

    fixed, driving, moving = _roles(tracks)
    chosen_unit = unit or ("mm" if tracks.scale is not None else "px")
    if chosen_unit not in ("mm", "px"):
        msg = f"unit must be 'mm' or 'px', got {chosen_unit!r}"
        raise ValueError(msg)
    if chosen_unit == "mm" and tracks.scale is None:
        msg = "displacement in mm needs a scale: give mm_per_px, size_mm or positions_mm"
        raise ValueError(msg)
    seen = tracks.positions("mm" if chosen_unit == "mm" else "px")
    xy, variance = np.stack([seen.x, seen.y]), np.stack([seen.sd_x**2, seen.sd_y**2, seen.covariance()])
    notes = _lens_notes(tracks)
    if tracks.readout_s:
        delay_s = row_delay_s(median_over_time(tracks.y_px), tracks.decode.height_px, tracks.readout_s)
        x, sd_x = to_common_time(tracks.time_s, seen.x, seen.sd_x, delay_s)
        y, sd_y = to_common_time(tracks.time_s, seen.y, seen.sd_y, delay_s)
        seen = Positions(x, y, sd_x, sd_y, seen.correlation)
        xy, variance = np.stack([x, y]), np.stack([sd_x**2, sd_y**2, seen.covariance()])
        notes = (
            *notes,
            f"Rows are read over {1e3 * tracks.readout_s:g} ms: each marker is shifted to the time of the middle row.",
        )
    reference = None
    if fixed.any():
        reference = _mean_reference(xy[:, :, fixed], variance[:, :, fixed])
        xy, variance = xy - reference[0][:, :, None], variance + reference[1][:, :, None]
        notes = (*notes, f"The motion of {', '.join(tracks.reference)} is subtracted.")
    left_out = (tracks.flags & flags.LEFT_OUT) > 0
    del seen
    for array in (xy, variance):
        array[:, left_out] = np.nan
    rest, centred = _centred(xy)
    del xy
    every = centred, variance
    drive = _mean_reference(centred[:, :, driving], variance[:, :, driving]) if driving.any() else None
    if not moving.all():
        centred, variance = centred[:, :, moving], variance[:, :, moving]
    frame_s = float(np.median(np.diff(tracks.time_s))) if tracks.time_s.size > 1 else 0.0
    if direction is None:
        unit_vector = vibration_direction(centred, frame_s)
        notes = (*notes, *stronger_across(centred, unit_vector, frame_s))
    else:
        unit_vector = _normalised(direction)
    values, sd = component(unit_vector, centred, variance)
    zoom, zoom_notes = _zoom(tracks, chosen_unit, rest, *every, unit_vector)
    if zoom is not None:
        scale = zoom.scale(tracks.time_s)[:, None]
        values, sd = values / scale, sd / scale
    notes = (*notes, *zoom_notes)
    del every
    known_input = None
    if drive is not None:
        known_input = _known_input(tracks, component(unit_vector, *drive), zoom, chosen_unit)
    base, base_sd = (None, None) if reference is None else component(unit_vector, *reference)
    follows_line = kind_of(tracks.kind).follows_line
    return DisplacementSeries(
        name=tracks.recording,
        time_s=tracks.time_s,
        channels=tuple(n for n, moves in zip(tracks.markers, moving, strict=True) if moves),
        values=values,
        sd=sd,
        unit=chosen_unit,
        positions_mm=tracks.positions_mm[moving],
        direction=(float(unit_vector[0]), float(unit_vector[1])),
        notes=notes,
        base=base,
        base_sd=base_sd,
        known_input=known_input,
        rate_sd_ppm=tracks.time_axis.rate_sd_ppm,
        scale_change=zoom,
        misleading=(*misleading_lost_markers(tracks), *(codec_skipped(tracks) if follows_line else ())),
        position_errors=position_errors(
            np.stack([tracks.x_px, tracks.y_px])[:, :, moving],
            np.stack([tracks.sd_x_px, tracks.sd_y_px])[:, :, moving],
            sd,
            (float(unit_vector[0]), float(unit_vector[1])),
            None if tracks.correlation_xy is None else tracks.correlation_xy[:, moving],
            largest_sd(values) if tracks.decode.predictive else None,
            frame_s=frame_s,
            lossy=tracks.decode.lossy,
            predictive=tracks.decode.predictive,
            reordered=tracks.decode.reordered,
            # The noise of a template that all stations share is small; the codec's errors are not.
            alike=follows_line and tracks.decode.lossy,
        ),
    )


def _roles(tracks: MarkerTracks) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Which markers are references, which are inputs, and which are on the beam; shape (m,) each."""
    roles = {"reference": tracks.reference, "input": tracks.input}
    for role, names in roles.items():
        unknown = [name for name in names if name not in tracks.markers]
        if unknown:
            msg = f"{role} {', '.join(unknown)} is not among the markers {', '.join(tracks.markers)}"
            raise ValueError(msg)
    if both := sorted(set(tracks.reference) & set(tracks.input)):
        msg = f"{', '.join(both)} is a reference, which does not move, and an input: give one of the two"
        raise ValueError(msg)
    fixed, driving = (np.isin(np.array(tracks.markers), names) for names in roles.values())
    moving = ~(fixed | driving)
    if not moving.any():
        msg = "every marker is a reference or an input: at least one marker must be on the beam"
        raise ValueError(msg)
    return fixed, driving, moving


def _known_input(
    tracks: MarkerTracks, motion: tuple[FloatArray, FloatArray], zoom: ScaleChange | None, unit: str
) -> KnownInput:
    """The motion of the input markers along the direction of the vibration."""
    values, sd = motion
    if zoom is not None:
        scale = zoom.scale(tracks.time_s)
        values, sd = values / scale, sd / scale
    noise = float(np.median(sd[np.isfinite(sd)])) if np.isfinite(sd).any() else float("nan")
    return KnownInput(", ".join(tracks.input), values, unit, sd=noise)


def _lens_notes(tracks: MarkerTracks) -> tuple[str, ...]:
    lens, decode = tracks.lens, tracks.decode
    if lens is None or (lens.width_px, lens.height_px) == (decode.width_px, decode.height_px):
        return ()
    note = (
        f"The lens was calibrated with images of {lens.width_px} x {lens.height_px} px, but the recording has "
        f"{decode.width_px} x {decode.height_px} px: a cropped or binned image needs its own calibration."
    )
    return (note,)


def _normalised(direction: tuple[float, float]) -> FloatArray:
    vector = np.array(direction, dtype=np.float64)
    length = float(np.hypot(*vector))
    if not np.isfinite(length) or length == 0.0:
        msg = f"direction must be a finite vector other than zero, got {direction}"
        raise ValueError(msg)
    return vector / length


def _zoom(
    tracks: MarkerTracks,
    unit: str,
    rest: FloatArray,
    centred: FloatArray,
    variance: FloatArray,
    direction: FloatArray,
) -> tuple[ScaleChange | None, tuple[str, ...]]:
    """Change of the scale that the markers show, references included, and what the user must know of it."""
    # Of a line only one component of each station is measured.
    if kind_of(tracks.kind).follows_line:
        return None, ()
    per_px = tracks.scale.mm_per_px if unit == "mm" and tracks.scale is not None else 1.0
    beside, beside_sd = np.zeros_like(rest), np.zeros_like(rest)
    if tracks.fixed_points_px is not None:
        beside = per_px * np.array([[1.0], [-1.0]]) * tracks.fixed_points_px
        beside_sd = np.hypot(TUNING.fixed_point_share * beside, TUNING.fixed_point_sd_px * per_px)
    seen = MarkersInFrames.of(
        tracks.time_s,
        centred,
        variance,
        direction,
        (rest + beside, beside_sd),
        pixel=0.0 if tracks.fixed_points_px is None else per_px,
        lossy=tracks.decode.lossy,
    )
    if seen is None:
        return None, ()
    if seen.rest.size > 1:
        change = scale_change(seen)
        return change, () if change is None else (change.note,)
    # From the middle of the image, y up. Nearer to it a zoom about it hardly moves the marker: the camera does.
    size = np.array([tracks.decode.width_px, tracks.decode.height_px])
    middle_px = 0.5 * size[:, None] * np.array([[1.0], [-1.0]])
    from_middle = np.stack([median_over_time(tracks.x_px), -median_over_time(tracks.y_px)]) - middle_px
    turned = np.array([-direction[1], direction[0]])
    distance_px = max(
        float(np.nanmax(np.abs(turned @ from_middle))), TUNING.nearest_middle * float(np.abs(turned) @ size)
    )
    return None, possible_zoom(seen, distance_px * per_px)


def _centred(xy: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Each marker's median over time, shape (2, m), and positions relative to it, shape (2, n, m)."""
    rest = median_over_time(np.moveaxis(xy, 1, 0))
    return rest, np.asarray(xy - rest[:, None, :])


def _mean_reference(xy: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Motion of the references about their own rest, weighted by inverse variance, (2, n), and its variances (3, n).

    The covariance of x and y, where their errors are not independent, is not used.
    """
    centred, variance = _centred(xy)[1], variance[:2]
    weight = np.where(np.isfinite(centred) & (variance > 0), 1.0 / np.maximum(variance, 1e-300), 0.0)
    total = weight.sum(axis=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(total > 0, np.nansum(weight * np.nan_to_num(centred), axis=2) / total, np.nan)
        mean_variance = np.where(total > 0, 1.0 / total, np.nan)
    return mean, np.concatenate([mean_variance, np.zeros((1, len(mean_variance[0])))])
