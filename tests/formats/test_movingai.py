"""MovingAI maps and scenarios. Oracles: what was written, counts of the published files, published optima by scipy's Dijkstra."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from robocar.core import MapFormatError, ParameterError
from robocar.formats import ScenarioLine, load_movingai_map, load_scenarios

shapes = array_shapes(min_dims=2, max_dims=2, max_side=10)


def map_text(rows, newline="\n", end=True):
    lines = ["type octile", f"height {len(rows)}", f"width {len(rows[0])}", "map", *rows]
    return newline.join(lines) + (newline if end else "")


@settings(deadline=None)
@given(arrays("U1", shapes, elements=st.sampled_from(".GS@OTW")), st.sampled_from(["\n", "\r\n"]), st.booleans())
def test_every_terrain_with_both_line_ends(tmp_path_factory, terrain, newline, end):
    """. G S are passable, @ O T W are not; the file's last row is row 0."""
    path = tmp_path_factory.mktemp("map") / "a.map"
    path.write_bytes(map_text(["".join(row) for row in terrain], newline, end).encode())
    grid = load_movingai_map(path, 0.5)
    np.testing.assert_array_equal(grid.free, np.isin(terrain, list(".GS"))[::-1])
    np.testing.assert_array_equal(grid.occupied, np.isin(terrain, list("@OTW"))[::-1])
    assert grid.resolution == 0.5


GOOD = map_text(["..@", ".T."])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["line 1", "type octile"]),
        (GOOD.replace("type octile", "type tile"), ["line 1", "type octile", "'type tile'"]),
        (GOOD.replace("height 2", "height two"), ["line 2", "height", "'height two'"]),
        (GOOD.replace("height 2", "height 0"), ["line 2", "positive", "'height 0'"]),
        (GOOD.replace("height 2", "height -2"), ["line 2", "'height -2'"]),
        (GOOD.replace("width 3", "breadth 3"), ["line 3", "width", "'breadth 3'"]),
        (GOOD.replace("width 3", "height 3"), ["line 3", "width", "'height 3'"]),
        (GOOD.replace("map\n", ""), ["line 4", "'map'", "'..@'"]),
        ("type octile\nheight 2\n", ["line 3", "width", "end of the file"]),
        ("type octile\nheight 2\nwidth 3\n", ["line 4", "map", "end of the file"]),
        (GOOD.replace("..@", "..@."), ["line 5", "4 characters", "width 3"]),
        (GOOD.replace(".T.", ".T"), ["line 6", "2 characters", "width 3"]),
        (GOOD.replace("..@\n", "..@\n\n"), ["line 7", "height 2", "3 rows"]),
        (GOOD.replace("height 2", "height 3"), ["truncated", "height 3", "2 rows"]),
        (GOOD.replace("height 2", "height 1"), ["line 6", "height 1", "2 rows"]),
        (GOOD.replace(".T.", ".x."), ["line 6", "column 2", "'x'", ". G S @ O T W"]),
        (GOOD.replace(".T.", "@ ."), ["line 6", "column 2", "' '"]),
        (GOOD.replace("height 2", "height 100000").replace("width 3", "width 100000"), ["100000 x 100000 cells"]),
    ],
)
def test_broken_maps_are_named_with_their_line(tmp_path, text, words):
    path = tmp_path / "a.map"
    for newline in ("\n", "\r\n"):
        path.write_bytes(text.replace("\n", newline).encode())
        with pytest.raises(MapFormatError) as caught:
            load_movingai_map(path)
        message = str(caught.value)
        assert message.startswith(str(path))
        assert [word for word in words if word not in message] == []


def test_binary_files_missing_files_and_bad_resolutions(tmp_path):
    path = tmp_path / "a.map"
    with pytest.raises(MapFormatError, match=r"a\.map: no such file"):
        load_movingai_map(path)
    path.write_bytes(b"type octile\n\xff\xff")
    with pytest.raises(MapFormatError, match=r"a\.map, line 2: byte 0xff"):
        load_movingai_map(path)
    path.write_text(GOOD)
    for resolution in (0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ParameterError, match="resolution"):
            load_movingai_map(path, resolution)


