"""Points that a segmentation has assigned to the body or to a limb, and weights of sources, from real logs."""

import numpy as np
import pytest

from tests.support.logs import (
    PERIOD,
    START,
    K,
    Log,
    annotations,
    depth_log,
    foxglove_cloud,
    ros_calibration,
    ros_cloud,
    ros_laser,
    ros_point,
    ros_tf,
    with_field,
)
from voodoo_jax.config.options import ReadSettings, Settings, SettingsError
from voodoo_jax.config.toml import check_settings
from voodoo_jax.io.log_reader import open_log, read_log, survey

RNG = np.random.default_rng(1)
CLOUD = RNG.uniform([1, -1, 0], [3, 1, 2], (60, 3)).astype(np.float32)
HAND = CLOUD[:7] + np.float32(0.5)
LABELS = np.arange(60) % 5  # 0 .. 4
MAKERS = {"ros": ros_cloud, "foxglove": foxglove_cloud}


def parts_of(frame) -> list[str]:
    """The part of each point by name; "" for free."""
    assert frame.part is not None and frame.part.dtype == np.int32 and len(frame.part) == len(frame.points)
    return [frame.parts[k] if k >= 0 else "" for k in frame.part]


def uses(path, settings: ReadSettings) -> dict[str, str]:
    return {t.topic: t.use for t in survey(path, settings).topics}


def two_clouds(tmp_path, count: int = 3):
    log = Log()
    for i in range(count):
        t = START + i * PERIOD
        log.add("/all", t, ros_cloud(t, "base", CLOUD)).add("/hand", t, foxglove_cloud(t, "base", HAND))
    return log.write(tmp_path / "two.mcap")


def test_without_settings_all_is_free_and_weighs_one(tmp_path):
    frame = read_log(two_clouds(tmp_path)).frames[0]
    assert frame.part is None and frame.parts == () and frame.weight is None


def test_topic_of_a_part(tmp_path):
    path = two_clouds(tmp_path)
    settings = ReadSettings(parts=("/hand=l_forearm", "/elsewhere=body"))
    recording = read_log(path, settings)
    for frame in recording:
        assert parts_of(frame) == [""] * 60 + ["l_forearm"] * 7 and frame.parts == ("l_forearm",)
        np.testing.assert_allclose(frame.points[60:], HAND, atol=1e-6)
    assert recording.notes[-1] == "read.parts has no effect: the log has no topic '/elsewhere'."
    assert uses(path, settings) == {"/all": "point cloud", "/hand": "point cloud, points of l_forearm"}
    both = read_log(path, ReadSettings(parts=("/hand=body", "/all=head"))).frames[0]
    assert parts_of(both) == ["head"] * 60 + ["body"] * 7
    other = read_log(path, ReadSettings(topics=("/all",), parts=("/hand=body",)))
    assert other.frames[0].part is None and "not in read.topics" in other.notes[-1]


def test_a_cloud_cut_out_of_a_camera_is_read_beside_its_image(tmp_path):
    log = depth_log(3)
    for i in range(3):
        log.add("/people", START + i * PERIOD, ros_cloud(START + i * PERIOD, "cam_optical", CLOUD))
    path = log.write(tmp_path / "a.mcap")
    assert read_log(path).sensors == ("/cam/depth",)
    recording = read_log(path, ReadSettings(parts=("/people=body",)))
    assert recording.sensors == ("/cam/depth", "/people") and recording.notes == ()
    assert parts_of(recording.frames[2]) == [""] * 767 + ["body"] * 60


def test_a_fast_cloud_of_a_limb_makes_no_frames(tmp_path):
    log = depth_log(5)
    log.add("/tf_static", START, ros_tf((START, "base", "hand", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))))
    for i in range(60):
        t = START - 50_000_000 + i * 4_000_000
        log.add("/hand", t, ros_cloud(t, "hand", HAND))
    path = log.write(tmp_path / "a.mcap")
    recording = read_log(path, ReadSettings(parts=("/hand=l_forearm",)))
    assert [f.time_ns for f in recording] == [START + i * PERIOD for i in range(5)]
    assert all(parts_of(f) == [""] * 767 + ["l_forearm"] * 7 for f in recording)
    only = Log(items=[i for i in log.items if i[0] == "/hand"]).write(tmp_path / "b.mcap")
    recording = read_log(only, ReadSettings(parts=("/hand=l_forearm",)))
    assert len(recording) == 60 and parts_of(recording.frames[0]) == ["l_forearm"] * 7


