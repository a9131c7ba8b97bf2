"""What a change of a threshold can change: a few series identified, films tracked, decays simulated, beams updated.

Each part returns what it found as numbers; `difference` compares two runs of one part.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks.ambient_scenes import ambient_record
from benchmarks.coverage_cases import make
from benchmarks.film_scenes import Film
from benchmarks.known_input import with_input
from benchmarks.known_input_scenes import KINDS, record
from benchmarks.line_scenes import LineScene
from benchmarks.records import SETS
from modal_id import (
    Identification,
    IdentifySettings,
    SamplerSettings,
    fit_free_decay,
    identify,
)
from sim import MEASURED_DAMPING_RATIO, MEASURED_FREQUENCY_HZ, paper_beam, sample_beam
from sim.beam import AncfBeam, ElasticClamp, beam_modes, static_equilibrium
from sim.comparison import AirDrag, Candidate, DecayComparison, compare_decay
from sim.damping import GenericDamping, RayleighDamping, StillAir, WithAirDrag
from sim.dynamics import simulate, simulate_free_decay, state_with_coordinates
from sim.render import (
    ArucoMarker,
    BareStrip,
    Camera,
    DecayingMode,
    DotMarker,
    Optics,
    RecordingPlan,
    Scene,
    StagedRecording,
    Stripe,
    Surface,
    Texture,
    decaying_cantilever,
    position_bound_px,
    render_frames,
    stage_recording,
    write_video,
)
from sim.updating import MeasuredModes, Updating, UpdatingSettings, update
from tracker import (
    DisplacementSeries,
    Failure,
    FloatArray,
    KnownInput,
    MarkerTracks,
    TrackerSettings,
    track,
)

POSITIONS_MM = np.array([90.0, 190.0, 290.0, 390.0, 490.0])
# relative sd of a frequency and of a damping ratio where a simulation states none: typical of a recording
SIMULATED_SD = {"frequency": 1e-5, "damping": 5e-3}


@dataclass
class Found:
    """Values with their standard deviations by name, positions in px by film, and the digest of everything."""

    frequency: dict[str, tuple[float, float]] = field(default_factory=dict)
    damping: dict[str, tuple[float, float]] = field(default_factory=dict)
    positions_px: dict[str, list[float]] = field(default_factory=dict)
    lost: int = 0
    failures: int = 0
    digest: str = ""

    def add(self, *arrays: FloatArray) -> None:
        """Numbers that count only as changed or not."""
        content = b"".join(np.ascontiguousarray(a, dtype=np.float64).tobytes() for a in arrays)
        self.digest = hashlib.sha256(self.digest.encode() + content).hexdigest()


@dataclass(frozen=True)
class Difference:
    """Largest change of a frequency and a damping ratio in sd, rms change of positions, frames lost, failures."""

    frequency_sd: float
    damping_sd: float
    positions_px: float
    lost: int
    failures: int
    identical: bool

    def with_worse(self, other: Difference) -> Difference:
        """The larger changes of two parts of the battery; frames and failures add up."""
        return Difference(
            max(self.frequency_sd, other.frequency_sd),
            max(self.damping_sd, other.damping_sd),
            max(self.positions_px, other.positions_px),
            self.lost + other.lost,
            self.failures + other.failures,
            self.identical and other.identical,
        )


def difference(one: Found, other: Found) -> Difference:
    """Change from one run of a part to another."""

    def largest(a: dict[str, tuple[float, float]], b: dict[str, tuple[float, float]]) -> float:
        return max((abs(b[k][0] - a[k][0]) / a[k][1] for k in a.keys() & b.keys()), default=0.0)

    squares = [0.0]
    for name in one.positions_px.keys() & other.positions_px.keys():
        a, b = np.array(one.positions_px[name]), np.array(other.positions_px[name])
        if a.shape == b.shape and np.isfinite(a - b).any():
            squares.append(float(np.nanmean((a - b) ** 2)))
    return Difference(
        largest(one.frequency, other.frequency),
        largest(one.damping, other.damping),
        float(np.sqrt(max(squares))),
        other.lost - one.lost,
        other.failures - one.failures,
        all(getattr(one, k) == getattr(other, k) for k in ("digest", "frequency", "damping", "failures")),
    )


def series() -> Found:
    """Synthetic records identified: one clean, one with all disturbances, one short."""
    found = Found()
    for case, mode, seconds in (("white", 1, 6.0), ("all together", 2, 10.0), ("AR(1) 0.5", 0, 2.0)):
        one = make(case, mode, seed=3)[0]
        first = one.time_s < seconds
        short = DisplacementSeries(
            name=case,
            time_s=one.time_s[first],
            channels=one.channels,
            values=one.values[first],
            sd=one.sd[first],
            unit=one.unit,
            positions_mm=one.positions_mm,
        )
        _identified(found, identify(short, IdentifySettings(sampler=SamplerSettings(max_steps=400))))
    return found


def _identified(found: Found, result: Identification | Failure) -> None:
    if isinstance(result, Failure):
        found.failures += 1
        return
    for i, mode in enumerate(result.modes):
        name = f"{result.series.name} {i}"
        found.frequency[name] = (mode.frequency_hz, mode.frequency_sd_hz)
        found.damping[name] = (mode.damping_ratio, mode.damping_ratio_sd)
    found.lost += int(np.count_nonzero(~result.used))
    found.add(result.fitted, result.residual_sd)


def films() -> Found:
    """Films of each kind of marker, drawn without the renderer, tracked against the truth."""
    found = Found()
    with tempfile.TemporaryDirectory() as folder:
        for kind, codec, amplitude_px in (
            ("aruco", "H.264", 6.0),
            ("dots", "lossless", 12.0),
            ("patch", "MJPG", 3.0),
        ):
            film = Film(kind, codec, amplitude_px, 90, 5)
            _tracked(found, kind, track(film.write(Path(folder)), film.settings(), recording=kind))
        scene = LineScene(width_px=3.0, shape=(360, 160), length_px=220.0, decay=0.004)
        path = Path(folder) / "line.mkv"
        write_video(path, iter(scene.frames(60)), fps_container=Fraction(50), codec="ffv1")
        ends = scene.points(0.0, np.array([0.0, scene.length_px]))[0]
        settings = TrackerSettings(fps=200.0, kind="line", line_px=ends.round().tolist())
        _tracked(found, "line", track(path, settings))
    return found


def _tracked(found: Found, name: str, tracks: object) -> None:
    if not isinstance(tracks, MarkerTracks):
        found.failures += 1
        return
    found.positions_px[name] = np.stack([tracks.x_px, tracks.y_px]).ravel().tolist()
    found.lost += int(np.count_nonzero(~np.isfinite(tracks.x_px)))
    found.add(tracks.x_px, tracks.y_px)


def simulations() -> Found:
    """Modes, equilibria and decays of the beam, from rest and shaken, small and large."""
    found = Found()
    for orientation in ("hanging", "horizontal"):
        beam = AncfBeam(paper_beam(orientation))
        modes = beam_modes(beam, 5)
        _values(found, "frequency", orientation, modes.frequency_hz)
        found.add(modes.phi, static_equilibrium(beam, tip_moment_n_m=0.02))
    clamped = paper_beam(elements=10)
    springs = beam_modes(AncfBeam(replace(clamped, clamp=ElasticClamp(2.0))), 3)
    _values(found, "frequency", "elastic clamp", springs.frequency_hz)
    damping = GenericDamping(MEASURED_DAMPING_RATIO)
    rayleigh = RayleighDamping.from_modes((11.6, 64.0), (0.01, 0.0028))
    for name, model, mode, tip_mm in (
        ("small", damping, 2, 2.0),
        ("large", WithAirDrag(damping, StillAir()), 1, 180.0),
        ("Rayleigh", rayleigh, 1, 20.0),
    ):
        run = simulate_free_decay(
            paper_beam("horizontal" if name == "large" else "hanging"),
            model,
            mode=mode,
            tip_amplitude_mm=tip_mm,
            duration_s=1.2,
        )
        _decayed(found, name, run.time_s, run.tip_mm)
        found.add(run.trajectory.energy_j)
    return found


def _values(found: Found, kind: str, name: str, values: FloatArray) -> None:
    target = found.frequency if kind == "frequency" else found.damping
    for i, value in enumerate(values):
        target[f"{name} {i}"] = (float(value), SIMULATED_SD[kind] * abs(float(value)))


def _decayed(found: Found, name: str, time_s: FloatArray, values: FloatArray) -> None:
    """Frequency by the zero crossings, damping by the peaks between them, and the motion itself."""
    moved = values - values[-values.size // 2 :].mean()
    at = np.flatnonzero(moved[1:] * moved[:-1] < 0.0)
    crossing = time_s[at] - moved[at] * np.diff(time_s)[at] / (moved[at + 1] - moved[at])
    if crossing.size > 2:
        half_s = (crossing[-1] - crossing[0]) / (crossing.size - 1)
        _values(found, "frequency", name, np.array([0.5 / half_s]))
        peaks = [np.max(np.abs(moved[a:b])) for a, b in pairwise(at)]
        slope = np.polyfit(np.arange(len(peaks)), np.log(peaks), 1)[0]
        _values(found, "damping", name, np.array([-slope / np.pi]))
    found.add(time_s, values)


def updates() -> Found:
    """The sample beam and the paper's beam updated by all methods."""
    found = Found()
    measured = np.array(MEASURED_FREQUENCY_HZ)
    modes = MeasuredModes(np.arange(1, 6), measured, 1e-5 * measured)
    for name, beam in (
        ("hanging", paper_beam(elements=12)),
        ("horizontal", paper_beam("horizontal", elements=8)),
    ):
        result = update(beam, modes, UpdatingSettings(draws=80), seed=1)
        if not isinstance(result, Updating):
            found.failures += 1
            continue
        for i, draws in enumerate(result.bayesian.predicted_hz.T):
            found.frequency[f"{name} {i}"] = (float(np.median(draws)), float(np.std(draws)))
        paper = result.paper
        found.add(paper.updated_hz, paper.width_factor, paper.start_spread, np.array([paper.smallest_bound]))
        found.add(result.uniform.updated_hz, result.uniform.combination_sd, result.bayesian.prior_sd_hz)
        found.add(np.array([result.uniform.known, result.bayesian.determined, result.bayesian.reliable]))
        found.add(*(np.append(m.log_evidence_laplace, m.log_evidence_drawn) for m in result.evidence.models))
        found.add(np.array([len(result.evidence.undecided), len(paper.at_bound)]), result.predicted_hz)
    return found


