"""Sizes of images as their headers say them, read before anything is decoded: TIFF, WebP and GIF.

Only what is kept without loss is a map: grey levels say what is a wall, and a lossy codec changes them round every edge.
"""

from __future__ import annotations

import struct

from robocar.core import MapFormatError
from robocar.reading import PathLike

SIGNATURES = {
    "PNM": (b"P1", b"P2", b"P3", b"P4", b"P5", b"P6"),
    "PNG": (b"\x89PNG\r\n\x1a\n",),
    "BMP": (b"BM",),
    "GIF": (b"GIF87a", b"GIF89a"),
    "TIFF": (b"II*\0", b"MM\0*"),
    "JPEG": (b"\xff\xd8\xff",),
}
_TIFF_LOSSLESS = (1, 2, 3, 4, 5, 8, 32773, 32946)  # none, CCITT, LZW, Deflate, PackBits
_TIFF_TYPES = {1: "B", 3: "H", 4: "I"}


def image_kind(start: bytes) -> str | None:
    """The kind of an image by its first bytes, None where it is none."""
    if start[:4] == b"RIFF" and start[8:12] == b"WEBP":
        return "WebP"
    return next((kind for kind, signatures in SIGNATURES.items() if start.startswith(signatures)), None)


def size_of(data: bytes, kind: str, path: PathLike) -> tuple[int, int]:
    """(rows, cols) of a TIFF, WebP or GIF.

    Raises:
        MapFormatError: the header is damaged, or the pixels are kept with loss.
    """
    try:
        rows, cols = {"TIFF": _tiff, "WebP": _webp, "GIF": _gif}[kind](data, path)
    except (struct.error, IndexError) as failure:
        raise MapFormatError(f"{path}: truncated or damaged {kind}, its header cannot be read") from failure
    if rows < 1 or cols < 1:
        raise MapFormatError(f"{path}: damaged {kind}, the header says {cols} x {rows} pixels")
    return rows, cols


def lossy(path: PathLike, kind: str) -> MapFormatError:
    """The error about an image whose grey levels are not what was drawn."""
    return MapFormatError(f"{path}: {kind} keeps grey levels with loss, and walls fray: draw or export it anew as PNG")


def _gif(data: bytes, path: PathLike) -> tuple[int, int]:
    cols, rows = struct.unpack_from("<HH", data, 6)
    return rows, cols


def _webp(data: bytes, path: PathLike) -> tuple[int, int]:
    """RFC 9649: `VP8L` is the lossless kind; `VP8X` says the size of what follows in chunks."""
    kind = data[12:16]
    if kind == b"VP8L":
        bits = struct.unpack_from("<I", data, 21)[0]
        return (bits >> 14 & 0x3FFF) + 1, (bits & 0x3FFF) + 1
    if kind == b"VP8X" and b"VP8L" in data[30:100] and not data[20] & 2:
        (low, cols), (more, rows) = struct.unpack_from("<HB", data, 24)[::-1], struct.unpack_from("<HB", data, 27)[::-1]
        return (more << 16 | rows) + 1, (low << 16 | cols) + 1
    raise lossy(path, "WebP" if kind in (b"VP8 ", b"VP8X") else "this WebP")


def _tiff(data: bytes, path: PathLike) -> tuple[int, int]:
    """TIFF 6.0, section 2: the first directory of tags."""
    order = "<" if data[:2] == b"II" else ">"
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, at)
    tags = {}
    for k in range(count):
        tag, kind, _ = struct.unpack_from(f"{order}HHI", data, at + 2 + 12 * k)
        if kind in _TIFF_TYPES:
            tags[tag] = struct.unpack_from(f"{order}{_TIFF_TYPES[kind]}", data, at + 10 + 12 * k)[0]
    if tags.get(259, 1) not in _TIFF_LOSSLESS:
        raise lossy(path, f"TIFF of compression {tags[259]}")
    return tags.get(257, 0), tags.get(256, 0)
