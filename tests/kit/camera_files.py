"""Recordings in formats of high-speed cameras and as images, written byte by byte; one of every supported format."""

import struct
import zlib

import cv2
import numpy as np
import tifffile

from kit.films import images, write
from tracker.geometry import resolve_time_axis
from tracker.video import open_recording


def packed(words, bits):
    """Words as a stream of bits, most significant first; through `np.unpackbits`, not through shifts."""
    columns = np.unpackbits(words.astype(">u2").view(np.uint8).reshape(-1, 2), axis=1)
    return np.packbits(columns[:, 16 - bits :].ravel()).tobytes()


def pixel_bytes(image, bits):
    if bits in (10, 12):
        return packed(image.ravel(), bits)
    return image.astype("<u2" if bits == 16 else np.uint8).tobytes()


CIH = """#Camera Information Header
Date : 2020/1/1
Camera Type : FASTCAM
Record Rate(fps) : {rate}
Shutter Speed(s) : 1/1000
Total Frame : {frames}
Save Step : {step}
Image Width : {width}
Image Height : {height}
Color Type : {color}
Color Bit : {bits}
File Format : MRaw
EffectiveBit Depth : {depth}
EffectiveBit Side : {side}
Comment Text : C:\\elsewhere\\other.mraw
"""

CIHX = """<?xml version="1.0" encoding="utf-8"?>
<cih><frameInfo><totalFrame>{frames}</totalFrame><skipFrame>{step}</skipFrame></frameInfo>
<recordInfo><recordRate>{rate}</recordRate></recordInfo>
<imageDataInfo><resolution><width>{width}</width><height>{height}</height></resolution>
<colorInfo><type>{color}</type><bit>{bits}</bit></colorInfo>
<effectiveBit><depth>{depth}</depth><side>{side}</side></effectiveBit></imageDataInfo>
<deviceInfo><recordRate>1</recordRate></deviceInfo></cih>"""


def write_photron(header, images, *, bits, shift=0, **changes):
    """A header, its format by the suffix, and its .mraw file."""
    height, width = images[0].shape
    values = {"rate": 30000, "frames": len(images), "step": 1, "width": width, "height": height}
    values |= {"color": "Mono", "bits": bits, "depth": bits, "side": "Lower"} | changes
    if header.suffix == ".cih":
        header.write_text(CIH.format(**values))
    else:
        header.write_bytes(
            b"!!! This file can not be edited. !!!\x00\xff\xfe" + CIHX.format(**values).encode() + b"\x00tail"
        )
    pixels = b"".join(pixel_bytes(image << shift, bits) for image in images)
    header.with_suffix(".mraw").write_bytes(pixels)
    return header


def write_cine(path, images, *, bits, packing=0, depth=None, rate=5000, times_s=None, flip_v=0, flip_h=0):
    """A monochrome .cine; `bits` of 8 or 16 in words, or packed to 10 or 12."""
    height, width = images[0].shape
    n = len(images)
    setup = bytearray(0x1700)
    setup[140:142] = b"ST"
    struct.pack_into("<H", setup, 142, len(setup))
    struct.pack_into("<II", setup, 756, flip_h, flip_v)
    struct.pack_into("<I", setup, 768, rate)
    struct.pack_into("<I", setup, 896, depth or bits)
    tags = b""
    if times_s is not None:
        words = [int(t * 2**32) & ~3 | k % 4 for k, t in enumerate(times_s)]
        tags = struct.pack(f"<IHH{n}Q", 8 + 8 * n, 1002, 0, *words)
    at_offsets = 84 + len(setup) + len(tags)
    blocks = []
    for image in images:
        shown = image[::-1] if flip_v else image
        shown = shown[:, ::-1] if flip_h else shown
        if not packing:
            shown = shown[::-1]  # bitmaps begin with the lowest row
            padding = -width % 4 if bits == 8 else 0
            shown = np.pad(shown, ((0, 0), (0, padding)))
        data = pixel_bytes(np.ascontiguousarray(shown), bits)
        blocks.append(struct.pack("<I", 12) + b"note" + struct.pack("<I", len(data)) + data)
    offsets, position = [], at_offsets + 8 * n
    for block in blocks:
        offsets.append(position)
        position += len(block)
    words = 16 if bits > 8 else 8
    head = struct.pack(
        "<2sHHHiIiIIIIQ", b"CI", 44, 0, 1, -n, n, -n, n, 44, 84, at_offsets, int(1.7e9) << 32
    ) + struct.pack(
        "<IiiHHIIiiII", 40, width, height, 1, words, packing, len(data), 0, 0, 0, 1 << (depth or bits)
    )
    path.write_bytes(head + bytes(setup) + tags + struct.pack(f"<{n}q", *offsets) + b"".join(blocks))
    return path