def _recorded(mode: int, tip_mm: float, seconds: float, air: float) -> DisplacementSeries:
    """A decay of the sample beam with noise of half a per cent of the tip's amplitude."""
    beam = AncfBeam(sample_beam())
    modes = beam_modes(beam, 8)
    start = 1e-3 * tip_mm / modes.transverse_at(np.array([0.5]))[0, mode - 1]
    coordinate = np.where(np.arange(8) == mode - 1, start, 0.0)
    damping = WithAirDrag(GenericDamping(MEASURED_DAMPING_RATIO), StillAir(drag_coefficient=air))
    run = simulate(
        beam,
        damping,
        state=state_with_coordinates(beam, modes, coordinate, np.zeros(8)),
        duration_s=seconds,
        step_s=5e-4,
        output_positions_m=1e-3 * POSITIONS_MM,
        output_every=max(1, round(0.06 / modes.frequency_hz[mode - 1] / 5e-4)),
        modes=modes,
    )
    if not run:
        raise ArithmeticError(run.reason)
    noise = 0.005 * tip_mm * np.random.default_rng(mode).standard_normal(run.transverse_m.shape)
    return DisplacementSeries(
        name=f"mode {mode}",
        time_s=run.time_s,
        channels=tuple("abcde"),
        values=1e3 * run.transverse_m + noise,
        sd=np.full(noise.shape, 0.005 * tip_mm),
        unit="mm",
        positions_mm=POSITIONS_MM,
        direction=(1.0, 0.0),
    )


