"""A file that grows gives the frames of the finished one."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType

from tests.support import logs
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.io.container import LogError
from voodoo_jax.io.live.frames import LiveLog
from voodoo_jax.io.live.sources import GrowingFile, Source, open_source
from voodoo_jax.io.log_reader import open_log
from voodoo_jax.records.recording import Frame

MS = 1_000_000
READ = ReadSettings(laser=True)


class Growing:
    """A file to which some bytes are added each time that it is looked at."""

    def __init__(self, path: Path, data: bytes, step: int):
        self.path, self._data, self._step, self._at = str(path), data, step, 0
        path.write_bytes(b"")
        self._file = GrowingFile(str(path), idle=1e9)
        self.notes = self._file.notes

    @property
    def ended(self) -> bool:
        return self._file.ended or self._at >= len(self._data)

    def poll(self, seconds: float):
        found = self._file.poll(0.0)
        if not found and self._at < len(self._data):
            with open(self.path, "ab") as file:
                file.write(self._data[self._at : self._at + self._step])
            self._at += self._step
            found = self._file.poll(0.0)
        return found

    def close(self) -> None:
        self._file.close()


@pytest.fixture(autouse=True)
def closed(monkeypatch) -> Iterator[None]:
    """Files are closed at the end."""
    made: list[GrowingFile] = []
    usual = GrowingFile.__init__

    def kept(self, *args, **options):
        made.append(self)
        usual(self, *args, **options)

    monkeypatch.setattr(GrowingFile, "__init__", kept)
    yield
    for file in made:
        file.close()


def opened(source: Source, said: list[str], settings: ReadSettings = READ) -> LiveLog:
    live = LiveLog(source, settings, open_log, said.append)
    live.open()
    return live


def busy_log(seconds: float = 4.0) -> logs.Log:
    """A camera on a robot that drives, a lidar, a scanner and a face detector, whose messages come late and mixed."""
    items = []
    log, start = logs.Log(), logs.START
    turn = (-0.5, 0.5, -0.5, 0.5)
    log.add("/tf_static", start, logs.ros_tf((start, "base", "cam_optical", (0.0, 0.0, 1.25), turn)))
    log.add("/cam/camera_info", start, logs.ros_calibration("cam_optical"))
    for i in range(int(seconds * 25)):
        stamp = start + i * 40 * MS
        pose = (0.1 * np.sin(i / 20), 0.0, 0.0)
        items.append((stamp + 4 * MS, "/tf", logs.ros_tf((stamp, "odom", "base", pose, (0.0, 0.0, 0.0, 1.0)))))
    for i in range(int(seconds * 30)):
        stamp = start + i * 33 * MS + (i % 3) * MS
        items.append((stamp + 12 * MS, "/cam/depth", logs.ros_image(stamp, "cam_optical", logs.depth_metres(i))))
    for i in range(int(seconds * 10)):
        stamp = start + 7 * MS + i * 100 * MS
        points = np.stack(np.meshgrid(np.linspace(1, 2, 40), np.linspace(-1, 1, 40), [0.3 + 0.01 * i]), -1)
        items.append((stamp + 30 * MS, "/lidar", logs.ros_cloud(stamp, "base", points.reshape(-1, 3))))
    for i in range(int(seconds * 15)):
        stamp = start + 3 * MS + i * 66 * MS
        items.append((stamp + 45 * MS, "/cam/faces", logs.annotations(stamp, [("face", 12.0 + i / 20, 10.0)])))
    for at, topic, message in sorted(items, key=lambda item: item[0]):
        log.add(topic, at, message)
    return log


def same(one: Frame, other: Frame) -> None:
    assert one.time_ns == other.time_ns
    for name in ("points", "sensor", "origins", "weight"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=f"{one.time_ns}, {name}")
    assert one.rays.names == other.rays.names
    np.testing.assert_array_equal(one.rays.directions, other.rays.directions)
    np.testing.assert_array_equal(one.rays.origins, other.rays.origins)


@pytest.fixture(scope="module")
def busy(tmp_path_factory) -> tuple[Path, list[Frame]]:
    path = busy_log().write(tmp_path_factory.mktemp("busy") / "busy.mcap", chunk_size=20_000)
    return path, list(open_log(path, READ).frames())


@pytest.mark.parametrize("finished", [True, False], ids=["to its end", "of a recorder that is stopped hard"])
def test_frames_of_several_sensors_are_those_of_the_finished_log(busy, tmp_path, finished):
    path, wanted = busy
    data = path.read_bytes()
    source = Growing(tmp_path / "grows.mcap", data if finished else data[: -len(data) // 20], 7001)
    live = opened(source, [])
    found = [(frame, live.source.ended) for frame in live.frames()]
    assert sum(not over for _, over in found) > 0.9 * len(found)  # as they come, not at the end
    assert sum(len(frame.rays.names) for frame in wanted) > 40 and len(wanted[0].origins) == 2
    # where the file breaks off nobody knows what else belonged to the last frames
    count = len(wanted) if finished else len(found) - 8
    assert len(found) == len(wanted) if finished else len(found) > 0.9 * len(wanted)
    for (frame, _), other in zip(found[:count], wanted):
        same(frame, other)


def test_a_frame_waits_for_what_may_still_belong_to_it(busy, tmp_path):
    """Where one sensor falls silent the others' frames come all the same, a little later."""
    path = tmp_path / "silent.mcap"
    log = busy_log()
    silent = logs.START + 2_800 * MS
    log.items = [item for item in log.items if not (item[0] in ("/lidar", "/cam/faces") and item[1] > silent)]
    log.write(path, chunk_size=4000)
    live = opened(Growing(tmp_path / "grows.mcap", path.read_bytes(), 3000), [])
    late = []
    for frame in live.frames():
        if not live.source.ended and frame.time_ns > silent:
            newest = max(message.log_time for _, _, message in live.held)
            late.append((newest - frame.time_ns) / 1e9)
    assert len(late) > 20 and max(late) < 0.4


