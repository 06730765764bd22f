"""Grey levels of map images: PGM, PPM and PBM (up to 16 bits), PNG, BMP, GIF, and lossless TIFF and WebP.

Netpbm's are read here, because OpenCV does not scale binary samples by the header's `maxval`. The others are decoded by OpenCV
after their structure has been checked: about a broken file it would write to stderr, and not say what is wrong.
"""

from __future__ import annotations

import re
import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robocar.core import MapFormatError
from robocar.core.text import shown
from robocar.formats.files import check_cells
from robocar.formats.image_headers import image_kind, lossy, size_of
from robocar.reading import PathLike, read_bytes

IMAGE_KINDS = "PGM, PPM, PBM, PNG, BMP, GIF, or lossless TIFF or WebP"
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_TOKEN = re.compile(rb"(?:\s|#[^\r\n]*+)*+([^\s#]+)")
_NO_SAMPLE = re.compile(rb"\S*[^\s0-9]\S*|[0-9]{10,}")
_COMMENT = re.compile(rb"#[^\r\n]*+")


@dataclass(frozen=True, slots=True, eq=False)
class GreyImage:
    """Brightness of the pixels, row 0 at the top.

    Args:
        levels: sum of the colour channels, (rows, cols), 0 is black.
        white: the level of a white pixel.
        transparent: pixels that are not fully opaque, (rows, cols), or None where the image has no alpha channel.
    """

    levels: NDArray
    white: int
    transparent: NDArray[np.bool_] | None = None


def read_image(path: PathLike) -> GreyImage:
    """Read an image, told apart by content; of several pictures in it the first.

    Colour channels are averaged with equal weights, as map_server does.

    Raises:
        MapFormatError: missing, empty, truncated or damaged; no image, or one of another kind; kept with loss; too large.
    """
    data = read_bytes(path)
    kind = image_kind(data[:16])
    if kind == "PNM":
        return _read_pnm(data, path)
    if kind == "PNG":
        return _read_png(data, path)
    if kind == "BMP":
        return _read_bmp(data, path)
    if kind == "JPEG":
        raise lossy(path, kind)
    if kind is not None:
        rows, cols = size_of(data, kind, path)
        check_cells(path, rows, cols)
        return _grey(_decode(data, path, rows, cols), path)
    what = "is empty" if not data else f"begins with {data[:8]!r}"
    raise MapFormatError(f"{path}: {what}; not an image that can be read: {IMAGE_KINDS}")


def _read_pnm(data: bytes, path: PathLike) -> GreyImage:
    """Netpbm's bit, grey and pixel maps: https://netpbm.sourceforge.net/doc/pnm.html"""
    kind = {b"P1": "PBM", b"P4": "PBM", b"P2": "PGM", b"P5": "PGM"}.get(data[:2], "PPM")
    position = 2
    header = []
    for field, largest in (("width", None), ("height", None), ("maxval", 65535))[: 2 if kind == "PBM" else 3]:
        match = _TOKEN.match(data, position)
        if match is None:
            raise MapFormatError(f"{path}: truncated {kind} header, {field} is missing")
        token = match[1]
        if not token.isdigit() or len(token) > 9 or int(token) < 1 or (largest is not None and int(token) > largest):
            valid = f"an integer from 1 to {largest}" if largest else "a positive integer"
            raise MapFormatError(f"{path}: {kind} {field} must be {valid}, not {token[:20].decode('latin-1')!r}")
        header.append(int(token))
        position = match.end()
    cols, rows, white = [*header, 1][:3]
    check_cells(path, rows, cols)
    channels = 3 if kind == "PPM" else 1
    if data[:2] == b"P4":
        return GreyImage(1 - _bits(data, position + 1, rows, cols, path), 1)
    if data[:2] == b"P1":  # whose digits need no blanks between them
        data, position = b" ".join(bytes([c]) for c in _COMMENT.sub(b" ", data[position:]) if not chr(c).isspace()), 0
    read_samples = _plain_samples if data[:2] in (b"P2", b"P3") or kind == "PBM" else _binary_samples
    levels = read_samples(data, position, rows * cols * channels, white, path)
    if levels.max() > white:
        raise MapFormatError(f"{path}: {kind} sample {levels.max()} is above the header's maxval {white}")
    if kind == "PBM":
        return GreyImage(1 - levels.reshape(rows, cols), 1)
    if channels == 3:
        return GreyImage(levels.reshape(rows, cols, 3).sum(axis=-1, dtype=np.uint32), 3 * white)
    return GreyImage(levels.reshape(rows, cols), white)


