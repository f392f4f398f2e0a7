"""Named features of a log: rays through calibrated cameras, 3D points, laser scans, with geometry known to the test."""

from dataclasses import dataclass

import numpy as np
import pytest

from tests.support.logs import (
    DETECTIONS,
    HALF,
    PERIOD,
    START,
    Log,
    annotations,
    depth_log,
    detections,
    foxglove_calibration,
    foxglove_laser,
    foxglove_tf,
    poses_in_frame,
    ros_calibration,
    ros_laser,
    ros_marker,
    ros_markers,
    ros_point,
    ros_pose,
    ros_tf,
    scene,
)
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.geometry import lens
from voodoo_jax.io.log_reader import LogError, open_log, read_log, survey
from voodoo_jax.records.recording import Frame

K = np.array([[300.0, 0.0, 159.5], [0.0, 310.0, 119.5], [0.0, 0.0, 1.0]])
SIZE = (240, 320)
OPTICAL = (-0.5, 0.5, -0.5, 0.5)
EYE = np.array([0.2, -0.1, 1.4])  # of the colour camera in `base`, looking along x
FACE, HAND = np.array([2.0, 0.3, 1.7]), np.array([1.8, -0.6, 1.1])  # in `base`


@dataclass(frozen=True)
class WithLaser(ReadSettings):
    laser: bool = True


def pixel(point, d=(), model="plumb_bob") -> np.ndarray:
    """Where the colour camera sees a point of `base`, lens included."""
    x, y, z = np.asarray(point) - EYE
    ray = np.array([-y, -z]) / x
    return K[:2, :2] @ (lens.distort(ray, np.array(d), model) if d else ray) + K[:2, 2]


def colour(log: Log, d=(), model="plumb_bob") -> Log:
    log.add("/tf_static", START, ros_tf((START, "base", "colour", tuple(EYE), OPTICAL)))
    return log.add("/colour/camera_info", START, ros_calibration("colour", K, d, model, SIZE))


def add_detections(log: Log, topic: str, stamp: int, frame: str, items: list, version: int = 4) -> Log:
    name, data, text = detections(stamp, frame, items, version)
    log.schema_text[name] = text
    return log.add(topic, stamp, (name, data))


def check_ray(frame: Frame, name: str, point) -> None:
    i = frame.rays.names.index(name)
    to = np.asarray(point) - frame.rays.origins[i]
    d = frame.rays.directions[i]
    np.testing.assert_allclose(frame.rays.origins[i], EYE, atol=1e-6)
    np.testing.assert_allclose([np.linalg.norm(d), np.linalg.norm(to - (to @ d) * d)], [1, 0], atol=1e-5)
    assert to @ d > 0 and d.dtype == np.float32 and frame.rays.origins.dtype == np.float32


def pairs(frame: Frame) -> dict[str, list[float]]:
    assert frame.pairs.points.shape == (len(frame.pairs.names), 3) and frame.pairs.points.dtype == np.float32
    return {name: np.round(p.astype(float), 5).tolist() for name, p in zip(frame.pairs.names, frame.pairs.points)}


LENSES = [
    ("plumb_bob", ()),
    ("plumb_bob", (-0.28, 0.07, 0.0002, -0.0005, 0.0)),
    ("rational_polynomial", (0.46, -2.6, 0.0006, -0.0002, 1.5, 0.34, -2.4, 1.43)),
    ("equidistant", (0.02, -0.01, 0.003, -0.0005)),
]


@pytest.mark.parametrize("model, d", LENSES)
def test_detection_is_a_ray_through_the_point(tmp_path, model, d):
    log = colour(depth_log(2), d, model)
    best = [("left_hand", 0.2), ("face", 0.9), ("right_hand", 0.3)]
    add_detections(log, "/colour/detections", START, "colour", [(best, *pixel(FACE, d, model))])
    add_detections(log, "/colour/detections", START + PERIOD, "colour", [([("hand", 1.0)], *pixel(HAND, d, model))])
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert recording.features == ("/colour/detections",) and recording.sensors == ("/cam/depth",)
    assert recording.notes == () and [f.rays.names for f in recording] == [("face",), ("hand",)]
    check_ray(recording.frames[0], "face", FACE)
    check_ray(recording.frames[1], "hand", HAND)
    assert all(len(f.points) == 767 and f.pairs.names == () for f in recording)


