"""Text grids. Oracles: what was drawn."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from robocar.core import SE2, MapFormatError, ParameterError
from robocar.formats import load_text_grid, parse_text_grid

shapes = array_shapes(min_dims=2, max_dims=2, max_side=8)


@given(arrays("U1", shapes, elements=st.sampled_from("#. ?")), st.sampled_from(["\n", "\r\n"]), st.booleans())
def test_what_is_drawn_is_read(cells, newline, end):
    text = newline.join("".join(row) for row in cells) + (newline if end else "")
    drawn = parse_text_grid(text, 0.25)
    value = {"#": 100, ".": 0, " ": 0, "?": -1}
    assert drawn.grid.data.tolist() == [[value[c] for c in row] for row in cells[::-1].tolist()]
    assert (drawn.start, drawn.goal) == (None, None)
    assert drawn.grid.resolution == 0.25


def test_start_and_goal_are_the_centres_of_their_cells(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes(b"####\r\n#.G#\r\n#S.#\r\n####\r\n")
    drawn = load_text_grid(path, 0.5)
    assert drawn.start is not None
    assert drawn.goal is not None
    np.testing.assert_allclose(drawn.start, [0.75, 0.75])
    np.testing.assert_allclose(drawn.goal, [1.25, 1.25])
    assert drawn.grid.free.sum() == 4
    turned = load_text_grid(path, 0.5, SE2(1, 2, np.pi / 2))
    assert turned.goal is not None
    np.testing.assert_allclose(turned.goal, [1 - 1.25, 2 + 1.25])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["line 1"]),
        ("\n\n", ["line 1"]),
        ("\n...\n", ["line 1", "empty"]),
        ("...\n..\n", ["line 2", "2 characters", "3"]),
        ("...\n\n...\n", ["line 2", "0 characters", "3"]),
        ("...\n.x.\n", ["line 2", "column 2", "'x'", "'#'"]),
        ("...\n.\t.\n", ["line 2", "column 2", "'\\t'"]),
        ("...\n.é.\n", ["line 2", "column 2", "'é'"]),
        ("S..\n..S\n", ["line 2", "column 3", "second S"]),
        ("SS.\n", ["line 1", "column 2", "second S"]),
        ("G..\n..G\n", ["line 2", "column 3", "second G"]),
    ],
)
def test_broken_drawings_are_named_with_line_and_column(tmp_path, text, words):
    path = tmp_path / "a.txt"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(MapFormatError) as caught:
        load_text_grid(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert [word for word in words if word not in message] == []


def test_bad_resolutions():
    for resolution in (0, -1, float("nan"), True):
        with pytest.raises(ParameterError, match="resolution"):
            parse_text_grid(".", resolution)
