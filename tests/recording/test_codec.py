"""Oracle: what was written. Every observation and command comes back from a file identical to the last bit."""

import math
import struct
from dataclasses import fields, is_dataclass

import numpy as np
import pytest
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
    Observation,
    Reading,
    Scan,
    Serial,
    Twist,
    WheelAngles,
)
from robocar.recording import RerunRecorder, Scenery, codec, read_observations

NUMBERS = st.floats(allow_nan=True, allow_infinity=True)
FINITE = st.floats(allow_nan=False, allow_infinity=False, width=64, min_value=-1e9, max_value=1e9)
TIMES = st.floats(min_value=0.0, max_value=1e5)
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
    return Scan(draw(TIMES), draw(numbers), draw(numbers), reach, width, draw(POSES), draw(TEXT))


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


DETECTIONS = st.builds(Detection, TIMES, TEXT, NUMBERS, NUMBERS, arrays(np.float64, (2, 2), elements=NUMBERS))
OBSERVATIONS = st.builds(
    Observation,
    TIMES,
    wheel_angles=readings(st.builds(WheelAngles, NUMBERS, NUMBERS)),
    twist=readings(st.builds(Twist, NUMBERS, NUMBERS)),
    odom_pose=readings(POSES),
    sonars=st.lists(scans(1), max_size=3).map(tuple),
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
PAN = st.none() | FINITE
COMMANDS = st.one_of(
    st.builds(Drive, st.builds(Twist, NUMBERS, NUMBERS), PAN),
    st.builds(Serial, TEXT, PAN),
    st.builds(Hold, PAN),
    st.builds(Done, TEXT, PAN),
    st.builds(GiveUp, TEXT, st.sampled_from(["no_path", "stuck"]), PAN),
)


class NoMap:
    def reset(self, rng):
        pass

    def update(self, belief, observation):
        pass

    def grid(self):
        return None


def bits(value):
    """A value as something that compares equal only when every bit does: NaN equals NaN, 0.0 differs from -0.0."""
    if is_dataclass(value):
        return (type(value).__name__, *(bits(getattr(value, f.name)) for f in fields(value) if f.name != "trace"))
    if isinstance(value, np.ndarray):
        return (value.shape, value.dtype.str, value.tobytes())
    if isinstance(value, tuple):
        return tuple(map(bits, value))
    if isinstance(value, bool | str) or value is None:
        return value
    return struct.pack("<d", value)


# Every example opens a recording: making a failing one smaller takes minutes, so it is shown as it is found.
@settings(
    max_examples=25,
    deadline=None,
    phases=[Phase.explicit, Phase.reuse, Phase.generate],
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
@given(st.lists(st.tuples(OBSERVATIONS, COMMANDS), min_size=1, max_size=6), st.integers(1, 3))
def test_a_recorded_run_reads_back_bit_by_bit(tmp_path_factory, run, flush_ticks):
    path = tmp_path_factory.mktemp("codec") / "run.rrd"
    recorder = RerunRecorder(path, run_id="codec", scenery=Scenery(), flush_ticks=flush_ticks)
    for observation, command in run:
        recorder.log(observation, Belief(SE2()), NoMap(), command, None)
    recorder.close()
    assert [tuple(map(bits, pair)) for pair in read_observations(path)] == [tuple(map(bits, pair)) for pair in run]


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
