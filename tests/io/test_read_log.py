"""The log reader: every kind of input, with geometry known to the test."""

import subprocess
import sys

import numpy as np
import pytest

from tests.support.logs import (
    HALF,
    PERIOD,
    START,
    STORE,
    K,
    Log,
    depth_log,
    depth_metres,
    depth_points,
    foxglove_calibration,
    foxglove_cloud,
    foxglove_image,
    foxglove_tf,
    foxglove_tfs,
    in_base,
    ros_calibration,
    ros_cloud,
    ros_image,
    ros_tf,
)
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.geometry import lens
from voodoo_jax.io.log_reader import LogError, open_log, read_log, survey

RNG = np.random.default_rng(0)
CLOUD = RNG.uniform([-1, -1, 0.5], [1, 1, 3], (60, 3))
LEVEL = (0.0, 0.0, 0.0, 1.0)


def base_tf(child: str = "lidar", xyz: tuple = (1.0, 2.0, 0.5), q: tuple = (0.0, 0.0, HALF, HALF)):
    return ros_tf((START, "base", child, xyz, q))


def turned(points):
    """What `base_tf` does: a quarter turn to the left, then the shift."""
    return np.column_stack([-points[:, 1], points[:, 0], points[:, 2]]) + [1.0, 2.0, 0.5]


def cloud_log(message, tf=None) -> Log:
    log = Log().add("/anything/goes", START, message)
    return log if tf is None else log.add("/my/tf_static", START + 5 * 10**9, tf)


def close(a, b):
    np.testing.assert_allclose(a, b, atol=1e-5, rtol=0)


@pytest.mark.parametrize("encoding, padding, big", [("16UC1", 0, False), ("32FC1", 10, False), ("16UC1", 3, True)])
def test_depth_image(tmp_path, encoding, padding, big):
    log = Log()
    for i in range(3):  # calibration and transform only after the images
        log.add("/d", START + i, ros_image(START + i * PERIOD, "cam_optical", depth_metres(i), encoding, padding, big))
    log.add("/elsewhere/info", START + 10, ros_calibration("cam_optical"))
    log.add("/tf_static", START + 11, depth_log(0).items[0][2])
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert recording.fixed_frame == "base" and recording.sensors == ("/d",) and recording.notes == ()
    assert [f.time_ns for f in recording] == [START + i * PERIOD for i in range(3)]
    np.testing.assert_array_equal(recording.up, [0, 0, 1])
    for i, frame in enumerate(recording):
        close(frame.points, in_base(depth_points(depth_metres(i))))
        close(frame.origins, [[0, 0, 1.25]])
        assert frame.points.dtype == np.float32 and frame.sensor.dtype == np.int32 and not frame.sensor.any()


def test_mono16_is_depth_only_with_calibration_and_if_nothing_better(tmp_path):
    log = Log().add("/cam/image", START, ros_image(START, "c", depth_metres(), "mono16"))
    with pytest.raises(LogError, match="without calibration"):
        read_log(log.write(tmp_path / "a.mcap"))
    log.add("/cam/camera_info", START, ros_calibration("another_frame"))
    assert len(read_log(log.write(tmp_path / "b.mcap")).frames[0].points) == 767
    log.add("/cam/z_depth", START, ros_image(START, "c", depth_metres()))
    assert read_log(log.write(tmp_path / "c.mcap")).sensors == ("/cam/z_depth",)


@pytest.mark.parametrize("kind", ["f4", "f8"])
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("organised", [False, True])
def test_ros_cloud(tmp_path, kind, big, organised):
    points = CLOUD.reshape(6, 10, 3).copy() if organised else CLOUD.copy()
    flat = points.reshape(-1, 3)
    flat[3] = np.nan
    flat[7] = 0.0
    flat[9, 1] = np.inf
    flat[11] = [0, 0, 50.0]  # out of range
    message = ros_cloud(START, "lidar", points, kind, big, point_padding=7, row_padding=13 if organised else 0)
    frame = read_log(cloud_log(message, base_tf()).write(tmp_path / "a.mcap")).frames[0]
    close(frame.points, turned(np.delete(flat, [3, 7, 9, 11], axis=0)))
    close(frame.origins, [[1, 2, 0.5]])


