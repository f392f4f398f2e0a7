"""Sound files of a few kB at each door, which doors.py changes."""

import json
import random
import sqlite3
import struct
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

CANARY = "voodoo-secret-7c1e"  # in a file beside the folders that are named
CAMERA = "width = 8\nheight = 6\nfx = 9.0\nfy = 9.0\ncx = 4.0\ncy = 3.0\nunit = 0.001\nrate = 30.0\n"


@dataclass(frozen=True)
class Sound:
    """Files in a folder (bytes, text, or a tree of JSON) and what of them is named: "" is the folder itself."""

    name: str
    main: str
    files: dict[str, Any]
    places: list[int] = field(default_factory=list)  # of numbers in binary files
    twist: Callable[[Path, random.Random], None] | None = None  # a change of another kind
    camera: bool = False
    rate: float = 0.0
    least: float = 0.03  # metres of a part that becomes a limb
    beside: Path = Path()


def sound_files(door: str, folder: Path) -> list[Sound]:
    """Those of a door; `folder` for what is made on the way."""
    folder.mkdir(parents=True)
    return {"convert": recordings, "body": bodies, "live": streams, "results": results, "pages": names}[door](folder)


# -- recordings of other formats


def recordings(folder: Path) -> list[Sound]:
    png = cv2.imencode(".png", np.arange(48, dtype=np.uint16).reshape(6, 8) * 40)[1].tobytes()
    colour = cv2.imencode(".png", np.full((6, 8, 3), 90, np.uint8))[1].tobytes()
    tum = {"camera.toml": CAMERA, "depth.txt": "1.0 depth/a.png\n1.1 depth/b.png\n", "depth/a.png": png}
    tum |= {"depth/b.png": png, "rgb.txt": "1.0 rgb/a.png\n", "rgb/a.png": colour}
    lines = [
        "PathFileType\t4\t(X/Y/Z)\ta.trc",
        "DataRate\tNumMarkers\tUnits",
        "100\t2\tmm",
        "Frame#\tTime\tA\t\t\tB\t\t",
    ]
    lines += ["\t\tX1\tY1\tZ1\tX2\tY2\tZ2", *(f"{k}\t{k / 100}\t1\t2\t3\t4\t5\t{k}" for k in range(1, 5))]
    joints = [[float(k), 2.0, 3.0] for k in range(3)]
    frames = [{"timestamp_usec": 33000 * k, "bodies": [{"body_id": 1, "joint_positions": joints}]} for k in range(4)]
    head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 5\nHEIGHT 1\nPOINTS 5\nDATA "
    points = np.arange(15, dtype="<f4").tobytes()
    packed = struct.pack("<II", 62, 60) + b"".join(bytes([29]) + points[k : k + 30] for k in (0, 30))
    clouds = {
        "1.0.pcd": head.encode() + b"binary\n" + points,
        "1.1.pcd": head.encode() + b"binary_compressed\n" + packed,
    }
    clouds |= {"1.2.pcd": head + "ascii\n" + "1 2 3\n" * 5}
    ply = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
    )
    plys = {"1.0.ply": (ply + "end_header\n").encode() + points, "1.1.ply": ply.replace("binary_little_endian", "ascii")
            + "end_header\n" + "1 2 3\n" * 5}  # fmt: skip
    bag, c3d = bag1(folder), c3d_file(folder)
    return [
        Sound("tum", "", tum, twist=links),
        Sound("bag", "a.bag", {"a.bag": bag}, fields_of(bag)),
        Sound("trc", "a.trc", {"a.trc": "\n".join(lines)}),
        Sound("db3", "a.db3", {"a.db3": bag2(folder)}, list(range(100)), twist=hostile_tables),
        Sound("json", "a.json", {"a.json": {"joint_names": ["a", "b", "c"], "frames": frames}}),
        Sound("pcd", "", clouds, twist=links),
        Sound("c3d", "a.c3d", {"a.c3d": c3d}, [*range(64), *range(512, 1200)]),
        Sound("ply", "", plys),
        Sound("mkv", "a.mkv", {"a.mkv": mkv(folder), "camera.toml": CAMERA}, list(range(600)), camera=True),
        Sound("folder", "", {"camera.toml": CAMERA, "f1.png": png, "f2.png": png}, list(range(60)), twist=links),
    ]


def fields_of(data: bytes) -> list[int]:
    """Places of lengths and numbers in records of a ROS 1 bag."""
    found, at = [], data.index(b"\n") + 1
    while at + 4 < len(data):
        length = struct.unpack_from("<I", data, at)[0]
        found += [at, at + 4, *(i + 1 for i in range(at, min(at + length, len(data))) if data[i : i + 1] == b"=")]
        at += 4 + length
        if at + 4 > len(data):
            break
        found.append(at)
        at += 4 + struct.unpack_from("<I", data, at)[0]
    return found


