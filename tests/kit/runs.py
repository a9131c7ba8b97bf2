"""Results of runs by Eq. 1, in the program's classes, for the tests of the report."""

from dataclasses import replace
from fractions import Fraction
from functools import cache

import numpy as np

from kit.identified import identified, identified_mode
from kit.series import series_of
from kit.tracks import decoded, tracks_of
from modal_id import AmplitudeCurve, AmplitudeDependence, Check, FailedMode, Onset
from modalcam.pipeline import BeamResult, RecordingResult, RunResult
from sim import MEASURED_DAMPING_RATIO, MEASURED_FREQUENCY_HZ, paper_beam
from sim.beam import AncfBeam, beam_modes
from sim.comparison import (
    DecayComparison,
    ModelDecay,
    Prediction,
    Samples,
    crps,
    log_density,
    score_difference,
    score_sum,
)
from sim.damping import MeasuredDamping, beam_section, compare_laws
from sim.updating import MeasuredModes, UpdatingSettings, update
from tracker import BLURRED, NOT_FOUND, FailedTracking, FrameStrip, Scale, TimeAxis

POSITIONS_MM = np.array([90.0, 190.0, 290.0, 390.0, 490.0])
PLAYBACK = TimeAxis("container", Fraction(50), Fraction(50), ("The container says 50 fps.",))
HOSTILE = (
    "<img src=x onerror=window.PWN=1>.mp4",
    "</script><script>window.PWN=1</script>.avi",
    '"onload="window.PWN=1.avi',
    "{{7*7}}{% raw %}.avi",
    "$x_1$^.avi",
    "tab\there\x1b[31m\nnewline.avi",
    "rtl\u202egpj.avi",
    "caf\u00e9 \u05d0\u05d1\u05d2 \U0001f3b8 \ufffe.avi",
    "bytes\udcff.avi",
    'url(#x) style="fill:#1c2126" var(--ink).avi',
)
CHECKS = (
    Check(
        "largest line of the residual spectrum", 9.1, 8.7, 0.31, "A vibration was not fitted.", "Remove it."
    ),
    Check("kurtosis of the residual", 3.02, 3.0, 0.42, "Single samples deviate.", "Inspect them."),
)


@cache
def beam_theory():
    return beam_modes(AncfBeam(paper_beam()), 5)


def run_mode(rng, frequency_hz, damping_ratio, shape, number, **more):
    """A mode as a run gives it: sampled draws, and the agreement of its shape with theory."""
    drawn = {
        "scores": lambda rng: rng.standard_normal((4, 1500)),
        "laplace_sd": (2e-5 * frequency_hz / 1.05, 0.008 * damping_ratio / 1.04),
    }
    drawn |= {"sd": (2e-5, 0.008), "r_hat": (1.002, 1.004), "ess": (3120.0, 2980.0), "acceptance": 0.61}
    drawn |= {"autocorrelation_steps": 1.6, "noise_factor": 1.08, "seed": (1, 2, 3), "mac": 0.9987}
    drawn |= {"shape_sd": np.full(shape.size, 0.004)}
    return identified_mode(frequency_hz, damping_ratio, shape, number, rng, **(drawn | more))


def amplitude_dependence(amplitude=8.0, frequency_hz=26.84):
    a = np.concatenate([[0.0], np.geomspace(0.02, 1.0, 40)])
    law = {"law": "saturating", "constant_probability": 0.0, "residual_power": 1.1}
    curve = AmplitudeCurve(
        amplitude * a,
        damping_ratio=0.0026 + 4e-4 * a / (a + 0.1),
        damping_ratio_sd=2e-5 + 2e-5 * a,
        frequency_hz=frequency_hz - 0.02 * a**2,
        frequency_sd_hz=1e-4 + 0.0 * a,
        **law,
        constant_residual_power=33.0,
    )
    return AmplitudeDependence(
        0.0026, 2e-5, 4e-4, 5e-5, frequency_hz, 1e-4, -0.02, 0.004, significant=True, curve=curve
    )