def test_foxglove_cloud_with_pose_and_transforms(tmp_path):
    pose = ((0.1, 0.2, 0.3), (0.0, 0.0, HALF, HALF))
    log = Log().add("/p", START, foxglove_cloud(START, "lidar", CLOUD, pose, padding=5))
    log.add("/t", START, foxglove_tfs(foxglove_tf(START - 10**10, "base", "lidar", (0.0, 0.0, 2.0), LEVEL)))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    expected = np.column_stack([-CLOUD[:, 1], CLOUD[:, 0], CLOUD[:, 2]]) + [0.1, 0.2, 2.3]
    close(recording.frames[0].points, expected)
    close(recording.frames[0].origins, [[0.1, 0.2, 2.3]])
    assert recording.notes == ()


def test_foxglove_depth_image(tmp_path):
    for encoding in ("16UC1", "mono16", "32FC1"):
        log = Log().add("/i", START, foxglove_image(START, "cam_optical", depth_metres(), encoding))
        log.add("/c", START, foxglove_calibration("cam_optical"))
        log.add("/t", START, foxglove_tf(START, "base", "cam_optical", (0.0, 0.0, 1.25), (-0.5, 0.5, -0.5, 0.5)))
        close(read_log(log.write(tmp_path / "a.mcap")).frames[0].points, in_base(depth_points(depth_metres())))


def test_idl_schema(tmp_path):
    def idl(package: str, name: str, members: str, before: str = "") -> str:
        body = f"{before}module {package} {{ module msg {{ struct {name} {{ {members} }}; }}; }};"
        return f"{'=' * 80}\nIDL: {package}/msg/{name}\n{body}\n"

    def include(name: str) -> str:
        return f'// generated from {name}.msg\n\n#include "{name}.idl"\n\n'

    text = idl("builtin_interfaces", "Time", "int32 sec; uint32 nanosec;")
    text = idl("std_msgs", "Header", "builtin_interfaces::msg::Time stamp; string frame_id;") + text
    members = "std_msgs::msg::Header header; uint32 height; uint32 width; string encoding; uint8 is_bigendian; "
    text = (
        idl("sensor_msgs", "Image", members + "uint32 step; sequence<uint8> data;", include("std_msgs/msg/Header"))
        + text
    )
    log = Log(schema_text={"sensor_msgs/msg/Image": text.encode()}, schema_encoding="ros2idl")
    log.add("/cam/depth", START, ros_image(START, "cam", depth_metres()))
    log.add("/cam/info", START, foxglove_calibration("cam"))
    close(read_log(log.write(tmp_path / "a.mcap")).frames[0].points, depth_points(depth_metres()))


def test_moving_sensor_is_interpolated(tmp_path):
    log = Log()
    quarter = (0.0, 0.0, HALF, HALF)
    log.add("/tf", START, ros_tf((START, "map", "base", (0.0, 0.0, 0.0), LEVEL)))
    log.add("/tf", START, ros_tf((START + 10**9, "map", "base", (1.0, 0.0, 0.0), quarter)))
    log.add("/tf_static", START, ros_tf((0, "base", "lidar", (0.0, 0.0, 1.0), LEVEL)))
    offsets = np.array([-0.6, -0.4, 0.25, 1.0, 1.4, 1.6])
    stamps = [START + int(s * 1e9) for s in offsets]
    for stamp in stamps:
        log.add("/p", stamp, ros_cloud(stamp, "lidar", CLOUD, "f8"))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert recording.fixed_frame == "map"
    assert [f.time_ns for f in recording] == stamps[1:5]
    assert any("2 messages left out, no transform from 'lidar' to 'map'" in n for n in recording.notes)
    for frame, s in zip(recording, np.clip(offsets[1:5], 0, 1)):
        c, d = np.cos(s * np.pi / 2), np.sin(s * np.pi / 2)
        close(frame.points, CLOUD @ np.array([[c, -d, 0], [d, c, 0], [0, 0, 1]]).T + [s, 0, 1])
        close(frame.origins, [[s, 0, 1]])
    in_base_frame = read_log(tmp_path / "a.mcap", ReadSettings(fixed_frame="base"))
    close(in_base_frame.frames[0].points, CLOUD + [0, 0, 1])
    assert len(in_base_frame) == 6


