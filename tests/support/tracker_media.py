"""Small video files, intact and damaged, written with PyAV; nothing is downloaded."""

import struct
from fractions import Fraction
from itertools import islice

import av
import numpy as np


def images(n=40, width=160, height=120, depth=8):
    """A dark dot that oscillates on a light background, with seeded noise."""
    rng = np.random.default_rng(7)
    y, x = np.indices((height, width))
    out = []
    for k in range(n):
        centre = 0.5 * width + 5.0 * np.sin(0.5 * k), 0.5 * height
        dot = np.clip(7.0 - np.hypot(x - centre[0], y - centre[1]), 0, 1)
        image = (200 - 160 * dot) * 2.0 ** (depth - 8) + rng.normal(0, 2.0 * 2.0 ** (depth - 8), dot.shape)
        out.append(np.clip(np.rint(image), 0, 2**depth - 1).astype(np.uint8 if depth == 8 else np.uint16))
    return out


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
    formats = {
        "mjpeg": "yuvj420p",
        "ffv1": "gray",
        "libx264": "yuv420p",
        "rawvideo": "gray",
        "mpeg4": "yuv420p",
    }
    with av.open(str(path), "w", format=container_format) as container:
        stream = container.add_stream(codec, rate=Fraction(rate), options=options or {})
        stream.width, stream.height = width, height
        stream.pix_fmt = pixel_format or formats[codec]
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
    with av.open(str(source)) as film, av.open(str(path), "w") as container:
        stream = container.add_stream_from_template(film.streams.video[0])
        for packet in islice((p for p in film.demux(video=0) if p.dts is not None), count):
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