def bag1(folder: Path) -> bytes:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store, path = get_typestore(Stores.ROS1_NOETIC), folder / "a.bag"
    bag = Writer(path)
    bag.set_compression(Writer.CompressionFormat.BZ2)
    with bag:
        one = bag.add_connection("/words", "std_msgs/msg/String", typestore=store)
        for k in range(5):
            message = store.types["std_msgs/msg/String"](data=f"word {k}")
            bag.write(one, 10**9 + k, store.serialize_ros1(message, "std_msgs/msg/String"))
    return path.read_bytes()


def bag2(folder: Path) -> bytes:
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(folder / "bag", version=9) as bag:
        one = bag.add_connection("/words", "std_msgs/msg/String", typestore=store)
        for k in range(5):
            message = store.types["std_msgs/msg/String"](data=f"word {k}")
            bag.write(one, 10**9 + k, store.serialize_cdr(message, "std_msgs/msg/String"))
    return next((folder / "bag").glob("*.db3")).read_bytes()


def hostile_tables(folder: Path, rng: random.Random) -> None:
    """Values, types, views and generated columns that no recorder writes."""
    statements = [
        "UPDATE messages SET timestamp = -5", "UPDATE messages SET timestamp = 9e18", "UPDATE messages SET data = NULL",
        "UPDATE messages SET data = zeroblob(900000000)", "UPDATE messages SET topic_id = 'x'",
        "UPDATE topics SET name = char(27) || '[31m'", "UPDATE topics SET type = '../x'", "UPDATE topics SET type = 7",
        "UPDATE message_definitions SET encoded_message_definition = char(0)", "DELETE FROM topics",
        "UPDATE message_definitions SET encoded_message_definition = 'std_msgs/String x'",
        "INSERT INTO messages SELECT NULL, topic_id, timestamp, data FROM messages",
        "UPDATE schema SET schema_version = 99",
        "ALTER TABLE messages RENAME TO m; CREATE VIEW messages AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT"
        " x + 1 FROM c) SELECT x AS id, 1 AS topic_id, x AS timestamp, zeroblob(9) AS data FROM c",
        "ALTER TABLE messages RENAME TO m; CREATE TABLE messages(id, topic_id DEFAULT 1, timestamp DEFAULT 5, data"
        " GENERATED ALWAYS AS (zeroblob(900000000))); INSERT INTO messages(id) VALUES (1), (2), (3)",
    ]  # fmt: skip
    try:
        base = sqlite3.connect(folder / "a.db3")
        try:
            base.executescript("PRAGMA max_page_count = 2000;" + rng.choice(statements))
            base.commit()
        finally:
            base.close()
    except (sqlite3.Error, UnicodeError):  # it is damaged already
        return


def links(folder: Path, rng: random.Random) -> None:
    """A file becomes a link that leads out, or to a device."""
    path = rng.choice(sorted(p for p in folder.rglob("*") if p.is_file()))
    path.unlink()
    path.symlink_to(rng.choice(["/dev/zero", "/etc/passwd", "../../../secret", "../../secret", str(path)]))


def c3d_file(folder: Path) -> bytes:
    import ezc3d

    file = ezc3d.c3d()
    point = file["parameters"]["POINT"]
    point["LABELS"]["value"], point["UNITS"]["value"], point["RATE"]["value"] = ["A", "B"], ["mm"], [100.0]
    file["data"]["points"] = np.arange(40, dtype=float).reshape(4, 2, 5) + 1
    file.write(str(folder / "a.c3d"))
    return (folder / "a.c3d").read_bytes()


def mkv(folder: Path) -> bytes:
    import av

    with av.open(str(folder / "a.mkv"), "w") as container:
        depth: Any = container.add_stream("ffv1", rate=30)
        depth.width, depth.height, depth.pix_fmt, depth.metadata["title"] = 8, 6, "gray16le", "DEPTH"
        for k in range(3):
            frame = av.VideoFrame.from_ndarray(np.full((6, 8), 1000 + k, np.uint16), format="gray16le")
            frame.pts = k
            container.mux(depth.encode(frame))
        container.mux(depth.encode())
    return (folder / "a.mkv").read_bytes()


# -- bodies


