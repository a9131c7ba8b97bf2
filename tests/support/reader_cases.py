"""One recording of every supported format, from the same images."""

from support import camera_files as files
from support import tracker_media as media

DEEP = {"png folder 16": 16, "tiff stack 16": 16, "mraw 10": 10, "mraw 12": 12, "mraw 16": 12, "cine 12": 12}
DEEP |= {"cine 14 in 16": 14, "tiff stack 12 in 16": 12, "ffv1 12": 12}
LOSSY = {"mjpeg avi", "h264 mp4", "mpeg4 mov", "jpg folder"}

WRITERS = {
    "mjpeg avi": lambda d, i: media.write(d / "a.avi", i),
    "ffv1 mkv": lambda d, i: media.write(d / "a.mkv", i, codec="ffv1"),
    "ffv1 12": lambda d, i: media.write(d / "a.mkv", i, codec="ffv1", pixel_format="gray12le"),
    "h264 mp4": lambda d, i: media.write(d / "a.mp4", i, codec="libx264"),
    "mpeg4 mov": lambda d, i: media.write(d / "a.mov", i, codec="mpeg4"),
    "gif": lambda d, i: files.write_gif(d / "a.gif", i),
    "png folder": lambda d, i: files.write_folder(d / "a", i, ".png"),
    "png folder 16": lambda d, i: files.write_folder(d / "a", i, ".png"),
    "bmp folder": lambda d, i: files.write_folder(d / "a", i, ".bmp"),
    "jpg folder": lambda d, i: files.write_folder(d / "a", i, ".jpg"),
    "tif folder": lambda d, i: files.write_folder(d / "a", i, ".tif"),
    "tiff stack": lambda d, i: files.write_stack(d / "a.tif", i),
    "tiff stack 16": lambda d, i: files.write_stack(d / "a.tif", i),
    "tiff stack 12 in 16": lambda d, i: files.write_stack(d / "a.tif", i),
    "mraw 8": lambda d, i: files.write_photron(d / "a.cih", i, bits=8),
    "mraw 10": lambda d, i: files.write_photron(d / "a.cih", i, bits=10),
    "mraw 12": lambda d, i: files.write_photron(d / "a.cihx", i, bits=12),
    "mraw 16": lambda d, i: files.write_photron(d / "a.cihx", i, bits=16, depth=12),
    "cine 8": lambda d, i: files.write_cine(d / "a.cine", i, bits=8),
    "cine 12": lambda d, i: files.write_cine(d / "a.cine", i, bits=12, packing=0x400),
    "cine 14 in 16": lambda d, i: files.write_cine(d / "a.cine", i, bits=16, depth=14),
}


def images_for(case, n=20, **size):
    """Images with the bit depth of the case."""
    return media.images(n, depth=DEEP.get(case, 8), **size)