def test_transient_local_topic_is_static(tmp_path):
    log = Log(metadata={"/fixed": {"offered_qos_profiles": "- history: 3\n  durability: 1\n"}})
    log.add("/fixed", START, ros_tf((1, "base", "lidar", (0.0, 0.0, 1.0), LEVEL)))
    log.add("/fixed", START, ros_tf((2, "base", "lidar", (0.0, 0.0, 2.0), LEVEL)))
    log.add("/p", START, ros_cloud(START, "lidar", CLOUD))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    close(recording.frames[0].origins, [[0, 0, 2]])
    assert any("last value" in n for n in recording.notes)


def two_sensors(fast, slow) -> Log:
    log = Log().add("/tf_static", START, base_tf("a"))
    log.add("/tf_static", START, ros_tf((START, "base", "b", (0.0, 0.0, 0.0), LEVEL)))
    for t in fast:
        log.add("/a", START + t, ros_cloud(START + t, "a", CLOUD))
    for t in slow:
        log.add("/b", START + t, ros_cloud(START + t, "b", CLOUD[:5]))
    return log


def test_two_sensors_at_different_rates(tmp_path):
    fast = [i * PERIOD for i in range(30)]
    slow = [i * 3 * PERIOD + 4_000_000 for i in range(10)]
    recording = read_log(two_sensors(fast, slow).write(tmp_path / "a.mcap", chunk_size=3000))
    assert recording.sensors == ("/a", "/b") and [f.time_ns - START for f in recording] == fast
    for i, frame in enumerate(recording):
        close(frame.points[frame.sensor == 0], turned(CLOUD))
        assert (frame.sensor == 1).sum() == (5 if i % 3 == 0 else 0)
        close(frame.origins, [[1, 2, 0.5], [0, 0, 0]])
    close(recording.frames[3].points[60:], CLOUD[:5])


def test_pause_of_the_leading_sensor(tmp_path):
    fast = [i * PERIOD for i in range(30) if not 10 < i < 20]
    slow = [i * 2 * PERIOD for i in range(20)]  # also goes on after the leading one has ended
    recording = read_log(two_sensors(fast, slow).write(tmp_path / "a.mcap"))
    assert [f.time_ns - START for f in recording] == sorted({*fast, *slow})
    assert sum((f.sensor == 1).sum() for f in recording) == 5 * len(slow)
    assert sum((f.sensor == 0).sum() for f in recording) == 60 * len(fast)


def test_equal_rates_first_name_leads(tmp_path):
    times = [i * PERIOD for i in range(20)]
    recording = read_log(
        two_sensors(times, [t + 5_000_000 - i % 2 * 99_000 for i, t in enumerate(times)]).write(tmp_path / "a")
    )
    assert [f.time_ns - START for f in recording] == times
    assert all(len(f.points) == 65 for f in recording)


def test_image_and_cloud_of_one_camera_are_used_once(tmp_path):
    log = depth_log(4)
    for i in range(4):
        points = depth_points(depth_metres(i))
        log.add("/cam/points", START + i * PERIOD, ros_cloud(START + i * PERIOD, "cam_optical", points))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert recording.sensors == ("/cam/depth",)
    assert any("'/cam/points' is left out: it is the same camera as '/cam/depth'" in n for n in recording.notes)
    assert read_log(tmp_path / "a.mcap", ReadSettings(topics=("/cam/points",))).sensors == ("/cam/points",)
    with pytest.raises(LogError, match="no depth topic '/cam/dept'.*/cam/depth, /cam/points"):
        read_log(tmp_path / "a.mcap", ReadSettings(topics=("/cam/dept",)))


def test_two_logs_at_once_and_streaming(tmp_path):
    a = open_log(depth_log(6).write(tmp_path / "a.mcap", chunk_size=4000))
    b = open_log(cloud_log(ros_cloud(START, "lidar", CLOUD), base_tf()).write(tmp_path / "b.mcap"))
    first = a.frames()
    one = next(first)
    close(next(b.frames()).points, turned(CLOUD))
    rest = list(first)
    close(rest[-1].points, in_base(depth_points(depth_metres(5))))
    assert len(a) == 1 + len(rest) == 6
    np.testing.assert_array_equal(next(a.frames()).points, one.points)  # can be read again
    assert len(read_log(tmp_path / "b.mcap")) == 1


