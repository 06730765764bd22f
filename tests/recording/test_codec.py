"""Oracle: what was written. Every observation and command comes back from a file identical to the last bit."""

import math
import struct
from dataclasses import fields, is_dataclass

import numpy as np
import pyarrow as pa
import pytest
import rerun as rr
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robocar.core import (
    SE2,
    Belief,
    Detection,
    Done,
    Drive,
    GiveUp,
    Hold,
    Image,
    LogFormatError,
    Observation,
    Reading,
    Scan,
    Serial,
    State,
    Twist,
    WheelAngles,
)
from robocar.recording import RerunRecorder, Scenery, codec, read_observations

NUMBERS = st.floats(allow_nan=True, allow_infinity=True)
FINITE = st.floats(allow_nan=False, allow_infinity=False, width=64, min_value=-1e9, max_value=1e9)
TIMES = st.floats(min_value=0.0, max_value=1e5)
NAMES = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=12)
TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
POSES = st.builds(SE2, FINITE, FINITE, FINITE)


def readings(values):
    return st.none() | st.builds(Reading, TIMES, values)


@st.composite
def scans(draw, most_beams):
    n = draw(st.integers(0, most_beams))
    numbers = arrays(np.float64, n, elements=NUMBERS)
    reach = draw(st.floats(min_value=0.01, max_value=100.0))
    width = draw(st.floats(min_value=0.0, max_value=1.0))
    return Scan(draw(TIMES), draw(numbers), draw(numbers), reach, width, draw(POSES), draw(NAMES))


@st.composite
def images(draw):
    shape = draw(st.tuples(st.integers(1, 6), st.integers(1, 6), st.just(3)))
    pixels = draw(arrays(np.uint8, shape))
    return Image(draw(TIMES), pixels, draw(arrays(np.float64, (3, 3), elements=FINITE)), draw(mounts()))


@st.composite
def mounts(draw):
    mount = np.eye(4)
    mount[:3, 3] = draw(arrays(np.float64, 3, elements=st.floats(-10, 10)))
    return mount


DETECTIONS = st.builds(
    Detection, TIMES, TEXT, NUMBERS, NUMBERS, arrays(np.float64, (2, 2), elements=NUMBERS), st.floats(1e-3, 1e3)
)
OBSERVATIONS = st.builds(
    Observation,
    TIMES,
    wheel_angles=readings(st.builds(WheelAngles, NUMBERS, NUMBERS)),
    twist=readings(st.builds(Twist, NUMBERS, NUMBERS)),
    odom_pose=readings(POSES),
    sonars=st.lists(scans(1), max_size=3, unique_by=lambda scan: scan.name).map(tuple),
    lidar=st.none() | scans(9),
    psd=readings(NUMBERS),
    compass=readings(NUMBERS),
    acceleration=readings(arrays(np.float64, 2, elements=NUMBERS)),
    bumper=readings(st.booleans()),
    image=st.none() | images(),
    top_image=st.none() | images(),
    landmarks=st.lists(DETECTIONS, max_size=3).map(tuple),
    serial=st.lists(TEXT, max_size=2).map(tuple),
)
UNUSUAL = st.dictionaries(
    st.sampled_from(["lidar/rear", "gyro", "floor/temperature", "a:b", "wheels", "Ü"]),
    st.one_of(
        st.builds(Reading, TIMES, st.one_of(NUMBERS, st.booleans(), st.integers(-(2**53), 2**53), POSES)),
        st.builds(Reading, TIMES, arrays(np.float64, st.integers(0, 4), elements=NUMBERS)),
        scans(3),
        images(),
        st.lists(TEXT, min_size=1, max_size=2).map(tuple),
    ),
)
"""Sensors that nobody here has heard of."""
RUNS = st.tuples(OBSERVATIONS, UNUSUAL).map(lambda pair: pair[0].with_readings(pair[1]))
PAN = st.none() | FINITE
WORK = st.dictionaries(TEXT, st.integers(0, 2**53), max_size=3)
COMMANDS = st.one_of(
    st.builds(Drive, st.builds(Twist, NUMBERS, NUMBERS), pan=PAN, work=WORK),
    st.builds(Serial, TEXT, pan=PAN, work=WORK),
    st.builds(Hold, pan=PAN, work=WORK),
    st.builds(Done, TEXT, pan=PAN, work=WORK),
    st.builds(GiveUp, TEXT, st.sampled_from(["no_path", "stuck"]), pan=PAN, work=WORK),
)


def bits(value):
    """A value as something that compares equal only when every bit does: NaN equals NaN, 0.0 differs from -0.0."""
    if isinstance(value, Observation):
        scans = tuple(name for name, reading in value.readings.items() if isinstance(reading, Scan))  # in order
        return (bits(value.time), scans, {name: bits(reading) for name, reading in value.readings.items()})
    if is_dataclass(value):
        return (type(value).__name__, *(bits(getattr(value, f.name)) for f in fields(value) if f.name != "trace"))
    if isinstance(value, np.ndarray):
        return (value.shape, value.dtype.str, value.tobytes())
    if isinstance(value, tuple):
        return tuple(map(bits, value))
    if isinstance(value, dict):
        return tuple((name, bits(item)) for name, item in value.items())
    if isinstance(value, bool | str | int) or value is None:
        return value
    return struct.pack("<d", value)


