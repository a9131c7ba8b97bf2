"""Public functions of modalcam: they accept plain numbers and raise exceptions instead of returning falsy results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike

from modalcam.common import IdentificationError, TrackingError

if TYPE_CHECKING:
    from modal_id import FrequencyResponse, Identification
    from modal_id.modes import Aliases
    from modalcam.pipeline import Progress as RunProgress
    from modalcam.pipeline import RunResult
    from sim.beam import BeamModes
    from tracker import DisplacementSeries, MarkerTracks
    from tracker.follow import Progress


def track(
    path: str | Path,
    *,
    fps: float | str | Fraction | None = None,
    mm_per_px: float | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> MarkerTracks:
    """Track the markers of one recording.

    Parameters
    ----------
    path : str or Path
        A video, a camera file (.cihx, .cine), a TIFF stack or a folder of images.
    fps : float, int, Fraction or str, optional
        Rate at which the scene was recorded. High-speed files usually state the playback rate instead; without `fps`
        the time axis comes from the file, and ``tracks.time_axis`` states its source.
    mm_per_px : float, optional
        Scale in the plane of the beam. Without it, a marker's `size_mm` or two `positions_mm` give the scale; without
        those, positions stay in pixels.
    progress : callable, optional
        Called with the number of frames done and the number declared (0 if unknown).
    **options
        Any other field of `tracker.settings.TrackerSettings`: `kind`, `size_mm`, `positions_mm`, `exposure_s`,
        `reference`, ...

    Returns
    -------
    MarkerTracks
        Position and standard deviation of every marker in every frame. A frame in which a marker could not be
        measured is NaN and flagged.

    Raises
    ------
    TrackingError
        If the file cannot be read, no marker is found, or no time axis can be determined.
    ValueError
        If an option is unknown or out of range.

    Examples
    --------
    >>> import modalcam as mc
    >>> tracks = mc.track("sample_videos/mode4.avi", fps=500.0, mm_per_px=1.0)  # doctest: +SKIP
    >>> len(tracks.markers)
    6
    """
    from tracker import (  # noqa: PLC0415
        FailedTracking,
        TrackerSettings,
    )
    from tracker import track as track_recording  # noqa: PLC0415

    values: dict[str, Any] = {"fps": fps, "mm_per_px": mm_per_px, **options}
    settings = TrackerSettings(**values)
    found = track_recording(Path(path), settings, progress=progress)
    if isinstance(found, FailedTracking):
        msg = str(found)
        raise TrackingError(msg)
    return found


def displacement(
    tracks: MarkerTracks, *, direction: tuple[float, float] | None = None, unit: str | None = None
) -> DisplacementSeries:
    """Displacement of the markers along one common direction.

    Parameters
    ----------
    tracks : MarkerTracks
    direction : tuple of float, optional
        Vector in the image plane, x to the right, y up. Default: the direction of largest motion of all markers.
    unit : {"mm", "px"}, optional
        Default: mm if the tracks have a scale, else px.

    Returns
    -------
    DisplacementSeries
        One channel for each marker that is not a reference, about its own median. Missing frames are NaN.

    Raises
    ------
    TrackingError
        If no marker was detected in any frame.
    ValueError
        If mm are requested without a scale, or a reference is not one of the markers.

    Examples
    --------
    >>> import modalcam as mc
    >>> tracks = mc.track("sample_videos/mode4.avi", fps=500.0, mm_per_px=1.0)  # doctest: +SKIP
    >>> series = mc.displacement(tracks)
    >>> series.unit, series.values.shape
    ('mm', (1301, 6))
    """
    from tracker import displacement_series  # noqa: PLC0415

    if not np.isfinite(tracks.x_px).any():
        msg = f"{tracks.recording}: no marker was detected in any frame"
        raise TrackingError(msg)
    return displacement_series(tracks, direction=direction, unit=unit)


def frf(
    series: DisplacementSeries | Sequence[Mapping[str, Any]] | ArrayLike,
    y: ArrayLike | None = None,
    *,
    input: ArrayLike,  # noqa: A002 - the field's word
    **options: Any,
) -> FrequencyResponse:
    """Frequency response of the channels to a measured input, from the identified modes and without them.

    Parameters
    ----------
    series, y, input
        As in `identify`.
    **options
        The other arguments of `identify`: `input_unit`, `input_sd`, `unit`, `onset_s`, `end_s`, `seed` and so on.

    Returns
    -------
    FrequencyResponse
        Transmissibility (input in the unit of `y`) or receptance (force) of the fitted modes with a 90 % band of its
        modulus, the local-polynomial estimate with its standard deviation, and the coherence; `to_dataframe` has one
        row per channel and frequency. Where `input` is missing (NaN) it is taken from a spline through its neighbours.

    Raises
    ------
    IdentificationError
        As `identify`; without a mode there is no response.
    ValueError
        As `identify`.

    Notes
    -----
    The local-polynomial estimate is biased towards zero by noise of the input, and where a resonance is narrower than
    13 bins; see `modal_id.response.local_polynomial`. The response of the modes is not.

    Examples
    --------
    A mode of 5 Hz and 1 % on a base that sweeps from 1 to 13 Hz:

    >>> import numpy as np
    >>> import modalcam as mc
    >>> from scipy.signal import lsim
    >>> t, omega = np.arange(4000) / 200.0, 2 * np.pi * 5
    >>> base = np.sin(2 * np.pi * (1 + 0.3 * t) * t)
    >>> y = lsim(([0.02 * omega, omega**2], [1, 0.02 * omega, omega**2]), base, t)[1]
    >>> y += 0.01 * np.random.default_rng(1).standard_normal(t.size)
    >>> response = mc.frf(t, y, input=base)
    >>> peak = np.argmax(np.abs(response.model[:, 0]))
    >>> round(float(response.frequency_hz[peak])), round(float(np.abs(response.model[peak, 0])))
    (5, 50)
    """
    # Never None where an input is given.
    return cast("FrequencyResponse", identify(series, y, input=input, **options).response)


def identify(
    series: DisplacementSeries | Sequence[Mapping[str, Any]] | ArrayLike,
    y: ArrayLike | None = None,
    *,
    mode: int | None = None,
    frequency_hz: float | None = None,
    beam: BeamModes | None = None,
    onset_s: float | None = None,
    end_s: float | None = None,
    unit: str = "mm",
    positions_mm: ArrayLike | None = None,
    seed: int = 0,
    excitation: Literal["free", "ambient"] = "free",
    input: ArrayLike | None = None,  # noqa: A002 - the field's word
    input_unit: str | None = None,
    input_sd: float = float("nan"),
    input_lag_ms: float | Literal["auto"] | None = None,
) -> Identification:
    """Identify modes from a free decay, from ambient vibration, or from the response to a measured input.

    Parameters
    ----------
    series : DisplacementSeries, list of dict, or array, shape (n,)
        A series of `displacement`; signals of SEP 005, as readers of SDyPy give them, all of one unit and clock; or the
        times in s of `y`, strictly increasing. Steps may be uneven.
    y : array, shape (n,) or (n, k), optional
        Displacement, velocity or acceleration of k channels, where `series` holds times. NaN is missing.
    mode : int, optional
        Number of the mode that was excited, 1 being the lowest; needs `beam`.
    frequency_hz : float, optional
        Approximate frequency of that mode, instead of `mode`.
    beam : BeamModes, optional
        Theoretical modes (`modes`), which number the identified ones.
    onset_s : float, optional
        Start of the free decay. Default: found in the data, with its uncertainty.
    end_s : float, optional
        End of the part of the record that is used. Default: the end of the decay, found in the data.
    unit : str
        Unit of `y`, for labels.
    positions_mm : array, shape (k,), optional
        Distance of each channel of `y` from the clamp; with `beam`, mode shapes are compared with theory (MAC).
    seed : int
        Seed of the sampler: the same input and seed give the same result.
    excitation : {"free", "ambient"}
        "ambient" for stationary motion under random forces that are not measured, such as wind; times are even then.
    input : array, shape (n,), optional
        What drives the channels of `y`, at the same times: the motion of the base, in the quantity and unit of `y`
        (absolute or relative motion), or a force. The motion may then be anything.
    input_unit : str, optional
        Unit of `input`. Default: that of `y`, a motion of the base; any other means a force.
    input_sd : float
        Standard deviation of the noise of `input`; NaN where unknown: it is then taken from the floor of its spectrum.
    input_lag_ms : float or "auto", optional
        Time in ms by which `input` is late against `y`; "auto" estimates it, with the modes. Default: one clock.

    Returns
    -------
    Identification
        ``identification.modes`` in order of frequency, each with its posterior; ``identification.target`` is the
        requested mode, None where it was not found, and the strongest where none was requested.
        ``identification.segments`` lists the parts of the record (rest, driving, free decays, disturbances). For a
        record that is driven throughout there are no modes, and ``identification.driven`` holds the frequencies.

    Raises
    ------
    IdentificationError
        If no mode can be distinguished from noise and drift, or the record has neither a free decay nor a steady
        driven motion.
    ValueError
        If times and values do not fit each other, or an option is out of range.

    Notes
    -----
    Eq. 1 and 2 of Yoo, Lee and Kim, "Tracking for high-order damping of thin beam oscillation". A constant damping
    ratio is biased where damping depends on amplitude: this is tested, flagged, and the interval is widened.

    Examples
    --------
    A synthetic decay of 10 Hz and 1 % with 1 % noise:

    >>> import numpy as np
    >>> import modalcam as mc
    >>> t = np.arange(2000) / 500.0
    >>> y = np.exp(-0.01 * 2 * np.pi * 10 * t) * np.cos(2 * np.pi * 10 * t)
    >>> y += 0.01 * np.random.default_rng(1).standard_normal(t.size)
    >>> found = mc.identify(t, y)
    >>> mode = found.modes[0]
    >>> round(mode.frequency_hz, 2), round(100 * mode.damping_ratio, 2)
    (10.0, 1.0)

    The same as a signal of SEP 005, which readers of SDyPy such as `sdypy_io_tdms` return in a list:

    >>> signals = [{"name": "tip", "data": y, "unit_str": "mm", "fs": 500.0}]
    >>> mc.identify(signals).series.channels
    ('tip',)

    A beam whose clamp was filmed while it was shaken, ``base`` and ``y`` in mm:

    >>> found = mc.identify(t, y, input=base)  # doctest: +SKIP
    >>> found.modes[0].participation, found.modes[0].participation_sd  # doctest: +SKIP
    """
    from modal_id import IdentifySettings  # noqa: PLC0415
    from modal_id import identify as identify_series  # noqa: PLC0415
    from modalcam.config import expected_of_theory  # noqa: PLC0415
    from tracker import DisplacementSeries, Failure, KnownInput  # noqa: PLC0415

    if not isinstance(series, DisplacementSeries) and not _are_signals(series):
        series = _series(cast("ArrayLike", series), y, unit, positions_mm)
    elif y is not None:
        msg = "identify takes a series, or times and values; found a series and values"
        raise ValueError(msg)
    elif not isinstance(series, DisplacementSeries):
        series = DisplacementSeries.from_sep005(cast("Sequence[Mapping[str, Any]]", series))
        if positions_mm is not None:
            series = replace(series, positions_mm=np.asarray(positions_mm, dtype=np.float64))
    if input is not None:
        given_unit = series.unit if input_unit is None else input_unit
        values = np.asarray(input, dtype=np.float64)
        known = KnownInput("input", values, given_unit, is_force=given_unit != series.unit, sd=input_sd)
        series = replace(series, known_input=known)
    settings = IdentifySettings(
        **expected_of_theory(beam, series.positions_mm),
        mode=mode,
        target_frequency_hz=frequency_hz,
        onset_s=onset_s,
        end_s=end_s,
        seed=seed,
        excitation=excitation,
        input_lag_ms=input_lag_ms,
    )
    found = identify_series(series, settings)
    if isinstance(found, Failure):
        raise IdentificationError(str(found))
    if not found.motions:
        reasons = "; ".join(failed.reason for failed in found.failed) or "no mode was found"
        msg = f"{series.name}: {reasons}"
        raise IdentificationError(msg)
    return found


def aliases(*found: Identification) -> Aliases:
    """Which frequencies above half the sampling rate the modes may have, from recordings of one structure.

    Parameters
    ----------
    *found : Identification
        One for each recording, best at two or more sampling rates. One alone lists its aliases.

    Returns
    -------
    Aliases
        For each mode of each recording the frequencies that give the same samples, with their probabilities;
        `to_dataframe` has one row per mode and frequency. Identified values are not changed.

    Notes
    -----
    Model and bias: `modal_id.modes.resolve_aliases`. Modes with a damping ratio of 1 or more are left out.

    Examples
    --------
    A mode of 128 Hz, recorded at 250 and at 400 frames per second:

    >>> import numpy as np
    >>> import modalcam as mc
    >>> def record(fps):
    ...     t = np.arange(400) / fps
    ...     y = np.exp(-2 * t) * np.cos(2 * np.pi * 128 * t)
    ...     return mc.identify(t, y + 0.01 * np.random.default_rng(1).standard_normal(t.size))
    >>> slow, fast = mc.aliases(record(250.0), record(400.0)).lines
    >>> round(slow.line.frequency_hz), round(slow.best.frequency_hz), slow.best.probability > 0.99
    (122, 128, True)
    """
    from modal_id.modes import lines_of, resolve_aliases  # noqa: PLC0415

    names = [one.series.name for one in found]
    unique = [name if names.count(name) == 1 else f"{name} {k}" for k, name in enumerate(names, 1)]
    return resolve_aliases(
        line for name, one in zip(unique, found, strict=True) for line in lines_of(name, one)
    )


def _are_signals(series: object) -> bool:
    """Whether it is a list of signals of SEP 005, or one of them."""
    first = series[0] if isinstance(series, Sequence) and len(series) else series
    return isinstance(first, Mapping)


def _series(
    t: ArrayLike, y: ArrayLike | None, unit: str, positions_mm: ArrayLike | None
) -> DisplacementSeries:
    from tracker import DisplacementSeries  # noqa: PLC0415

    if y is None:
        msg = "identify takes a series, or times and values; found no values"
        raise ValueError(msg)
    time_s = np.asarray(t, dtype=np.float64)
    values = np.asarray(y, dtype=np.float64)
    if values.ndim == 1:
        values = values[:, None]
    if time_s.ndim != 1 or values.ndim != 2 or values.shape[0] != time_s.size:
        msg = f"expected n times and n or (n, k) values, found shapes {time_s.shape} and {np.shape(y)}"
        if values.ndim == 2 and values.shape[1] == time_s.size:
            msg += "; the values are transposed: give their transpose, y.T"
        raise ValueError(msg)
    count = values.shape[1]
    positions = (
        np.full(count, np.nan) if positions_mm is None else np.atleast_1d(np.asarray(positions_mm, float))
    )
    return DisplacementSeries(
        name="series",
        time_s=time_s,
        channels=tuple(f"y{k + 1}" for k in range(count)),
        values=values,
        sd=np.full_like(values, np.nan),
        unit=unit,
        positions_mm=positions,
    )


def run(
    folder: str | Path,
    *,
    out: str | Path,
    config: str | Path | None = None,
    fps: float | str | Fraction | None = None,
    seed: int = 0,
    jobs: int = 1,
    force: bool = False,
    plugins: Sequence[str] = (),
    progress: RunProgress | None = None,
) -> RunResult:
    """Run the whole pipeline on every recording of a folder and write all results, as ``modalcam run`` does.

    Recordings are processed in other processes, which import the calling script: guard its top level with
    ``if __name__ == "__main__":``.

    Parameters
    ----------
    folder : str or Path
        Recordings, and optionally ``experiment.toml``.
    out : str or Path
        Folder of the results, made if necessary. Results of an earlier run are reused where they are up to date.
    config : str or Path, optional
        Configuration file, instead of ``experiment.toml`` in the folder.
    fps : float, int, Fraction or str, optional
        Recorded rate of every recording; takes precedence over the configuration.
    seed : int
        Seed of all random streams: the same input and seed give the same results for any number of `jobs`.
    jobs : int
        Number of processes.
    force : bool
        Recompute everything.
    plugins : sequence of str
        Modules to import first, in every process, which register marker kinds, damping models, readers or writers.
    progress : object, optional
        Listener with the methods of `modalcam.pipeline.Progress`.

    Returns
    -------
    RunResult
        ``result.recordings``, each with tracks, identification and comparison, or the reason why there is none.

    Raises
    ------
    ModalcamError
        If the configuration or `out` cannot be used, or the folder holds no recording. A recording that fails does not
        raise: its reason is in the result and in the report.

    Examples
    --------
    >>> import modalcam as mc
    >>> result = mc.run("sample_videos", out="out", jobs=2)  # doctest: +SKIP
    >>> result.to_dataframe()[["recording", "mode", "frequency_hz", "damping_ratio"]]  # doctest: +SKIP
    """
    from modalcam.commands import Options  # noqa: PLC0415
    from modalcam.commands import run as run_folder  # noqa: PLC0415
    from modalcam.config import camera_given  # noqa: PLC0415
    from modalcam.pipeline import Progress  # noqa: PLC0415

    options = Options(
        out=Path(out),
        config=None if config is None else Path(config),
        camera=camera_given({"fps": fps}),
        seed=seed,
        jobs=jobs,
        force=force,
        plugins=tuple(plugins),
    )
    return run_folder(Path(folder), options, progress or Progress())
