"""Skeletons of body trackers and tables of points become named points: as files and as messages without names."""

import json

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import voodoo_jax as vj
from tests.support.logs import START, STORE, Log, header, ros_pose
from voodoo_jax.io.convert.sources import convert
from voodoo_jax.io.convert.target import ConvertError
from voodoo_jax.model.marker_names import orders, readings

FRAMES = 5
SEP = 80 * "=" + "\nMSG: "
AT = np.random.default_rng(0).normal(0, 0.4, (FRAMES, 38, 3)) + [0, 0, 2]  # metres


def pairs(recording: vj.Recording, frame: int = 2) -> dict[str, np.ndarray]:
    found = recording.frames[frame].pairs
    return dict(zip(found.names, found.points))


def read(source) -> vj.Recording:
    return vj.read_log(source)


def test_ntu(tmp_path):
    lines = [str(FRAMES)]
    for frame in AT:
        lines += ["1", "72057594037931101 0 1 1 1 1 0 0.02 0.05 2", "25"]
        rows = [" ".join(f"{x:.6f}" for x in at) for at in frame[:25]]
        lines += [f"{row} 0 0 0 0 0 0 0 0 {0 if k == 7 else 2}" for k, row in enumerate(rows)]  # 0: not tracked
    (tmp_path / "a.skeleton").write_text("\n".join(lines))
    found = read(tmp_path / "a.skeleton")
    np.testing.assert_array_equal(found.up, [0, 1, 0])
    np.testing.assert_allclose(pairs(found)["elbow_right"], AT[2, 9], atol=1e-5)
    assert len(pairs(found)) == 24 and "hand_left" not in pairs(found) and len(found) == FRAMES


def test_nuitrack(tmp_path):
    """Its axes are left-handed: y upwards, z ahead."""

    def body(frame):
        joints = zip(("LEFT_ELBOW", "right_knee"), 1000 * frame)
        return {
            "UserID": 1,
            "Joints": [{"Type": n, "Confidence": 0.7, "Real": dict(zip("XYZ", at))} for n, at in joints],
        }

    told = [{"Timestamp": str(33_000 * i), "Skeletons": [body(frame)]} for i, frame in enumerate(AT)]
    (tmp_path / "a.json").write_text(json.dumps(told))
    convert(tmp_path / "a.json", tmp_path / "a.mcap")
    found = vj.read_log(tmp_path / "a.mcap")
    np.testing.assert_allclose(pairs(found)["left_elbow"], AT[2, 0] * [1, -1, 1], atol=1e-5)
    np.testing.assert_array_equal(found.up, [0, -1, 0])


@pytest.mark.parametrize(
    ("count", "name", "row"), [(18, "right_wrist", 4), (34, "left_knee", 19), (38, "left_hip", 18)]
)
def test_zed(count, name, row, tmp_path):
    bodies = lambda frame: [{"id": k, "keypoint": (frame[:count] + k).tolist()} for k in (3, 4)]  # noqa: E731
    told = {str(i): {"timestamp": START + 33_000_000 * i, "body_list": bodies(frame)} for i, frame in enumerate(AT)}
    (tmp_path / "a.json").write_text(json.dumps(told))
    np.testing.assert_allclose(pairs(read(tmp_path / "a.json"))[f"body4:{name}"], AT[2, row] + 4, atol=1e-5)


