"""Recordings of other formats become logs that are read as the recording itself would be."""

import json
import sqlite3
import struct
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import cv2
import ezc3d
import numpy as np
import pytest
import trimesh
from mcap.reader import make_reader
from rosbags.rosbag1 import Writer as Bag1
from rosbags.rosbag2 import Writer as Bag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import voodoo_jax as vj
from tests.exporters.test_tracks_files import make_tracks
from voodoo_jax.cli.main import main
from voodoo_jax.config.options import ReadSettings
from voodoo_jax.exporters.formats import export
from voodoo_jax.io.container import LogError
from voodoo_jax.io.convert.clouds import read_pcd
from voodoo_jax.io.convert.errors import ConvertError
from voodoo_jax.io.convert.sources import as_mcap, convert
from voodoo_jax.model.body_file import load_body
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.simulate.sensor import Camera
from voodoo_jax.storage.urls import expanded

CAMERA = Camera(40, 31, 45.5, 43.1, 19.5, 15.0, (0.0, 0.0, 1.0), 0.07)


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    """A simulated log of ROS 2 messages."""
    body = load_body("human10")
    sim = simulate(body, placed(make_motion(body, "swing", 0.8, 5.0), 2.5, 0.0, np.pi), CAMERA)
    return write_simulation(sim, tmp_path_factory.mktemp("log") / "sim.mcap")


def messages(path: Path) -> list[tuple[str, str, int, bytes]]:
    with open(path, "rb") as stream:
        return [(c.topic, s.name, m.log_time, m.data) for s, c, m in make_reader(stream).iter_messages() if s]


def assert_same_frames(found: vj.Recording, expected: vj.Recording, atol: float = 0.0) -> None:
    assert len(found) == len(expected) > 3 and found.fixed_frame == expected.fixed_frame
    for a, b in zip(found, expected):
        assert a.time_ns == b.time_ns
        np.testing.assert_allclose(a.points, b.points, rtol=0, atol=atol)


def test_sqlite_bags_of_ros_2_are_copied_to_the_byte(log, tmp_path):
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Bag2(tmp_path / "bag", version=9) as bag:
        connections = {}
        for topic, kind, stamp, data in messages(log):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=store)
            bag.write(connections[topic], stamp, data)
    for source in (tmp_path / "bag", next((tmp_path / "bag").glob("*.db3"))):
        assert convert(source, tmp_path / "out.mcap") == []
        assert sorted(messages(tmp_path / "out.mcap")) == sorted(messages(log))
    assert_same_frames(vj.read_log(tmp_path / "out.mcap"), vj.read_log(log))


def without_definitions(folder: Path) -> None:
    """A bag as Humble and those before it write it (schema 3)."""
    for path in folder.glob("*.db3"):
        with sqlite3.connect(path) as base:
            base.execute("drop table message_definitions")
            base.execute("update schema set schema_version=3")
            kept = "id, name, type, serialization_format, offered_qos_profiles"
            base.execute(f"create table other as select {kept} from topics")
            base.execute("drop table topics")
            base.execute("alter table other rename to topics")


POINT = "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line"
CLOUD = (
    "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n{}/CustomPoint[] points"
)


def lidar_bag(folder: Path, package: str) -> Path:
    """A bag of clouds of a driver's type, without its definition."""
    store, kind = get_typestore(Stores.ROS2_HUMBLE), f"{package}/msg/CustomMsg"
    store.register(get_types_from_msg(POINT, f"{package}/msg/CustomPoint"))
    store.register(get_types_from_msg(CLOUD.format(package), kind))
    t = store.types
    with Bag2(folder, version=9) as bag:
        topic = bag.add_connection("/lidar", kind, typestore=store)
        for i in range(4):
            head = t["std_msgs/msg/Header"](t["builtin_interfaces/msg/Time"](5, i * 10**8), "lidar")
            points = [t[f"{package}/msg/CustomPoint"](0, 2.0 + i, float(k), 0.5, 1, 0, 0) for k in range(50)]
            message = t[kind](head, 0, 50, 0, np.zeros(3, np.uint8), points)
            bag.write(topic, 5 * 10**9 + i * 10**8, store.serialize_cdr(message, kind))
    without_definitions(folder)
    return folder