def test_scenario_lines_with_tabs_blanks_and_both_line_ends(tmp_path):
    path = tmp_path / "a.scen"
    path.write_bytes(b"version 1\r\n0\tmaps/my map.map\t4\t3\t0\t2\t3\t0\t3.4142\r\n\r\n7 b.map 4 3 1 1 1 1 0\r\n")
    first, second = load_scenarios(path)
    assert first == ScenarioLine(0, "maps/my map.map", 4, 3, (0, 2), (3, 0), 3.4142)
    assert (first.start_cell, first.goal_cell) == ((0, 0), (2, 3))
    assert second == ScenarioLine(7, "b.map", 4, 3, (1, 1), (1, 1), 0.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["line 1", "version 1"]),
        ("version 2\n", ["line 1", "version 1", "'version 2'"]),
        ("0 a.map 4 3 0 0 1 1 1\n", ["line 1", "version 1"]),
        ("version 1\n0 a.map 4 3 0 0 1 1\n", ["line 2", "8 fields", "9"]),
        ("version 1\n0 a.map 4 3 0 0 1 1 1.4 5\n", ["line 2", "10 fields", "9"]),
        ("version 1\n0 a.map 4 3 0 0 1 1 1.4\nx a.map 4 3 0 0 1 1 1.4\n", ["line 3", "bucket", "'x'"]),
        ("version 1\n0 a.map 4 3 0 0 1.5 1 1.4\n", ["line 2", "goal x", "'1.5'"]),
        ("version 1\n0 a.map 4 3 0 -1 1 1 1.4\n", ["line 2", "start y", "'-1'"]),
        ("version 1\n0 a.map 4 3 4 0 1 1 1.4\n", ["line 2", "start x 4", "outside", "4 x 3"]),
        ("version 1\n0 a.map 4 3 0 0 1 3 1.4\n", ["line 2", "goal y 3", "outside", "4 x 3"]),
        ("version 1\n0 a.map 4 3 0 0 1 1 far\n", ["line 2", "optimal length", "'far'"]),
        ("version 1\n0 a.map 4 3 0 0 1 1 nan\n", ["line 2", "optimal length", "'nan'"]),
        ("version 1\n0 a.map 4 3 0 0 1 1 -1\n", ["line 2", "optimal length", "'-1'"]),
    ],
)
def test_broken_scenarios_are_named_with_line_and_field(tmp_path, text, words):
    path = tmp_path / "a.scen"
    path.write_text(text)
    with pytest.raises(MapFormatError) as caught:
        load_scenarios(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert [word for word in words if word not in message] == []


# Rows, columns, passable cells and lines of the published files, counted with standard text tools.
PUBLISHED = {
    "arena": ("arena.map.scen", 49, 49, 2054, 160),
    "lak101d": ("lak101d.map.scen", 31, 30, 318, 80),
    "lak105d": ("lak105d.map.scen", 25, 31, 443, 100),
    "random-32-32-10": ("random-32-32-10-random-1.scen", 32, 32, 922, 461),
    "room-32-32-4": ("room-32-32-4-random-1.scen", 32, 32, 682, 341),
}


def octile_graph(free):
    """Edges of cost 1 and sqrt(2) between free cells (rows, cols); a diagonal only beside two free cells."""
    rows, cols = free.shape
    index = np.arange(rows * cols).reshape(rows, cols)
    sources, targets, costs = [], [], []
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
        r0, r1 = slice(0, rows - dr), slice(dr, rows)
        c0, c1 = (slice(0, cols - dc), slice(dc, cols)) if dc >= 0 else (slice(1, cols), slice(0, cols - 1))
        step = free[r0, c0] & free[r1, c1]
        if dr and dc:
            step &= free[r0, c1] & free[r1, c0]
        sources.append(index[r0, c0][step])
        targets.append(index[r1, c1][step])
        costs.append(np.full(int(step.sum()), np.hypot(dr, dc)))
    return coo_array(
        (np.concatenate(costs), (np.concatenate(sources), np.concatenate(targets))), shape=(free.size, free.size)
    ).tocsr()


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_maps_and_every_published_optimum(data_dir, name):
    """Dijkstra between our cells finds each published length: map, flip and points fit together."""
    scenario_name, rows, cols, passable, count = PUBLISHED[name]
    folder = data_dir / "movingai"
    grid = load_movingai_map(folder / f"{name}.map")
    assert grid.shape == (rows, cols)
    assert int(grid.free.sum()) == passable
    lines = load_scenarios(folder / scenario_name)
    assert len(lines) == count
    assert {(line.height, line.width) for line in lines} == {grid.shape}
    starts = sorted({line.start_cell for line in lines})
    lengths = dijkstra(octile_graph(grid.free), directed=False, indices=[r * cols + c for r, c in starts])
    found = np.array([lengths[starts.index(line.start_cell), line.goal_cell[0] * cols + line.goal_cell[1]] for line in lines])
    np.testing.assert_allclose(found, [line.optimal_length for line in lines], rtol=0, atol=1e-2)