def recording(
    index,
    *,
    file=None,
    number=1,
    frequency_hz=10.0,
    damping_ratio=0.003,
    seed=0,
    markers=None,
    positions_mm=POSITIONS_MM,
    scale=True,
    time_axis=None,
    flags=(),
    fps=500,
    seconds=4.0,
    width=120,
    height=520,
):
    """One recording through tracking and identification: driven until the onset, then free by Eq. 1."""
    rng = np.random.default_rng([seed, index])
    file = file or f"mode_{number}.avi"
    k = positions_mm.size
    markers = markers or tuple(str(i) for i in range(k))
    marked_mm = np.where(np.isfinite(positions_mm), positions_mm, np.linspace(90.0, 490.0, k))
    theory = beam_theory().transverse_at(1e-3 * marked_mm)[:, number - 1]
    unit, mm_per_px = ("mm", 1.0) if scale else ("px", 1.0)
    amplitude = 8.0 / number
    shape = (
        amplitude * theory / np.max(np.abs(theory)) * np.exp(0.4j) * (1.0 + 0.002j * rng.standard_normal(k))
    )
    time_s = np.arange(int(fps * seconds)) / fps
    onset, fit_from = 0.4, 0.42
    omega = 2.0 * np.pi * frequency_hz
    since = time_s - fit_from
    decay = np.exp(-damping_ratio * omega * np.maximum(since, -0.02))
    free = np.real(shape * (decay * np.exp(1j * omega * np.sqrt(1 - damping_ratio**2) * since))[:, None])
    baseline = 0.3 + 0.02 * np.sin(2 * np.pi * 0.2 * time_s)[:, None] + np.zeros(k)
    noise_sd = 0.02
    values = free + baseline + noise_sd * rng.standard_normal(free.shape)
    lost = rng.random(values.shape) < 0.01
    values[lost] = np.nan
    after = time_s >= fit_from
    used = after[:, None] & ~lost
    series = series_of(
        time_s, values, unit, noise_sd, positions_mm, name=file, channels=markers, direction=(1.0, 0.0)
    )
    dependence = amplitude_dependence(amplitude, frequency_hz) if "AMPLITUDE_DEPENDENT" in flags else None
    own = {"amplitude_unit": unit, "flags": tuple(flags), "amplitude_dependence": dependence}
    modes = [run_mode(rng, frequency_hz, damping_ratio, shape, number, **own)]
    if number == 3:
        modes.append(run_mode(rng, 1.85, 0.01, 0.01 * shape, 1, target=False, amplitude_unit=unit))
    identification = identified(
        series,
        tuple(sorted(modes, key=lambda m: m.frequency_hz)),
        np.where(after[:, None], free + baseline, np.nan),
        np.where(after[:, None], baseline, np.nan),
        used,
        noise_sd,
        Onset(onset, 2e-5, fit_from, "model", 0.998, "The driving stops within one frame."),
        failed=(FailedMode("the amplitude is below the noise", frequency_hz=53.2, number=4),)
        if number == 3
        else (),
        checks=CHECKS,
    )
    tracks = tracks_of(
        width / 2 + values / mm_per_px,
        np.where(lost, np.nan, 20.0 + marked_mm),
        fps=fps,
        recording=file,
        markers=markers,
        sd_x_px=np.where(lost, np.nan, 0.0052),
        sd_y_px=np.where(lost, np.nan, 0.0058),
        flags=np.where(lost, NOT_FOUND.value, np.where(np.abs(free) > 6, BLURRED.value, 0)).astype(np.uint32),
        positions_mm=positions_mm,
        scale=Scale(1.0, 0.002, "experiment.toml") if scale else None,
        time_axis=time_axis or TimeAxis("user", Fraction(fps), Fraction(25)),
        decode=decoded(time_s.size, codec="mjpeg", size=(width, height)),
        first_frame=frame_image(rng, width, height, 20.0 + marked_mm),
        strip=strip(rng, width, height, 20.0 + marked_mm, time_s.size),
    )
    name, found = f"recording_{index + 1}", {"tracks": tracks, "series": series}
    return RecordingResult(name, file, f"{index:064x}", number, **found, identification=identification)


def strip(rng, width, height, rows, frames):
    """Five frames at half size, the last frame included."""
    images = [frame_image(rng, width, height, rows)[::2, ::2] for _ in range(5)]
    return FrameStrip(np.linspace(0, frames - 1, 5).astype(int), np.stack(images), 2.0)


def frame_image(rng, width, height, rows):
    """A dark beam with dots on a light background, with noise."""
    y, x = np.arange(height)[:, None], np.arange(width)
    image = 190.0 + 6.0 * rng.standard_normal((height, width))
    image[:, np.abs(x - width / 2) < 4] -= 90.0
    for row in rows:
        near = np.abs(y[:, 0] - row) < 6
        image[near] = np.where(np.hypot(x - width / 2, y[near] - row) < 6, 30.0, image[near])
    return np.clip(image, 0, 255).astype(np.uint8)


def paper_recordings(count=5):
    return tuple(
        recording(
            i,
            file=f"mode_{i % 5 + 1}.avi" if i < 5 else f"again_{i}.avi",
            number=i % 5 + 1,
            frequency_hz=MEASURED_FREQUENCY_HZ[i % 5],
            damping_ratio=MEASURED_DAMPING_RATIO[i % 5],
            flags=("AMPLITUDE_DEPENDENT",) if i % 5 == 2 else (),
        )
        for i in range(count)
    )


RAYLEIGH_ALPHA_1_S, RAYLEIGH_BETA_S = 0.2282, 3.18e-5


def scores(found, measured, used, simulated, first):
    after_s = found.series.time_s[found.series.time_s >= found.onset.fit_from_s]
    noise_sd = np.full(first.shape, 0.02)
    samples = Samples(after_s, measured, used, first, noise_sd, period_s=1.0 / found.target.frequency_hz)
    own, other = (Prediction(mean, np.full(mean.shape, 0.02)) for mean in (simulated, first))
    return {
        "log_density": score_sum(samples, log_density, own),
        "crps": score_sum(samples, crps, own),
        "log_density_gain": score_difference(samples, log_density, other, own),
        "crps_gain": score_difference(samples, crps, other, own),
    }