def test_bags_without_definitions(tmp_path, capsys):
    """The usual drivers' types are known, others are read with the files of their packages."""
    known = vj.read_log(lidar_bag(tmp_path / "livox", "livox_ros_driver2"))
    assert len(known) == 4 and float(known.frames[2].points[:, 0].mean()) == 4.0
    other = lidar_bag(tmp_path / "other", "acme_msgs")
    with pytest.raises(ConvertError, match="no usable topic left.*--read.types"):
        convert(other, tmp_path / "a.mcap")
    assert main(["info", str(other)]) == 1 and "--read.types" in capsys.readouterr().err
    for name, text in (("CustomMsg", CLOUD.format("acme_msgs")), ("CustomPoint", POINT)):
        (tmp_path / f"{name}.msg").write_text(text)
    file = str(tmp_path / "CustomMsg.msg")
    assert_same_frames(vj.read_log(other, ReadSettings(types=(file,))), known)
    assert main(["info", str(other), "--read.types", file]) == 0 and "point cloud" in capsys.readouterr().out
    with pytest.raises(LogError, match="not a message definition"):
        vj.read_log(other, ReadSettings(types=(str(tmp_path / "none.msg"),)))


def test_folders_of_recordings(tmp_path, capsys):
    """All in them are found, but for what was exported from tracks."""
    tracks = make_tracks()
    (tmp_path / "a" / "deep").mkdir(parents=True)
    names = ["walk.trc", "deep/RUN.C3D"]
    for name in names:
        export(tracks, tmp_path / "a" / name.lower()).rename(tmp_path / "a" / name)
    lidar_bag(tmp_path / "a" / "bag", "livox_ros_driver2")
    (tmp_path / "a" / "done.tracks.npz").touch()
    export(tracks, tmp_path / "a" / "done.trc")
    found = [Path(log).relative_to(tmp_path / "a").as_posix() for log in expanded(tmp_path / "a")]
    assert found == ["bag/bag.db3", *sorted(names)]
    assert main(["info", str(tmp_path / "a")]) == 0
    assert capsys.readouterr().out.count("protobuf  named points") == 2


def test_ros_1_bags_are_read_as_their_ros_2_twins(log, tmp_path):
    """Headers, calibrations and transforms have other fields and names in ROS 1; a type that ROS 2 lacks is kept."""
    store, two = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg("std_msgs/Header header\nfloat64 volts", "lab_msgs/msg/Battery"))
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    t = store.types

    def header(h):
        time = t["builtin_interfaces/msg/Time"](sec=h.stamp.sec, nanosec=h.stamp.nanosec)
        return t["std_msgs/msg/Header"](seq=7, stamp=time, frame_id=h.frame_id)

    def twin(m):
        kind = m.__msgtype__
        if kind == "tf2_msgs/msg/TFMessage":
            one = m.transforms[0]
            v, q = one.transform.translation, one.transform.rotation
            transform = t["geometry_msgs/msg/Transform"](
                translation=t["geometry_msgs/msg/Vector3"](x=v.x, y=v.y, z=v.z),
                rotation=t["geometry_msgs/msg/Quaternion"](x=q.x, y=q.y, z=q.z, w=q.w),
            )
            stamped = t["geometry_msgs/msg/TransformStamped"](
                header=header(one.header), child_frame_id=one.child_frame_id, transform=transform
            )
            return t[kind](transforms=[stamped])
        own = {name: getattr(m, name, None) for name in t[kind].__dataclass_fields__ if name != "__msgtype__"}
        own["header"] = header(m.header)
        if "roi" in own:
            own |= {"D": m.d, "K": m.k, "R": m.r, "P": m.p}
            fields = ("x_offset", "y_offset", "height", "width", "do_rectify")
            own["roi"] = t["sensor_msgs/msg/RegionOfInterest"](**{name: getattr(m.roi, name) for name in fields})
        return t[kind](**own)

    with Bag1(tmp_path / "old.bag") as bag:
        connections = {}
        for topic, kind, stamp, data in messages(log):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, kind, typestore=store)
            bag.write(connections[topic], stamp, store.serialize_ros1(twin(two.deserialize_cdr(data, kind)), kind))
        battery = bag.add_connection("/battery", "lab_msgs/msg/Battery", typestore=store)
        zero = two.types["std_msgs/msg/Header"](two.types["builtin_interfaces/msg/Time"](1, 2), "base")
        message = t["lab_msgs/msg/Battery"](header=header(zero), volts=11.5)
        bag.write(battery, stamp, store.serialize_ros1(message, "lab_msgs/msg/Battery"))
    assert convert(tmp_path / "old.bag", tmp_path / "new.mcap") == []
    assert_same_frames(vj.read_log(tmp_path / "new.mcap"), vj.read_log(log))
    ((_, kind, _, data),) = [m for m in messages(tmp_path / "new.mcap") if m[0] == "/battery"]
    known = get_typestore(Stores.ROS2_HUMBLE)
    known.register(get_types_from_msg("std_msgs/Header header\nfloat64 volts", kind))
    assert known.deserialize_cdr(data, kind).volts == 11.5