def test_scores_of_a_pose_nets_key_points_weigh_them(tmp_path):
    """As much as they say; a detector's scores say nothing, for it has its own scale."""
    net = [("left_shoulder", 0.9), ("left_elbow", 0.5), ("left_wrist", 0.2), ("left_hip", 1.0), ("left_knee", 0.7)]
    items = [([one], *pixel(FACE)) for one in net]
    log = add_detections(colour(depth_log(1)), "/net", START, "colour", items)
    add_detections(log, "/faces", START, "colour", [([("face", 0.3)], *pixel(FACE))])
    rays = read_log(log.write(tmp_path / "a.mcap"), ReadSettings(weights=("/net=2",))).frames[0].rays
    weights = dict(zip(rays.names, rays.weights.tolist()))
    assert weights == pytest.approx({name: 2 * score for name, score in net} | {"face": 1.0})


@pytest.mark.parametrize("version", [2, 3, 4])
def test_releases_of_vision_msgs(tmp_path, version):
    items = [([("face", 0.8), ("hand", 0.7)], *pixel(FACE)), ([], 3.0, 4.0), ([("hand", np.nan)], *pixel(HAND))]
    log = add_detections(colour(depth_log(1)), "/elsewhere/found", START, "colour", items, version)
    frame = read_log(log.write(tmp_path / "a.mcap")).frames[0]
    assert frame.rays.names == ("face", "hand")
    check_ray(frame, "face", FACE)
    check_ray(frame, "hand", HAND)


@pytest.mark.parametrize("kind", ["circles", "points", "boxes"])
def test_image_annotations(tmp_path, kind):
    log = colour(depth_log(3))
    for i in (0, 2):
        items = [("face", *pixel(FACE)), ("hand", *pixel(HAND))]
        # Logged a while after the picture was taken: their own stamps say when.
        log.add("/colour/found", START + 10**9, annotations(START + i * PERIOD, items, kind))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert [f.rays.names for f in recording] == [("face", "hand"), (), ("face", "hand")] and recording.notes == ()
    check_ray(recording.frames[2], "face", FACE)
    check_ray(recording.frames[2], "hand", HAND)


def test_camera_of_annotations(tmp_path):
    """By namespace, else the one that is no depth sensor's, else none."""
    note = annotations(START, [("face", *pixel(FACE))])
    frame = read_log(colour(depth_log(1)).add("/found", START, note).write(tmp_path / "a.mcap")).frames[0]
    check_ray(frame, "face", FACE)
    log = colour(depth_log(1)).add("/third/camera_info", START, ros_calibration("colour", 2 * K, size=SIZE))
    recording = read_log(log.add("/found", START, note).write(tmp_path / "b.mcap"))
    assert recording.features == () and recording.frames[0].rays.names == ()
    assert any("'/found' is left out: 2D features without calibration" in n for n in recording.notes)
    log.items[-1] = ("/colour/found", START, note)
    check_ray(read_log(log.write(tmp_path / "c.mcap")).frames[0], "face", FACE)
    only = depth_log(1).add("/found", START, note)  # the only camera there is, though it is the depth camera
    assert read_log(only.write(tmp_path / "d.mcap")).frames[0].rays.names == ("face",)


def test_detections_without_calibration_or_with_a_bad_one(tmp_path):
    log = add_detections(depth_log(1), "/x/found", START, "nowhere", [([("face", 1.0)], 3.0, 4.0)])
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert recording.notes == ("'/x/found' is left out: 2D features without calibration (none for frame 'nowhere').",)
    assert {t.topic: t.use for t in survey(tmp_path / "a.mcap").topics}["/x/found"].startswith("not used: 2D features")
    log.add("/x/info", START, ros_calibration("nowhere", np.zeros((3, 3))))
    notes = read_log(log.write(tmp_path / "b.mcap")).notes
    assert any("whose calibration is unusable: the focal length is 0" in n for n in notes)
    log.items[-1] = ("/x/info", START, ros_calibration("nowhere", K))
    recording = read_log(log.write(tmp_path / "c.mcap"))
    assert recording.features == () and "no transform between 'nowhere' and 'base'" in recording.notes[-1]


