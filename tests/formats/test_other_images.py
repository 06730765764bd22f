"""Images besides PGM, PNG and BMP. Oracle: OpenCV writes them, or bytes by hand; the same drawing in every lossless format."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from robocar.core import MapFormatError
from robocar.formats import check_file, load_map

DRAWING = np.array([[0, 254, 254], [205, 254, 0]], np.uint8)
OCCUPANCY = [[-1, 0, 100], [100, 0, 0]]  # upside down


def encoded(ending: str, pixels: np.ndarray = DRAWING, *options: int) -> bytes:
    done, data = cv2.imencode(ending, pixels, list(options))
    assert done
    return data.tobytes()


def gif(order: bytes = b"GIF89a") -> bytes:
    """Three colours, 3 x 2 pixels, with the codes of LZW each in 3 bits and a clear before the table grows."""
    palette = bytes([0, 0, 0, 205, 205, 205, 254, 254, 254, 0, 0, 0])
    codes = [4, 0, 2, 4, 2, 1, 4, 2, 0, 5]
    bits = sum(code << 3 * k for k, code in enumerate(codes))
    data = bits.to_bytes(4, "little")
    head = order + struct.pack("<HHBBB", 3, 2, 0b10000001, 0, 0) + palette
    return head + b"," + struct.pack("<HHHHB", 0, 0, 3, 2, 0) + b"\x02" + bytes([len(data)]) + data + b"\0;"


FILES = {
    "a.tif": encoded(".tiff"),
    "a.tiff": encoded(".tiff", cv2.cvtColor(DRAWING, cv2.COLOR_GRAY2BGR), cv2.IMWRITE_TIFF_COMPRESSION, 8),
    "big_endian.tif": b"MM\0*\0\0\0\x08\0\x08"
    + b"".join(
        struct.pack(">HHIHH", tag, 3, 1, value, 0) if kind == 3 else struct.pack(">HHII", tag, 4, 1, value)
        for tag, kind, value in (
            *((256, 3, 3), (257, 3, 2), (258, 3, 8), (259, 3, 1), (262, 3, 1)),
            *((273, 4, 110), (278, 3, 2), (279, 4, 6)),
        )
    )
    + b"\0\0\0\0"
    + DRAWING.tobytes(),
    "a.webp": encoded(".webp", DRAWING, cv2.IMWRITE_WEBP_QUALITY, 101),
    "a.gif": gif(),
    "a.ppm": encoded(".ppm", cv2.cvtColor(DRAWING, cv2.COLOR_GRAY2BGR)),
    "plain.ppm": b"P3 3 2 255 " + b" ".join(b"%d %d %d" % (v, v, v) for v in DRAWING.ravel().tolist()),
    "a": encoded(".tiff"),
}


@pytest.mark.parametrize("name", FILES)
def test_lossless_images_are_maps(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(FILES[name])
    assert load_map(path, 0.1).data.tolist() == OCCUPANCY


@pytest.mark.parametrize("content", [b"P4 9 2\n\x80\x80\x00\x00", b"P1\n# drawn\n9 2\n100000001\n0 0 0 0 0 0 0 0 0\n"])
def test_bit_maps(content: bytes, tmp_path: Path) -> None:
    """Oracle: 1 is black, which is a wall."""
    path = tmp_path / "a.pbm"
    path.write_bytes(content)
    assert load_map(path, 0.1).data.tolist() == [[0] * 9, [100, *[0] * 7, 100]]


@pytest.mark.parametrize("name", ["a.jpg", "a.webp", "a.png"])
def test_images_with_loss_are_refused_whatever_they_are_called(name: str, tmp_path: Path) -> None:
    for content, kind in ((encoded(".jpg"), "JPEG"), (encoded(".webp", DRAWING, cv2.IMWRITE_WEBP_QUALITY, 80), "WebP")):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(MapFormatError, match=f"{kind} keeps grey levels with loss.*as PNG"):
            load_map(path, 0.1)


@pytest.mark.parametrize("name", FILES)
def test_truncated_and_damaged_images_are_refused_or_read(name: str, tmp_path: Path) -> None:
    """Property: `MapFormatError` or a map, for every cut; none for what cannot be complete."""
    path = tmp_path / name
    for end in range(len(FILES[name])):
        path.write_bytes(FILES[name][:end])
        try:
            grid = load_map(path, 0.1)
        except MapFormatError:
            continue
        assert grid.shape == (2, 3)
        assert end > 20


def test_a_drawing_on_transparent_ground_says_so(tmp_path: Path) -> None:
    """Oracle: 11 of 12 pixels are not opaque."""
    pixels = np.zeros((3, 4, 4), np.uint8)
    pixels[0, 0] = (0, 0, 0, 255)
    path = tmp_path / "a.png"
    path.write_bytes(encoded(".png", pixels))
    assert "warning: 91.7% of the pixels are not opaque and become unknown" in str(check_file(path, 0.1))
    notes: list[str] = []
    load_map(path, 0.1, notes)
    assert len(notes) == 1