@pytest.mark.parametrize("ending", ["c3d", "trc"])
def test_exported_points_come_back(ending, tmp_path):
    tracks = make_tracks()
    source = export(tracks, tmp_path / f"walk.{ending}")
    with as_mcap(str(source)) as (path, notes):
        recording = vj.read_log(path)
        assert notes == [] and recording.fixed_frame == "lab"
    # the first three and the 40th are not tracked
    assert len(recording) == 71
    frame = recording.frames[20]
    at = dict(zip(frame.pairs.names, frame.pairs.points))
    expected = tracks.joint("l_knee")[23]
    expected = expected if ending == "c3d" else np.array([expected[0], expected[2], -expected[1]])
    np.testing.assert_array_equal(recording.up, [0, 0, 1] if ending == "c3d" else [0, 1, 0])
    np.testing.assert_allclose(at["l_knee"], expected, atol=1e-4)
    times = np.array([f.time_ns for f in recording])
    np.testing.assert_allclose(np.diff(times)[:30], 33_333_333, atol=2000)


def c3d_of(path: Path, names: list[str], points: np.ndarray, **parameters: list) -> Path:
    """A C3D file of points [frame, point, 3] at 100 Hz; `parameters` of its group POINT."""
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    for key, value in {"LABELS": names, "UNITS": ["mm"], **parameters}.items():
        file.add_parameter("POINT", key, value)
    file["data"]["points"] = np.concatenate([points.transpose(2, 1, 0), np.ones((1, *points.shape[1::-1]))])
    file.write(str(path))
    return path


@pytest.mark.parametrize(("scale", "unit"), [(1000.0, "mm"), (1.0, "m"), (100.0, "cm")])
def test_points_without_a_unit_are_as_large_as_a_body(scale, unit, tmp_path):
    points = np.random.default_rng(0).uniform([0, 0, 0.05], [0.5, 0.4, 1.7], (20, 30, 3))
    source = c3d_of(tmp_path / "a.c3d", [f"m{k}" for k in range(30)], points * scale, UNITS=[])
    (note,) = convert(source, tmp_path / "a.mcap")
    assert f"names no unit: judged by size, it is {unit}" in note
    np.testing.assert_allclose(vj.read_log(tmp_path / "a.mcap").frames[3].pairs.points, points[3], atol=1e-4)
    with pytest.raises(ConvertError, match="names no unit"):
        convert(c3d_of(tmp_path / "b.c3d", ["a", "b", "c"], points[:, :3] * 1e6, UNITS=[]), tmp_path / "b.mcap")


def test_what_a_model_computed_is_no_marker(tmp_path):
    names = ["LASI", "LFEO", "LFEA", "LFEL", "LFEP", "LKneeAngles", "CentreOfMass", "RFEO"]
    points = np.random.default_rng(0).uniform(1, 2000, (4, len(names), 3))
    groups = {"TYPE_GROUPS": ["ANGLES", "ANGLE", "MODELED_MARKERS", "MODELED_MARKER"]}
    listed = {"ANGLES": ["LKneeAngles"], "MODELED_MARKERS": ["CentreOfMass"]}
    notes = convert(c3d_of(tmp_path / "a.c3d", names, points, **groups, **listed), tmp_path / "a.mcap")
    assert notes == ["5 computed channels were left out (angles, forces, axes of bones): they are not markers"]
    assert set(vj.read_log(tmp_path / "a.mcap").frames[0].pairs.names) == {"LASI", "CentreOfMass", "RFEO"}


@pytest.mark.parametrize(("told", "unit"), [("mete", 1.0), ("Millimeters", 0.001), ("CM", 0.01), ("furlong", 0.001)])
def test_words_for_units(told, unit, tmp_path):
    """They may be cut; one that is none is found by size."""
    points = np.random.default_rng(0).uniform(-0.8, 0.8, (5, 6, 3))
    source = c3d_of(tmp_path / "a.c3d", [f"M{i}" for i in range(6)], points / unit, UNITS=[told])
    frame = vj.read_log(source).frames[2]
    np.testing.assert_allclose(frame.pairs.points, points[2], atol=1e-5)


def test_labels_in_other_letters(tmp_path):
    """Latin-1."""
    points = np.random.default_rng(0).uniform(-800, 800, (5, 6, 3))
    source = c3d_of(tmp_path / "a.c3d", [f"EpauleX{i}" for i in range(6)], points)
    source.write_bytes(source.read_bytes().replace(b"Epaule", b"\xc9paule"))
    assert "\xc9pauleX3" in vj.read_log(source).frames[2].pairs.names