def test_downsampling_and_range(tmp_path):
    path = depth_log(1).write(tmp_path / "a.mcap")
    few = read_log(path, ReadSettings(max_points=200)).frames[0].points
    close(few, in_base(depth_points(np.where((np.mgrid[0:24, 0:32] % 2 == 0).all(0), depth_metres(), 0.0))))
    ranged = read_log(path, ReadSettings(min_range=1.7, max_range=2.0)).frames[0]
    distance = np.linalg.norm(ranged.points - ranged.origins[0], axis=1)
    assert 0 < len(distance) < 767 and distance.min() >= 1.7 - 1e-6 and distance.max() <= 2.0 + 1e-6
    nothing = read_log(path, ReadSettings(max_range=0.5))
    assert nothing.frames[0].points.shape == (0, 3) and nothing.frames[0].sensor.shape == (0,)
    cloud = read_log(cloud_log(ros_cloud(START, "l", CLOUD)).write(tmp_path / "b"), ReadSettings(max_points=25))
    close(cloud.frames[0].points, CLOUD[::3])


def test_stamps(tmp_path):
    order = [0, 2, 1, 3, 3, 4]
    log = Log()
    for i, k in enumerate(order):
        log.add("/p", START + i * PERIOD, ros_cloud(START + k * PERIOD, "l", CLOUD + k * 0.01, "f8"))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert [f.time_ns for f in recording] == [START + k * PERIOD for k in range(5)]
    for k, frame in enumerate(recording):
        close(frame.points, CLOUD + k * 0.01)
    assert any("backwards at 1 place" in n for n in recording.notes)
    assert any("1 message with the stamp of another" in n for n in recording.notes)
    for stamp in (0, 5):  # no stamp at all, a clock that stands still
        log = Log()
        for i in range(5):
            log.add("/p", START + i * PERIOD, foxglove_cloud(stamp, "l", CLOUD))
        recording = read_log(log.write(tmp_path / "b.mcap"))
        assert [f.time_ns for f in recording] == [START + i * PERIOD for i in range(5)]
        assert any("log time is used" in n for n in recording.notes)


def test_without_transforms(tmp_path):
    recording = read_log(cloud_log(ros_cloud(START, "lidar", CLOUD)).write(tmp_path / "a.mcap"))
    assert recording.fixed_frame == "lidar" and any("no transforms" in n for n in recording.notes)
    np.testing.assert_array_equal(recording.up, [0, 0, 1])
    close(recording.frames[0].points, CLOUD)
    log = Log(items=[item for item in depth_log(2).items if item[0] != "/tf_static"])
    recording = read_log(log.write(tmp_path / "b.mcap"))
    np.testing.assert_array_equal(recording.up, [0, -1, 0])


def test_up_of_an_optical_frame(tmp_path):
    path = depth_log(2).write(tmp_path / "a.mcap")
    close(read_log(path, ReadSettings(fixed_frame="cam_optical")).up, [0, -1, 0])


def test_transform_missing(tmp_path):
    log = two_sensors([0, PERIOD], [])
    log.add("/c", START, ros_cloud(START, "island", CLOUD))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert recording.sensors == ("/a",)
    assert any("'/c' is left out: no transform between 'island' and 'base'" in n for n in recording.notes)
    log = cloud_log(ros_cloud(START, "island", CLOUD), base_tf())
    with pytest.raises(LogError, match=r"no depth sensor is in the transform tree.*island.*base, lidar"):
        read_log(log.write(tmp_path / "b.mcap"))
    close(read_log(tmp_path / "b.mcap", ReadSettings(fixed_frame="island")).frames[0].points, CLOUD)
    with pytest.raises(LogError, match="no frame 'nowhere'. Its frames: base, island, lidar"):
        read_log(tmp_path / "b.mcap", ReadSettings(fixed_frame="nowhere"))
    with pytest.raises(LogError, match="connected to the fixed frame 'base'"):
        read_log(tmp_path / "b.mcap", ReadSettings(fixed_frame="base"))