def comparison(found):
    """Eq. 1 with the measured damping (generic) and with that of Eq. 3 (rayleigh)."""
    mode = found.target
    since = found.series.time_s - found.onset.fit_from_s
    after = since >= 0.0
    omega = 2.0 * np.pi * mode.frequency_hz
    rayleigh = 0.5 * (RAYLEIGH_ALPHA_1_S / omega + RAYLEIGH_BETA_S * omega)

    def decay(damping_ratio):
        return np.real(mode.shape * np.exp(complex(-damping_ratio, 1.0) * omega * since[after])[:, None])

    measured = (found.series.values - found.baseline)[after]
    used = found.used[after]
    models = []
    for name, damping_ratio in (("generic", mode.damping_ratio), ("rayleigh", rayleigh)):
        simulated = decay(damping_ratio)
        low, high = decay(0.98 * damping_ratio), decay(1.02 * damping_ratio)
        error = np.sqrt(np.mean((simulated - measured)[used] ** 2) / np.mean(measured[used] ** 2))
        models.append(
            ModelDecay(
                model=name,
                simulated=simulated,
                nrmse=float(error),
                frequency_hz=mode.frequency_hz,
                damping_ratio=damping_ratio,
                frequency_shift=-1.2e-4,
                envelope_error=float(error),
                phase_error_rad=2e-3,
                band_low=np.minimum(low, high),
                band_high=np.maximum(low, high),
                predictive_sd=np.full(simulated.shape, 0.02),
                coverage=float(np.mean(np.abs(simulated - measured)[used] < 1.645 * 0.02)),
                **scores(found, measured, used, simulated, decay(mode.damping_ratio)),
            )
        )
    return DecayComparison(
        recording=found.series.name,
        mode_number=mode.number,
        frequency_hz=mode.frequency_hz,
        damping_ratio=mode.damping_ratio,
        frequency_shift=-1.1e-4,
        frequency_shift_sd=2e-5,
        tip_amplitude_mm=1.02 * float(np.max(np.abs(mode.shape))),
        channels=found.series.channels,
        positions_mm=found.series.positions_mm,
        unit=found.series.unit,
        time_s=found.series.time_s[after],
        measured=measured,
        used=used,
        models=tuple(models),
    )


def compared(recordings):
    return tuple(replace(r, comparison=comparison(r.identification)) for r in recordings)


@cache
def beam_result(elements=20):
    """The paper's beam, updated to the paper's frequencies."""
    standard, frequency_hz = paper_beam(elements=elements), np.array(MEASURED_FREQUENCY_HZ)
    measured = MeasuredModes(np.arange(1, 6), frequency_hz, 2e-5 * frequency_hz)
    updated = update(standard, measured, UpdatingSettings(draws=50))
    given = (tuple(range(1, 6)), MEASURED_FREQUENCY_HZ, MEASURED_DAMPING_RATIO)
    data = MeasuredDamping(*given, damping_sd=(3e-5,) * 5, section=beam_section(standard, "steel"))
    return BeamResult(
        standard,
        beam_modes(AncfBeam(standard), 5),
        updated=updated,
        updated_modes=beam_modes(AncfBeam(updated.properties), 5),
        rayleigh_alpha_1_s=RAYLEIGH_ALPHA_1_S,
        rayleigh_beta_s=RAYLEIGH_BETA_S,
        laws=compare_laws(data),
    )


def hostile_run():
    """Every hostile name as file, as marker and in every text."""
    quick = {"seconds": 0.6, "positions_mm": np.linspace(50.0, 490.0, len(HOSTILE))}
    whole = recording(len(HOSTILE), file=HOSTILE[0] * 2, markers=HOSTILE, time_axis=PLAYBACK, **quick)
    nothing = {"series": None, "identification": None}
    files = [replace(whole, name=n, file=n, tracks=FailedTracking(n, n), **nothing) for n in HOSTILE]
    texts = {"command_line": " ".join(HOSTILE), "resolved_config": "\n".join(HOSTILE)}
    return run_result(
        (*files, *compared([whole])), folder=HOSTILE[0], not_done=HOSTILE, versions=(HOSTILE[:2],), **texts
    )


def run_result(recordings=(), *, beam=None, not_done=(), folder="beam on the shaker", **more):
    values = {
        "resolved_config": '[camera]\nfps = 500.0\nmm_per_px = 1.0\n\n[markers]\nkind = "blob"\n',
        "versions": (("modalcam", "0.1.0"), ("python", "3.11.2"), ("numpy", "2.4.6")),
        "command_line": "modalcam run /home/someone/secret/videos -o /home/someone/out",
        "seed": 1,
    }
    return RunResult(
        folder=folder, recordings=tuple(recordings), beam=beam, not_done=tuple(not_done), **{**values, **more}
    )