def test_names_that_were_cut_to_the_same_letters_are_told_apart_by_their_descriptions(tmp_path):
    names, described = ["RKNE", "RKNE", "LASI"], ["R.Knee", "R.Knee.Medial", "L.ASIS"]
    points = np.arange(1.0, 37.0).reshape(4, 3, 3) * 20
    convert(c3d_of(tmp_path / "a.c3d", names, points, DESCRIPTIONS=described), tmp_path / "a.mcap")
    pairs = vj.read_log(tmp_path / "a.mcap").frames[0].pairs
    at = dict(zip(pairs.names, pairs.points))
    assert set(at) == {"R.Knee", "R.Knee.Medial", "LASI"}
    np.testing.assert_allclose(at["R.Knee.Medial"], points[0, 1] / 1000, atol=1e-6)


def test_a_header_with_two_tabs_between_values_is_read(tmp_path):
    lines = [
        "PathFileType  4\t(X/Y/Z) C:\\a.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        "  100.0\t\t  100.0\t\t    2\t\t     1\t\t mm\t  100.0\t      1\t    2",
        "Frame#\tTime\tR.Knee\t\t\t",
        "\t\tX1\tY1\tZ1",
        "",
        "1\t0.00000\t410.290\t1568.444\t-313.711\t",
        "2\t0.01000\t410.180\t1568.395\t-313.297\t",
    ]
    (tmp_path / "a.trc").write_text("\n".join(lines))
    convert(tmp_path / "a.trc", tmp_path / "a.mcap")
    frames = vj.read_log(tmp_path / "a.mcap").frames
    assert len(frames) == 2
    np.testing.assert_allclose(frames[1].pairs.points, [[0.41018, 1.568395, -0.313297]], atol=1e-6)


def test_points_in_inches_with_gaps(tmp_path):
    file = ezc3d.c3d()
    point = file["parameters"]["POINT"]
    point["LABELS"]["value"], point["UNITS"]["value"], point["RATE"]["value"] = ["LASI", "RASI"], ["in"], [100.0]
    data = np.ones((4, 2, 5)) * 10
    data[:3, 1, 2] = np.nan
    file["data"]["points"] = data
    file.write(str(tmp_path / "a.c3d"))
    convert(tmp_path / "a.c3d", tmp_path / "a.mcap")
    frames = vj.read_log(tmp_path / "a.mcap").frames
    assert [len(frame.pairs.names) for frame in frames] == [2, 2, 1, 2, 2]
    np.testing.assert_allclose(frames[0].pairs.points, 0.254, atol=1e-6)


def depth_of(log: Path) -> tuple[list[int], list[np.ndarray]]:
    store = get_typestore(Stores.ROS2_HUMBLE)
    found = [store.deserialize_cdr(data, kind) for _, kind, _, data in messages(log) if kind.endswith("/Image")]
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in found]
    return stamps, [m.data.view("<u2").reshape(CAMERA.height, CAMERA.width) for m in found]


def camera_text(unit: float, **more) -> str:
    values = dict(width=40, height=31, fx=45.5, fy=43.1, cx=19.5, cy=15.0, unit=unit) | more
    return "\n".join(f"{key} = {value}" for key, value in values.items())


def test_folders_of_depth_images(log, tmp_path):
    """As the TUM benchmark has them, and plain ones; points are those of the log in the camera's frame."""
    expected = vj.read_log(log)
    stamps, images = depth_of(log)
    tum, plain = tmp_path / "tum", tmp_path / "plain"
    (tum / "depth").mkdir(parents=True)
    plain.mkdir()
    lines = ["# depth maps"]
    for i, (stamp, image) in enumerate(zip(stamps, images)):
        name = f"depth/{stamp / 1e9:.6f}.png"
        cv2.imwrite(str(tum / name), image * 5)  # 1/5000 m
        cv2.imwrite(str(plain / f"frame{i + 8}.png"), image)  # 8, 9, 10: not in the order of the letters
        lines.append(f"{stamp / 1e9:.6f} {name}")
    (tum / "depth.txt").write_text("\n".join(lines))
    (tum / "camera.toml").write_text(camera_text(1 / 5000))
    (tmp_path / "cam.toml").write_text(camera_text(0.001, rate=5))
    assert convert(tum, tmp_path / "tum.mcap") == ["counts of 0.2 mm became metres in 32 bits"]
    assert convert(plain, tmp_path / "plain.mcap", tmp_path / "cam.toml") == []
    for name in ("tum", "plain"):
        found = vj.read_log(tmp_path / f"{name}.mcap")
        assert len(found) == len(expected) and found.fixed_frame == "depth_optical"
        for a, b in zip(found, expected):
            turned = (b.points - np.array(CAMERA.position)) @ CAMERA.rotation
            np.testing.assert_allclose(a.points, turned, atol=1e-4)
        assert abs(int(np.diff([f.time_ns for f in found])[0]) - (stamps[1] - stamps[0])) < 2000