def test_rectified_pixels_have_no_lens(tmp_path):
    log = colour(depth_log(1), (-0.3, 0.1, 0.0, 0.0, 0.0))
    add_detections(log, "/colour/image_rect/found", START, "colour", [([("face", 1.0)], *pixel(FACE))])
    check_ray(read_log(log.write(tmp_path / "a.mcap")).frames[0], "face", FACE)


def test_marker_array_some_missing(tmp_path):
    log = depth_log(3).add("/tf_static", START, ros_tf((START, "base", "lab", (1.0, 0.0, 0.0), (0.0, 0.0, HALF, HALF))))
    for i in range(3):
        t = START + i * PERIOD
        made = [ros_marker(t, "lab", "LWRI", (1, 2, 3)), ros_marker(t, "base", "RWRI", (i, 0, 0.5))]
        if i == 1:
            made[0] = ros_marker(t, "lab", "LWRI", (0, 0, 0), alpha=0.0)
        made.append(ros_marker(t, "lab", "C7", (np.nan if i == 2 else 1, 0, 0)))
        made.append(ros_marker(t, "lab", "gone", (5, 5, 5)))
        made.append(ros_marker(t, "lab", "gone", (0, 0, 0), action=2))
        made.append(ros_marker(t, "lab", "", (0, 0, 1), id=9, text="T10"))
        log.add("/mocap", t, ros_markers(*made))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    left, c7, t10 = {"LWRI": [-1, 1, 3]}, {"C7": [1, 1, 0]}, {"T10": [1, 0, 1]}
    assert [pairs(f) for f in recording] == [
        left | {"RWRI": [0, 0, 0.5]} | c7 | t10,
        {"RWRI": [1, 0, 0.5]} | c7 | t10,
        left | {"RWRI": [2, 0, 0.5]} | t10,
    ]
    assert recording.features == ("/mocap",) and recording.notes == ()


def test_markers_of_one_namespace_are_told_apart_throughout(tmp_path):
    log = Log()
    for i in range(3):
        t = START + i * PERIOD
        made = [ros_marker(t, "lab", "hand", (1, 0, 0), 3), ros_marker(t, "lab", "hand", (2, 0, 0), 4, text="tip")]
        cloud = ros_marker(t, "lab", "foot", (0, 0, 1), type=7, points=[(1, 0, 0), (0, 1, 0)], q=(0, 0, HALF, HALF))
        log.add("/m", t, ros_markers(*made[: 1 if i == 2 else 2], cloud))
        log.add("/single", t, ros_marker(t, "lab", "nose", (0, 0, 2), id=i))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    feet = {"foot/0/0": [0, 1, 1], "foot/0/1": [-1, 0, 1], "nose": [0, 0, 2]}
    assert pairs(recording.frames[0]) == {"hand/3": [1, 0, 0], "hand/tip": [2, 0, 0]} | feet
    assert pairs(recording.frames[2]) == {"hand/3": [1, 0, 0]} | feet
    log = Log().add(
        "/m",
        START,
        ros_markers(ros_marker(START, "lab", "a", (1, 1, 1)), ros_marker(START, "lab", "", (0, 0, 0), action=3)),
    )
    with pytest.raises(LogError, match="have no names"):
        read_log(log.write(tmp_path / "b.mcap"))