def _bits(data: bytes, start: int, rows: int, cols: int, path: PathLike) -> NDArray[np.uint8]:
    """Pixels of one bit, each row in whole bytes."""
    width = (cols + 7) // 8
    if len(data) - start < rows * width:
        raise MapFormatError(f"{path}: truncated PBM, the header announces {rows * width} bytes of pixels")
    packed = np.frombuffer(data, np.uint8, rows * width, start).reshape(rows, width)
    return np.unpackbits(packed, axis=1, count=cols)


def _binary_samples(data: bytes, position: int, count: int, white: int, path: PathLike) -> NDArray:
    dtype = np.dtype(np.uint8 if white < 256 else ">u2")
    start = position + 1
    needed = count * dtype.itemsize
    # The raster begins after one white-space byte; a header with CRLF line ends has two, and only then one byte is left over.
    if data[position : position + 2] == b"\r\n" and len(data) - start == needed + 1:
        start += 1
    if len(data) - start < needed:
        raise MapFormatError(
            f"{path}: truncated PGM, the header announces {needed} bytes of pixels, the file has {max(0, len(data) - start)}"
        )
    return np.frombuffer(data, dtype, count, start).astype(dtype.newbyteorder("="))


def _plain_samples(data: bytes, position: int, count: int, white: int, path: PathLike) -> NDArray:
    text = _COMMENT.sub(b" ", data[position:])
    if bad := _NO_SAMPLE.search(text):
        what = bad[0][:20].decode("latin-1")
        raise MapFormatError(f"{path}: PGM sample {shown(what)} is not an integer from 0 to {white}")
    samples = np.fromstring(text, dtype=np.int64, sep=" ") if text.strip() else np.empty(0, np.int64)  # no list of as many texts
    if samples.size != count:
        state = "truncated PGM" if samples.size < count else "PGM with too many pixels"
        raise MapFormatError(f"{path}: {state}, the header announces {count} pixels, the file has {samples.size}")
    return samples.astype(np.uint32)


