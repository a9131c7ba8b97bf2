"""What makes a predicted interval as wide as it is, in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modalcam.planning.request import PlannedMode, PlanRequest
from tracker.arrays import FloatArray

# A cause is named when the interval would be smaller by this factor without it.
_WORTH_NAMING = 1.1
# Least motion, in px, that an ordinary recording tells from what the camera and the lamp do by themselves.
_LEAST_MOTION_PX = 0.05
# Cycles that the onset and the first decay take before anything is fitted.
_LEAST_CYCLES = 5
# Seen this close to 0 or to half the rate, in cycles of the record, a mode is not told from drift or from its mirror.
_LEAST_CYCLES_APART = 10.0
_LONGEST_BLUR_PX = 10.0


@dataclass(frozen=True)
class Limit:
    """A cause, by what factor the standard deviation of damping is larger for it, and what would help."""

    cause: str
    factor: float
    advice: str


def limits_of(
    request: PlanRequest,
    mode: PlannedMode,
    *,
    frequency_hz: float,
    seen_hz: float,
    decay_s: float,
    amplitude_px: FloatArray,
    blur_px: float,
    damping_sd: float,
    still: float,
    longer: float,
    without_drift: float,
    spread_evenly: float,
    template: float,
) -> tuple[tuple[Limit, ...], tuple[str, ...]]:
    """Causes in order of what they cost, and warnings of what may keep the mode from being identified at all.

    Parameters
    ----------
    still, longer, without_drift, spread_evenly : float
        Standard deviation of the damping ratio with exposures of no length, with a decay filmed to its end, with a
        known rest position, and with markers spread evenly along the beam.
    template : float
        Factor by which the template's noise makes the standard deviation of the damping ratio larger.
    """
    best = float(np.max(np.abs(amplitude_px)))
    shutter = request.camera.exposure_s
    candidates = [
        Limit("exposure blur", damping_sd / still, f"a shutter shorter than {shutter:.3g} s, and more light"),
        Limit("length of the record", damping_sd / longer, "film the decay longer"),
        Limit(
            "slow drift of the rest position",
            damping_sd / without_drift,
            "film more cycles; a reference marker tells drift of the camera from motion",
        ),
        Limit(
            "markers near nodes of the mode",
            damping_sd / spread_evenly,
            "place markers where the shape is large",
        ),
        Limit(
            "noise in the tracker's template",
            template,
            "another amplitude: it matters most at about a pixel of motion; more frames do not average it out",
        ),
    ]
    named = sorted((c for c in candidates if c.factor >= _WORTH_NAMING), key=lambda c: -c.factor)
    rest = Limit(
        "pixel noise",
        1.0,
        "more motion, more light, larger markers, a higher frame rate, or fewer mm per pixel",
    )
    return (*named, rest), _warnings(
        request, mode, frequency_hz, seen_hz, decay_s, best_px=best, blur_px=blur_px
    )


def _warnings(
    request: PlanRequest,
    mode: PlannedMode,
    frequency_hz: float,
    seen_hz: float,
    decay_s: float,
    *,
    best_px: float,
    blur_px: float,
) -> tuple[str, ...]:
    out = []
    fps = request.fps
    if frequency_hz > 0.5 * fps:
        out.append(
            f"Aliased: {frequency_hz:.4g} Hz is above half of {fps:g} fps and appears at {seen_hz:.4g} Hz. Its "
            f"frequency is right only if it is known to within {0.5 * fps:g} Hz beforehand; film at "
            f"{2.5 * frequency_hz:.3g} fps or more."
        )
    apart = min(seen_hz, abs(0.5 * fps - seen_hz)) * decay_s
    if apart < _LEAST_CYCLES_APART:
        out.append(
            f"Seen at {seen_hz:.4g} Hz, {apart:.2g} cycles of the record from 0 or from half the frame rate: it cannot "
            "be told from drift, or from its own mirror image; choose another frame rate."
        )
    if decay_s * frequency_hz < _LEAST_CYCLES:
        out.append(
            f"Only {decay_s * frequency_hz:.2g} cycles are filmed; {_LEAST_CYCLES} or more are needed to find where "
            "the decay begins."
        )
    if best_px < _LEAST_MOTION_PX:
        out.append(
            f"The largest motion of a marker is {best_px:.2g} px; below {_LEAST_MOTION_PX:g} px lamps, fans and the "
            "camera's own shaking decide."
        )
    if blur_px > _LONGEST_BLUR_PX:
        out.append(
            f"A marker moves {blur_px:.3g} px during an exposure; markers are found and followed up to about "
            f"{_LONGEST_BLUR_PX:g} px."
        )
    if frequency_hz * request.camera.exposure_s > 0.5:
        out.append(
            f"The exposure lasts {frequency_hz * request.camera.exposure_s:.2g} cycles of mode {mode.number}: most of "
            "its motion is averaged away."
        )
    return tuple(out)