def test_motive(tmp_path):
    """Markers that were measured, not those that were solved, nor what nobody has named."""
    kinds = ["Bone"] * 7 + ["Rigid Body Marker"] * 3 + ["Marker"] * 6
    names = ["Anna:Hip"] * 7 + ["Anna:LFHD"] * 6 + ["Unlabeled 12"] * 3
    what = ["Rotation"] * 4 + ["Position"] * 12
    lines = ["Format Version,1.23,Take Name,walk,Capture Frame Rate,120.0,Length Units,Millimeters", ""]
    lines += [",".join(["", word, *row]) for word, row in (("Type", kinds), ("Name", names), ("ID", names), ("", what))]
    lines.append("Frame,Time (Seconds)," + ",".join([*"XYZW", *"XYZ" * 4]))
    for i, frame in enumerate(AT):
        cells = [0.5, 0.5, 0.5, 0.5, *(1000 * frame[:2]).ravel(), *(1000 * frame[2]), 1, 2, 3]
        cells = cells if i != 3 else [*cells[:10], "", "", "", 1, 2, 3]
        lines.append(",".join(map(str, [i, i / 120, *cells])))
    (tmp_path / "take.csv").write_text("\n".join(lines))
    found = read(tmp_path / "take.csv")
    assert list(pairs(found)) == ["Anna:LFHD"]
    np.testing.assert_allclose(pairs(found)["Anna:LFHD"], AT[2, 2], atol=1e-5)
    np.testing.assert_array_equal(found.up, [0, 1, 0])
    assert len(found) == FRAMES - 1  # of one without a marker nothing is left


def test_other_tables(tmp_path):
    """FreeMoCap's: millimetres, and no times."""
    names = ["nose", "left_hip", "right_hip", "left_knee"]
    rows = [",".join(f"{1000 * x:.4f}" for x in frame[:4].ravel()) for frame in AT]
    head = ",".join(f"{name}_{axis}" for name in names for axis in "xyz")
    (tmp_path / "a.csv").write_text("\n".join([head, *rows]))
    found = read(tmp_path / "a.csv")
    np.testing.assert_allclose(pairs(found)["right_hip"], AT[2, 2], atol=1e-5)
    assert any("30 frames a second" in note for note in found.notes)
    timed = [f"{7 + 0.25 * i},{row}" for i, row in enumerate(rows)]
    (tmp_path / "b.csv").write_text("\n".join([f"timestamp,{head}", *timed]))
    assert np.diff([f.time_ns for f in read(tmp_path / "b.csv")]).tolist() == [250_000_000] * (FRAMES - 1)
    (tmp_path / "c.csv").write_text("a,b\n1,2\n")
    with pytest.raises(ConvertError, match="NAME_x"):
        convert(tmp_path / "c.csv", tmp_path / "c.mcap")


def poses(i, places):
    made = [ros_pose(0, "map", at).pose for at in places]
    return STORE.types["geometry_msgs/msg/PoseArray"](header(START + 33_000_000 * i, "map"), made)


def standing() -> dict[tuple[str, str], np.ndarray]:
    """Somebody with one arm ahead, by side and name, metres."""
    sides = {
        "eye": (0.1, 0.03, 1.62), "ear": (0.0, 0.08, 1.6), "shoulder": (0, 0.2, 1.42), "elbow": (0, 0.25, 1.1),
        "wrist": (0.05, 0.27, 0.85), "hip": (0, 0.1, 0.93), "knee": (0, 0.11, 0.5), "ankle": (0, 0.12, 0.08),
        "hand": (0.06, 0.27, 0.78), "handtip": (0.07, 0.27, 0.7), "thumb": (0.09, 0.25, 0.8), "foot": (0.14, 0.12, 0.0),
        "bigtoe": (0.17, 0.1, 0.0), "smalltoe": (0.15, 0.17, 0.0), "heel": (-0.06, 0.12, 0.0),
        "clavicle": (0.05, 0.03, 1.4),
    }  # fmt: skip
    middle = {"nose": (0.12, 0, 1.58), "neck": (0, 0, 1.5), "head": (0, 0, 1.75), "pelvis": (0, 0, 0.95)}
    middle |= {"spinenavel": (0, 0, 1.1), "spinechest": (0, 0, 1.3)}
    middle |= {
        "midhip": middle["pelvis"],
        "spinebase": middle["pelvis"],
        "spine": (0, 0, 1.15),
        "spinemid": (0, 0, 1.15),
    }
    middle |= {"spineshoulder": (0, 0, 1.42), "torso": (0, 0, 1.2)}
    made = {("", name): np.array(at, float) for name, at in middle.items()}
    for side, sign in (("l", 1), ("r", -1)):
        made |= {(side, name): np.array(at) * [1, sign, 1] for name, at in sides.items()}
    return made | {("l", "elbow"): np.array((0.3, 0.2, 1.4)), ("l", "wrist"): np.array((0.55, 0.2, 1.4))}


