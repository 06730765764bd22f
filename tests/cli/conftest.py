"""Fixtures of the command line's tests: a call in this process, and the files that it is given."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from robocar.cli import main
from tests.cli.command_line import SHORT, Call

GRID = "############\n#S.........#\n#..........#\n#......#...#\n#......#...#\n#......#..G#\n############\n"
MAP_YAML = {
    "image": "map.pgm",
    "resolution": 0.05,
    "origin": [-1, -1, 0],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Call:
    """`robocar <words>` in this process, in an empty folder: exit status, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*words: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            main([str(word) for word in words])
        captured = capsys.readouterr()
        assert isinstance(ended.value.code, int)
        return ended.value.code, captured.out, captured.err

    return run


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """Good and bad files of several kinds."""
    (tmp_path / "short.yaml").write_text(yaml.safe_dump(SHORT))
    (tmp_path / "grid.txt").write_text(GRID)
    # 2 x 2 m from (-1, -1) on, free but for a block in the upper right corner.
    rows = [[0 if row < 8 and col >= 32 else 254 for col in range(40)] for row in range(40)]
    (tmp_path / "map.pgm").write_text("P2\n40 40\n255\n" + "\n".join(" ".join(map(str, row)) for row in rows) + "\n")
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(MAP_YAML))
    (tmp_path / "hello.pgm").write_text("hello\n")
    for name, change in (
        ("missing", {"image": "nowhere.pgm"}),
        ("not_image", {"image": "hello.pgm"}),
        ("zero", {"resolution": 0}),
        ("negative", {"resolution": -0.05}),
        ("nan", {"resolution": float("nan")}),
        ("crossed", {"occupied_thresh": 0.1}),
    ):
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(MAP_YAML | change))
    (tmp_path / "ragged.map").write_text("type octile\nheight 2\nwidth 3\nmap\n...\n..\n")
    (tmp_path / "count.map").write_text("type octile\nheight 3\nwidth 3\nmap\n...\n...\n")
    for name, change in (
        ("typo", {"goall": [1, 1]}),
        ("code", {"defaults": {"navigator": "os:getcwd"}}),
        ("walled", {"start": [1.8, 1.8, 0]}),
        ("mover", {"movers": [{"name": "cart", "cylinder": [0.1, 0.3], "waypoints": [[1.0, 1.8], [3.0, 1.8]]}]}),
    ):
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(SHORT | change))
    (tmp_path / "broken.yaml").write_text("map: [\n")
    return tmp_path