def test_colour_images_beside_depth_images(log, tmp_path):
    """Of the TUM benchmark with times of their own, of plain folders with those of depth; others are left out, said."""
    stamps, images = depth_of(log)
    colours = np.random.default_rng(0).integers(0, 255, (len(images), 31, 40, 3), np.uint8)
    for name, colour in (("tum", "rgb"), ("plain", "color")):
        for folder in ("depth", colour):
            (tmp_path / name / folder).mkdir(parents=True)
        (tmp_path / name / "camera.toml").write_text(camera_text(0.001, rate=5))
        for i, (depth, picture) in enumerate(zip(images, colours)):
            cv2.imwrite(str(tmp_path / name / "depth" / f"{i:03d}.png"), depth)
            cv2.imwrite(str(tmp_path / name / colour / f"{i:03d}.png"), picture)
        if name == "tum":
            for table, late in (("depth", 0.0), ("rgb", 0.002)):
                rows = (f"{s / 1e9 + late:.6f} {table}/{i:03d}.png" for i, s in enumerate(stamps))
                (tmp_path / name / f"{table}.txt").write_text("\n".join(rows))
        assert convert(tmp_path / name, tmp_path / f"{name}.mcap") == []
        found = vj.read_log(tmp_path / f"{name}.mcap", ReadSettings(images=True))
        assert len(found) == len(images) and all(len(frame.pictures) == 1 for frame in found)
        for frame, picture in zip(found, colours):
            np.testing.assert_array_equal(frame.pictures[0].unpack()[0], picture)
    cv2.imwrite(str(tmp_path / "plain" / "color" / "001.png"), colours[0, :20])
    (tmp_path / "plain" / "color" / "002.png").write_bytes(b"")
    notes = convert(tmp_path / "plain", tmp_path / "less.mcap")
    assert len(notes) == 2 and "not registered to depth" in notes[0] and "002.png' was left out" in notes[1]


def lzf(data: bytes) -> bytes:
    """Packs bytes as LibLZF does: repetitions of 3 to 264 bytes up to 8192 back, and up to 32 bytes as they are."""
    out, plain, at = bytearray(), bytearray(), 0

    def flush() -> None:
        for k in range(0, len(plain), 32):
            out.extend([len(plain[k : k + 32]) - 1, *plain[k : k + 32]])
        plain.clear()

    seen: dict[bytes, int] = {}
    while at < len(data):
        start = seen.get(data[at : at + 3], -1)
        seen[data[at : at + 3]] = at
        length, back = 0, at - start - 1
        while start >= 0 and back < 8192 and length < 264 and at + length < len(data):
            if data[start + length] != data[at + length]:
                break
            length += 1
        if length < 3:
            plain.append(data[at])
            at += 1
            continue
        flush()
        long = [7 << 5 | back >> 8, length - 9] if length > 8 else [length - 2 << 5 | back >> 8]
        out.extend([*long, back & 255])
        at += length
    flush()
    return bytes(out)


def test_packed_clouds_that_are_damaged_are_said(tmp_path):
    head = b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA binary_compressed\n"
    good = lzf(bytes(24))
    assert len(good) < 10  # a repetition that overlaps itself
    cases = {
        "good": struct.pack("<II", len(good), 24) + good,
        "cut": struct.pack("<II", len(good), 24) + good[:-1],
        "other size": struct.pack("<II", len(good), 36) + good,
        "bomb": struct.pack("<II", len(good), 2**31) + good,
        "before its beginning": struct.pack("<II", 3, 24) + bytes([7 << 5, 15, 9]),
        "too short": struct.pack("<II", 2, 24) + bytes([0, 1]),
        "nothing": b"",
    }
    for k, (name, data) in enumerate(cases.items()):
        (tmp_path / "a.pcd").write_bytes(head + data)
        if not k:
            assert read_pcd((tmp_path / "a.pcd").read_bytes(), "a.pcd").tolist() == [[0, 0, 0]] * 2
            continue
        with pytest.raises(ConvertError, match="cannot be read as PCD"):
            read_pcd((tmp_path / "a.pcd").read_bytes(), "a.pcd")
            raise AssertionError(name)