def chunked(path: Path) -> bytes:
    """A log of the one camera, 2.6 s, some frames in a chunk."""
    return logs.depth_log(80).write(path, chunk_size=9000, compression=CompressionType.NONE).read_bytes()


def test_one_camera_needs_no_later_message(tmp_path):
    data = chunked(tmp_path / "whole.mcap")
    source = Growing(tmp_path / "grows.mcap", data, 1500)
    live = opened(source, [])
    last = []
    for frame in live.frames():
        last.append(frame.time_ns)
        if not live.source.ended and frame.time_ns in live.log_times:
            assert live.log_times[frame.time_ns] == frame.time_ns
    assert len(last) == 80 and len(live.arrived) <= 80


def test_a_chunk_that_is_damaged_costs_itself(tmp_path):
    data = bytearray(chunked(tmp_path / "whole.mcap"))
    at, length = logs.chunks(bytes(data))[-4]
    data[at + length // 2] ^= 0xFF
    live = opened(Growing(tmp_path / "grows.mcap", bytes(data), 4096), [])
    count = len(list(live.frames()))
    assert 60 < count < 80 and any("1 chunks cannot be read" in note for note in live.notes)


def test_what_came_before_a_broken_record_is_kept(tmp_path):
    data = chunked(tmp_path / "whole.mcap")
    at, _ = logs.chunks(data)[-2]
    broken = data[: at - 8] + (1 << 60).to_bytes(8, "little") + data[at:]

    class Open(Growing):  # says itself when it ends
        ended = False

    live = opened(Open(tmp_path / "grows.mcap", broken, 4096), [])
    assert 60 < len(list(live.frames())) < 80
    assert live.source.ended and any("impossible length" in note for note in live.notes)


def test_what_is_missing_is_waited_for(tmp_path):
    """The calibration comes after three seconds; without one the end is an error that says so."""
    log = logs.depth_log(200)
    calibration = log.items.pop(1)
    log.items.insert(100, ("/cam/camera_info", log.items[100][1], calibration[2]))
    data = log.write(tmp_path / "late.mcap", chunk_size=9000).read_bytes()
    said: list[str] = []
    live = opened(Growing(tmp_path / "a.mcap", data, 2000), said)
    assert any("calibration" in text for text in said) and len(list(live.frames())) > 90
    log.items = [item for item in log.items if item[0] != "/cam/camera_info"]
    data = log.write(tmp_path / "never.mcap").read_bytes()
    with pytest.raises(LogError, match="calibration"):
        opened(Growing(tmp_path / "b.mcap", data, 9000), [])


def test_what_cannot_be_read_is_said(tmp_path):
    with pytest.raises(LogError, match="no file"):
        open_source(str(tmp_path / "none.mcap"), 1.0)
    (tmp_path / "text.mcap").write_text("this is a text, and no log")
    with pytest.raises(LogError, match="not an MCAP log"):
        open_source(str(tmp_path / "text.mcap"), 1.0)
    (tmp_path / "folder").mkdir()
    with pytest.raises(LogError, match="no .mcap file"):
        open_source(str(tmp_path / "folder"), 1.0)
    (tmp_path / "empty.mcap").write_bytes(b"")
    source = open_source(str(tmp_path / "empty.mcap"), 0.05)
    with pytest.raises(LogError, match="holds no messages"):
        LiveLog(source, READ, open_log).open()
    assert source.ended


def test_a_bag_that_is_split_goes_on_in_its_next_file(tmp_path):
    folder = tmp_path / "bag"
    folder.mkdir()
    first, second = logs.depth_log(100), logs.Log()
    second.items, first.items = first.items[72:], first.items[:72]
    first.write(folder / "bag_0.mcap")
    source = open_source(str(folder), 0.3)

    def frames() -> Iterator[Frame]:
        live = opened(source, [])
        for number, frame in enumerate(live.frames()):
            if number == 0:
                second.write(folder / "bag_1.mcap")
            yield frame

    assert [f.time_ns for f in frames()] == [logs.START + i * logs.PERIOD for i in range(100)]
