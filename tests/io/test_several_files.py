"""One recording is what was recorded together: split bags, files side by side, compressed files and messages."""

import os
from pathlib import Path

import numpy as np
import pytest
import zstandard

from tests.support.logs import PERIOD, START, STORE, Log, depth_log, ros_cloud, ros_tf
from voodoo_jax.batch.log_job import output_places
from voodoo_jax.batch.resume import fingerprint_of
from voodoo_jax.io.log_reader import LogError, read_log, survey
from voodoo_jax.storage.urls import byte_size, expanded

COUNT = 6


def part(items) -> Log:
    log = Log()
    log.items = list(items)
    return log


@pytest.fixture
def whole(tmp_path):
    return read_log(depth_log(COUNT).write(tmp_path / "whole.mcap"))


def split(folder: Path, metadata: str = "block") -> Path:
    """A bag of two files; transforms and calibration in the first one only."""
    folder.mkdir()
    items = depth_log(COUNT).items
    name = folder.name
    part(items[:5]).write(folder / f"{name}_0.mcap")
    part(items[5:]).write(folder / f"{name}_1.mcap")
    lines = {"block": f"\n    - {name}_0.mcap\n    - {name}_1.mcap", "flow": f" [{name}_0.mcap, '{name}_1.mcap']"}
    if metadata:
        text = f"rosbag2_bagfile_information:\n  version: 8\n  relative_file_paths:{lines[metadata]}\n  files: []\n"
        (folder / "metadata.yaml").write_text(text)
    return folder


def assert_same(one, other) -> None:
    assert one.fixed_frame == other.fixed_frame and one.sensors == other.sensors
    for a, b in zip(one, other, strict=True):
        assert a.time_ns == b.time_ns
        np.testing.assert_array_equal(a.points, b.points)


@pytest.mark.parametrize("metadata", ["block", "flow", ""])
def test_a_split_bag_is_one_recording(tmp_path, whole, metadata):
    bag = split(tmp_path / "walk", metadata)
    recording = read_log(bag)
    assert_same(recording, whole)
    assert recording.notes == () and [t.count for t in survey(bag).topics] == [1, COUNT, 1]
    assert expanded(tmp_path) == [str(bag), str(tmp_path / "whole.mcap")]
    assert Path(output_places(str(bag), "out")[0]).name == "walk.tracks.npz"
    files = sorted(str(path) for path in bag.glob("*.mcap"))
    assert byte_size(str(bag)) == sum(os.path.getsize(file) for file in files)
    assert fingerprint_of(str(bag)) not in (fingerprint_of(files[0]), fingerprint_of(files[1]))
    with pytest.raises(LogError, match="one of the 2 files.*folder 'walk'"):
        read_log(files[1])
    assert "give the folder 'walk'" in " ".join(read_log(files[0]).notes)


def test_files_that_are_named_together(tmp_path, whole):
    files = sorted(split(tmp_path / "bag", "").glob("*.mcap"))
    assert_same(read_log(files[::-1]), whole)  # in whatever order
    joined = "+".join(map(str, files))
    assert expanded(joined) == [joined]
    assert_same(read_log(joined), whole)
    assert Path(output_places(joined, "out")[0]).name == "bag_0.tracks.npz"
    plus = depth_log(1).write(tmp_path / "a+b.mcap")  # a name of one file
    assert expanded(plus) == [str(plus)] and len(read_log(plus)) == 1


def test_logs_of_one_folder_that_are_no_bag_stay_apart(tmp_path):
    folder = tmp_path / "day"
    folder.mkdir()
    for name in ("walk_0.mcap", "walk_1.mcap"):
        depth_log(1).write(folder / name)
    assert len(expanded(folder)) == 2


def test_recorders_side_by_side(tmp_path):
    lidar = Log().add("/tf_static", START, ros_tf((START, "base", "lidar", (0, 0, 1.0), (0, 0, 0, 1))))
    for i in range(COUNT):
        stamp = START + i * PERIOD
        lidar.add("/lidar", stamp, ros_cloud(stamp, "lidar", np.full((150, 3), 1.0 + 0.1 * i)))
    files = [depth_log(COUNT).write(tmp_path / "a.mcap"), lidar.write(tmp_path / "b.mcap")]
    recording = read_log(files)
    assert recording.sensors == ("/cam/depth", "/lidar") and len(recording) == COUNT
    assert all(set(frame.sensor.tolist()) == {0, 1} for frame in recording)


def test_a_file_compressed_as_a_whole(tmp_path, whole):
    packed = tmp_path / "whole.mcap.zstd"
    packed.write_bytes(zstandard.ZstdCompressor().compress((tmp_path / "whole.mcap").read_bytes()))
    assert_same(read_log(packed), whole)
    (tmp_path / "whole.mcap").unlink()
    assert expanded(tmp_path) == [str(packed)]
    assert Path(output_places(str(packed), "out")[0]).name == "whole.tracks.npz"
    packed.write_bytes(packed.read_bytes()[:200])
    with pytest.raises(LogError):
        read_log(packed)


def test_messages_compressed_one_by_one(tmp_path, whole):
    log = Log()
    pack = zstandard.ZstdCompressor().compress
    for topic, at, message in depth_log(COUNT).items:
        name = message.__msgtype__
        log.schema_text[name] = STORE.generate_msgdef(name, ros_version=2)[0].encode()
        log.add(topic, at, (name, pack(bytes(STORE.serialize_cdr(message, name)))))
    assert_same(read_log(log.write(tmp_path / "a.mcap")), whole)