def test_points_poses_and_scenes(tmp_path):
    log = depth_log(1)
    log.add("/markers/l_wrist", START, ros_point(START, "base", (1, 2, 3)))
    log.add("/markers/head/", START, ros_pose(START, "base", (0, 0, 1.5)))
    log.add("/toes", START, poses_in_frame(START, "base", [(1, 1, 0), (2, 1, 0)]))
    log.add("/heel", START, poses_in_frame(START, "base", [(3, 1, 0)]))
    entities = [
        ("knee", "spheres", [(1, 0, 0.5)]),
        ("hip", "cubes", [(1, 0, 1.0)]),
        ("ear", "texts", [(1, 0, 1.6)]),
        ("toe", "spheres", [(1, 0, 0), (1.5, 0, 0)]),
    ]
    log.add("/scene", START, scene(START, "base", entities))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert recording.features == ("/heel", "/markers/head/", "/markers/l_wrist", "/scene", "/toes")
    assert pairs(recording.frames[0]) == {
        "l_wrist": [1, 2, 3],
        "head": [0, 0, 1.5],
        "toes/0": [1, 1, 0],
        "toes/1": [2, 1, 0],
        "heel": [3, 1, 0],
        "knee": [1, 0, 0.5],
        "hip": [1, 0, 1],
        "ear": [1, 0, 1.6],
        "toe/0": [1, 0, 0],
        "toe/1": [1.5, 0, 0],
    }
    uses = {t.use for t in survey(tmp_path / "a.mcap").topics}
    assert uses == {"calibration", "depth image", "named points", "transforms"}


def test_nearest_in_time_and_one_per_name(tmp_path):
    log = depth_log(4)
    for ms, x in [(-3, 0), (8, 1), (14, 2), (35, 3), (55, 4), (90, 5), (99 + 17, 6)]:
        log.add("/p", START + ms * 10**6, ros_point(START + ms * 10**6, "base", (x, 0, 0)))
    log.add("/q", START + 5, ros_point(START, "base", (9, 0, 0)))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    # Frames at 0, 33, 66, 99 ms: -3 beats 8 and 14, 116 comes more than half a period after the last.
    got = [pairs(f).get("p", [None])[0] for f in recording]
    assert got == [0, 3, 4, 5] and pairs(recording.frames[0])["q"] == [9, 0, 0]
    assert recording.notes == ("'/p': 1 feature left out, with no frame near in time.",)


def test_the_surer_of_two_with_one_name(tmp_path):
    items = [([("face", 0.4)], *pixel(HAND)), ([("face", 0.6)], *pixel(FACE)), ([("face", 0.5)], 3.0, 4.0)]
    log = add_detections(colour(depth_log(1)), "/colour/found", START, "colour", items)
    frame = read_log(log.write(tmp_path / "a.mcap")).frames[0]
    assert frame.rays.names == ("face",)
    check_ray(frame, "face", FACE)


def test_features_lead_without_depth(tmp_path):
    log = Log()
    for i in range(30):
        t = START + i * 8_333_333
        log.add("/markers", t, ros_markers(ros_marker(t, "lab", "C7", (i, 0, 1))))
        if i % 4 == 0:
            log.add("/slow", t, ros_point(t + 10**6, "lab", (0, i, 0)))
    reader = open_log(log.write(tmp_path / "a.mcap"))
    frames = list(reader.frames())
    assert len(reader) == 30 and reader.features == ("/markers", "/slow")
    assert reader.sensors == () and reader.fixed_frame == "lab" and reader.up.tolist() == [0, 0, 1]
    for i, frame in enumerate(frames):
        assert frame.time_ns == START + i * 8_333_333
        assert frame.points.shape == (0, 3) and frame.sensor.shape == (0,) and frame.origins.tolist() == [[0, 0, 0]]
        assert pairs(frame) == {"C7": [i, 0, 1]} | ({"slow": [0, i, 0]} if i % 4 == 0 else {})
    with pytest.raises(LogError, match="has no depth data. It has.*Needed is a depth image"):
        read_log(tmp_path / "a.mcap", ReadSettings(features=False))


def test_rays_alone(tmp_path):
    log = colour(Log())
    for i in range(3):
        items = [([("face", 1.0)], *pixel(FACE))] if i != 1 else []
        add_detections(log, "/colour/found", START + i * PERIOD, "colour", items)
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert [f.rays.names for f in recording] == [("face",), (), ("face",)] and recording.fixed_frame == "base"
    check_ray(recording.frames[2], "face", FACE)
    log = Log(items=[i for i in log.items if i[0] != "/tf_static"], schema_text=log.schema_text)
    recording = read_log(log.write(tmp_path / "b.mcap"))
    assert recording.fixed_frame == "colour" and recording.up.tolist() == [0, -1, 0]