def bodies(folder: Path) -> list[Sound]:
    import base64

    rng = np.random.default_rng(0)
    angle, height = rng.uniform(0, 6.3, 60), rng.uniform(0, 1, 60)
    vertices = np.stack([0.1 * np.cos(angle), height, 0.1 * np.sin(angle)], 1).astype("<f4")
    faces = rng.integers(0, 60, (40, 3)).astype("<u2")
    owner = np.zeros((60, 4), np.uint8)
    owner[:, 0] = height > 0.5
    weights = np.tile(np.array([1, 0, 0, 0], "<f4"), (60, 1))
    parts = [part.tobytes() for part in (vertices, faces, owner, weights)]
    starts = np.cumsum([0, *map(len, parts)]).tolist()
    kinds = [(5126, 60, "VEC3"), (5123, 120, "SCALAR"), (5121, 60, "VEC4"), (5126, 60, "VEC4")]
    tree = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": starts[-1], "uri": "a.bin"}],
        "bufferViews": [{"buffer": 0, "byteOffset": a, "byteLength": len(p)} for a, p in zip(starts, parts)],
        "accessors": [
            {"bufferView": k, "componentType": c, "count": n, "type": t} for k, (c, n, t) in enumerate(kinds)
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "JOINTS_0": 2, "WEIGHTS_0": 3}, "indices": 1}]}],
        "nodes": [
            {"mesh": 0, "skin": 0}, {"name": "root", "children": [2]}, {"name": "arm", "translation": [0, 0.5, 0]},
        ],
        "skins": [{"joints": [1, 2]}],
    }  # fmt: skip
    inline = json.loads(json.dumps(tree))
    inline["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(b"".join(parts)).decode()
    packed, binary = json.dumps(tree | {"buffers": [{"byteLength": starts[-1]}]}).encode(), b"".join(parts)
    packed += b" " * (-len(packed) % 4)
    glb = struct.pack("<III", 0x46546C67, 2, 28 + len(packed) + len(binary)) + struct.pack("<I4s", len(packed), b"JSON")
    glb += packed + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    box = "<visual><geometry><box size='0.1 0.1 0.4'/></geometry></visual>"
    mesh = "<visual><geometry><mesh filename='a.stl' scale='1 1 1'/></geometry></visual>"
    urdf = f"<robot name='x'><link name='a'>{box}</link><link name='b'>{mesh}</link><joint name='j' type='revolute'>"
    urdf += "<parent link='a'/><child link='b'/><origin xyz='0 0 0.4' rpy='0 0 0'/><axis xyz='0 1 0'/>"
    urdf += "<limit lower='-1' upper='1'/></joint></robot>"
    triangles = np.zeros(12, [("n", "<f4", 3), ("p", "<f4", (3, 3)), ("a", "<u2")])
    triangles["p"] = rng.uniform(0, 0.2, (12, 3, 3))
    stl = bytes(80) + struct.pack("<I", 12) + triangles.tobytes()
    obj = "".join(f"v {x:.3f} {y:.3f} {z:.3f}\n" for x, y, z in triangles["p"].reshape(-1, 3))
    obj += "".join(f"f {3 * k + 1} {3 * k + 2} {3 * k + 3}\n" for k in range(12))
    found = [
        Sound("gltf", "a.gltf", {"a.gltf": tree, "a.bin": binary}, twist=links),
        Sound("gltf inline", "a.gltf", {"a.gltf": inline}),
        Sound("glb", "a.glb", {"a.glb": glb}, [0, 4, 8, 12, 16, 20 + len(packed), 24 + len(packed)]),
        Sound("urdf", "a.urdf", {"a.urdf": urdf, "a.stl": stl}, [80, 84], twist=links),
        Sound("urdf obj", "a.urdf", {"a.urdf": urdf.replace("a.stl", "a.obj"), "a.obj": obj}),
    ]
    # seven of eight are read but not fitted, which takes ten times as long
    return [replace(one, least=10.0 if k else 0.03) for k in range(8) for one in found]


# -- what a server of messages says, and files that grow


def streams(folder: Path) -> list[Sound]:
    from experiments.common import DEMO
    from experiments.fuzz.logs import base_of, written

    base = base_of(DEMO / "demo.mcap", 2)
    channels = [
        {"id": n, "topic": topic, "encoding": encoding, "schemaName": base.log.schemas[schema][0],
         "schemaEncoding": base.log.schemas[schema][1], "schema": base.log.schemas[schema][2].decode()}
        for n, (topic, encoding, schema) in base.log.channels.items()
    ]  # fmt: skip
    said: list[Any] = [{"op": "serverInfo", "name": "x", "capabilities": []}, {"op": "advertise", "channels": channels}]
    said += [{"data": struct.pack("<BIQ", 1, m.channel, m.time).hex() + m.data.hex()} for m in base.log.messages]
    return [Sound("server", "said.json", {"said.json": said}), Sound("file", "a.mcap", {"a.mcap": written(base.log)})]


# -- results


def tracks_file(folder: Path) -> Path:
    """Tracks of the demo's first frames, all of them lost."""

    from voodoo_jax.exporters.npz import write_tracks_npz
    from voodoo_jax.model.body_file import load_on_host
    from voodoo_jax.records.tracks import Evidence, Tracks

    body, n = load_on_host("human"), 4
    limbs, centres = body.limb_count, len(body.topology.centres)
    arrays: dict[str, Any] = {
        "rotation": np.tile(np.array([1, 0, 0, 0], np.float32), (n, limbs, 1)),
        "translation": np.random.default_rng(0).normal(0, 1, (n, limbs, 3)).astype(np.float32),
        "joints": np.zeros((n, centres, 3), np.float32), "status": np.zeros(n, np.int8),
        "time_ns": 10**18 + np.arange(n, dtype=np.int64) * 33_000_000,
    }  # fmt: skip
    tracks = Tracks(source="a.mcap", fixed_frame="world", body=body, seconds=1.0, notes=("a note",),
                    evidence=Evidence.blank(n, limbs), **arrays)  # fmt: skip
    path = folder / "a.tracks.npz"
    write_tracks_npz(tracks, path)
    return path


def results(folder: Path) -> list[Sound]:
    from voodoo_jax.batch.outcome import Outcome

    path = tracks_file(folder)
    data = path.read_bytes()
    rows = [
        Outcome("a.mcap", "a.tracks.npz", 4, 1.0, 0.01, "stature 1.800 m", notes=("x",)).row(),
        Outcome("b.mcap").row(),
    ]
    text = "\n".join(json.dumps(row) for row in rows)
    return [
        Sound("npz", "a.tracks.npz", {"a.tracks.npz": data}, zip_fields(data)),
        Sound("npz arrays", "a.tracks.npz", {"a.tracks.npz": data}, zip_fields(data), twist=other_arrays),
        Sound("jsonl", "replay.jsonl", {"replay.jsonl": text, "a.tracks.npz": data}, twist=other_rows),
    ]


def zip_fields(data: bytes) -> list[int]:
    """Places in the heads of a ZIP archive's members."""
    found = []
    for mark, size in ((b"PK\3\4", 30), (b"PK\1\2", 46), (b"PK\5\6", 22)):
        at = data.find(mark)
        while at >= 0:
            found += range(at + 4, at + size)
            at = data.find(mark, at + 4)
    return found


def other_arrays(folder: Path, rng: random.Random) -> None:
    """Arrays of other kinds, shapes and values, in a sound archive."""
    path = folder / "a.tracks.npz"
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
    except Exception:  # it is damaged already
        return
    arrays.pop("digest", None)
    for name in rng.sample(sorted(arrays), rng.choice((1, 2, 4))):
        one = arrays[name]
        arrays[name] = rng.choice([
            np.zeros(0), one[..., None], one.ravel()[:1], np.array("\x1b[31m" * 5), np.full(one.shape, np.nan),
            np.full(one.shape, 1e308), np.array(-1), np.zeros((1, 0, 5)), np.array(["\u202e"] * 3), np.array(2**63 - 1),
            np.array(json.dumps({"name": "x", "\x1b": "y"})), np.array('{"stature": Infinity}'), np.array("["*100000),
        ])  # fmt: skip
    np.savez(path, **arrays)


def other_rows(folder: Path, rng: random.Random) -> None:
    """Rows that name other places, or have other kinds of values."""
    from voodoo_jax.batch.outcome import Outcome

    row = Outcome("a.mcap", "a.tracks.npz", 4, 1.0, 0.01, "stature 1.800 m", notes=("x",)).row()
    key = rng.choice(["tracks", *sorted(row)])
    row[key] = rng.choice([
        "http://127.0.0.1:9/x.tracks.npz", "ftp://127.0.0.1/x", "zip://x::http://127.0.0.1:9/x", "/etc/passwd",
        "../../secret",
        None, 7, 1e999, [], {"a": 1}, "<script>alert(1)</script>", "\x1b[31m",
    ])  # fmt: skip
    (folder / "replay.jsonl").write_text(json.dumps(row) + "\n")


# -- names in pages


def names(folder: Path) -> list[Sound]:
    words = [
        "<script>alert(1)</script>", "@BLOB@", "@HEAD@@BODY@@STYLE@", '"><img src=x onerror=alert(1)>', "</script><b>",
        "\u202eabc", "a&b;", "]]>", "@ROWS@" * 50, "{{x}}", "\x00", "\ud800".encode("utf-8", "replace").decode(),
    ]  # fmt: skip
    made = tracks_file(folder)
    return [
        Sound("names", "words.json", {"words.json": {"words": words[k:] + words[:k]}}, beside=made) for k in range(12)
    ]