def in_order(names) -> np.ndarray:
    """Places of the points of a system's order [point, 3]."""
    at = standing()
    return np.array([next(at[r] for r in readings(name) if r in at) for name in names])


@pytest.mark.parametrize(
    ("count", "system"),
    [(15, "nite"), (17, "coco"), (17, "h36m"), (17, "mpi_inf_3dhp"), (25, "openpose"), (25, "kinect_v2"), (32, None)],
)
def test_poses_without_names(count, system, tmp_path):
    """As many as a net or a tracker has joints; of orders with so many points, the one that makes a person of them.
    Particles of a filter are none."""
    names = orders(count)[system or next(iter(orders(count)))]
    places, log = in_order(names), Log()
    for i in range(4):
        log.add("/body", START + 33_000_000 * i, poses(i, places + 0.01 * i))
        log.add("/particles", START + 33_000_000 * i, poses(i, np.resize(places, (21, 3))))
    found = vj.read_log(log.write(tmp_path / "a.mcap"))
    assert set(pairs(found)) == set(names)
    ankle = next(name for name in names if ("l", "ankle" if system != "nite" else "foot") in readings(name))
    np.testing.assert_allclose(pairs(found)[ankle], places[names.index(ankle)] + 0.02, atol=1e-6)


def test_poses_in_an_unknown_order_have_no_names(tmp_path):
    places, log = in_order(orders(17)["coco"])[np.random.default_rng(3).permutation(17)], Log()
    for i in range(4):
        log.add("/body", START + 33_000_000 * i, poses(i, places + 0.01 * i))
    found = vj.read_log(log.write(tmp_path / "a.mcap"))
    assert all(name.startswith("unnamed/") for name in pairs(found))
    assert any("no order that is known" in note for note in found.notes)


@pytest.mark.parametrize("says", [True, False])
@pytest.mark.parametrize(
    ("format", "count", "hidden", "name", "row"),
    [(0, 18, 0, "left_ear", 17), (0, 18, 1, "left_hip", 11), (1, 34, 2, "left_knee", 19), (2, 38, 2, "left_hip", 18)],
)
def test_bodies_without_names(format, count, hidden, name, row, says, tmp_path):
    """As ZED's: room for 70 key points, of which its smallest format fills 18. The last ones are often hidden; this
    makes no other format of them."""
    text = (
        "std_msgs/Header header\nz_msgs/Body[] objects\n"
        + SEP + "z_msgs/Body\nint16 label_id\n" + "int8 body_format\n" * says + "z_msgs/Skeleton skeleton_3d\n"
        + SEP + "z_msgs/Skeleton\nz_msgs/KeyPoint[70] keypoints\n" + SEP + "z_msgs/KeyPoint\nfloat32[3] kp\n"
    )  # fmt: skip
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(text, "z_msgs/msg/Bodies"))
    own = {name: store.types[f"z_msgs/msg/{name}"] for name in ("Bodies", "Body", "Skeleton", "KeyPoint")}
    log = Log(schema_text={"z_msgs/msg/Bodies": store.generate_msgdef("z_msgs/msg/Bodies", ros_version=2)[0].encode()})
    for i, frame in enumerate(AT):
        places = np.full((70, 3), np.nan, np.float32)
        places[: count - hidden] = frame[: count - hidden]
        body = own["Body"](7, *[format] * says, own["Skeleton"]([own["KeyPoint"](p) for p in places]))
        stamp = START + 33_000_000 * i
        head = store.types["std_msgs/msg/Header"]
        time = store.types["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
        data = bytes(store.serialize_cdr(own["Bodies"](head(time, "map"), [body]), "z_msgs/msg/Bodies"))
        log.add("/bodies", stamp, ("z_msgs/msg/Bodies", data))
    found = vj.read_log(log.write(tmp_path / "a.mcap"))
    np.testing.assert_allclose(pairs(found)[f"body7:{name}"], AT[2, row], atol=1e-5)
    assert len(pairs(found)) == count - hidden