def test_features_can_be_switched_off(tmp_path):
    path = depth_log(2).write(tmp_path / "a.mcap")
    plain = read_log(path)
    log = colour(depth_log(2)).add("/p", START, ros_point(START, "base", (1, 2, 3)))
    add_detections(log, "/colour/found", START, "colour", [([("face", 1.0)], 3.0, 4.0)])
    off = read_log(log.write(tmp_path / "b.mcap"), ReadSettings(features=False))
    assert off.features == () and off.notes == plain.notes and off.sensors == plain.sensors
    for a, b in zip(off, plain):
        np.testing.assert_array_equal(a.points, b.points)
        assert a.rays.names == () and a.pairs.names == ()
    uses = {t.topic: t.use for t in survey(tmp_path / "b.mcap", ReadSettings(features=False)).topics}
    assert uses["/p"] == uses["/colour/found"] == "not used: no depth, calibration or transforms"


def test_broken_features_do_not_stop_the_depth(tmp_path):
    log = colour(depth_log(3))
    add_detections(log, "/colour/found", START, "colour", [([("face", 1.0)], *pixel(FACE))])
    log.add("/colour/found", START + PERIOD, (DETECTIONS, log.items[-1][2][1][:-20]))
    texts = annotations(START, [("a", 1, 1), ("b", 2, 2)])
    del texts.circles[1:]
    log.add("/colour/labels", START, texts)
    log.add("/dead", START, ("geometry_msgs/msg/PointStamped", b"\0\1\0\0"))
    log.schema_text["geometry_msgs/msg/PointStamped"] = b"this is no definition"
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert [len(f.points) for f in recording] == [767] * 3 and recording.features == ("/colour/found",)
    check_ray(recording.frames[0], "face", FACE)
    for topic in ("/colour/found", "/colour/labels", "/dead"):
        assert any(n.startswith(f"'{topic}': 1 message cannot be decoded") for n in recording.notes), topic
    assert any("2 texts cannot be the names of 1 circles" in n for n in recording.notes)


def test_absurd_numbers_are_left_out(tmp_path):
    log = depth_log(2).add("/p", START, ros_point(START, "base", (1e300, 0, 0)))
    scan = foxglove_laser(START, "base", 0.0, 1.0, [1.0, 2.0])
    scan.timestamp.seconds = 2**62  # no int64 holds as many nanoseconds
    log.add("/scan", START, scan).add("/q", START, poses_in_frame(START, "base", [(np.inf, 0, 0), (1, 1, 1)]))
    recording = read_log(log.write(tmp_path / "a.mcap"), WithLaser())
    assert [len(f.points) for f in recording] == [767, 767] and pairs(recording.frames[0]) == {"q": [1, 1, 1]}
    assert "'/p'" not in recording.features and recording.sensors == ("/cam/depth",)


def test_stamps_of_features(tmp_path):
    log = depth_log(3)
    for i in range(3):
        log.add("/none", START + i * PERIOD, ros_markers(ros_marker(0, "base", "a", (i, 0, 0))))
        log.add("/stuck", START + i * PERIOD, ros_point(7, "base", (i, 0, 0)))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert [pairs(f) for f in recording] == [{"a": [i, 0, 0], "stuck": [i, 0, 0]} for i in range(3)]
    assert "'/none': 3 messages without header stamp; the log time is used for them." in recording.notes
    assert "'/stuck': 3 messages have only 1 header stamp; log time is used." in recording.notes


def test_moving_frame_of_a_feature(tmp_path):
    log = Log().add("/tf", START, foxglove_tf(START, "map", "robot", (0, 0, 0), (0, 0, 0, 1)))
    log.add("/tf", START + 10**9, foxglove_tf(START + 10**9, "map", "robot", (1, 0, 0), (0, 0, 0, 1)))
    for i in range(5):
        t = START + i * 500_000_000
        log.add("/p", t, ros_point(t, "robot", (0, i, 0)))
    recording = read_log(log.write(tmp_path / "a.mcap"))
    assert [pairs(f) for f in recording][:4] == [{"p": [min(i / 2, 1), i, 0]} for i in range(4)]
    assert pairs(recording.frames[4]) == {} and any("1 feature left out, no transform" in n for n in recording.notes)