def comparisons() -> Found:
    """Recorded decays compared with two damping models and air drag: a large one of mode 1, a small one of mode 2."""
    found = Found()
    modes = beam_modes(AncfBeam(sample_beam()), 8)
    for mode, tip_mm, seconds in ((1, 120.0, 6.0), (2, 3.0, 2.0)):
        settings = IdentifySettings(
            mode=mode,
            expected_frequencies_hz=tuple(modes.frequency_hz),
            expected_shapes=modes.transverse_at(1e-3 * POSITIONS_MM),
            onset_s=0.0,
            sampler=SamplerSettings(max_steps=200),
        )
        recorded = identify(_recorded(mode, tip_mm, seconds, 2.0 if mode == 1 else 0.0), settings)
        if isinstance(recorded, Failure) or recorded.target is None:
            found.failures += 1
            continue
        ratios = [*MEASURED_DAMPING_RATIO]
        ratios[mode - 1] = recorded.target.damping_ratio
        generic = GenericDamping(tuple(ratios))
        rayleigh = RayleighDamping.from_modes(tuple(modes.omega_rad_s[:2]), MEASURED_DAMPING_RATIO[:2])  # type: ignore[arg-type]  # two of five
        draws = tuple(
            GenericDamping((*ratios[: mode - 1], ratios[mode - 1] * (1.0 + 0.01 * k), *ratios[mode:]))
            for k in range(-2, 3)
        )

        result = compare_decay(
            sample_beam(),
            recorded,
            {"generic": Candidate(generic, draws), "rayleigh": Candidate(rayleigh, draws[:3])},
            fit=partial(fit_free_decay, max_modes=len(recorded.modes)),
            air=AirDrag(generic),
            beams=(sample_beam(), paper_beam()),
        )
        if not isinstance(result, DecayComparison):
            found.failures += 1
            continue
        _compared(found, result, recorded.target.frequency_sd_hz, recorded.target.damping_ratio_sd)
    return found