def _read_png(data: bytes, path: PathLike) -> GreyImage:
    """PNG, third edition: https://www.w3.org/TR/png-3/"""
    chunks: dict[bytes, bytes] = {}
    position = len(_PNG_SIGNATURE)
    while b"IEND" not in chunks:
        if position + 12 > len(data):
            raise MapFormatError(f"{path}: truncated PNG, the file ends after {len(data)} bytes without an IEND chunk")
        length, kind = struct.unpack_from(">I4s", data, position)
        name = kind.decode() if kind.isalpha() else repr(kind)
        body = data[position + 8 : position + 8 + length]
        if position + 12 + length > len(data):
            raise MapFormatError(f"{path}: truncated PNG, chunk {name} is cut off")
        if zlib.crc32(kind + body) != struct.unpack_from(">I", data, position + 8 + length)[0]:
            raise MapFormatError(f"{path}: damaged PNG, wrong checksum in chunk {name}")
        chunks[kind] = chunks.get(kind, b"") + body
        position += 12 + length
    if len(chunks.get(b"IHDR", b"")) != 13:
        raise MapFormatError(f"{path}: damaged PNG, no valid IHDR chunk")
    cols, rows, depth, colour, compression, filtering, interlace = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
    if rows < 1 or cols < 1 or depth not in _PNG_DEPTHS.get(colour, ()) or (compression, filtering) != (0, 0) or interlace > 1:
        raise MapFormatError(f"{path}: damaged PNG, IHDR says {cols} x {rows} pixels, colour type {colour}, {depth} bits")
    check_cells(path, rows, cols)
    needed = rows * (1 + (cols * depth * _PNG_CHANNELS[colour] + 7) // 8)
    try:
        unpacked = len(zlib.decompressobj().decompress(chunks.get(b"IDAT", b""), needed))
    except zlib.error as failure:
        raise MapFormatError(f"{path}: damaged PNG, the pixels cannot be unpacked ({failure})") from failure
    if unpacked < needed and not interlace:
        raise MapFormatError(f"{path}: truncated PNG, {needed} bytes of pixels announced, {unpacked} found")
    pixels = _decode(data, path, rows, cols)
    image = _grey(pixels, path)
    if b"tRNS" in chunks and colour in (0, 2):
        # One colour stands for "transparent"; OpenCV ignores it. Its numbers are in the file's bit depth and in RGB order.
        key = np.frombuffer(chunks[b"tRNS"], ">u2").astype(int) * (255 // (2**depth - 1) if depth < 8 else 1)
        channels = np.atleast_3d(pixels)[..., :3][..., ::-1]
        if key.size == (1 if colour == 0 else 3):
            return GreyImage(image.levels, image.white, np.all(channels == key, axis=-1))
    return image


def _read_bmp(data: bytes, path: PathLike) -> GreyImage:
    """Windows bitmap, with BITMAPCOREHEADER (12 bytes) or BITMAPINFOHEADER and its successors (40 and more)."""
    if len(data) < 26:
        raise MapFormatError(f"{path}: truncated BMP, only {len(data)} bytes")
    offset, header = struct.unpack_from("<II", data, 10)
    if header == 12:
        cols, rows, _, bits = struct.unpack_from("<HHHH", data, 18)
        compression = 0
    elif header >= 40 and len(data) >= 54:
        cols, rows, _, bits, compression = struct.unpack_from("<iiHHI", data, 18)
        rows = abs(rows)  # negative where row 0 is stored first
    else:
        raise MapFormatError(f"{path}: truncated or damaged BMP, header of {header} bytes in a file of {len(data)}")
    if rows < 1 or cols < 1 or bits not in (1, 2, 4, 8, 16, 24, 32) or compression > 3:
        raise MapFormatError(
            f"{path}: damaged or unknown BMP, the header says {cols} x {rows} pixels of {bits} bits, compression {compression}"
        )
    check_cells(path, rows, cols)
    run_length_coded = compression in (1, 2)
    needed = offset + (cols * bits + 31) // 32 * 4 * rows
    if len(data) < needed and not run_length_coded:
        raise MapFormatError(f"{path}: truncated BMP, the header announces {needed} bytes, the file has {len(data)}")
    pixels = _decode(data, path, rows, cols)
    # Without bit masks the fourth byte of a pixel is padding, not alpha.
    return _grey(pixels[..., :3] if compression == 0 and pixels.ndim == 3 else pixels, path)


def _decode(data: bytes, path: PathLike, rows: int, cols: int) -> NDArray:
    import cv2

    logging = cv2.utils.logging
    level = logging.getLogLevel()
    logging.setLogLevel(logging.LOG_LEVEL_SILENT)  # what is wrong is said here, not by codecs on stderr
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as failure:
        raise MapFormatError(f"{path}: the image cannot be decoded ({shown(failure.err)})") from failure
    finally:
        logging.setLogLevel(level)
    if pixels is None or pixels.shape[:2] != (rows, cols):
        raise MapFormatError(f"{path}: the image is damaged or truncated and cannot be decoded")
    return pixels


def _grey(pixels: NDArray, path: PathLike) -> GreyImage:
    largest = int(np.iinfo(pixels.dtype).max) if pixels.dtype.kind in "iu" else 0
    if not np.issubdtype(pixels.dtype, np.unsignedinteger) or largest > 65535:
        raise MapFormatError(f"{path}: pixels of type {pixels.dtype}; a map has levels of 8 or 16 bits")
    if pixels.ndim == 2:
        return GreyImage(pixels, largest)
    levels = pixels[..., :3].sum(axis=-1, dtype=np.uint32)
    transparent = pixels[..., 3] < largest if pixels.shape[-1] == 4 else None
    return GreyImage(levels, 3 * largest, transparent)