@pytest.mark.parametrize("kind", ["u1", "i1", "u2", "i2", "i4", "f4", "f8"])
@pytest.mark.parametrize("maker", MAKERS)
def test_label_field(tmp_path, maker, kind):
    cloud = with_field(MAKERS[maker](START, "base", CLOUD), "label", LABELS.astype(kind))
    cloud = with_field(cloud, "after", LABELS.astype("u1"))
    path = Log().add("/seg", START, cloud).write(tmp_path / "a.mcap")
    assert read_log(path).frames[0].part is None
    settings = ReadSettings(labels=("3=head", "1=l_forearm", "4=free", "2=body"))
    recording = read_log(path, settings)
    frame = recording.frames[0]
    assert parts_of(frame) == [["", "l_forearm", "body", "head", ""][k] for k in LABELS]
    assert frame.parts == ("head", "l_forearm", "body")
    np.testing.assert_array_equal(frame.points, CLOUD)
    assert not any("read.labels" in n for n in recording.notes)
    assert uses(path, settings)["/seg"] == "point cloud, parts by its field 'label'"
    asked = read_log(path, ReadSettings(label_field="label")).frames[0]
    assert parts_of(asked) == ["body" if k else "" for k in LABELS]
    other = read_log(path, ReadSettings(label_field="after", labels=("2=head",))).frames[0]
    assert parts_of(other) == ["head" if k == 2 else "" for k in LABELS]


def test_labels_of_big_endian_organised_clouds_stay_with_their_points(tmp_path):
    """`ring` stands before x and holds the same number everywhere; range and thinning take label and point alike."""
    grid = CLOUD.reshape(6, 10, 3).copy()
    grid[2, 3] = np.nan
    grid[0, 0] = [0, 0, 50.0]
    path = Log().add("/p", START, ros_cloud(START, "base", grid, "f8", big=True)).write(tmp_path / "a.mcap")
    frame = read_log(path, ReadSettings(label_field="ring", labels=(f"{0xCDCD}=head",))).frames[0]
    assert parts_of(frame) == ["head"] * 58
    flat = CLOUD.copy()
    flat[6] = np.nan  # not counted among the points whose label has no entry
    cloud = with_field(ros_cloud(START, "base", flat), "object_class", LABELS.astype("u1"))
    path = Log().add("/p", START, cloud).write(tmp_path / "b.mcap")
    recording = read_log(path, ReadSettings(labels=("3=head",), max_points=25))
    frame, rows = recording.frames[0], [i for i in range(0, 60, 3) if i != 6]
    assert sum(LABELS[i] not in (0, 3) for i in rows) == int(recording.notes[-1].split()[1])
    np.testing.assert_array_equal(frame.points, flat[rows])
    assert parts_of(frame) == ["head" if LABELS[i] == 3 else "" for i in rows]


def test_values_without_entry_are_counted(tmp_path):
    values = LABELS.astype("f4")
    values[:3] = [np.nan, 0.5, 1e9]
    log = Log()
    for i in range(2):
        t = START + i * PERIOD
        log.add("/seg", t, with_field(ros_cloud(t, "base", CLOUD), "segment_id", values))
    reader = open_log(log.write(tmp_path / "a.mcap"), ReadSettings(labels=("1=head", "2=head")))
    for _ in range(2):  # reading again does not count twice
        frames = list(reader.frames())
        assert parts_of(frames[1]) == ["head" if v in (1, 2) else "" for v in values]
        (note,) = [n for n in reader.notes if "read.labels" in n]
        assert note.startswith(f"'/seg': {2 * (24 + 3)} points are free because read.labels has no entry")
        assert "'segment_id'" in note and "0.5" in note