def _compared(found: Found, result: DecayComparison, frequency_sd: float, damping_sd: float) -> None:
    for decay in result.models:
        name = f"{result.recording} {decay.model}"
        found.frequency[name] = (decay.frequency_hz, frequency_sd)
        found.damping[name] = (decay.damping_ratio, damping_sd)
        found.add(decay.simulated, decay.predictive_sd)
        found.add(
            np.array(
                [decay.log_density.total, decay.log_density_gain.se, decay.envelope_error, decay.coverage]
            )
        )
        if decay.band_low is not None and decay.band_high is not None:
            found.add(decay.band_low, decay.band_high)
    found.lost -= len(result.models)
    if result.drag is not None:
        found.add(np.array([result.drag.drag_coefficient_q95]))


def renderings() -> Found:
    """Films made by the renderer, tracked: a shaken beam with markers, and a bare beam before a pattern."""
    found = Found()
    staged = stage_recording(
        paper_beam(elements=10),
        GenericDamping((0.01, 0.003)),
        RecordingPlan(mode_number=2, tip_amplitude_m=0.004, shake_s=0.1, decay_s=0.2),
        Optics(fps=Fraction(200), mm_per_px=0.7, exposure_s=2e-3),
        markers=(
            ArucoMarker(dictionary="DICT_4X4_50", marker_id=3, size_mm=14.0),
            DotMarker(diameter_mm=8.0, background=180.0, quiet_zone_mm=3.0),
        ),
        positions_m=np.array([0.25, 0.48]),
    )
    if isinstance(staged, StagedRecording):
        images = list(staged.frames(np.random.default_rng(2)))
        found.add(*images)
        found.positions_px["shaken"] = staged.centres_px.ravel().tolist()
        _filmed(found, "aruco", images, TrackerSettings(fps=200.0, kind="aruco"))
    else:
        found.failures += 1
    camera = Camera(
        width_px=150, height_px=260, mm_per_px=2.0, origin_px=(75.2, 12.3), read_noise_sd=1.0, noise_gain=0.02
    )
    motion = decaying_cantilever(
        480.0, (DecayingMode(number=1, amplitude_mm=60.0, frequency_hz=1.9, damping_ratio=0.01),)
    )
    surface = Surface(
        gray=70.0, stripe=Stripe(gray=60.0, width_mm=1.0), texture=Texture(sd=4.0, grain_mm=3.0)
    )
    strip = BareStrip(width_mm=6.0, arc_mm=motion.arc_mm, motion=motion, surface=surface)
    scene = Scene(
        markers=(),
        motion=lambda t: type(motion(t))(*(np.zeros((t.size, 0)) for _ in range(3))),
        strip=strip,
        backdrop=Texture(sd=3.0, grain_mm=12.0, seed=1),
    )
    times = np.arange(40) / 60.0
    images = list(render_frames(scene, camera, times, np.random.default_rng(4)))
    found.add(*images)
    ends = camera.to_px(np.zeros(2), np.array([0.0, -480.0]))
    settings = TrackerSettings(fps=60.0, kind="line", line_px=np.rint(np.stack(ends, axis=1)).tolist())
    _filmed(found, "bare", images, settings)
    dot = DotMarker(diameter_mm=6.0)
    found.add(position_bound_px(dot, camera, np.array([0.0, 3.0])))
    return found


