"""Films of drawn dots, and small video files, intact and damaged, written with PyAV; nothing is downloaded."""

import struct
from fractions import Fraction
from itertools import islice

import av
import cv2
import numpy as np

from kit.beams import experiment

# The decay: the smallest recording that passes every stage, a dot on a beam that oscillates in mode 2 and decays.
FPS, FRAMES, WIDTH, HEIGHT = 100.0, 140, 64, 32
# Three cycles: of two, noise decides whether they are seen to be driven.
ONSET_S = 0.3
EXPERIMENT = experiment(
    '[camera]\nfps = 100.0\nmm_per_px = 1.0\n[markers]\nkind = "blob"\nsize_mm = 12.0\npositions_mm = [490.0]\n',
    elements=10,
)
# Targets that move far between frames.
FPS_DOTS, FPS_BALL = 22.67, 60.0
DOTS_X_PX, DOT_RADIUS_PX = 90.0 + 130.0 * np.arange(5), 10.5
BALL_RADIUS_PX, BALL_HZ, BALL_ZETA = 33.0, 0.9758, 8e-4
FORMATS = {"mjpeg": "yuvj420p", "ffv1": "gray", "libx264": "yuv420p", "rawvideo": "gray", "mpeg4": "yuv420p"}


def dots(centres_px, *, shape=(HEIGHT, WIDTH), radius_px=6.0, contrast=170.0, noise=1.5, seed=1, depth=8):
    """Dark dots with an edge of 1 px on a light background; centres (frames, dots, 2), NaN for a hidden one."""
    rng, unit = np.random.default_rng(seed), 2.0 ** (depth - 8)
    rows, columns = np.indices(shape, sparse=True)
    out = []
    for centres in np.asarray(centres_px, dtype=float):
        image = np.full(shape, 200.0)
        for x, y in centres[np.isfinite(centres[:, 0])]:
            image -= contrast * np.clip(radius_px + 0.5 - np.hypot(columns - x, rows - y), 0.0, 1.0)
        image = unit * (image + rng.normal(0.0, noise, shape))
        out.append(np.clip(np.rint(image), 0, 2**depth - 1).astype(np.uint8 if depth == 8 else np.uint16))
    return out


def images(n=40, width=160, height=120, depth=8):
    """A dot that oscillates by 5 px along the rows."""
    x = 0.5 * width + 5.0 * np.sin(0.5 * np.arange(n))
    centres = np.stack([x, np.full(n, 0.5 * height)], axis=1)[:, None]
    return dots(centres, shape=(height, width), radius_px=6.5, contrast=160.0, noise=2.0, seed=7, depth=depth)


def decay_px(time_s, onset_s=ONSET_S, weaker_1_s=0.0):
    """Displacement of the dot: amplitude that is constant or falls slowly, then a decay from `onset_s` on."""
    since = np.asarray(time_s) - onset_s
    size = 4.0 * np.exp(-np.maximum(0.0, since) - weaker_1_s * np.minimum(0.0, since))
    return size * np.cos(2 * np.pi * 10.2 * since)


def decay_images(frames=FRAMES, seed=1, **drive):
    """The dot in the middle of the image; `drive` as for `decay_px`."""
    x = 32.0 + decay_px(np.arange(frames) / FPS, **drive)
    return dots(np.stack([x, np.full(frames, 16.0)], axis=1)[:, None], seed=seed)


def write_decay(folder, *, name="take", **changes):
    """Write the recording and experiment.toml into the folder, and return it; `changes` as for `decay_images`."""
    folder.mkdir(exist_ok=True)
    (folder / "experiment.toml").write_text(EXPERIMENT)
    write(folder / f"{name}.mkv", decay_images(**changes), codec="ffv1", rate=30)
    return folder


