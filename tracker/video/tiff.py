"""TIFF files as recordings: one page per frame, read page by page."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from tracker.arrays import GrayImage
from tracker.video.photron import HEADER_SUFFIXES, with_companion, with_header_beside
from tracker.video.source import TUNING as LIMITS
from tracker.video.source import (
    Frame,
    FrameSource,
    Reader,
    SourceInfo,
    UnreadableVideoError,
    check_image_size,
    check_regular_file,
    luma_16,
    read_head,
    unreadable,
)

TIFF_SUFFIXES = (".tif", ".tiff")
TIFF_MAGICS = (b"II*\x00", b"MM\x00*", b"II+\x00", b"MM\x00+")
# Raised by tifffile and its decoders on damaged files and unsupported compressions.
DAMAGE = (
    tifffile.TiffFileError,
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    OSError,
    struct.error,
    RuntimeError,
)
MINISWHITE, LOSSY_COMPRESSIONS = 0, (6, 7, 34892, 33007)


def is_tiff(head: bytes) -> bool:
    """Whether a file with these first bytes is a TIFF or BigTIFF."""
    return head.startswith(TIFF_MAGICS)


def is_stack(path: Path) -> bool:
    """Whether a TIFF holds more than one image; False where this cannot be determined."""
    try:
        check_regular_file(path)
        if not is_tiff(read_head(path, 4)):
            return False
        with tifffile.TiffFile(path) as file:
            return bool(file.pages.is_multipage) or _images_without_pages(file) > 1
    except (UnreadableVideoError, *DAMAGE):
        return False


class TiffSource:
    """A TIFF as a `tracker.video.source.FrameSource`, of gray or RGB pixels of 8 to 16 bit.

    Pages are read one by one. ImageJ files that announce more images than they have pages store the others directly
    after the first. A damaged page is a frame without image.
    """

    def __init__(self, path: Path) -> None:
        check_regular_file(path)
        head = read_head(path, 4)
        if not is_tiff(head):
            raise unreadable(path, f"not a TIFF (it begins with {head!r}); give it the correct ending")
        self._path = path
        try:
            self._file = tifffile.TiffFile(path)
        except DAMAGE as error:
            raise unreadable(path, f"damaged at its start ({error}); export it again") from error
        try:
            self._page = self._first_page()
            self._announced = _images_without_pages(self._file)
            self._without_pages = min(self._announced, self._held()) if self._announced else 0
            self._file.pages.cache = False  # memory must not grow with the number of pages
            self.info = self._source_info()
        except DAMAGE as error:
            self._file.close()
            if isinstance(error, UnreadableVideoError):
                raise
            raise unreadable(path, f"its first page is damaged ({error}); export it again") from error

    def close(self) -> None:
        """Release the file."""
        self._file.close()

    def stamps(self) -> list[int | None]:
        """Index of each image."""
        return list(range(self._without_pages or sum(1 for _ in self._pages())))

    def frames(self) -> Iterator[Frame]:
        """One frame per page."""
        if self._without_pages:
            for k in range(self._without_pages):
                yield Frame(self._image_after_first(k), k)
            return
        for k, page in enumerate(self._pages()):
            yield Frame(self._image(page, k), k)

    def frame_at(self, pts: int) -> GrayImage | None:
        """The image with one of the `stamps`; None if it is damaged."""
        if self._without_pages:
            return self._image_after_first(pts)
        page = next(itertools.islice(self._pages(), pts, None), None)
        return None if page is None else self._image(page, pts)

    def _first_page(self) -> Any:
        page = self._file.pages.first
        check_image_size(self._path, int(page.imagewidth), int(page.imagelength))
        samples, bits = int(page.samplesperpixel), page.bitspersample
        kind = page.dtype.kind if page.dtype is not None else "?"
        depths = range(8, 17) if samples == 1 else (8, 16)
        if kind != "u" or bits not in depths or samples not in (1, 3, 4):
            raise unreadable(
                self._path,
                f"pixels of {samples} x {bits} bit ({page.dtype}) are not supported; "
                "save as gray of 8 to 16 bit",
            )
        if int(page.imagedepth) != 1:
            raise unreadable(
                self._path, f"its pages are volumes of {page.imagedepth} images; save one image a page"
            )
        try:
            page.asarray()
        except DAMAGE as error:
            compression = getattr(page.compression, "name", page.compression)
            raise unreadable(
                self._path,
                f"its first image cannot be read (compression {compression}: {error}); save it without compression, or "
                "install the codecs: pip install imagecodecs",
            ) from error
        return page

    def _held(self) -> int:
        """Number of images after the start of the first one that the file has bytes for, an incomplete one included."""
        page = self._page
        return -(-(self._file.filehandle.size - int(page.dataoffsets[0])) // int(page.nbytes))

    def _source_info(self) -> SourceInfo:
        page = self._page
        gray = int(page.samplesperpixel) == 1
        depth = int(page.bitspersample) if gray else 16
        return SourceInfo(
            codec="tiff",
            pixel_format=f"gray{page.bitspersample}" if gray else f"rgb{3 * int(page.bitspersample)}",
            width_px=int(page.imagewidth),
            height_px=int(page.imagelength),
            bit_depth=depth,
            white_level=(1 << depth) - 1,
            frames_declared=self._announced,
            lossy=int(page.compression) in LOSSY_COMPRESSIONS,
        )

    def _pages(self) -> Iterator[Any]:
        """Pages one by one, without thumbnails; the chain ends where it is damaged."""
        visited: set[int] = set()
        for k in range(LIMITS.max_frames):
            try:
                page: Any = self._file.pages[k]
                small = bool(page.is_reduced)
            except DAMAGE:
                return
            if page.offset in visited:
                return  # a damaged chain may loop
            visited.add(page.offset)
            if not small:
                yield page

    def _image(self, page: Any, k: int) -> GrayImage | None:
        first = self._page
        if (page.imagewidth, page.imagelength) != (first.imagewidth, first.imagelength):
            raise unreadable(
                self._path,
                f"the image changes from {first.imagewidth} x {first.imagelength} to "
                f"{page.imagewidth} x {page.imagelength} px at page {k}; split the file there",
            )
        if (page.samplesperpixel, page.bitspersample) != (first.samplesperpixel, first.bitspersample):
            raise unreadable(self._path, f"the pixel format changes at page {k}; split the file there")
        try:
            return self._gray(page.asarray())
        except DAMAGE:
            return None

    def _image_after_first(self, k: int) -> GrayImage | None:
        page = self._page
        size = int(page.nbytes)
        handle = self._file.filehandle
        try:
            handle.seek(int(page.dataoffsets[0]) + k * size)
            data = handle.read(size)
            if len(data) < size:
                return None
            words = np.frombuffer(data, dtype=page.dtype.newbyteorder(self._file.byteorder))
            return self._gray(words.reshape(page.shape))
        except DAMAGE:
            return None

    def _gray(self, pixels: Any) -> GrayImage | None:
        page = self._page
        if int(page.samplesperpixel) > 1:
            if pixels.ndim != 3:
                return None
            channels = pixels if pixels.shape[-1] in (3, 4) else np.moveaxis(pixels, 0, -1)
            return luma_16(channels[..., :3], deep=int(page.bitspersample) > 8)
        image = pixels.reshape(int(page.imagelength), int(page.imagewidth))
        if int(page.photometric) == MINISWHITE:
            image = self.info.white_level - image
        if self.info.bit_depth == 8:
            return np.asarray(image, dtype=np.uint8)
        return np.asarray(image, dtype=np.uint16)


def _images_without_pages(file: tifffile.TiffFile) -> int:
    """Number of images that ImageJ announces, where only the first has a page; 0 for other files."""
    metadata = file.imagej_metadata if file.is_imagej else None
    announced = int((metadata or {}).get("images", 0))
    if announced < 2 or file.pages.is_multipage or int(file.pages.first.compression) != 1:
        return 0
    return min(announced, LIMITS.max_frames)


class TiffReader(Reader):
    """TIFF stacks; whether a TIFF is one, only its content shows (`is_stack`)."""

    name = "tiff"

    def recognises(self, path: Path, head: bytes) -> bool:  # noqa: ARG002 - the content decides
        """By the first bytes."""
        return is_tiff(head)

    def open(self, path: Path) -> FrameSource:
        """Open a TIFF, with the rate of a camera header in the same folder."""
        return with_header_beside(TiffSource(path), path)

    def files(self, path: Path) -> tuple[Path, ...]:
        """The TIFF and a camera header in the same folder."""
        return with_companion(path, HEADER_SUFFIXES)


TIFF = TiffReader()
