"""What a file looks like by its first bytes: to refuse what is not a video before any decoder sees it."""

from __future__ import annotations

# Leading bytes, and what such a file is; none of these is a recording.
NOT_VIDEO: tuple[tuple[bytes, str], ...] = (
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"\x89PNG\r\n", "a PNG picture"),
    (b"II*\x00", "a TIFF picture"),
    (b"MM\x00*", "a TIFF picture"),
    (b"PK\x03\x04", "a zip archive"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"7z\xbc\xaf", "a 7z archive"),
    (b"Rar!", "a RAR archive"),
    (b"%PDF", "a PDF document"),
    (b"\x93NUMPY", "a NumPy array"),
    (b"\x89HDF\r\n", "an HDF5 file"),
    (b"ffconcat", "a playlist of other files"),
    (b"#EXTM3U", "a playlist of other files"),
    (b"<?xml", "an XML document"),
    (b"\x7fELF", "a program"),
    (b"MZ", "a program"),
)


def looks_like(head: bytes) -> str | None:
    """Name of a kind of file that is no video, or None when `head` may begin one.

    Text is recognised by its bytes: printable ASCII and white space only (at least 16 bytes of it).
    """
    if not head:
        return "an empty file"
    for magic, name in NOT_VIDEO:
        if head.startswith(magic):
            return name
    printable = sum(byte in b"\t\n\r\f" or 32 <= byte < 127 for byte in head)
    if printable == len(head):
        return "a text file"
    return None
