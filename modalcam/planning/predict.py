"""Predicted intervals of frequency and damping ratio, mode by mode, and what limits each."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from modal_id.fit.bound import ModalBound, modal_bound
from modal_id.onset.onset import settling_s
from modalcam.planning.limits import Limit, limits_of
from modalcam.planning.request import PlannedMode, PlanRequest, decay_length_s
from modalcam.planning.softening import frequency_per_amplitude_squared
from modalcam.planning.template_error import template_factors
from sim.beam.ancf import AncfBeam
from sim.beam.modes import beam_modes
from sim.render.bound import position_bound_px
from tracker.arrays import FloatArray

# Lengths of motion blur at which the bound of a position is computed; between them it is interpolated.
_BLUR_POINTS = 7
_LEAST_BLUR_PX = 0.5
# More samples than this are thinned: the sd follows from the density of what is left.
_MOST_SAMPLES = 20_000
# Standard deviation of the onset that `identify` states on rendered takes, in cycles: 0.09 and 0.14 at modes 2 and 3.
_ONSET_SD_CYCLES = 0.1
# A change of frequency over the record of so many standard deviations is found to depend on the amplitude.
_SEEN_SD = 3.0
# Root mean square of every cantilever mode along the beam, relative to the tip.
_SPREAD_SHAPE = 0.5
# The phase at which the decay starts is not known before: the mean of the information over two quadratures.
_PHASES_RAD = (0.0, 0.5 * np.pi)


@dataclass(frozen=True)
class ModePlan:
    """What one planned recording will tell.

    Attributes
    ----------
    number : int
    frequency_hz, damping_ratio : float
        As assumed.
    seen_hz : float
        Where the mode appears at the frame rate: another frequency than its own where it is aliased.
    decay_s : float
    amplitude_px : array, shape (m,)
        Of each marker at the start, as the exposure leaves it; signed by the shape.
    sd_px : array, shape (m,)
        Of a position of each marker, root mean square over the decay.
    blur_px : float
        Longest motion during an exposure.
    frequency_sd_hz, damping_sd : float
        Predicted standard deviations.
    limits : tuple of Limit
        What makes them as large as they are, the strongest first.
    warnings : tuple of str
    softening : float
        Relative change of the frequency from small amplitude to the start of the decay.
    template_factor : float
        Factor in `damping_sd` for noise in the template that the tracker learns.
    linear_tip_mm : float
        Largest amplitude of the tip at which that change stays within the noise; inf where it is there already.
    """

    number: int
    frequency_hz: float
    damping_ratio: float
    seen_hz: float
    decay_s: float
    amplitude_px: FloatArray
    sd_px: FloatArray
    blur_px: float
    frequency_sd_hz: float
    damping_sd: float
    limits: tuple[Limit, ...]
    warnings: tuple[str, ...]
    softening: float
    template_factor: float
    linear_tip_mm: float


@dataclass(frozen=True)
class Motion:
    """A mode's frequency, its shape at the markers relative to the tip, and its softening over the tip's mm^2."""

    frequency_hz: float
    shape: FloatArray
    per_mm2: float = 0.0


def motions(request: PlanRequest, positions_mm: FloatArray | None = None) -> tuple[Motion, ...]:
    """Frequencies and shapes of the planned modes by the beam's theory, at the markers or at other places.

    Raises
    ------
    ValueError
        If the mesh has not that many modes.
    BuckledBeamError
        If a standing beam cannot carry its weight.
    """
    beam = AncfBeam(request.beam)
    modes = beam_modes(beam, max(m.number for m in request.modes))
    places = np.asarray(request.positions_mm if positions_mm is None else positions_mm, dtype=np.float64)
    shapes = modes.transverse_at(1e-3 * places) / modes.transverse_at(np.array([request.beam.length_m]))
    per_mm2 = 1e-6 * frequency_per_amplitude_squared(request.beam, modes)
    return tuple(
        Motion(float(modes.frequency_hz[k]), shapes[:, k], float(per_mm2[k]))
        for k in (m.number - 1 for m in request.modes)
    )


def predict(request: PlanRequest) -> tuple[ModePlan, ...]:
    """Predicted standard deviations for every planned mode.

    Notes
    -----
    By the Cramer-Rao bound: of a marker's position in a frame (`sim.render.bound`), blurred as the motion blurs it
    at each moment, and of frequency and damping over the decay (`modal_id.fit.bound`) from where `identify` begins to
    fit, about a cycle after the stop; times what the tracker's template adds (`modalcam.planning.template_error`).
    Reached by `run` where noise is white and amplitudes small; what it cannot foresee - lamps, vibration of the
    camera, compression, damping that depends on amplitude - makes real intervals wider.
    """
    ways = motions(request)
    curves = _position_curves(request, ways)
    return tuple(_one(request, mode, way, curves) for mode, way in zip(request.modes, ways, strict=True))


def _one(
    request: PlanRequest, mode: PlannedMode, motion: Motion, curves: dict[str, PchipInterpolator]
) -> ModePlan:
    frequency = motion.frequency_hz
    decay_s = decay_length_s(mode, frequency)
    amplitude = _amplitude_px(request, mode, motion)
    sd = _position_sd(request, mode, motion, decay_s, curves)
    bound = _bound(request, mode, motion, decay_s, amplitude, sd)
    usual_sd = np.asarray(np.sqrt(np.mean(sd**2, axis=0)))
    times, each = _times_s(request, frequency, decay_s)
    template = template_factors(times, frequency, mode.damping_ratio, amplitude, usual_sd / np.sqrt(each))
    blur = _speed_px_s(request, mode, motion).max() * request.camera.exposure_s
    fps = request.fps
    seen = abs(frequency - fps * round(frequency / fps))

    def other(
        *, still: bool = False, long: bool = False, drift: bool = True, spread: bool = False
    ) -> ModalBound:
        """The bound if one thing were otherwise."""
        there = replace(motion, shape=np.full_like(motion.shape, _SPREAD_SHAPE)) if spread else motion
        calm = request if not still else replace(request, camera=replace(request.camera, exposure_s=0.0))
        length = decay_length_s(replace(mode, decay_s=None), frequency) if long else decay_s
        length = max(length, decay_s)
        return _bound(
            calm,
            mode,
            there,
            length,
            _amplitude_px(calm, mode, there),
            _position_sd(calm, mode, there, length, curves),
            with_drift=drift,
        )

    limits, warnings = limits_of(
        request,
        mode,
        frequency_hz=frequency,
        seen_hz=seen,
        decay_s=decay_s,
        amplitude_px=amplitude,
        blur_px=float(blur),
        damping_sd=bound.damping_sd,
        still=other(still=True).damping_sd if request.camera.exposure_s > 0.0 else bound.damping_sd,
        longer=other(long=True).damping_sd,
        without_drift=other(drift=False).damping_sd,
        spread_evenly=other(spread=True).damping_sd,
        template=template[1],
    )
    return ModePlan(
        number=mode.number,
        frequency_hz=frequency,
        damping_ratio=mode.damping_ratio,
        seen_hz=float(seen),
        decay_s=decay_s,
        amplitude_px=amplitude,
        sd_px=usual_sd,
        blur_px=float(blur),
        frequency_sd_hz=bound.frequency_sd_hz * template[0],
        damping_sd=bound.damping_sd * template[1],
        limits=limits,
        warnings=warnings,
        softening=motion.per_mm2 * mode.tip_amplitude_mm**2,
        template_factor=template[1],
        linear_tip_mm=_linear_tip_mm(mode, motion, decay_s, bound),
    )


def _linear_tip_mm(mode: PlannedMode, motion: Motion, decay_s: float, bound: ModalBound) -> float:
    lost = -np.expm1(-4.0 * np.pi * motion.frequency_hz * mode.damping_ratio * decay_s)
    change_hz = abs(motion.per_mm2) * mode.tip_amplitude_mm**2 * motion.frequency_hz * lost
    if change_hz <= _SEEN_SD * bound.frequency_sd_hz:
        return float("inf")
    # The change grows with the amplitude squared, and the standard deviation falls with it.
    return float(mode.tip_amplitude_mm * np.cbrt(_SEEN_SD * bound.frequency_sd_hz / change_hz))


def _amplitude_px(request: PlanRequest, mode: PlannedMode, motion: Motion) -> FloatArray:
    # A position in a blurred frame is the mean over the exposure: a sinusoid loses a sinc of its amplitude.
    attenuation = float(np.sinc(motion.frequency_hz * request.camera.exposure_s))
    return np.asarray(motion.shape * (mode.tip_amplitude_mm / request.camera.mm_per_px * attenuation))


def _speed_px_s(request: PlanRequest, mode: PlannedMode, motion: Motion) -> FloatArray:
    """Largest speed of each marker."""
    amplitude = np.abs(motion.shape) * mode.tip_amplitude_mm / request.camera.mm_per_px
    return np.asarray(2.0 * np.pi * motion.frequency_hz * amplitude)


def _times_s(request: PlanRequest, frequency_hz: float, decay_s: float) -> tuple[FloatArray, float]:
    """Times of the samples that are fitted, from the stop, and how many each stands for where there are too many."""
    step_s = 1.0 / request.fps
    begin = int(np.ceil(settling_s(frequency_hz, step_s, _ONSET_SD_CYCLES / frequency_hz, decay_s) / step_s))
    count = max(int(decay_s * request.fps), begin + 8)
    every = -(-count // _MOST_SAMPLES)
    return np.asarray(np.arange(begin, count, every) * step_s, dtype=np.float64), float(every)


def _position_curves(request: PlanRequest, ways: tuple[Motion, ...]) -> dict[str, PchipInterpolator]:
    """Standard deviation of a position over the length of motion blur, for each kind of print, in px."""
    speeds = [_speed_px_s(request, m, w).max() for m, w in zip(request.modes, ways, strict=True)]
    # At the tip the motion is largest: the counterfactual with all markers there must be covered too.
    tips = [m.tip_amplitude_mm * w.frequency_hz for m, w in zip(request.modes, ways, strict=True)]
    largest = max(*speeds, 2.0 * np.pi * max(tips) / request.camera.mm_per_px) * request.camera.exposure_s
    blurs = np.linspace(0.0, max(largest, _LEAST_BLUR_PX), _BLUR_POINTS)
    # Without blur one point says it all.
    needed = blurs if largest > 0.0 else blurs[:1]
    return {
        type(marker).__name__: PchipInterpolator(
            blurs, np.broadcast_to(position_bound_px(marker, request.camera, needed), blurs.shape)
        )
        for marker in {type(m).__name__: m for m in request.prints}.values()
    }


def _position_sd(
    request: PlanRequest,
    mode: PlannedMode,
    motion: Motion,
    decay_s: float,
    curves: dict[str, PchipInterpolator],
) -> FloatArray:
    """Standard deviation of each sample of each marker (n, m), as blurred as the marker is fast then."""
    times, _ = _times_s(request, motion.frequency_hz, decay_s)
    longest = _speed_px_s(request, mode, motion) * request.camera.exposure_s
    envelope = np.exp(-2.0 * np.pi * motion.frequency_hz * mode.damping_ratio * times)
    # Samples fall at all phases: each takes the mean speed of its cycle, 2 / pi of the largest.
    paths = (2.0 / np.pi) * envelope[:, None] * longest
    return np.column_stack([curves[type(m).__name__](paths[:, k]) for k, m in enumerate(request.prints)])


def _bound(
    request: PlanRequest,
    mode: PlannedMode,
    motion: Motion,
    decay_s: float,
    amplitude_px: FloatArray,
    sd_px: FloatArray,
    *,
    with_drift: bool = True,
) -> ModalBound:
    times, each = _times_s(request, motion.frequency_hz, decay_s)
    bounds = [
        modal_bound(
            times,
            motion.frequency_hz,
            mode.damping_ratio,
            amplitude_px,
            phase,
            sd_px / np.sqrt(each),
            with_drift=with_drift,
        )
        for phase in _PHASES_RAD
    ]
    return ModalBound(
        float(np.mean([b.frequency_sd_hz for b in bounds])), float(np.mean([b.damping_sd for b in bounds]))
    )