def _filmed(found: Found, name: str, images: list[FloatArray], settings: TrackerSettings) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.mkv"
        write_video(path, iter(images), fps_container=Fraction(50), codec="ffv1")
        _tracked(found, name, track(path, settings, recording=name))


def _of_record(name: str, seed: int) -> Found:
    """One of the random records."""
    return _answered(SETS[name](seed).series, IdentifySettings())


def _of_ambient(seed: int) -> Found:
    """Two minutes under random forces."""
    return _answered(ambient_record(seed, duration_s=120.0)[0], IdentifySettings(excitation="ambient"))


def _of_input(kind: str, seed: int, noise_mm: float) -> Found:
    """The response to a measured motion of the base."""
    one = record(kind, seed, input_noise_mm=noise_mm)
    known = KnownInput("base", one.base, "mm", sd=noise_mm or float("nan"))
    return _answered(with_input(one.time_s, one.values, known), IdentifySettings())


def _answered(given: DisplacementSeries, settings: IdentifySettings) -> Found:
    found = Found()
    _identified(found, identify(given, settings))
    return found


# of both sets: at rest, driven, plucked, held, with outliers, gaps and drift
RECORDS: dict[str, Callable[[], Found]] = {
    **{f"{name} {seed}": partial(_of_record, name, seed) for name in SETS for seed in range(24)},
    **{f"ambient {seed}": partial(_of_ambient, seed) for seed in (0, 1, 3)},
    **{f"input {kind}": partial(_of_input, kind, 1, 0.0) for kind in KINDS},
    "input with noise": partial(_of_input, KINDS[0], 2, 0.02),
}
PARTS: dict[str, Callable[[], Found]] = {
    **RECORDS,
    "films": films,
    "series": series,
    "simulations": simulations,
    "updates": updates,
    "comparisons": comparisons,
    "renderings": renderings,
}
# parts that a constant of a folder can change, the most specific first
AFFECTED = {
    "tracker": ("films",),
    "modal_id": (*RECORDS, "series"),
    "sim.beam": ("simulations", "updates"),
    "sim.damping": ("simulations",),
    "sim.dynamics": ("simulations",),
    "sim.updating": ("updates",),
    "sim.comparison": ("comparisons",),
    "sim.render": ("renderings",),
    "sim": ("simulations", "updates", "comparisons", "renderings"),
    "modalcam": ("series",),
}


def affected(module: str) -> tuple[str, ...]:
    """Parts of the battery that the constants of a module can change."""
    return next(parts for folder, parts in AFFECTED.items() if f"{module}.".startswith(f"{folder}."))
