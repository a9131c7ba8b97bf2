"""Predicted intervals of frequency and damping ratio, mode by mode, and what limits each.

The shift of a natural frequency with amplitude follows the theory of a single mode. Errors that return with the motion
widen the intervals: the template is learnt from the first frames of a recording, their noise remains in it and biases
every position by a small function of the marker's position within the pixel, which does not average out over a longer
record. `identify` estimates that function together with the modes; what it cannot tell apart from damping widens the
interval.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.integrate import cumulative_trapezoid, trapezoid
from scipy.interpolate import PchipInterpolator

from modal_id.data import MIN_SAMPLES, bandwidth_hz, baseline_matrix
from modal_id.modes import apparent_hz
from modal_id.posterior import ModalBound, modal_bound
from modal_id.segments import settling_s
from modal_id.solve import pole
from modalcam.apps.plan.request import Limit, ModePlan, PlannedMode, PlanRequest
from sim.beam import AncfBeam, BeamModes, BeamProperties, beam_modes
from sim.render import Camera, Marker, position_bound_px
from tracker import FloatArray, harmonics, position_errors

_POINTS = 2001


def frequency_per_amplitude_squared(beam: BeamProperties, modes: BeamModes) -> FloatArray:
    """Relative change of each mode's natural frequency over the tip's amplitude squared, 1 / m^2.

    Negative where the mode softens, as all but the first of a uniform cantilever do; the first is nearly neutral.

    Notes
    -----
    One mode ``q(t) w(s)``, w(L) = 1, of a beam that does not stretch (Crespo da Silva & Glynn, J. Struct. Mech. 6,
    1978, doi:10.1080/03601217808907348): bending energy grows by ``q^4 / 2 int EI w''^2 w'^2 ds``, and points move
    along the beam by ``u = -q^2 / 2 int_0^s w'^2``. Harmonic balance gives
    ``d omega / omega = (3/4 K4 / K - 1/4 M4 / M) q^2`` with ``K4 = int EI w''^2 w'^2``,
    ``M4 = int m (int_0^s w'^2)^2``. A hanging beam is lifted by ``q^4 / 8 int_0^s w'^4`` more than in linear theory,
    which adds ``g / 4 int m int_0^s w'^4`` to K4. Axial strain and sag are neglected.
    """
    s = np.linspace(0.0, beam.length_m, _POINTS)
    tip = modes.transverse_at(np.array([beam.length_m]))[0]
    shape = modes.transverse_at(s) / tip
    slope = np.gradient(shape, s, axis=0)
    bend = np.gradient(slope, s, axis=0)
    element = np.minimum((s / beam.length_m * beam.elements).astype(int), beam.elements - 1)
    width, thickness = beam.width_m[element, None], beam.thickness_m[element, None]
    stiffness = beam.elastic_modulus_pa * width * thickness**3 / 12.0
    along = cumulative_trapezoid(slope**2, s, axis=0, initial=0.0)
    # Modal mass for unit amplitude at the tip; modes are mass-normalised.
    mass = 1.0 / tip**2
    mass_per_m = beam.density_kg_m3 * width * thickness

    def weighed(values: FloatArray) -> FloatArray:
        """Integral of `values`, shape (points, modes), over the mass of the beam and its point masses."""
        bodies = [body.mass_kg * values[np.argmin(np.abs(s - body.position_m))] for body in beam.point_masses]
        return np.asarray(sum(bodies, trapezoid(mass_per_m * values, s, axis=0)))

    inertia = weighed(along**2)
    bending = trapezoid(stiffness * bend**2 * slope**2, s, axis=0)
    lifted = cumulative_trapezoid(slope**4, s, axis=0, initial=0.0)
    bending = bending + 0.25 * _gravity_along(beam) * weighed(lifted)
    return np.asarray(0.75 * bending / (mass * modes.omega_rad_s**2) - 0.25 * inertia / mass)


def _gravity_along(beam: BeamProperties) -> float:
    """Component of gravity along the beam, positive if it puts the beam under tension."""
    angle_deg = {"hanging": 0.0, "standing": 180.0}.get(beam.orientation, beam.angle_deg)
    return 0.0 if angle_deg is None else beam.gravity_m_s2 * float(np.cos(np.radians(angle_deg)))


# Enough samples for the share of the variance: the function of the pixel is smooth in the phase.
_MOST_SAMPLES = 4000
_PHASES_RAD = (0.0, 0.5 * np.pi)


def template_factors(
    time_s: FloatArray, frequency_hz: float, damping_ratio: float, amplitude_px: FloatArray, sd_px: FloatArray
) -> tuple[float, float]:
    """Factors by which template noise increases the standard deviations of frequency and damping ratio.

    Times, shape (n,), are from the beginning of the free decay; `amplitude_px` and `sd_px`, shape (m,), are the
    amplitude of each marker at time 0 and the standard deviation of its position. Markers at rest have factors of 1.

    Notes
    -----
    Information of frequency and damping with the periodic error of each marker marginalised, against that without it;
    amplitudes and drift are unknown in both. Markers are weighted as in the fit.
    """
    if not np.any(amplitude_px):
        return 1.0, 1.0
    every = -(-time_s.size // _MOST_SAMPLES)
    variance = np.zeros(2)
    for phase_rad in _PHASES_RAD:
        plain, marginal = _information(
            time_s[::every], every, frequency_hz, damping_ratio, amplitude_px, sd_px, phase_rad
        )
        variance += np.diag(np.linalg.inv(marginal)) / np.diag(np.linalg.inv(plain)) / len(_PHASES_RAD)
    frequency, damping = np.sqrt(variance)
    return float(frequency), float(damping)


def _information(
    time_s: FloatArray,
    every: int,
    frequency_hz: float,
    damping_ratio: float,
    amplitude_px: FloatArray,
    sd_px: FloatArray,
    phase_rad: float,
) -> tuple[FloatArray, FloatArray]:
    """Information of frequency and damping ratio without and with the error, each sample standing for `every`."""
    wave = np.exp(pole(2.0 * np.pi * frequency_hz, damping_ratio) * time_s + 1j * phase_rad)
    drift = baseline_matrix(time_s, bandwidth_hz(frequency_hz))
    slopes = np.column_stack([(1j * time_s * wave).real, (time_s * wave).real])
    basis = np.linalg.qr(np.column_stack([wave.real, wave.imag, drift]))[0]
    slopes -= basis @ (basis.T @ slopes)
    plain, marginal = np.zeros((2, 2)), np.zeros((2, 2))
    for size, sd in zip(amplitude_px, sd_px, strict=True):
        error = position_errors.TUNING.lossless_share * np.sqrt(every) * harmonics(size * wave.real)
        error -= basis @ (basis.T @ error)
        shared = error.T @ slopes
        seen = np.linalg.solve(error.T @ error + np.eye(error.shape[1]), shared)
        plain += (size / sd) ** 2 * (slopes.T @ slopes)
        marginal += (size / sd) ** 2 * (slopes.T @ slopes - shared.T @ seen)
    return plain, marginal


# Lengths of motion blur at which the bound of a position is computed; between them it is interpolated.
_BLUR_POINTS = 7
_LEAST_BLUR_PX = 0.5
# Longer series are thinned: the standard deviation follows from the density of the remaining samples.
_MOST_FITTED_SAMPLES = 20_000
# Root mean square of every cantilever mode along the beam, relative to the tip.
_RMS_SHAPE = 0.5
_NOISE = Limit(
    "pixel noise", 1.0, "more motion, more light, larger markers, a higher frame rate, or fewer mm per pixel"
)


@dataclass(frozen=True)
class Tuning:
    """Thresholds of the prediction."""

    #: [cycles] standard deviation of the onset, which decides where the fit begins
    #: measurement: `identify` states 0.09 and 0.14 for rendered recordings of modes 2 and 3.
    onset_sd: float = 0.1
    #: [sd] change of the frequency over the record beyond which it counts as amplitude dependence
    #: statistics: A normal error exceeds it in 0.27 % of cases.
    detected: float = 3.0
    #: [1] a cause without which the interval would be narrower by this factor is named
    #: convention: A tenth of an interval.
    worth_naming: float = 1.1
    #: [cycles] a longer decay is refused
    #: convention: A number in another unit, not an experiment.
    most_cycles: float = 1e6
    #: [px] a smaller marker is refused
    #: convention: As for the longest decay.
    least_marker: float = 0.1
    #: [px] a larger marker, or blur, is refused
    #: convention: As for the longest decay.
    most_marker: float = 500.0
    #: [px] a larger motion is refused
    #: convention: As for the longest decay.
    most_swing: float = 1e4


TUNING = Tuning()
_CurveKey = tuple[Camera, type[Marker], float]
_Curves = dict[_CurveKey, PchipInterpolator]


@dataclass(frozen=True)
class Motion:
    """Frequency of a mode, its shape at the markers relative to the tip, and its softening per mm^2 at the tip."""

    frequency_hz: float
    shape: FloatArray
    per_mm2: float


def _curve_key(mode: PlannedMode, marker: Marker) -> _CurveKey:
    # ArUco markers differ by their code alone: one stands for all.
    return mode.camera, type(marker), marker.half_extent_mm


def _position_curves(modes: tuple[PlannedMode, ...], motions: tuple[Motion, ...]) -> _Curves:
    """Standard deviation of a position, in px, over the length of motion blur, for each camera and kind of marker."""
    longest: dict[Camera, float] = {}
    for mode, motion in zip(modes, motions, strict=True):
        # Covers the tip too, where other marker positions may be tried.
        amplitude_mm = mode.tip_amplitude_mm * max(1.0, float(np.abs(motion.shape).max()))
        speed = 2.0 * np.pi * motion.frequency_hz * amplitude_mm / mode.camera.mm_per_px
        longest[mode.camera] = max(longest.get(mode.camera, 0.0), speed * mode.camera.exposure_s)
    curves: _Curves = {}
    for mode in modes:
        largest = longest[mode.camera]
        blurs = np.linspace(0.0, max(largest, _LEAST_BLUR_PX), _BLUR_POINTS)
        # Without an exposure there is no blur, and one point is enough.
        needed = blurs if largest > 0.0 else blurs[:1]
        for marker in reversed(mode.markers):
            key = _curve_key(mode, marker)
            if key not in curves:
                bound = position_bound_px(marker, mode.camera, needed)
                curves[key] = PchipInterpolator(blurs, np.broadcast_to(bound, blurs.shape))
    return curves


@dataclass(frozen=True)
class _Decay:
    """One planned decay: motion of the markers in the frames, and the standard deviation of each position."""

    mode: PlannedMode
    motion: Motion
    curves: _Curves
    decay_s: float
    exposure_s: float
    with_drift: bool = True

    @cached_property
    def samples(self) -> tuple[FloatArray, float]:
        """Times of the fitted samples from the stop, thinned, and how many samples each stands for."""
        frequency, step_s = self.motion.frequency_hz, 1.0 / self.mode.fps
        settled_s = settling_s(frequency, step_s, TUNING.onset_sd / frequency, self.decay_s)
        begin = int(np.ceil(settled_s / step_s))
        count = max(int(self.decay_s * self.mode.fps), begin + 8)
        every = -(-count // _MOST_FITTED_SAMPLES)
        return np.asarray(np.arange(begin, count, every) * step_s, dtype=np.float64), float(every)

    @cached_property
    def sd_px(self) -> FloatArray:
        """Standard deviation of each sample of each marker, shape (n, m), blurred by its speed at that time."""
        times, _ = self.samples
        envelope = np.exp(-2.0 * np.pi * self.motion.frequency_hz * self.mode.damping_ratio * times)
        # Samples fall at all phases: each takes the mean speed of its cycle, 2 / pi of the largest.
        paths = (2.0 / np.pi) * envelope[:, None] * (self.speed_px_s * self.exposure_s)
        curves = [self.curves[_curve_key(self.mode, marker)] for marker in self.mode.markers]
        return np.column_stack([curve(path) for curve, path in zip(curves, paths.T, strict=True)])

    @property
    def speed_px_s(self) -> FloatArray:
        """Largest speed of each marker."""
        amplitude = np.abs(self.motion.shape) * self.mode.tip_amplitude_mm / self.mode.camera.mm_per_px
        return np.asarray(2.0 * np.pi * self.motion.frequency_hz * amplitude)

    @property
    def amplitude_px(self) -> FloatArray:
        """Of each marker, signed."""
        # A position in a blurred frame is the mean over the exposure: a sinusoid is attenuated by a sinc.
        attenuation = float(np.sinc(self.motion.frequency_hz * self.exposure_s))
        scale = self.mode.tip_amplitude_mm / self.mode.camera.mm_per_px * attenuation
        return np.asarray(self.motion.shape * scale)

    def bound(self) -> ModalBound:
        """Cramer-Rao bound of frequency and damping, mean over the phase at the start."""
        times, stands_for = self.samples
        sd_px = self.sd_px / np.sqrt(stands_for)
        zeta, drift = self.mode.damping_ratio, self.with_drift
        bounds = [
            modal_bound(
                times, self.motion.frequency_hz, zeta, self.amplitude_px, phase, sd_px, with_drift=drift
            )
            for phase in _PHASES_RAD
        ]
        frequency_sd_hz, damping_sd = np.mean([(b.frequency_sd_hz, b.damping_sd) for b in bounds], axis=0)
        return ModalBound(float(frequency_sd_hz), float(damping_sd))


def motions(request: PlanRequest, positions_mm: FloatArray | None = None) -> tuple[Motion, ...]:
    """Frequencies and shapes of the planned modes by the beam's theory, at their markers or at other positions.

    Raises
    ------
    ValueError, BuckledBeamError, NoEquilibriumError
        If the mesh has fewer modes, if a standing beam buckles under its own weight, or if no equilibrium is found.
    """
    modes = beam_modes(AncfBeam(request.beam), max(m.number for m in request.modes))
    per_mm2 = 1e-6 * frequency_per_amplitude_squared(request.beam, modes)
    tip = modes.transverse_at(np.array([request.beam.length_m]))
    out = []
    for mode in request.modes:
        k = mode.number - 1
        positions = np.asarray(mode.positions_mm if positions_mm is None else positions_mm, dtype=np.float64)
        shapes = modes.transverse_at(1e-3 * positions) / tip
        out.append(Motion(float(modes.frequency_hz[k]), shapes[:, k], float(per_mm2[k])))
    return tuple(out)


def predict(request: PlanRequest) -> tuple[ModePlan, ...]:
    """Predicted standard deviations of every planned mode; raises what `motions` raises.

    Notes
    -----
    Cramer-Rao bounds: of the position of a marker in a frame (`sim.render.bound`), with the motion blur of each
    moment, and of frequency and damping over the decay (`modal_id.posterior.cramer_rao`) from where `identify`
    begins to fit, about a cycle after the stop; times the factor of the tracker's template
    (`modalcam.apps.plan.predict`); for a frequency, also the tolerance of the frame rate.
    `run` reaches them where noise is white and amplitudes are small. Light
    flicker, camera vibration, compression and amplitude-dependent damping are not foreseen and widen real intervals.
    """
    ways = motions(request)
    for mode, way in zip(request.modes, ways, strict=True):
        _check(mode, way)
    curves = _position_curves(request.modes, ways)
    return tuple(_predicted(mode, way, curves) for mode, way in zip(request.modes, ways, strict=True))


def _check(mode: PlannedMode, motion: Motion) -> None:
    """Refuse numbers that no experiment has, mostly one in another unit: what they need has no limit."""
    frequency, decay_s = motion.frequency_hz, mode.decay_length_s(motion.frequency_hz)
    sizes_px = [2.0 * marker.half_extent_mm / mode.camera.mm_per_px for marker in mode.markers]
    swing_px = mode.tip_amplitude_mm / mode.camera.mm_per_px
    blur_px = 2.0 * np.pi * frequency * swing_px * mode.camera.exposure_s
    t, size = TUNING, "camera.mm_per_px or markers.size_mm"
    checks = (
        (decay_s * mode.fps, MIN_SAMPLES, np.inf, "frames in the decay", "camera.fps or plan.decay_s"),
        (frequency * decay_s, 0.0, t.most_cycles, "cycles in the decay", "plan.decay_s or the beam"),
        (min(sizes_px), t.least_marker, np.inf, "px of the smallest marker", size),
        (max(sizes_px), 0.0, t.most_marker, "px of the largest marker", size),
        (swing_px, 0.0, t.most_swing, "px of motion", "plan.tip_amplitude_mm"),
        (blur_px, 0.0, t.most_marker, "px of motion blur", "camera.exposure_s"),
    )
    for value, least, most, what, keys in checks:
        if not least <= value <= most:
            expected = f"at least {least:g}" if value < least else f"at most {most:g}"
            msg = (
                f"mode {mode.number} at {frequency:.4g} Hz: expected {expected} {what}, found {value:.3g}; "
                f"check {keys}"
            )
            raise ValueError(msg)


def _predicted(mode: PlannedMode, motion: Motion, curves: _Curves) -> ModePlan:
    found: ModePlan | None = None
    try:
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            found = _one(mode, motion, curves)
    except np.linalg.LinAlgError:
        found = None  # singular: two unknowns have the same effect on the frames
    if found is None or not np.isfinite([found.frequency_sd_hz, found.damping_sd]).all():
        msg = (
            f"mode {mode.number} at {motion.frequency_hz:.4g} Hz is not determined by frames at {mode.fps:g} per "
            "second; check camera.fps, the markers' positions and the beam"
        )
        raise ValueError(msg)
    return found


def _one(mode: PlannedMode, motion: Motion, curves: _Curves) -> ModePlan:
    frequency, fps = motion.frequency_hz, mode.fps
    decay = _Decay(mode, motion, curves, mode.decay_length_s(frequency), mode.camera.exposure_s)
    bound = decay.bound()
    times, stands_for = decay.samples
    rms_sd = np.sqrt(np.mean(decay.sd_px**2, axis=0) / stands_for)
    template = template_factors(times, frequency, mode.damping_ratio, decay.amplitude_px, rms_sd)
    return ModePlan(
        planned=mode,
        frequency_hz=frequency,
        seen_hz=apparent_hz(frequency, fps),
        decay_s=decay.decay_s,
        amplitude_px=decay.amplitude_px,
        blur_px=float(decay.speed_px_s.max() * mode.camera.exposure_s),
        # A wrong rate scales all times: frequencies change, damping ratios do not.
        frequency_sd_hz=float(
            np.hypot(bound.frequency_sd_hz * template[0], 1e-6 * mode.rate_sd_ppm * frequency)
        ),
        damping_sd=bound.damping_sd * template[1],
        limits=_limits(decay, bound.damping_sd, template[1]),
        softening=motion.per_mm2 * mode.tip_amplitude_mm**2,
        template_factor=template[1],
        linear_tip_mm=_linear_tip_mm(decay, bound),
    )


def _limits(decay: _Decay, damping_sd: float, template: float) -> tuple[Limit, ...]:
    """Causes in the order of their effect, by the bound without each of them."""
    full_s = replace(decay.mode, decay_s=None).decay_length_s(decay.motion.frequency_hz)
    even = replace(decay.motion, shape=np.full_like(decay.motion.shape, _RMS_SHAPE))
    others = (
        (
            "exposure blur",
            f"an exposure shorter than {decay.exposure_s:.3g} s, and more light",
            replace(decay, exposure_s=0.0),
        ),
        (
            "length of the record",
            "film the decay for longer",
            replace(decay, decay_s=max(full_s, decay.decay_s)),
        ),
        (
            "slow drift of the rest position",
            "film more cycles; a reference marker separates drift of the camera from motion",
            replace(decay, with_drift=False),
        ),
        (
            "markers near nodes of the mode",
            "place markers where the mode shape is large",
            replace(decay, motion=even),
        ),
    )
    causes = [Limit(cause, damping_sd / other.bound().damping_sd, advice) for cause, advice, other in others]
    remedy = "another amplitude: the effect is largest at about one pixel; more frames do not average it out"
    causes.append(Limit("noise in the tracker's template", template, remedy))
    named = sorted((c for c in causes if c.factor >= TUNING.worth_naming), key=lambda c: -c.factor)
    return (*named, _NOISE)


def _linear_tip_mm(decay: _Decay, bound: ModalBound) -> float:
    mode, motion = decay.mode, decay.motion
    lost = -np.expm1(-4.0 * np.pi * motion.frequency_hz * mode.damping_ratio * decay.decay_s)
    change_hz = abs(motion.per_mm2) * mode.tip_amplitude_mm**2 * motion.frequency_hz * lost
    if change_hz <= TUNING.detected * bound.frequency_sd_hz:
        return float("inf")
    # The change grows with the amplitude squared, and the standard deviation is inversely proportional to it.
    return float(mode.tip_amplitude_mm * np.cbrt(TUNING.detected * bound.frequency_sd_hz / change_hz))