# Every example opens a recording: making a failing one smaller takes minutes, so it is shown as it is found.
@settings(
    max_examples=25,
    deadline=None,
    phases=[Phase.explicit, Phase.reuse, Phase.generate],
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
@given(st.lists(st.tuples(RUNS, COMMANDS), min_size=1, max_size=6), st.integers(1, 3))
def test_a_recorded_run_reads_back_bit_by_bit(tmp_path_factory, run, flush_ticks):
    path = tmp_path_factory.mktemp("codec") / "run.rrd"
    recorder = RerunRecorder(path, run_id="codec", scenery=Scenery(), flush_ticks=flush_ticks)
    for observation, command in run:
        recorder.log(observation, State.of(Belief(SE2())), command, None)
    recorder.close()
    assert [tuple(map(bits, pair)) for pair in read_observations(path)] == [tuple(map(bits, pair)) for pair in run]


@pytest.mark.parametrize(
    "value",
    ["warm", np.eye(2), None, 1j, np.complex64(1j), np.array(None), np.array(["warm"]), np.str_("warm"), np.datetime64("now")],
)
def test_a_reading_that_cannot_be_kept_is_refused(value):
    """Oracle: the types of the module's docstring; the message names the sensor and what would do."""
    with pytest.raises(TypeError, match=r"(?s)'odd': .*Scan, an Image.*float"):
        codec.encode_observation(Observation(0.0, {"odd": Reading(0.0, value)}))


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (np.float32(0.1), float(np.float32(0.1))),
        (np.float64(0.1), 0.1),
        (np.float16(0.5), 0.5),
        (np.int64(-3), -3),
        (np.uint8(200), 200),
        (np.bool_(True), True),
        (np.array(3.0), 3.0),
        (np.array(3), 3),
        (np.array(False), False),
        (2**60, 2**60),
    ],
)
def test_numpy_s_scalars_come_back_as_plain_numbers(tmp_path, value, expected):
    """Oracle: Python's own number of the same value."""
    path = tmp_path / "run.rrd"
    recorder = RerunRecorder(path, run_id="codec", scenery=Scenery())
    recorder.log(Observation(0.0, {"odd": Reading(0.0, value)}), State.of(Belief(SE2())), Hold(), None)
    recorder.close()
    ((observation, _),) = read_observations(path)
    read = observation.readings["odd"].value
    assert (type(read), read) == (type(expected), expected)


@pytest.mark.parametrize("value", [2**53 + 1, np.int64(2**53 + 1), 10**400])
def test_a_whole_number_that_no_float_holds_is_refused(value):
    with pytest.raises(ValueError, match=r"'odd': \d+ cannot be recorded: .*float64"):
        codec.encode_observation(Observation(0.0, {"odd": Reading(0.0, value)}))


def test_a_sensor_s_name_without_a_column_is_refused():
    """Oracle: Rerun, which aborts the interpreter at a NUL in a name."""
    with pytest.raises(ValueError, match="NUL"):
        codec.encode_observation(Observation(0.0, {"a\0": Reading(0.0, 1.0)}))


def test_a_recording_of_an_earlier_version_is_refused(tmp_path):
    """Oracle: the layout of 0.1.0, `sonars` and `psd`; read in silence it would be a run without sensors."""
    stream = rr.RecordingStream("robocar", recording_id="old")
    stream.save(tmp_path / "run.rrd")
    for entity, column in (("observation", "psd"), ("command", "values")):
        cells = rr.ComponentColumn(column, rr.AnyBatchValue(column, pa.array([0.0, 1.0])), lengths=[2])
        stream.send_columns(entity, [rr.TimeColumn("tick", sequence=[0]), rr.TimeColumn("sim_time", duration=[0.0])], [cells])
    stream.disconnect()
    with pytest.raises(LogFormatError, match="another version of Robocar: columns psd"):
        next(read_observations(tmp_path / "run.rrd"))


def test_bits_tell_zeros_and_nans_apart():
    """The comparison above is worth something."""
    assert bits(Twist(0.0)) != bits(Twist(-0.0))
    assert bits(Twist(math.nan)) == bits(Twist(math.nan))
    assert bits(np.array([1.0])) != bits(np.array([np.nextafter(1.0, 2.0)]))


@given(arrays(np.uint8, st.tuples(st.integers(1, 20), st.integers(1, 20), st.just(3))))
@settings(deadline=None)
def test_png_keeps_every_pixel(pixels):
    np.testing.assert_array_equal(codec.decode_png(np.frombuffer(codec.encode_png(pixels), np.uint8)), pixels)


def test_bytes_that_are_no_png_are_refused():
    with pytest.raises(ValueError, match="no PNG"):
        codec.decode_png(np.zeros(10, np.uint8))


def test_an_unknown_kind_of_command_is_refused():
    with pytest.raises(ValueError, match="'Fly'"):
        codec.decode_command({"kind": ["Fly"]})
