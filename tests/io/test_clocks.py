"""Stamps of several clocks in one log come together, or are said not to."""

import numpy as np
import pytest

from tests.support.logs import PERIOD, START, Log, depth_log, ros_cloud, ros_tf
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.io.log_reader import read_log

CLOUD = np.random.default_rng(0).uniform([1, -1, 0.5], [3, 1, 3], (200, 3))
BOOT = 3_484_289_833_850  # nanoseconds since a lidar's power-on
COUNT = 8


def clouds(
    log: Log, topic: str, stamp, at=lambda i: START + i * PERIOD, frame: str = "lidar", count: int = COUNT
) -> Log:
    for i in range(count):
        log.add(topic, at(i), ros_cloud(stamp(i), frame, CLOUD + 1e-4 * i))  # else it stands still
    return log


def times(recording) -> list[int]:
    return [(frame.time_ns - START) // PERIOD for frame in recording]


def two_sensors(stamp) -> Log:
    """A depth camera in the recorder's time, and a lidar with other stamps."""
    log = depth_log(COUNT)
    log.add("/tf_static", START, ros_tf((START, "base", "lidar", (0, 0, 1.0), (0, 0, 0, 1))))
    return clouds(log, "/lidar", stamp)


@pytest.mark.parametrize(
    "stamp, said",
    [
        (lambda i: BOOT + i * PERIOD, "53.9 years behind"),
        (lambda i: START + 3600 * 10**9 + i * PERIOD, "3600 s ahead"),
        (lambda i: START + 250_000_000 + i * PERIOD, "0.25 s ahead"),  # no message comes before it is measured
    ],
)
def test_another_clock_is_brought_to_the_recorders(tmp_path, stamp, said):
    recording = read_log(two_sensors(stamp).write(tmp_path / "a.mcap"))
    assert times(recording) == list(range(COUNT))
    assert all(set(frame.sensor.tolist()) == {0, 1} for frame in recording)
    assert [said in note for note in recording.notes] == [True]


def test_a_clock_that_begins_at_zero_has_stamps(tmp_path):
    """As of recordings that were simulated, or converted from numbered files."""
    log = clouds(Log(), "/lidar", lambda i: i * PERIOD, at=lambda i: i * PERIOD)
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert len(recording) == COUNT and "stamp" not in " ".join(recording.notes)
    late = clouds(Log(), "/lidar", lambda i: i * PERIOD, at=lambda i: START + i * PERIOD)
    assert "1 message without header stamp" in " ".join(read_log(late.write(tmp_path / "b.mcap")).notes)


def test_latency_is_no_other_clock(tmp_path):
    recording = read_log(two_sensors(lambda i: START - 2_000_000_000 + i * PERIOD).write(tmp_path / "a.mcap"))
    assert recording.notes == () and len(recording) == COUNT + COUNT  # as stamped, two seconds before


def test_what_the_user_says_of_a_clock_is_done(tmp_path):
    log = two_sensors(lambda i: START - 500_000_000 + i * PERIOD).write(tmp_path / "a.mcap")
    recording = read_log(log, ReadSettings(delays=("/lidar=-0.5",)))
    assert times(recording) == list(range(COUNT)) and recording.notes == ()


def test_transforms_of_another_clock(tmp_path):
    log = clouds(Log(), "/lidar", lambda i: BOOT + i * PERIOD)
    for i in range(COUNT):
        at = START + i * PERIOD
        log.add("/tf", at, ros_tf((at, "odom", "lidar", (0.1 * i, 0, 0), (0, 0, 0, 1))))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert recording.fixed_frame == "odom" and times(recording) == list(range(COUNT))
    np.testing.assert_allclose([frame.origins[0, 0] for frame in recording], 0.1 * np.arange(COUNT), atol=1e-6)


def test_simulated_time_stays_as_it_is(tmp_path):
    log = clouds(Log(), "/lidar", lambda i: 5 * 10**9 + i * PERIOD)
    assert [f.time_ns for f in read_log(log.write(tmp_path / "a.mcap"))] == [
        5 * 10**9 + i * PERIOD for i in range(COUNT)
    ]


def test_a_clock_that_is_set_while_it_is_recorded(tmp_path):
    step = lambda i: START + i * PERIOD - (7 * 10**9 if i < 4 else 0)  # noqa: E731
    recording = read_log(clouds(Log(), "/lidar", step).write(tmp_path / "a.mcap"))
    assert times(recording) == list(range(COUNT)) and "was set during the recording" in " ".join(recording.notes)
    # the recorder waits for five seconds, and gets all at once: nobody's clock was set
    waits = lambda i: START + (i * PERIOD if i < 4 else max(i * PERIOD, 5 * 10**9 + i))  # noqa: E731
    recording = read_log(clouds(Log(), "/lidar", lambda i: START + i * PERIOD, waits).write(tmp_path / "b.mcap"))
    assert times(recording) == list(range(COUNT)) and "clock" not in " ".join(recording.notes)


@pytest.mark.parametrize("chunk", [1, 4000, 1 << 20])  # bytes: the step is between two chunks, or in the only one
def test_the_recorders_clock_is_set_back(tmp_path, chunk):
    """What comes later in the file comes later, with the stamps of the same computer; of another one they stay."""
    set_back = 128_000_000 - PERIOD // 4
    step = lambda i: START + i * PERIOD - set_back * (i >= 5)  # noqa: E731
    log, plain = (clouds(Log(), "/lidar", at, at) for at in (step, lambda i: START + i * PERIOD))
    recording = read_log(log.write(tmp_path / "a.mcap", chunk_size=chunk))
    assert times(recording) == list(range(COUNT)) and "clock was set back" in " ".join(recording.notes)
    for frame, expected in zip(recording, read_log(plain.write(tmp_path / "b.mcap"))):
        np.testing.assert_array_equal(frame.points, expected.points)
    other = clouds(Log(), "/lidar", lambda i: START + i * PERIOD, step)
    assert times(read_log(other.write(tmp_path / "c.mcap", chunk_size=chunk))) == list(range(COUNT))


def test_parts_that_were_joined_in_another_order_are_of_one_clock(tmp_path):
    log = clouds(Log(), "/lidar", lambda i: START + i * PERIOD)
    log.items[:] = log.items[5:] + log.items[:5]
    recording = read_log(log.write(tmp_path / "a.mcap", chunk_size=1))
    assert times(recording) == list(range(COUNT)) and "clock" not in " ".join(recording.notes)


def test_never_two_epochs_in_one_result(tmp_path):
    both = lambda i: START + i * PERIOD if i >= 4 else BOOT + i * PERIOD  # noqa: E731  # a robot without a battery clock
    recording = read_log(clouds(Log(), "/lidar", both, both).write(tmp_path / "a.mcap"))
    assert np.array_equal(np.diff([f.time_ns for f in recording]), np.full(COUNT - 1, PERIOD))
    assert "clock was set" in " ".join(recording.notes)
    log = two_sensors(lambda i: BOOT + i * PERIOD)
    log.items = [(t, BOOT + a - START if t == "/lidar" else a, m) for t, a, m in log.items]  # log times tell nothing
    recording = read_log(log.write(tmp_path / "b.mcap"))
    assert times(recording) == list(range(COUNT)) and recording.sensors == ("/cam/depth",)
    assert "read.delays" in " ".join(recording.notes)


def test_one_stamp_gone_wrong(tmp_path):
    log = clouds(Log(), "/lidar", lambda i: 1 if i == 3 else START + i * PERIOD)
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert times(recording) == list(range(COUNT)) and "of no clock" in " ".join(recording.notes)


def test_gaps_are_said(tmp_path):
    at = lambda i: START + i * PERIOD + (12 * 10**9 if i >= 5 else 0)  # noqa: E731
    recording = read_log(clouds(Log(), "/lidar", at, at).write(tmp_path / "a.mcap"))
    assert "gap of 12.0 s, after 0.1 s" in " ".join(recording.notes)