def write_folder(folder, images, suffix, *, numbers=None, name="frame{}"):
    """A new folder of numbered images; TIFF without compression, which needs no further library."""
    options = [cv2.IMWRITE_TIFF_COMPRESSION, 1] if suffix == ".tif" else []
    folder.mkdir()
    for number, image in zip(numbers or range(1, len(images) + 1), images, strict=True):
        ok, data = cv2.imencode(suffix, image, options)
        assert ok
        (folder / (name.format(number) + suffix)).write_bytes(data.tobytes())
    return folder


def write_stack(path, images, **options):
    """A TIFF file with one page for each image."""
    with tifffile.TiffWriter(path) as file:
        for image in images:
            file.write(image, photometric=options.get("photometric", "minisblack"), contiguous=False)
    return path


def write_gif(path, images, rate=50):
    """An animated GIF."""
    return write(path, images, codec="gif", pixel_format="gray", rate=rate)


DEEP = {"png folder 16": 16, "tiff stack 16": 16, "mraw 10": 10, "mraw 12": 12, "mraw 16": 12, "cine 12": 12}
DEEP |= {"cine 14 in 16": 14, "tiff stack 12 in 16": 12, "ffv1 12": 12}
WRITERS = {
    "mjpeg avi": lambda d, i: write(d / "a.avi", i),
    "mjpeg mkv": lambda d, i: write(d / "a.mkv", i),
    "mjpeg mov": lambda d, i: write(d / "a.mov", i),
    "ffv1 avi": lambda d, i: write(d / "a.avi", i, codec="ffv1"),
    "ffv1 mkv": lambda d, i: write(d / "a.mkv", i, codec="ffv1"),
    "ffv1 12": lambda d, i: write(d / "a.mkv", i, codec="ffv1", pixel_format="gray12le"),
    "h264 mp4": lambda d, i: write(d / "a.mp4", i, codec="libx264"),
    "h264 mkv": lambda d, i: write(d / "a.mkv", i, codec="libx264"),
    "mpeg4 mp4": lambda d, i: write(d / "a.mp4", i, codec="mpeg4"),
    "mpeg4 mov": lambda d, i: write(d / "a.mov", i, codec="mpeg4"),
    "gif": lambda d, i: write_gif(d / "a.gif", i),
    "png folder": lambda d, i: write_folder(d / "a", i, ".png"),
    "png folder 16": lambda d, i: write_folder(d / "a", i, ".png"),
    "bmp folder": lambda d, i: write_folder(d / "a", i, ".bmp"),
    "jpg folder": lambda d, i: write_folder(d / "a", i, ".jpg"),
    "tif folder": lambda d, i: write_folder(d / "a", i, ".tif"),
    "tiff stack": lambda d, i: write_stack(d / "a.tif", i),
    "tiff stack 16": lambda d, i: write_stack(d / "a.tif", i),
    "tiff stack 12 in 16": lambda d, i: write_stack(d / "a.tif", i),
    "mraw 8": lambda d, i: write_photron(d / "a.cih", i, bits=8),
    "mraw 10": lambda d, i: write_photron(d / "a.cih", i, bits=10),
    "mraw 12": lambda d, i: write_photron(d / "a.cihx", i, bits=12),
    "mraw 16": lambda d, i: write_photron(d / "a.cihx", i, bits=16, depth=12),
    "cine 8": lambda d, i: write_cine(d / "a.cine", i, bits=8),
    "cine 12": lambda d, i: write_cine(d / "a.cine", i, bits=12, packing=0x400),
    "cine 14 in 16": lambda d, i: write_cine(d / "a.cine", i, bits=16, depth=14),
}
LOSSY = {"jpg folder", *(case for case in WRITERS if case.split()[0] in ("mjpeg", "h264", "mpeg4"))}


def images_for(case, n=20, **size):
    """Images with the bit depth of the case."""
    return images(n, depth=DEEP.get(case, 8), **size)


def read(path, opened=open_recording):
    """All frames of a recording, and its properties."""
    source = opened(path)
    try:
        return list(source.frames()), source.info
    finally:
        source.close()


def time_axis_of(path, user_fps=None):
    """The time axis of a recording, and the times of its frames in the order of decoding."""
    source = open_recording(path)
    stamps, info = source.stamps(), source.info
    source.close()
    return resolve_time_axis(
        stamps,
        time_base=info.time_base,
        container_rate=info.container_rate,
        header_rate=info.header_rate,
        user_fps=user_fps,
    )


def announced_png(width, height, pixels=bytes(1_000_000)):
    """Bytes of a black image whose file is small, whatever size it announces."""

    def chunk(name, data):
        return len(data).to_bytes(4, "big") + name + data + zlib.crc32(name + data).to_bytes(4, "big")

    head = width.to_bytes(4, "big") + height.to_bytes(4, "big") + b"\x08\x00\x00\x00\x00"
    parts = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(pixels)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + parts