def test_no_such_field(tmp_path):
    log = Log().add("/p", START, ros_cloud(START, "base", CLOUD))
    second = with_field(ros_cloud(START, "base", CLOUD), "label", LABELS.astype("u1"))
    path = log.write(tmp_path / "a.mcap")
    for settings in (ReadSettings(label_field="seg"), ReadSettings(labels=("1=body",))):
        recording = read_log(path, settings)
        assert recording.frames[0].part is None and len(recording.frames[0].points) == 60
        assert "so that all points are free: '/p' has x, y, z, ring." in recording.notes[-1]
        assert recording.notes[-1] in survey(path, settings).warnings
    # there, but not in every message
    log = Log().add("/p", START, second).add("/p", START + PERIOD, ros_cloud(START + PERIOD, "base", CLOUD))
    recording = read_log(log.write(tmp_path / "b.mcap"), ReadSettings(label_field="label"))
    assert parts_of(recording.frames[1]) == [""] * 60
    assert "'/p': 1 message without the field 'label': all their points are free." in recording.notes


def test_a_labelled_cloud_comes_before_the_image_of_its_camera(tmp_path):
    log = depth_log(1)
    log.add("/cam/seg", START, with_field(ros_cloud(START, "cam_optical", CLOUD), "label", LABELS.astype("u1")))
    path = log.write(tmp_path / "a.mcap")
    assert read_log(path).sensors == ("/cam/depth",)
    recording = read_log(path, ReadSettings(label_field="label"))
    assert recording.sensors == ("/cam/seg",) and "the same camera as '/cam/seg'" in recording.notes[0]


def test_weights_per_source(tmp_path):
    log = depth_log(2).add("/cam2/info", START, ros_calibration("eye", K))
    level = (0.0, 0.0, 0.0, 1.0)
    log.add("/tf_static", START, ros_tf(*[(START, "base", f, (0.0, 0.0, 1.0), level) for f in ("eye", "l", "c")]))
    log.add("/scan", START, ros_laser(START, "l", 0.0, 0.1, [1.0, 2.0]))
    log.add("/cloud", START, ros_cloud(START, "c", CLOUD))
    log.add("/cam2/found", START, annotations(START, [("face", 15.5, 11.5)]))
    log.add("/marker", START, ros_point(START, "base", (1, 2, 3))).add(
        "/other", START, ros_point(START, "base", (1, 1, 1))
    )
    path = log.write(tmp_path / "a.mcap")
    given = ("/scan=0", "/cloud=0.25", "/cam2/found=3", "/marker=2.5", "/gone=1", "/tf_static=4")
    settings = ReadSettings(laser=True, weights=given)
    recording = read_log(path, settings)
    first, second = recording.frames
    assert recording.sensors == ("/cam/depth", "/cloud", "/scan") and first.weight is not None
    assert first.weight.dtype == np.float32
    np.testing.assert_array_equal(first.weight, np.array([1, 0.25, 0], np.float32)[first.sensor])
    assert (first.sensor == 2).sum() == 2  # nothing is left out for its weight
    assert second.weight is not None and (second.weight == 1).all() and len(second.weight) == 767
    assert first.rays.weights is not None and first.rays.weights.tolist() == [3]
    assert first.pairs.weights is not None and first.pairs.names == ("marker", "other")
    assert first.pairs.weights.tolist() == [2.5, 1]
    assert "read.weights has no effect: the log has no topic '/gone'." in recording.notes
    assert "read.weights has no effect: '/tf_static' is transforms." in recording.notes
    found = uses(path, settings)
    assert found["/cloud"] == "point cloud, weight 0.25" and found["/cam2/found"] == "2D features, weight 3"
    some = read_log(path, ReadSettings(weights=("/marker=2",))).frames[0]
    assert some.weight is None and some.rays.weights is None and some.pairs.weights is not None


@pytest.mark.parametrize(
    "given",
    [
        {"weights": ("/a=-1",)},
        {"weights": ("/a=nan",)},
        {"weights": ("/a=inf",)},
        {"weights": ("/a",)},
        {"parts": ("/a=",)},
        {"parts": ("body",)},
        {"labels": ("head=3",)},
        {"labels": ("3",)},
    ],
)
def test_wrong_texts_are_refused(tmp_path, given):
    ((name, (text,)),) = given.items()
    with pytest.raises(SettingsError, match=f"read.{name}: '{text}' must look like .*, such as"):
        check_settings(Settings(read=ReadSettings(**given)))
    with pytest.raises(SettingsError, match=f"read.{name}"):
        read_log(two_clouds(tmp_path), ReadSettings(**given))