def write_faint_mode(folder, faint_hz, amplitude_px, *, count=6, frames=400, noise=12.0):
    """Write `take.mkv` at 100 fps: dots that decay together at 10.2 Hz, and with alternate signs at `faint_hz`."""
    t, k = np.arange(frames)[:, None] / FPS, np.arange(count)
    loud = 2.0 * np.exp(-t) * np.cos(2 * np.pi * 10.2 * t)
    faint = amplitude_px * np.exp(-0.6 * t) * np.cos(2 * np.pi * faint_hz * t)
    x = np.broadcast_to(16.0 + 32.0 * k, (frames, count))
    centres = np.stack([x, 16.0 + loud + (-1.0) ** k * faint], axis=2)
    film = dots(centres, shape=(HEIGHT, 32 * count), contrast=150.0, noise=noise, seed=4)
    write(folder / "take.mkv", film, codec="ffv1", rate=30)


def swing_px(frames, amplitude_px=60.0, frames_per_cycle=3.1, at_rest=8, decay=0.05):
    """Displacement of look-alike dots: held at the amplitude, then released into a decay of few frames a cycle."""
    n = np.maximum(np.arange(frames) - at_rest, 0)
    return amplitude_px * np.exp(-decay * n) * np.cos(2 * np.pi * n / frames_per_cycle)


def dot_images(centres_px, *, shape=(110, 700), radius_px=DOT_RADIUS_PX, noise=2.0, seed=0):
    """Look-alike dots as seen by a camera of low contrast."""
    return dots(centres_px, shape=shape, radius_px=radius_px, contrast=160.0, noise=noise, seed=seed)


def ball_x_px(frames):
    """Centre of the ball, in a height of 120 px: a slow pendulum of 150 px."""
    t = np.arange(frames) / FPS_BALL
    return 320 + 150 * np.exp(-BALL_ZETA * 2 * np.pi * BALL_HZ * t) * np.cos(2 * np.pi * BALL_HZ * t)


def ball_images(frames, seed=0, rows=(0, 240), columns=(0, 640)):
    """A textured ball that swings in front of a textured wall; only these rows and columns are drawn."""
    rng = np.random.default_rng(seed)
    wall = cv2.GaussianBlur(rng.standard_normal((240, 640)).astype(np.float32), (0, 0), 2) * 60 + 120
    skin = cv2.GaussianBlur(rng.standard_normal((81, 81)).astype(np.float32), (0, 0), 3) * 120 + 80
    disc = np.clip(BALL_RADIUS_PX + 0.5 - np.hypot(*(np.indices((81, 81)) - 40.0)), 0, 1).astype(np.float32)
    images, wall = [], wall[slice(*rows), slice(*columns)]
    for x in ball_x_px(frames):
        move = np.float32([[1, 0, x - 40 - columns[0]], [0, 1, 80 - rows[0]]])
        ball, cover = (cv2.warpAffine(part, move, wall.shape[::-1]) for part in (skin, disc))
        image = wall * (1 - cover) + ball * cover + 2 * rng.standard_normal(wall.shape)
        images.append(image.clip(0, 255).astype(np.uint8))
    return images


def write(
    path,
    images,
    *,
    codec="mjpeg",
    pixel_format=None,
    rate=50,
    pts=None,
    time_base=None,
    options=None,
    container_format=None,
):
    """Write gray images; `pts` in ticks of `time_base` sets uneven or invalid time stamps."""
    height, width = images[0].shape
    with av.open(str(path), "w", format=container_format) as container:
        stream = container.add_stream(codec, rate=Fraction(rate), options=options or {})
        stream.width, stream.height = width, height
        stream.pix_fmt = pixel_format or FORMATS[codec]
        if codec == "mjpeg":
            stream.codec_context.qmin = stream.codec_context.qmax = 2
        if time_base is not None:
            stream.codec_context.time_base = Fraction(time_base)
        for k, image in enumerate(images):
            source = "gray" if image.dtype == np.uint8 else "gray16le"
            frame = av.VideoFrame.from_ndarray(image, format=source)
            if pixel_format and pixel_format.startswith("gray1") and pixel_format != "gray16le":
                frame = exact(image, pixel_format)
            elif stream.pix_fmt != source:
                frame = frame.reformat(format=stream.pix_fmt, dst_color_range="JPEG", src_color_range="JPEG")
            frame.pts = k if pts is None else pts[k]
            frame.time_base = Fraction(1, rate) if time_base is None else Fraction(time_base)
            for packet in stream.encode(frame):
                container.mux(packet)
        for packet in stream.encode(None):
            container.mux(packet)
    return path


