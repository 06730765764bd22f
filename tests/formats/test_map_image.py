"""Image decoding. Oracles: encoders written here from the formats' specifications, and the pixels that went in."""

import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from robocar.core import MapFormatError
from robocar.formats.image import read_image


def png(rows, colour, depth, width, *, extra=b""):
    """A PNG of packed `rows` (bytes each), filter type 0."""

    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, len(rows), depth, colour, 0, 0, 0)
    pixels = zlib.compress(b"".join(b"\0" + row for row in rows))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + extra + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def png_chunk(kind, body):
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png_of(pixels):
    """8- or 16-bit PNG of (rows, cols, channels)."""
    colour = {1: 0, 2: 4, 3: 2, 4: 6}[pixels.shape[2]]
    depth = 8 * pixels.dtype.itemsize
    rows = [row.astype(pixels.dtype.newbyteorder(">")).tobytes() for row in pixels]
    return png(rows, colour, depth, pixels.shape[1])


def bmp_of(pixels, top_down=False):
    """24-bit (rows, cols, 3) RGB or 32-bit (rows, cols, 4) RGB + padding, as Windows bitmap."""
    rows, cols, channels = pixels.shape
    stored = pixels if top_down else pixels[::-1]
    body = b""
    for row in stored:
        line = np.concatenate([row[:, 2::-1], row[:, 3:]], axis=1).tobytes()
        body += line + b"\0" * (-len(line) % 4)
    info = struct.pack("<IiiHHIIiiII", 40, cols, -rows if top_down else rows, 1, 8 * channels, 0, len(body), 0, 0, 0, 0)
    return b"BM" + struct.pack("<IHHI", 54 + len(body), 0, 0, 54) + info + body