def test_calibration_missing_or_empty(tmp_path):
    log = Log(items=[item for item in depth_log(2).items if item[0] != "/cam/camera_info"])
    with pytest.raises(LogError, match=r"'/cam/depth' is a depth image without calibration \(none for frame"):
        read_log(log.write(tmp_path / "a.mcap"))
    log.add("/cam/camera_info", START, ros_calibration("cam_optical", np.zeros((3, 3))))
    with pytest.raises(LogError, match="not calibrated"):
        read_log(log.write(tmp_path / "b.mcap"))
    log.add("/p", START, ros_cloud(START, "base", CLOUD))
    recording = read_log(log.write(tmp_path / "c.mcap"))
    assert recording.sensors == ("/p",) and any("'/cam/depth' is left out" in n for n in recording.notes)


def test_no_depth(tmp_path):
    rgb = ros_image(START, "c", depth_metres())
    rgb.encoding = "rgb8"
    log = Log().add("/rgb", START, rgb).add("/tf_static", START, base_tf())
    point = STORE.types["geometry_msgs/msg/Point"](1.0, 2.0, 3.0)
    log.add("/point", START, point)
    with pytest.raises(LogError, match="has no depth data.*encoding rgb8.*Needed is a depth image"):
        read_log(log.write(tmp_path / "a.mcap"))
    found = {t.topic: t.use for t in survey(tmp_path / "a.mcap").topics}
    assert found["/rgb"] == "not used: encoding rgb8 is not a depth image"
    assert found["/point"].startswith("not used") and found["/tf_static"] == "transforms"


def test_survey(tmp_path):
    result = survey(depth_log(7).write(tmp_path / "a.mcap"))
    assert {t.topic: (t.count, t.use) for t in result.topics} == {
        "/cam/camera_info": (1, "calibration"),
        "/cam/depth": (7, "depth image"),
        "/tf_static": (1, "transforms"),
    }
    assert result.start_ns == START and result.duration == pytest.approx(6 * 0.033) and result.warnings == ()
    assert "/cam/depth" in str(result) and "depth image" in str(result) and "0.20 s" in str(result)


@pytest.mark.parametrize(
    "model, d",
    [
        ("plumb_bob", (-0.28, 0.07, 0.0002, -0.0005, 0.0)),
        ("rational_polynomial", (0.46, -2.6, 0.0006, -0.0002, 1.5, 0.34, -2.4, 1.43)),
        ("equidistant", (0.02, -0.01, 0.003, -0.0005)),
        ("kannala_brandt", (-0.03, 0.01, 0.0, 0.0)),
        ("plumb_bob", (0.0, 0.0, 0.0, 0.0, 0.0)),
    ],
)
def test_pixel_rays_invert_the_lens(tmp_path, model, d):
    k = np.array([[40.0, 0, 31.5], [0, 42.0, 23.5], [0, 0, 1]])
    rays = lens.pixel_rays(k, np.array(d), model, 64, 48)
    assert rays.shape == (48, 64, 2) and np.isfinite(rays).all()
    seen = lens.distort(rays, np.array(d), model) @ k[:2, :2].T + k[:2, 2]
    v, u = np.mgrid[0:48, 0:64]
    np.testing.assert_allclose(seen, np.stack([u, v], -1), atol=1e-5)


def test_lens_of_a_depth_image_is_undone(tmp_path):
    d = (-0.3, 0.1, 0.001, 0.0, 0.0)
    log = Log().add("/cam/depth", START, ros_image(START, "c", depth_metres()))
    log.add("/cam/info", START, ros_calibration("c", K, d))
    points = read_log(log.write(tmp_path / "a.mcap")).frames[0].points.astype(float)
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    q = x * x + y * y
    radial = 1 + d[0] * q + d[1] * q * q  # written out here once more, as the independent word on the model
    u = K[0, 0] * (x * radial + 2 * d[2] * x * y) + K[0, 2]
    v = K[1, 1] * (y * radial + d[2] * (q + 2 * y * y)) + K[1, 2]
    rows, columns = np.nonzero(depth_metres())
    np.testing.assert_allclose(np.column_stack([u, v]), np.column_stack([columns, rows]), atol=1e-3)
    log.items[1] = ("/cam/info", START, ros_calibration("c", K, (1.0,), "catadioptric"))
    with pytest.raises(LogError, match="lens model 'catadioptric' is unknown"):
        read_log(log.write(tmp_path / "b.mcap"))


def test_reader_does_not_import_jax():
    code = "import sys, voodoo_jax.io.log_reader; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