def first_frames(source, path, count):
    """Copy the first coded frames of a film as they are, with their time stamps; `count` of them."""
    return part(source, path, 0, count)


def part(source, path, start, stop=None):
    """Copy coded frames of a film as they are, from a key frame on."""
    with av.open(str(source)) as film, av.open(str(path), "w") as container:
        stream = container.add_stream_from_template(film.streams.video[0])
        for packet in islice((p for p in film.demux(video=0) if p.dts is not None), start, stop):
            packet.stream = stream
            container.mux(packet)
    return path


def edit(path, entries):
    """Replace the edit list of an MP4 file; entries are (duration in ms, media time in ticks or -1, rate).

    Works where the index follows the images, as FFmpeg writes it: no position in the file changes.
    """
    data = bytearray(path.read_bytes())
    at = data.index(b"elst") - 4
    size = int.from_bytes(data[at : at + 4], "big")
    rows = b"".join(struct.pack(">IiI", ms, ticks, round(65536 * rate)) for ms, ticks, rate in entries)
    body = b"elst" + struct.pack(">II", 0, len(entries)) + rows
    for name in (b"edts", b"trak", b"moov"):
        box = data.rindex(name, 0, at) - 4
        grown = int.from_bytes(data[box : box + 4], "big") + 4 + len(body) - size
        data[box : box + 4] = grown.to_bytes(4, "big")
    data[at : at + size] = (4 + len(body)).to_bytes(4, "big") + body
    path.write_bytes(bytes(data))
    return path


def numbered(n, width=96, height=64):
    """Images that hold their number in eight bright or dark bars."""
    out = []
    for k in range(n):
        bars = [255 * (k >> bit & 1) for bit in range(8)]
        out.append(np.repeat(np.repeat([bars], height, axis=0), width // 8, axis=1).astype(np.uint8))
    return out


def number_in(image):
    """Number of an image of `numbered`, also after lossy compression."""
    bars = image.reshape(image.shape[0], 8, -1).mean(axis=(0, 2)) > 0.5 * 255
    return int(np.sum(bars << np.arange(8)))


def exact(image, pixel_format):
    """A frame with the unchanged words of `image`, without conversion of bit depth."""
    frame = av.VideoFrame(image.shape[1], image.shape[0], pixel_format)
    plane = frame.planes[0]
    rows = np.zeros((image.shape[0], plane.line_size // 2), dtype="<u2")
    rows[:, : image.shape[1]] = image
    plane.update(rows.tobytes())
    return frame


def write_sound(path):
    """A file with an audio stream only."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("aac", rate=8000)
        stream.layout = "mono"
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 8000), np.float32), format="fltp", layout="mono")
        frame.sample_rate, frame.pts = 8000, 0
        for packet in [*stream.encode(frame), *stream.encode(None)]:
            container.mux(packet)
    return path


def damage_packet(path, index):
    """Overwrite the middle of one coded frame with noise."""
    with av.open(str(path)) as container:
        packets = [p for p in container.demux(video=0) if p.size]
        position, size = packets[index].pos, packets[index].size
    data = bytearray(path.read_bytes())
    rng = np.random.default_rng(3)
    start, stop = position + size // 4, position + 3 * size // 4
    data[start:stop] = rng.integers(0, 256, stop - start, dtype=np.uint8).tobytes()
    path.write_bytes(bytes(data))
    return path


def luma(path):
    """Gray levels of the frames of a film as they are coded."""
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            plane = frame.planes[0]
            rows = np.frombuffer(plane, dtype=np.uint8).reshape(-1, plane.line_size)
            yield rows[: frame.height, : frame.width].astype(float)
