"""Warnings and suggestions of a plan as sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence

from modalcam.planning.results import ModePlan, Plan
from modalcam.report.style.format import significant

# Smallest motion, in px, that an ordinary recording separates from light flicker and camera vibration.
_LEAST_MOTION_PX = 0.05
# Cycles needed to find the onset and to begin the fit.
_LEAST_CYCLES = 5
# Cycles of the record by which an apparent frequency must differ from 0 and from half the rate.
_LEAST_CYCLES_APART = 10.0
_LONGEST_BLUR_PX = 10.0


def advice(plan: Plan) -> tuple[str, ...]:
    """All warnings, then suggestions."""
    out = [f"Mode {m.number}: {w}" for m in plan.modes for w in warnings_of(m)]
    for m in plan.modes:
        first = m.limits[0]
        if first.factor > 1.0:
            out.append(
                f"Mode {m.number}: intervals are wider by a factor of {first.factor:.2g} because of {first.cause}. "
                f"Remedy: {first.advice}."
            )
    out += _softening(plan)
    for found in plan.positions:
        where = ", ".join(f"{p:g}" for p in found.positions_mm)
        factors = ", ".join(f"{f:.2g} (mode {n})" for f, n in zip(found.factors, found.modes, strict=True))
        out.append(f"Markers at {where} mm would multiply the widths of the intervals by {factors}.")
    return (*out, *_rates(plan))


def warnings_of(mode: ModePlan) -> tuple[str, ...]:
    """Reasons why `run` may fail to identify this mode."""
    fps, exposure_s = mode.planned.fps, mode.planned.camera.exposure_s
    frequency, cycles = mode.frequency_hz, mode.decay_s * mode.frequency_hz
    apart = min(mode.seen_hz, abs(0.5 * fps - mode.seen_hz)) * mode.decay_s
    exposed = frequency * exposure_s
    out = []
    if frequency > 0.5 * fps:
        out.append(
            f"Aliased: {frequency:.4g} Hz is above half of {fps:g} fps and appears at {mode.seen_hz:.4g} Hz. Its "
            f"identified frequency is correct only if it is known beforehand to within {0.5 * fps:g} Hz; film at "
            f"{2.5 * frequency:.3g} fps or more."
        )
    if apart < _LEAST_CYCLES_APART:
        out.append(
            f"Its apparent frequency of {mode.seen_hz:.4g} Hz is only {apart:.2g} cycles per record away from 0 or "
            "from half the frame rate: it cannot be separated from drift or from its own mirror image. Choose another "
            "frame rate or film for longer."
        )
    if cycles < _LEAST_CYCLES:
        out.append(
            f"Only {cycles:.2g} cycles are filmed; {_LEAST_CYCLES} or more are needed to find the onset of the decay."
        )
    if mode.largest_px < _LEAST_MOTION_PX:
        out.append(
            f"The largest motion of a marker is {mode.largest_px:.2g} px; below {_LEAST_MOTION_PX:g} px light flicker "
            "and vibration of the camera dominate."
        )
    if mode.blur_px > _LONGEST_BLUR_PX:
        out.append(
            f"A marker moves {mode.blur_px:.3g} px during an exposure; markers are detected and tracked up to about "
            f"{_LONGEST_BLUR_PX:g} px."
        )
    if exposed > 0.5:
        out.append(
            f"The exposure lasts {exposed:.2g} cycles of the mode: most of its motion is averaged out."
        )
    return tuple(out)


def _softening(plan: Plan) -> list[str]:
    """Frequency changes at large amplitude that exceed the noise."""
    large = [m for m in plan.modes if math.isfinite(m.linear_tip_mm)]
    if not large:
        return []
    changes = ", ".join(f"{significant(100.0 * m.softening, 2)} % (mode {m.number})" for m in large)
    below = ", ".join(f"{significant(m.linear_tip_mm, 2)} mm (mode {m.number})" for m in large)
    return [
        (
            f"At these amplitudes natural frequencies differ from those at small amplitude by {changes}, which is more "
            "than the noise: run will report them as amplitude-dependent, with intervals several times wider than "
            f"these. Tip amplitudes up to {below} keep the change within the noise, but the noise is then larger "
            "relative to the motion."
        )
    ]


def _rates(plan: Plan) -> list[str]:
    """Sufficient frame rates, and lower ones at which aliased modes stay separated."""
    planned = {m.number: m.planned.fps for m in plan.modes}
    enough: dict[float, list[int]] = {}
    for rate in plan.rates:
        if not rate.aliased:
            enough.setdefault(rate.fps, []).extend(rate.modes)
    texts = [
        f"{fps:g} fps{_of(plan, modes)}{'' if fps <= min(planned[n] for n in modes) else ', more than planned'}"
        for fps, modes in enough.items()
    ]
    out = [f"Frame rates well above twice the frequency of every mode: {'; '.join(texts)}."] if texts else []
    for rate in plan.rates:
        if rate.aliased:
            seen = ", ".join(f"{f:.4g}" for f in rate.seen_hz)
            out.append(
                f"A slower camera with {rate.fps:g} fps{_of(plan, rate.modes)} would do: aliased modes stay separated, "
                f"at apparent frequencies of {seen} Hz."
            )
    return out


def _of(plan: Plan, modes: Sequence[int]) -> str:
    if len(modes) == len(plan.modes):
        return ""
    return f" (mode{'s' if len(modes) > 1 else ''} {', '.join(map(str, modes))})"
