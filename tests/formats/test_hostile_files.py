"""Files from outside that are damaged, hostile or nonsense end as one line, soon and in little memory.

Oracle: `RobocarError` is the only error; every other one fails the test. What `check` takes and needs is measured in a process
of its own.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robocar.core import LogFormatError, MapFormatError, RobocarError, ScenarioError
from robocar.core.text import shown
from robocar.formats import load_map
from robocar.reading import MAX_DEPTH, parse_json, parse_yaml, read_bytes
from tests.formats.hostile import BAD, READERS, refusal

LINE = 2000  # characters of a message with all that is known in it


def put(folder: Path, name: str) -> Path:
    content = BAD[name][0]
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass"))
    return path


@pytest.mark.parametrize("name", [name for name in BAD if not name.endswith(".json")])
def test_check_refuses_a_bad_file_in_one_line(name: str, tmp_path: Path) -> None:
    message = refusal("check", put(tmp_path, name))
    assert message is not None
    assert Path(name).stem in message  # a scenario goes by its own name
    assert re.search(BAD[name][1], message), message
    assert len(message) < LINE
    assert message.isprintable()


@pytest.mark.parametrize("name", [name for name in BAD if name.endswith(".json")])
def test_a_bad_baseline_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    message = refusal("results", put(tmp_path, name))
    assert message is not None
    assert re.search(BAD[name][1], message), message
    assert len(message) < LINE


@pytest.mark.parametrize("reader", READERS)
def test_no_reader_raises_anything_else(reader: str, tmp_path: Path) -> None:
    """Each bad file, whatever it is called, at the door of every reader."""
    for name in BAD:
        message = refusal(reader, put(tmp_path, name))
        assert message is None or (len(message) < LINE and message.isprintable()), (reader, name)


LIMITED = """
import sys, time
from robocar.cli.check import check
from robocar.core import RobocarError
from robocar.regression.baseline import read_any
import robocar.episode.registry, robocar.scenario.scene
for name in sys.argv[1:]:
    from pathlib import Path
    started = time.process_time()
    try:
        read_any(name) if name.endswith(".json") else check(Path(name), None)
    except RobocarError:
        pass
    most = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))  # ru_maxrss is that of the parent, too
    print(name, time.process_time() - started, int(most.split()[1]) // 1024)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="counts kilobytes as Linux does")
def test_time_and_memory_of_a_check(tmp_path: Path) -> None:
    """Below 2 s of the processor's time each, and 500 MB for all in one process."""
    files = [str(put(tmp_path, name)) for name in BAD]
    done = subprocess.run([sys.executable, "-c", LIMITED, *files], capture_output=True, text=True, check=True)
    rows = [line.rsplit(" ", 2) for line in done.stdout.splitlines()]
    assert [row[0] for row in rows] == files
    assert {row[0]: float(row[1]) for row in rows if float(row[1]) > 2.0} == {}
    assert {row[0]: int(row[2]) for row in rows if int(row[2]) >= 500} == {}


@pytest.mark.parametrize("ending", [".yaml", ".tum", ".log", ".csv", ".png", ".npz", ".world", ".map", ".txt", ""])
def test_pipes_devices_folders_and_strange_names_are_refused_at_once(ending: str, tmp_path: Path) -> None:
    """A pipe that nobody writes into, a link to an endless device, a folder, names that no file has."""
    pipe, link, folder = (tmp_path / f"{name}{ending}" for name in ("pipe", "link", "folder"))
    os.mkfifo(pipe)
    link.symlink_to("/dev/zero")
    folder.mkdir()
    for path in (pipe, link, folder, tmp_path / f"nul\0{ending}", tmp_path / f"half\ud800{ending}", tmp_path / ("x" * 5000)):
        for reader in READERS:
            if " of a run" in reader or "." in reader:
                continue  # they copy the file first
            message = refusal(reader, path)
            assert message is not None, (reader, path)
            assert len(message) < 6000
            message.encode()


def test_read_bytes_reads_no_more_than_the_limit(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_bytes(path, limit=5) == b"12345"
    with pytest.raises(LogFormatError, match="more than 4 bytes"):
        read_bytes(path, LogFormatError, limit=4)


def test_yaml_that_people_write_is_taken() -> None:
    """Oracle: by hand. Merged keys may be set anew, aliases used; nesting up to the limit."""
    text = "base: &b {x: 1, y: 2}\nmine: {<<: *b, y: 3}\nagain: *b\n"
    assert parse_yaml(text, "t", ScenarioError) == {"base": {"x": 1, "y": 2}, "mine": {"x": 1, "y": 3}, "again": {"x": 1, "y": 2}}
    nested = "[" * (MAX_DEPTH - 1) + "]" * (MAX_DEPTH - 1)
    assert parse_yaml(nested, "t", ScenarioError) is not None
    assert parse_yaml("", "t", ScenarioError) is None


LEAVES = st.none() | st.integers() | st.floats() | st.text(max_size=200) | st.binary(max_size=200)


@settings(max_examples=50, deadline=None)
@given(st.recursive(LEAVES, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=40))
def test_any_value_is_shown_in_a_short_line(value: object) -> None:
    assert len(shown(value)) <= 100
    assert shown(value).isprintable()


# fmt: off
PIECES = st.sampled_from([
    b"map: ", b"start: [0, 0, 0]\n", b"image: a.pgm\n", b"robot: {", b"}", b"[", b"]", b"&a ", b"*a", b"<<: ", b"!!int ", b"? ",
    b"1e999", b"0x", b"9", b"nan", b".inf", b"2020-13-45", b"1:2:3", b"P5 3 3 255\n", b"P6 2 2 255\n", b"P4 9 1\n", b"GIF89a",
    b"II*\0\x08\0\0\0", b"MM\0*\0\0\0\x08", b"RIFF....WEBPVP8L", b"\x89PNG\r\n\x1a\n", b"BM", b"\x1f\x8b\x08\0", b"PK\x03\x04",
    b"<sdf><world>", b"</world></sdf>", b"<model name='a'><pose>", b"type octile\nheight 2\nwidth 2\nmap\n", b"version 1\n",
    b"FLASER 2 1 2 0 0 0 0 0 0 1 h 1\n", b"ROBOTLASER1 0 0 3 0.1 80 0 0 2 1 2 0 0 0 0 0 0 0 0 0 0 0 1 h 1\n",
    b"LASER_READING 2 1 2 0 0 0 1\n", b"angle,range\n", b"0.1,2\n", b"0 1 2 0 0 0 0 1\n", b"{\"schema\": 1, ",
    b"\"kind\": \"robocar-baseline\"", b"Infinity", b"#.#\n", b"\xff\xfe", b"\0", b"\n", b" ", b"-", b":",
])
# fmt: on
CONTENT = st.binary(max_size=80) | st.lists(PIECES | st.binary(max_size=4), max_size=12).map(b"".join)
ENDINGS = (
    *(".yaml", ".json", ".map", ".scen", ".world", ".world.gz", ".npz", ".txt", ".pgm", ".png", ".bmp", ".tif", ".gif", ".webp"),
    *(".tum", ".log", ".log.gz", ".gfs", ".csv", ""),
)


@pytest.mark.parametrize("reader", READERS)
@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(content=CONTENT, ending=st.sampled_from(ENDINGS))
def test_any_bytes_give_a_result_or_one_line(
    tmp_path_factory: pytest.TempPathFactory, reader: str, content: bytes, ending: str
) -> None:
    """Property: our own error or none."""
    path = tmp_path_factory.mktemp("fuzz") / f"any{ending}"
    path.write_bytes(content)
    message = refusal(reader, path)
    assert message is None or (len(message) < LINE and message.isprintable())


@settings(max_examples=150, deadline=None)
@given(st.lists(PIECES | st.binary(max_size=4), max_size=14).map(b"".join))
def test_any_text_is_yaml_and_json_or_refused(content: bytes) -> None:
    """Property: nothing else is raised."""
    for parse in (parse_yaml, parse_json):
        with suppress(MapFormatError):
            parse(content.decode("utf-8", "replace"), "x", MapFormatError)


def test_a_damaged_configuration_is_not_one_without_settings(tmp_path: Path) -> None:
    """Of a run: text, a list, nothing, no file."""
    for content in ("settings: [", "- a\n", "", "settings: 3\n"):
        path = tmp_path / "c"
        path.write_text(content)
        message = refusal("config.yaml of a run", path)
        assert message is not None
        assert "config.yaml" in message


def test_notes_do_not_go_through_python_warnings(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    (tmp_path / "a.pgm").write_bytes(b"P5 1 1 255\n\0")
    path = tmp_path / "a.yaml"
    path.write_text(
        "image: a.pgm\nresolution: 1\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.2\nxyzzy: 1\n"
    )
    notes: list[str] = []
    load_map(path, notes=notes)
    assert notes == ["unknown field xyzzy is ignored"]
    assert not recwarn.list


def test_messages_are_one_line_of_what_can_be_printed() -> None:
    assert str(RobocarError("a\nb\0\ud800 c")) == "a b\\x00\\ud800 c"
    assert len(str(RobocarError("x" * 10**6))) < 5000