@pytest.mark.parametrize("kind", ["ascii", "binary", "binary_compressed", "ply"])
def test_folders_of_clouds(kind, tmp_path):
    rng = np.random.default_rng(0)
    clouds = [rng.normal(0, 1, (50 + i, 3)).astype(np.float32) for i in range(5)]
    for i, points in enumerate(clouds):
        if kind == "ply":
            trimesh.PointCloud(points).export(tmp_path / f"{i + 8}.ply")
            continue
        head = "# .PCD v0.7\nVERSION 0.7\nFIELDS _ x y z rgb normal\nSIZE 1 4 4 4 4 4\nTYPE U F F F U F\n"
        head += f"COUNT 3 1 1 1 1 3\nWIDTH {len(points)}\nHEIGHT 1\nPOINTS {len(points)}\nDATA {kind}\n"
        row = [("_", "u1", 3), ("p", "<f4", 3), ("rgb", "<u4"), ("normal", "<f4", 3)]
        table = np.zeros(len(points), row)
        table["p"] = points
        text = "\n".join(f"0 0 0 {x:.9g} {y:.9g} {z:.9g} 7 0 0 1" for x, y, z in points) + "\n"
        body = table.tobytes() if kind == "binary" else text.encode()
        if kind == "binary_compressed":
            columns = b"".join(np.ascontiguousarray(table[name]).tobytes() for name, *_ in row if name != "p")
            axes = np.ascontiguousarray(points.T).tobytes()  # after the three bytes of each row of "_"
            packed = lzf(columns[: 3 * len(points)] + axes + columns[3 * len(points) :])
            body = struct.pack("<II", len(packed), table.nbytes) + packed
        (tmp_path / f"{i + 8}.pcd").write_bytes(head.encode() + body)
    with pytest.raises(ConvertError, match="--rate"):
        convert(tmp_path, tmp_path / "out.mcap")
    broken = "10.ply" if kind == "ply" else "10.pcd"
    (tmp_path / broken).write_bytes(b"ply\nnot so" if kind == "ply" else b"VERSION 0.7\nFIELDS x\n")
    (note,) = convert(tmp_path, tmp_path / "out.mcap", rate=10)
    assert broken in note
    recording = vj.read_log(tmp_path / "out.mcap")
    found = {round((f.time_ns - 10**9) / 1e8): f.points for f in recording}
    assert set(found) == {0, 1, 3, 4}
    for i, points in found.items():
        np.testing.assert_allclose(points, clouds[i], atol=1e-6)


def kinect_calibration() -> dict:
    """As in a recording's attachment, of a 1024 x 1024 sensor; colour 9:16 is cut from 3:4."""
    depth = [0.5127, 0.5169, 0.4928, 0.4929, 0.55, -0.02, -0.003, 0.89, 0.086, -0.014, 0, 0, -7e-5, 2e-5]
    colour = [0.4998, 0.5066, 0.478, 0.6374, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0.0, 0.0]
    turn = [1, 0, 0, 0, 0.9948, 0.1019, 0, -0.1019, 0.9948]
    cameras = [
        {"Location": "CALIBRATION_CameraLocationD0", "Intrinsics": {"ModelParameters": depth}},
        {"Location": "CALIBRATION_CameraLocationPV0", "Intrinsics": {"ModelParameters": colour},
         "Rt": {"Rotation": turn, "Translation": [-0.032, -0.002, 0.004]}},
    ]  # fmt: skip
    return {"CalibrationInformation": {"Cameras": cameras}}


def kinect_mkv(path: Path, images: list[np.ndarray], calibration: bytes | None) -> Path:
    """A recording as the Kinect's recorder writes it: raw big-endian depth (FOURCC b16g), JPEG, an attachment."""
    height, width = images[0].shape
    with av.open(str(path), "w", options={"allow_raw_vfw": "1"}) as container:
        depth = container.add_stream("rawvideo", rate=30)
        depth.width, depth.height, depth.pix_fmt, depth.metadata["title"] = width, height, "gray16be", "DEPTH"
        colour = container.add_stream("mjpeg", rate=30)
        colour.width, colour.height, colour.pix_fmt, colour.metadata["title"] = 64, 36, "yuvj420p", "COLOR"
        if calibration is not None:
            container.add_attachment("calibration.json", "application/octet-stream", calibration)
        container.metadata["K4A_DEPTH_MODE"] = "NFOV_2X2BINNED"
        for i, image in enumerate(images):
            frame = av.VideoFrame.from_ndarray(image, format="gray16le").reformat(format="gray16be")
            picture = av.VideoFrame.from_ndarray(np.full((36, 64, 3), 60 * i, np.uint8), format="rgb24")
            for stream, made in ((depth, frame), (colour, picture.reformat(format="yuvj420p"))):
                made.pts, made.time_base = 33 * i, Fraction(1, 1000)
                container.mux(stream.encode(made))
    data = path.read_bytes()
    at = data.find(struct.pack("<Iii", 40, width, -height))  # the header of raw images, which says no FOURCC
    path.write_bytes(data[: at + 16] + b"b16g" + data[at + 20 :])
    return path