def read(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("image") / "image"
    path.write_bytes(content)
    return read_image(path)


shapes = array_shapes(min_dims=2, max_dims=2, max_side=9)


@settings(deadline=None)
@given(
    st.integers(1, 65535).flatmap(
        lambda white: st.tuples(st.just(white), arrays(np.uint16, shapes, elements=st.integers(0, white)))
    ),
    st.sampled_from([b"\n", b"\r\n", b" ", b"\n# a comment 7 8 9\n", b"\t#\n#\n "]),
    st.booleans(),
)
def test_pgm_of_any_depth_with_comments(tmp_path_factory, image, separator, plain):
    """Every sample comes back, P2 and P5, with comments and any white space in the header."""
    white, pixels = image
    rows, cols = pixels.shape
    header = separator.join([b"P2" if plain else b"P5", b"%d" % cols, b"%d" % rows, b"%d" % white])
    if plain:
        body = b"\n" + b"\n".join(b" ".join(b"%d" % v for v in row) + b" # end of row 1" for row in pixels)
    else:
        body = b"\n" + pixels.astype(np.uint8 if white < 256 else ">u2").tobytes()
    found = read(tmp_path_factory, header + body)
    np.testing.assert_array_equal(found.levels, pixels)
    assert found.white == white
    assert found.transparent is None


def test_binary_pgm_with_crlf_header(tmp_path_factory):
    """A raster whose first byte is itself a line feed must not lose it."""
    pixels = bytes([10, 13, 200, 0])
    for newline in (b"\n", b"\r\n"):
        found = read(tmp_path_factory, newline.join([b"P5", b"2 2", b"255", b""]) + pixels)
        assert found.levels.ravel().tolist() == list(pixels)


@settings(deadline=None)
@given(
    st.sampled_from([np.uint8, np.uint16]).flatmap(
        lambda dtype: st.integers(1, 4).flatmap(
            lambda channels: arrays(dtype, st.tuples(*[st.integers(1, 7)] * 2, st.just(channels)))
        )
    )
)
def test_png_of_every_colour_type(tmp_path_factory, pixels):
    """Grey, grey + alpha, RGB and RGBA, 8 and 16 bits: mean of the colours, and which pixels are not opaque."""
    found = read(tmp_path_factory, png_of(pixels))
    channels = pixels.shape[2]
    colours = pixels[..., : 1 if channels < 3 else 3].astype(float)
    largest = np.iinfo(pixels.dtype).max
    np.testing.assert_allclose(found.levels / found.white, colours.mean(axis=2) / largest, rtol=0, atol=1e-12)
    expected = pixels[..., -1] < largest if channels in (2, 4) else np.zeros(pixels.shape[:2], bool)
    transparent = np.zeros(pixels.shape[:2], bool) if found.transparent is None else found.transparent
    np.testing.assert_array_equal(transparent, expected)


def test_png_with_palette_bits_and_a_transparent_colour(tmp_path_factory):
    palette = png_chunk(b"PLTE", bytes([0, 0, 0, 30, 60, 90, 255, 255, 255]))
    found = read(tmp_path_factory, png([bytes([0, 1, 2])], 3, 8, 3, extra=palette))
    np.testing.assert_allclose(found.levels[0] / found.white, [0, 60 / 255, 1])
    found = read(tmp_path_factory, png([bytes([0, 1, 2])], 3, 8, 3, extra=palette + png_chunk(b"tRNS", bytes([255, 128]))))
    assert found.transparent is not None
    assert found.transparent.tolist() == [[False, True, False]]
    found = read(tmp_path_factory, png([bytes([0b10100000])], 0, 1, 3))
    np.testing.assert_allclose(found.levels[0] / found.white, [1, 0, 1])
    found = read(tmp_path_factory, png([bytes([0x0F, 0x30])], 0, 4, 3, extra=png_chunk(b"tRNS", b"\0\x0f")))
    np.testing.assert_allclose(found.levels[0] / found.white, [0, 1, 0.2])
    assert found.transparent is not None
    assert found.transparent.tolist() == [[False, True, False]]
    found = read(tmp_path_factory, png([bytes([1, 2, 3, 3, 2, 1])], 2, 8, 2, extra=png_chunk(b"tRNS", bytes([0, 1, 0, 2, 0, 3]))))
    assert found.transparent is not None
    assert found.transparent.tolist() == [[True, False]]


@settings(deadline=None)
@given(arrays(np.uint8, st.tuples(*[st.integers(1, 7)] * 2, st.sampled_from([3, 4]))), st.booleans())
def test_bmp_either_way_up(tmp_path_factory, pixels, top_down):
    """Rows are padded to four bytes; the fourth byte of a 32-bit pixel without masks is no alpha."""
    found = read(tmp_path_factory, bmp_of(pixels, top_down))
    np.testing.assert_allclose(found.levels / found.white, pixels[..., :3].mean(axis=2) / 255, rtol=0, atol=1e-12)
    assert found.transparent is None


PIXELS = (np.arange(7 * 5 * 3) * 37 % 256).astype(np.uint8).reshape(7, 5, 3)
PGM = b"P5\n# comment\n5 7\n255\n" + PIXELS[..., 0].tobytes()


@pytest.mark.parametrize(
    "content", [PGM, png_of(PIXELS), png_of(PIXELS.astype(np.uint16)), bmp_of(PIXELS)], ids=["pgm", "png8", "png16", "bmp"]
)
def test_every_truncation_is_refused_in_one_line(tmp_path, capfd, content):
    """Each proper prefix of a good file is an error of ours, and nothing else is printed."""
    path = tmp_path / "image"
    path.write_bytes(content)
    assert read_image(path).levels.shape == (7, 5)
    for length in range(len(content)):
        path.write_bytes(content[:length])
        with pytest.raises(MapFormatError) as caught:
            read_image(path)
        assert str(caught.value).startswith(f"{path}: ")
        assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_damaged_png_is_refused_by_its_checksums(tmp_path):
    content = bytearray(png_of(PIXELS))
    content[60] ^= 0xFF
    path = tmp_path / "image.png"
    path.write_bytes(content)
    with pytest.raises(MapFormatError, match=r"image\.png: damaged PNG, wrong checksum in chunk IDAT"):
        read_image(path)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", ["empty", "PGM", "PNG", "BMP"]),
        (b"hello, I am no image", ["hello", "not an image"]),
        (b"P7\n1 1\n255\n\0\0\0", ["P7", "not an image"]),
        (b"P5\n0 4\n255\n", ["width", "positive", "'0'"]),
        (b"P5\n4 -4\n255\n", ["height", "positive", "'-4'"]),
        (b"P5\n4 x\n255\n", ["height", "'x'"]),
        (b"P5\n1 1\n0\n\0", ["maxval", "65535", "'0'"]),
        (b"P5\n1 1\n65536\n\0\0", ["maxval", "65535", "'65536'"]),
        (b"P5\n1 1", ["maxval", "missing"]),
        (b"P5\n1 1\n100\n\xff", ["255", "maxval 100"]),
        (b"P5\n100000 100000\n255\n", ["100000 x 100000 cells", "at most"]),
        (b"P2\n2 1\n255\n7 x", ["'x'", "integer"]),
        (b"P2\n2 1\n255\n7 -1", ["'-1'", "integer"]),
        (b"P2\n2 1\n255\n7 256", ["256", "maxval 255"]),
        (b"P2\n2 1\n255\n7", ["truncated", "2 pixels", "1"]),
        (b"P2\n2 1\n255\n7 8 9", ["too many", "2 pixels", "3"]),
        (png([b""], 0, 8, 0), ["PNG", "0 x 1"]),
        (png([b"\0"], 0, 8, 100_000), ["truncated PNG", "100001 bytes", "2"]),
        (png([b"\0"], 0, 8, 2**31 - 1), ["2147483647 x 1 cells", "at most"]),
        (bmp_of(PIXELS)[:18] + struct.pack("<ii", 0, 5) + bmp_of(PIXELS)[26:], ["BMP", "0 x 5"]),
        (bmp_of(PIXELS)[:18] + struct.pack("<ii", 2**30, 5) + bmp_of(PIXELS)[26:], ["1073741824 x 5 cells"]),
    ],
)
def test_what_is_wrong_with_an_image_is_said(tmp_path, capfd, content, words):
    path = tmp_path / "image.pgm"
    path.write_bytes(content)
    with pytest.raises(MapFormatError) as caught:
        read_image(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert [word for word in words if word not in message] == []
    assert "\n" not in message
    assert capfd.readouterr() == ("", "")


def test_a_missing_image_is_named(tmp_path):
    with pytest.raises(MapFormatError, match=r"gone\.pgm: no such file"):
        read_image(tmp_path / "gone.pgm")