def test_laser_scans_are_points(tmp_path):
    ranges = [1.0, np.inf, 2.0, 0.0, np.nan, 11.0, 3.0, 0.02]
    angles = -0.5 + 0.1 * np.arange(8)
    expected = np.array([[r * np.cos(a), r * np.sin(a), 0] for r, a in zip(ranges, angles) if r in (1.0, 2.0, 3.0)])
    log = depth_log(3)
    log.add("/tf_static", START, ros_tf((START, "base", "laser", (1.0, 2.0, 0.35), (0.0, 0.0, HALF, HALF))))
    for ms in (2, 12, 35):  # faster than the depth: the nearest joins
        scan = ros_laser(START + ms * 10**6, "laser", -0.5, 0.1, np.array(ranges) + (0.1 if ms == 12 else 0))
        log.add("/a/scan", START + ms * 10**6, scan)
    pose = ((0.0, 0.0, 0.1), (0.0, 0.0, 0.0, 1.0))
    fox = [r if r < 10 else np.inf for r in ranges]
    fox[-1] = np.inf
    log.add("/z/scan", START, foxglove_laser(START, "laser", angles[0], angles[-1], fox, pose))
    path = log.write(tmp_path / "a.mcap")
    assert read_log(path).sensors == ("/cam/depth",)
    recording = read_log(path, WithLaser())
    assert recording.sensors == ("/cam/depth", "/a/scan", "/z/scan") and len(recording) == 3
    turned = np.column_stack([-expected[:, 1], expected[:, 0], expected[:, 2]]) + [1.0, 2.0, 0.35]
    assert [[int((f.sensor == s).sum()) for s in range(3)] for f in recording] == [
        [767, 3, 3],
        [767, 3, 0],
        [767, 0, 0],
    ]
    first = recording.frames[0]
    np.testing.assert_allclose(first.points[first.sensor == 1], turned, atol=1e-5)
    np.testing.assert_allclose(first.points[first.sensor == 2], turned + [0, 0, 0.1], atol=1e-5)
    np.testing.assert_allclose(first.origins, [[0, 0, 1.25], [1, 2, 0.35], [1, 2, 0.45]], atol=1e-6)
    uses = {t.topic: t.use for t in survey(path, WithLaser()).topics}
    assert uses["/a/scan"] == uses["/z/scan"] == "laser scan"
    assert {t.topic: t.use for t in survey(path).topics}["/a/scan"] == "not used: a single line of a laser scanner"


def test_laser_with_markers_or_alone(tmp_path):
    log = Log().add("/scan", START + 3, ros_laser(START + 3, "lab", 0.0, 0.1, [1.0, 2.0]))
    with pytest.raises(LogError, match="no depth data"):
        read_log(log.write(tmp_path / "a.mcap"))
    assert read_log(tmp_path / "a.mcap", WithLaser()).frames[0].points.shape == (2, 3)
    for i in range(3):
        log.add("/p", START + i * PERIOD, ros_point(START + i * PERIOD, "lab", (1, 1, 1)))
    recording = read_log(log.write(tmp_path / "b.mcap"), WithLaser())
    assert [len(f.points) for f in recording] == [2, 0, 0] and recording.sensors == ("/scan",)
    assert all(pairs(f) == {"p": [1, 1, 1]} for f in recording)


def test_foxglove_camera(tmp_path):
    log = Log().add("/cam/calibration", START, foxglove_calibration("eye"))
    log.add("/cam/found", START, annotations(START, [("face", 15.5, 11.5)]))
    frame = read_log(log.write(tmp_path / "a.mcap")).frames[0]
    np.testing.assert_allclose(frame.rays.directions, [[0, 0, 1]], atol=1e-6)