def test_recordings_of_azure_kinects(tmp_path):
    """Depth to the count, the calibration of that depth mode as OpenCV has it, colour images beside."""
    rng = np.random.default_rng(0)
    images = [rng.integers(900, 4000, (288, 320)).astype(np.uint16) for _ in range(4)]
    images[0][0, :5] = 0
    path = kinect_mkv(tmp_path / "a.mkv", images, json.dumps(kinect_calibration()).encode() + b"\0")
    with as_mcap(str(path)) as (log, notes):
        recording = vj.read_log(log, vj.Settings().read)
        with_images = vj.read_log(log, replace(vj.Settings().read, images=True))
    assert notes == [] and len(recording) == 4
    np.testing.assert_allclose(np.diff([f.time_ns for f in recording]), 33_000_000, atol=1_500_000)
    p = kinect_calibration()["CalibrationInformation"]["Cameras"][0]["Intrinsics"]["ModelParameters"]
    k = np.array([[512 * p[2], 0, 512 * p[0] - 96.5], [0, 512 * p[3], 512 * p[1] - 90.5], [0, 0, 1]])
    lens = np.array([*p[4:6], p[13], p[12], *p[6:10]])
    found = recording.frames[2].points.astype(float)
    assert len(found) > 0.9 * images[2].size
    pixel = cv2.projectPoints(found, np.zeros(3), np.zeros(3), k, lens)[0][:, 0]
    u, v = np.round(pixel).astype(int).T
    assert np.quantile(np.abs(pixel - np.stack([u, v], 1)), 0.99) < 0.05
    np.testing.assert_allclose(found[:, 2], images[2][v, u] / 1000, atol=1e-6)
    assert sum(len(frame.pictures) for frame in with_images) >= 3

    (tmp_path / "cam.toml").write_text(camera_text(0.001, width=320, height=288))
    bare = kinect_mkv(tmp_path / "b.mkv", images, None)
    with pytest.raises(ConvertError, match="no calibration.*--camera"):
        convert(bare, tmp_path / "b.mcap")
    (note,) = convert(bare, tmp_path / "b.mcap", tmp_path / "cam.toml")
    assert "colour" in note and len(vj.read_log(tmp_path / "b.mcap")) == 4


def test_skeletons_of_kinects(tmp_path):
    """Joints of two bodies become the markers of two people, in metres."""
    names = ["PELVIS", "SPINE_NAVEL", "NECK", "SHOULDER_LEFT", "ELBOW_LEFT"]
    rng = np.random.default_rng(1)
    places = rng.normal(0, 500, (6, 2, 5, 3)) + [0, 0, 2500]
    frames = [
        {"timestamp_usec": 10**6 + 33_333 * i, "frame_id": i, "num_bodies": 2 - (i == 3), "bodies": [
            {"body_id": b + 1, "joint_positions": places[i, b].tolist()} for b in range(2 - (i == 3))
        ]} for i in range(6)
    ]  # fmt: skip
    (tmp_path / "a.json").write_text(json.dumps({"joint_names": names, "frames": frames}))
    (note,) = convert(tmp_path / "a.json", tmp_path / "a.mcap")
    assert "2 bodies" in note
    recording = vj.read_log(tmp_path / "a.mcap", replace(vj.Settings().read, scale=("/skeletons=1",)))
    assert [len(f.pairs.names) for f in recording] == [10, 10, 10, 5, 10, 10]
    at = dict(zip(recording.frames[2].pairs.names, recording.frames[2].pairs.points))
    np.testing.assert_allclose(at["body2:ELBOW_LEFT"], places[2, 1, 4] / 1000, atol=1e-6)
    (tmp_path / "b.json").write_text('{"frames": []}')
    with pytest.raises(ConvertError, match="joint_names"):
        convert(tmp_path / "b.json", tmp_path / "b.mcap")


