"""The smallest recording that passes every stage: a dot on a beam that oscillates in mode 2 and decays."""

import av
import numpy as np

FPS, FRAMES, WIDTH, HEIGHT = 100.0, 140, 64, 32
# Three cycles: of two, noise decides whether they are seen to be driven.
ONSET_S = 0.3
EXPERIMENT = """
[camera]
fps = 100.0
mm_per_px = 1.0
[markers]
kind = "blob"
size_mm = 12.0
positions_mm = [490.0]
[beam]
length_mm = 500.0
width_mm = 5.0
thickness_mm = 0.5
density_kg_m3 = 8000.0
elastic_modulus_mpa = 210000.0
elements = 10
"""


def swing_px(time_s, onset_s=ONSET_S, weaker_1_s=0.0):
    """Displacement of the dot: amplitude that is constant or falls slowly, then a decay from `onset_s` on."""
    since = np.asarray(time_s) - onset_s
    size = 4.0 * np.exp(-np.maximum(0.0, since) - weaker_1_s * np.minimum(0.0, since))
    return size * np.cos(2 * np.pi * 10.2 * since)


def write_decay(folder, *, name="take", seed=1, frames=FRAMES, **drive):
    """Write a recording with noise of this seed, and experiment.toml; `drive` as for `swing_px`."""
    (folder / "experiment.toml").write_text(EXPERIMENT.lstrip())
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    with av.open(str(folder / f"{name}.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=30)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "gray"
        for swing in swing_px(np.arange(frames) / FPS, **drive):
            distance = np.hypot(x - 32 - swing, y - 16)
            image = 200.0 - 170.0 * np.clip(6.5 - distance, 0.0, 1.0) + rng.normal(0.0, 1.5, x.shape)
            frame = np.clip(np.rint(image), 0, 255).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, "gray")))
        container.mux(stream.encode())


def write_faint_mode(folder, faint_hz, amplitude_px, *, dots=6, frames=400, noise=12.0):
    """Write `take.mkv` at 100 fps: dots that decay together at 10.2 Hz, and with alternate signs at `faint_hz`."""
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:HEIGHT, : 32 * dots]
    with av.open(str(folder / "take.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=30)
        stream.width, stream.height, stream.pix_fmt = x.shape[1], HEIGHT, "gray"
        for t in np.arange(frames) / FPS:
            loud = 2.0 * np.exp(-t) * np.cos(2 * np.pi * 10.2 * t)
            faint = amplitude_px * np.exp(-0.6 * t) * np.cos(2 * np.pi * faint_hz * t)
            image = 200.0 + rng.normal(0.0, noise, x.shape)
            for k in range(dots):
                distance = np.hypot(x - 16 - 32 * k, y - 16 - loud - (-1) ** k * faint)
                image -= 150.0 * np.clip(6.5 - distance, 0.0, 1.0)
            frame = np.clip(np.rint(image), 0, 255).astype(np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, "gray")))
        container.mux(stream.encode())