@pytest.mark.parametrize("unit", [0.001, 0.0001])
def test_bags_of_realsense(unit, log, tmp_path):
    """Image and calibration have names of their own and one frame for all; counts have any unit."""
    store, two = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
    t, depth = store.types, "/device_0/sensor_0/Depth_0"
    stamps, images = depth_of(log)

    def header(stamp):
        time = t["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
        return t["std_msgs/msg/Header"](seq=0, stamp=time, frame_id="0")

    with Bag1(tmp_path / "rs.bag") as bag:
        option = bag.add_connection(
            "/device_0/sensor_0/option/Depth_Units/value", "std_msgs/msg/Float32", typestore=store
        )
        bag.write(option, stamps[0], store.serialize_ros1(t["std_msgs/msg/Float32"](data=unit), "std_msgs/msg/Float32"))
        info = bag.add_connection(f"{depth}/info/camera_info", "sensor_msgs/msg/CameraInfo", typestore=store)
        old = next(two.deserialize_cdr(d, k) for _, k, _, d in messages(log) if k.endswith("CameraInfo"))
        roi = t["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        made = t["sensor_msgs/msg/CameraInfo"](
            header=header(stamps[0]), height=old.height, width=old.width, distortion_model="plumb_bob",
            D=old.d, K=old.k, R=old.r, P=old.p, binning_x=0, binning_y=0, roi=roi,
        )  # fmt: skip
        bag.write(info, stamps[0], store.serialize_ros1(made, "sensor_msgs/msg/CameraInfo"))
        data = bag.add_connection(f"{depth}/image/data", "sensor_msgs/msg/Image", typestore=store)
        for stamp, image in zip(stamps, images):
            counts = np.round(image * (0.001 / unit)).astype("<u2")
            made = t["sensor_msgs/msg/Image"](
                header=header(stamp), height=31, width=40, encoding="mono16", is_bigendian=0, step=80,
                data=counts.view(np.uint8).ravel(),
            )  # fmt: skip
            bag.write(data, stamp, store.serialize_ros1(made, "sensor_msgs/msg/Image"))
    notes = convert(tmp_path / "rs.bag", tmp_path / "rs.mcap")
    assert notes == ([] if unit == 0.001 else ["/device_0: depth counts of 0.1 mm became metres"])
    expected = vj.read_log(log)
    for a, b in zip(vj.read_log(tmp_path / "rs.mcap"), expected):
        turned = (b.points - np.array(CAMERA.position)) @ CAMERA.rotation
        np.testing.assert_allclose(a.points, turned, atol=1e-4)


def test_what_cannot_be_converted_is_said(tmp_path, capsys):
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\nbroken")
    (tmp_path / "a.trc").write_text("PathFileType\t4\n")
    (tmp_path / "a.c3d").write_bytes(b"\x02P\0\0")
    (tmp_path / "a.mkv").write_bytes(b"")
    (tmp_path / "a.mov").write_bytes(b"")
    (tmp_path / "images").mkdir()
    cases = {
        "a.bag": "bag",
        "a.trc": "TRC",
        "a.c3d": "C3D",
        "a.mkv": "as a video",
        "a.mov": "unsupported file",
        "images": "camera file",
    }
    for name, said in (cases | {"none.bag": "no file"}).items():
        with pytest.raises(ConvertError, match=said):
            convert(tmp_path / name, tmp_path / "out.mcap")
        assert not (tmp_path / "out.mcap").exists()
    with pytest.raises(LogError, match="TRC"), as_mcap(str(tmp_path / "a.trc")):
        pass
    assert main(["convert", str(tmp_path / "a.trc"), "--out", str(tmp_path / "b.mcap")]) == 1
    assert main(["convert", str(tmp_path / "a.trc")]) == 2
    assert main(["convert", "a", "b", "--out", str(tmp_path / "b.mcap")]) == 2
    assert "a folder" in capsys.readouterr().err


def test_several_recordings_go_into_a_folder(tmp_path, capsys):
    tracks = make_tracks()
    sources = [str(export(tracks, tmp_path / f"walk.{end}")) for end in ("c3d", "trc")]
    assert main(["convert", *sources, "--out", str(tmp_path / "logs")]) == 0
    assert {path.name for path in (tmp_path / "logs").iterdir()} == {"walk.c3d.mcap", "walk.trc.mcap"}
    assert str(tmp_path / "logs" / "walk.trc.mcap") in capsys.readouterr().out


@pytest.mark.parametrize("kind", [".ply", ".pcd"])
def test_a_cloud_alone(kind, tmp_path):
    """A scan is a recording of one frame, as it lies there."""
    points = np.random.default_rng(0).normal(0, 1, (60, 3)).astype(np.float32)
    scan = tmp_path / f"scan{kind}"
    if kind == ".ply":
        trimesh.PointCloud(points).export(scan)
    else:
        head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 60\nHEIGHT 1\n"
        scan.write_bytes(f"{head}POINTS 60\nDATA binary\n".encode() + points.tobytes())
    (frame,) = vj.read_log(scan)
    np.testing.assert_allclose(frame.points, points, atol=1e-6)
