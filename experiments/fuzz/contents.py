"""Sound files with messages that nobody means: images, calibrations, times, transforms, clouds and markers."""

import random
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from experiments.fuzz.kinds import Input, chance, mutated, png, rvl
from experiments.fuzz.logs import U32, Base, Log, Style, T, cdr, ros, written

S, G, V = "sensor_msgs/msg/", "geometry_msgs/msg/", "visualization_msgs/msg/"
ODD = (0.0, float("nan"), float("inf"), -float("inf"), -1.0, 1e-300, 1e300, 1e-5, 1e8)


def put(message: Any, **values: Any) -> None:
    """Sets fields."""
    for name, value in values.items():
        setattr(message, name, value)


def images(base: Base) -> Iterator[Input]:
    """Depth images that are not what they say, or hold absurd distances."""
    side = {
        "height 0": dict(height=0),
        "width 0": dict(width=0),
        "2^16 x 2^16": dict(height=65536, width=65536),
        "height 2^32": dict(height=U32),
        "width 2^32": dict(width=U32),
        "step 0": dict(step=0),
        "step 1": dict(step=1),
        "step 2^32": dict(step=U32),
        "no data": dict(data=np.zeros(0, np.uint8)),
        "encoding empty": dict(encoding=""),
        "encoding rgb8": dict(encoding="rgb8"),
        "encoding 32FC1": dict(encoding="32FC1"),
        "one row": dict(height=1),
        "encoding control": dict(encoding="\n\x1b[2J" * 100),
        "big endian 1": dict(is_bigendian=1),
        "big endian 255": dict(is_bigendian=255),
        "one pixel": dict(height=1, width=1),
    }
    for name, values in side.items():
        for which, only in (("all", None), ("every other", range(0, 99, 2))):
            change = lambda m, n, values=values: put(m, **values)  # noqa: E731
            yield Input(
                f"image/{name}/{which}",
                lambda change=change, only=only: written(base.edited(base.depth, change, only)),
            )
    for value in (0, 1, 3000, 65535):
        flat = lambda m, n, v=value: put(m, data=np.full(m.data.size // 2, v, "<u2").view(np.uint8))  # noqa: E731
        yield Input(f"image/all {value}", lambda flat=flat: written(base.edited(base.depth, flat)))
    for value in (np.nan, np.inf, -np.inf, 1e38, 1e-38, -3.0, 1e20):
        for share in (1.0, 0.1):
            change = lambda m, n, v=value, s=share: _floats(m, n, v, s)  # noqa: E731
            make = lambda change=change: written(base.edited(base.depth, change))  # noqa: E731
            yield Input(f"image/32FC1 {value}/share {share}", make)
    noise = lambda m, n: put(m, data=np.random.default_rng(n).integers(0, 256, m.data.size, np.uint8))  # noqa: E731
    yield Input("image/noise", lambda: written(base.edited(base.depth, noise)))
    half = lambda m, n: put(m, height=m.height // (1 + n % 2), data=m.data[: m.data.size // (1 + n % 2)])  # noqa: E731
    yield Input("image/two sizes", lambda: written(base.edited(base.depth, half)))
    yield Input(
        "image/4096 x 4096", lambda: written(base.edited(base.depth, _huge, range(2)), Style("zstd")), large=True
    )


def _floats(m: Any, n: int, value: float, share: float) -> None:
    z = m.data.view("<u2").astype("<f4") / 1000
    z[np.random.default_rng(n).random(z.size) < share] = value
    put(m, encoding="32FC1", step=4 * m.width, data=z.view(np.uint8))


def _huge(m: Any, n: int) -> None:
    put(m, height=4096, width=4096, step=8192, data=np.full(4096 * 4096, 2000, "<u2").view(np.uint8))


def calibrations(base: Base) -> Iterator[Input]:
    """Cameras that there cannot be."""

    def camera(name: str, change: Callable[[Any], None]) -> Input:
        return Input(f"camera/{name}", lambda: written(base.edited(base.info, lambda m, n: change(m))))

    def filled(m: Any, field: str, value: float, places: tuple[int, ...] | None) -> None:
        array = np.array(getattr(m, field), float)
        array[list(places) if places else slice(None)] = value
        setattr(m, field, array)

    for value in ODD:
        for name, field, places in (
            ("K", "k", None),
            ("focal", "k", (0, 4)),
            ("centre", "k", (2, 5)),
            ("P", "p", None),
        ):
            yield camera(f"{name} {value}", lambda m, f=field, v=value, p=places: filled(m, f, v, p))
        yield camera(f"D {value}", lambda m, v=value: put(m, d=np.full(5, v)))
    roi = T[S + "RegionOfInterest"](U32, U32, U32, U32, True)
    others = {
        "odd model": dict(d=np.ones(3), distortion_model="\x1bodd"),
        "D of 1": dict(d=np.array([0.1])),
        "D of 100,000": dict(d=np.full(100_000, 1e-3)),
        "fisheye of 2": dict(d=np.ones(2), distortion_model="equidistant"),
        "width 0": dict(width=0, height=0),
        "width 2^32": dict(width=U32, height=U32),
        "roi 2^32": dict(roi=roi),
        "binning 2^32": dict(binning_x=U32, binning_y=U32),
        "R nan": dict(r=np.full(9, np.nan)),
    }
    for name, values in others.items():
        yield camera(name, lambda m, values=values: put(m, **values))
    yield camera("frame elsewhere", lambda m: put(m.header, frame_id="elsewhere"))
    yield Input("camera/none", lambda: written(base.log.without(base.info)))


def times(base: Base) -> Iterator[Input]:
    """Stamps and log times that nobody means."""
    word, most = struct.Struct("<iI"), 2**31 - 1

    def turned(d: bytes, n: int, f: Callable[[int, int, int], tuple[int, int]]) -> bytes:
        return d[:4] + word.pack(*f(n, *word.unpack_from(d, 4))) + d[12:]

    wild = lambda n: random.Random(n)  # noqa: E731
    stamps: dict[str, Callable[[int, int, int], tuple[int, int]]] = {
        "zero": lambda n, s, ns: (0, 0),
        "negative": lambda n, s, ns: (-s, ns),
        "least": lambda n, s, ns: (-most - 1, 0),
        "most": lambda n, s, ns: (most, U32),
        "same": lambda n, s, ns: (1000, 0),
        "backwards": lambda n, s, ns: (s - n, ns),
        "ten years apart": lambda n, s, ns: (n * 10_000_000, 0),
        "1 ns apart": lambda n, s, ns: (1000, n),
        "one leap": lambda n, s, ns: (most if n == 6 else s, ns),
        "one zero": lambda n, s, ns: (0 if n == 6 else s, 1),
        "one negative": lambda n, s, ns: (-5 if n == 3 else s, ns),
        "there and back": lambda n, s, ns: (s + 10**8 * (n % 2), ns),
        "wild": lambda n, s, ns: (wild(n).randrange(-most, most), wild(-n).randrange(U32)),
        "an hour between": lambda n, s, ns: (s + 3600 * (n > 7), ns),
    }
    for name, f in stamps.items():
        yield Input(f"stamp/{name}", lambda f=f: written(base.log.changed(base.depth, lambda d, n: turned(d, n, f))))
    nothing = base.log.changed(base.depth, lambda d, n: d[:4] + bytes(8) + d[12:])
    logged: dict[str, Callable[[int, int], int]] = {
        "zero": lambda t, k: 0,
        "2^64": lambda t, k: 2**64 - 1,
        "2^63": lambda t, k: 2**63 + k,
        "backwards": lambda t, k: 10**18 - k,
        "mixed": lambda t, k: (0, 2**64 - 1, t)[k % 3],
    }
    for name, g in logged.items():
        for what, log in (("", base.log), (", no stamps", nothing)):
            yield Input(f"log time/{name}{what}", lambda log=log, g=g: written(_logged(log, g)))
    # of each bit of one message's times: the first word is the stamp of its header
    for bit in range(64):
        flip = lambda d, n, b=bit: d[:4] + (int.from_bytes(d[4:12], "little") ^ 1 << b).to_bytes(8, "little") + d[12:]  # noqa: E731
        one = lambda flip=flip: written(base.log.changed(base.depth, flip, [7]))  # noqa: E731
        yield Input(f"stamp/bit {bit} of one", one)


def _logged(log: Log, time: Callable[[int, int], int]) -> Log:
    return replace(log, messages=tuple(replace(m, time=time(m.time, k)) for k, m in enumerate(log.messages)))


def transforms(base: Base) -> Iterator[Input]:
    """Poses and trees of frames that cannot be."""
    nan, inf, camera = float("nan"), float("inf"), base.images[0].header.frame_id

    def changed(change: Callable[[Any], Any], topic: str = base.tf) -> bytes:
        return written(base.edited(base.tf, lambda m, n: change(m)).renamed(base.tf, topic))

    for name, q in {
        "0": (0, 0, 0, 0),
        "nan": (nan,) * 4,
        "inf": (inf, 0, 0, 1),
        "2": (0, 0, 0, 2),
        "odd": (3, -4, 5, 6),
        "1e200": (1e200, 0, 0, 1e200),
        "1e-200": (0, 0, 0, 1e-200),
        "1e-320": (0, 0, 0, 1e-320),
        "1e308": (1e308,) * 4,
    }.items():
        turn = lambda m, q=q: [put(t.transform.rotation, **dict(zip("xyzw", map(float, q)))) for t in m.transforms]  # noqa: E731
        yield Input(f"tf/quaternion {name}", lambda turn=turn: changed(turn))
    for value in (nan, inf, 1e5, 1e20, 1e38, 1e300):
        move = lambda m, v=value: [put(t.transform.translation, x=v) for t in m.transforms]  # noqa: E731
        yield Input(f"tf/translation {value}", lambda move=move: changed(move))

    def edge(parent: str, child: str, stamp: int = 0) -> Any:
        pose = T[G + "Transform"](T[G + "Vector3"](0.0, 0.0, 0.0), T[G + "Quaternion"](0.0, 0.0, 0.0, 1.0))
        time = T["builtin_interfaces/msg/Time"](stamp // 10**9, stamp % 10**9)
        return T[G + "TransformStamped"](T["std_msgs/msg/Header"](time, parent), child, pose)

    trees = {
        "none": [],
        "self": [edge(camera, camera)],
        "cycle": [edge("a", camera), edge("b", "a"), edge(camera, "b")],
        "cycle above": [edge("a", camera), edge("b", "a"), edge("a", "b")],
        "parents": [edge(p, camera) for p in "abc"],
        "no names": [edge("", ""), edge("", camera)],
        "elsewhere": [edge("a", "b")],
        "chain of 5000": [edge(f"f{n + 1}", f"f{n}") for n in range(5000)] + [edge("f0", camera)],
        "star of 20,000": [edge(camera, f"s{n}") for n in range(20_000)],
        "late": [edge("a", camera, (2**31 - 1) * 10**9)],
        "negative": [edge("a", camera, -(10**18))],
    }
    for name, edges in trees.items():
        tree = lambda m, edges=edges: put(m, transforms=edges)  # noqa: E731
        for topic in (base.tf, "/tf"):
            yield Input(f"tf/{name}/{topic}", lambda tree=tree, topic=topic: changed(tree, topic))


def _cloud(base: Base, n: int, points: np.ndarray) -> Any:
    fields: list[Any] = [T[S + "PointField"](axis, 4 * i, 7, 1) for i, axis in enumerate("xyz")]
    data = np.ascontiguousarray(points, "<f4").reshape(-1).view(np.uint8)
    count = len(points)
    return T[S + "PointCloud2"](base.header(n), 1, count, fields, False, 12, 12 * count, data, True)


def clouds(base: Base, seed: int) -> Iterator[Input]:
    """Point clouds that are not what they say, or hold absurd points."""
    F = T[S + "PointField"]
    axes = lambda offset=None, kind=7, count=1: [  # noqa: E731
        F(a, 4 * i if offset is None else offset, kind, count) for i, a in enumerate("xyz")
    ]
    values = {
        "step 0": dict(point_step=0),
        "step 1": dict(point_step=1),
        "step 2^32": dict(point_step=U32),
        "row step 0": dict(row_step=0),
        "row step 2^32": dict(row_step=U32),
        "width 2^32": dict(width=U32),
        "height 2^32": dict(height=U32),
        "2^16 x 2^16": dict(width=65536, height=65536),
        "2^64 points of nothing": dict(width=U32, height=U32, point_step=0, row_step=0),
        "height 0": dict(height=0),
        "no fields": dict(fields=[]),
        "10,000 fields": dict(fields=axes() + [F(f"f{i}", 0, 7, 1) for i in range(10_000)]),
        "fields twice": dict(fields=axes() + axes()),
        "type 0": dict(fields=axes(kind=0)),
        "type 99": dict(fields=axes(kind=99)),
        "offset 10": dict(fields=axes(10)),
        "offset 2^32": dict(fields=axes(U32)),
        "count 2^32": dict(fields=axes(count=U32)),
        "doubles": dict(fields=axes(0, 8)),
        "bytes": dict(fields=axes(kind=1)),
        "odd names": dict(fields=axes() + [F(a, 0, 7, 1) for a in ("", "\n", "__class__", "a" * 10**5)]),
        "no data": dict(data=np.zeros(0, np.uint8)),
        "big endian": dict(is_bigendian=True),
    }

    def made(points: Callable[[np.ndarray, int], np.ndarray], **other: Any) -> bytes:
        def one(n: int) -> bytes:
            with np.errstate(all="ignore"):
                m = _cloud(base, n, points(base.clouds[n], n))
            put(m, **other)
            return cdr(m)

        return written(base.instead("/points", ros(S + "PointCloud2"), "cdr", one))

    for name, other in values.items():
        yield Input(f"cloud/{name}", lambda other=other: made(lambda p, n: p, **other))
    some = lambda p, n: np.random.default_rng(n).random((len(p), 1)) < 0.1  # noqa: E731
    shapes: dict[str, Callable[[np.ndarray, int], np.ndarray]] = {
        "sound": lambda p, n: p,
        "none": lambda p, n: p[:0],
        "one": lambda p, n: p[:1],
        "ten": lambda p, n: p[:10],
        "nan": lambda p, n: p * np.nan,
        "inf": lambda p, n: p * np.inf,
        "the same": lambda p, n: np.repeat(p[:1], 5000, 0),
        "zero": lambda p, n: p * 0,
        "a line": lambda p, n: p * [0, 0, 1],
        "a plane": lambda p, n: p * [1, 1, 0] + [0, 0, 2],
        "1e10": lambda p, n: p * 1e10,
        "3e38": lambda p, n: np.sign(p) * 3e38,
        "1e-30": lambda p, n: p * 1e-30,
        "a tenth nan": lambda p, n: np.where(some(p, n), np.nan, p),
        "a tenth 1e38": lambda p, n: np.where(some(p, n), 1e38, p),
        "noise": lambda p, n: np.random.default_rng(n).normal(0, 3, (20_000, 3)),
        "every other empty": lambda p, n: p[: len(p) * (n % 2)],
        "the first alone": lambda p, n: p[: len(p) * (n == 0)],
        "leaps": lambda p, n: p + [10 * (n % 2), 0, 0],
        "100 times": lambda p, n: p * 100,
        "upside down": lambda p, n: p * [1, -1, 1],
    }
    for name, f in shapes.items():
        yield Input(f"points/{name}", lambda f=f: made(f))
    many = lambda p, n: np.resize(p, (5_000_000, 3)) if n == 3 else p  # noqa: E731
    yield Input("points/5 million in one", lambda: made(many), large=True)
    yield from _protobuf(base, seed)


def _protobuf(base: Base, seed: int) -> Iterator[Input]:
    from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
    from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
    from mcap_protobuf.schema import build_file_descriptor_set

    text = build_file_descriptor_set(PointCloud).SerializeToString()

    def message(n: int) -> Any:
        frame, points = base.images[n].header.frame_id, base.clouds[n].astype("<f4").tobytes()
        m: Any = PointCloud(frame_id=frame, point_stride=12, data=points)
        m.timestamp.FromNanoseconds(base.times[n])
        for i, axis in enumerate("xyz"):
            m.fields.add(name=axis, offset=4 * i, type=PackedElementField.FLOAT32)
        return m

    def made(change: Callable[[Any], Any], raw: Callable[[bytes], bytes] = lambda d: d, schema: bytes = text) -> bytes:
        def one(n: int) -> bytes:
            m = message(n)
            change(m)
            return raw(m.SerializeToString())

        return written(base.instead("/points", ("foxglove.PointCloud", "protobuf", schema), "protobuf", one))

    def turned(m: Any, w: float = 1.0, **place: float) -> None:
        m.pose.orientation.w = w
        for axis, value in place.items():
            setattr(m.pose.position, axis, value)

    def garbage(rng: random.Random) -> bytes:
        return made(lambda m: None, lambda d: mutated(d if rng.random() < 0.5 else d[-120:], rng))

    odd: dict[str, Callable[[Any], Any]] = {
        "sound": lambda m: None,
        "stride 0": lambda m: put(m, point_stride=0),
        "stride 2^32": lambda m: put(m, point_stride=U32),
        "no fields": lambda m: m.ClearField("fields"),
        "no time": lambda m: m.ClearField("timestamp"),
        "no data": lambda m: m.ClearField("data"),
        "offset 2^32": lambda m: [put(f, offset=U32) for f in m.fields],
        "time 2^62": lambda m: put(m.timestamp, seconds=2**62),
        "time -2^62": lambda m: put(m.timestamp, seconds=-(2**62)),
        "pose 0": lambda m: m.pose.SetInParent(),
        "pose nan": lambda m: turned(m, float("nan")),
        "pose far": lambda m: turned(m, x=1e300),
        "pose long": lambda m: turned(m, 1e300),
        "frame of 1 MB": lambda m: put(m, frame_id="f" * 10**6),
    }
    for name, change in odd.items():
        yield Input(f"protobuf/{name}", lambda change=change: made(change))
    for number in range(30):
        name = f"protobuf/garbage {number}"
        yield Input(name, lambda name=name: garbage(chance(seed, name)), by_chance=True)
    for number in range(10):
        name = f"protobuf/schema {number}"
        other = lambda name=name: made(lambda m: None, schema=mutated(text, chance(seed, name), 3))  # noqa: E731
        yield Input(name, other, by_chance=True)


def packed_images(base: Base, seed: int) -> Iterator[Input]:
    """Compressed depth and colour: damaged, or larger than memory."""

    def depth(data: Callable[[int, np.ndarray], bytes], how: str = "png") -> bytes:
        def one(n: int) -> bytes:
            image = base.images[n]
            body = bytes(12) + data(n, image.data.view("<u2").reshape(image.height, image.width))
            m = T[S + "CompressedImage"](base.header(n), f"16UC1; compressedDepth {how}", np.frombuffer(body, np.uint8))
            return cdr(m)

        return written(base.instead(base.depth + "/compressedDepth", ros(S + "CompressedImage"), "cdr", one))

    sound = lambda n, raw: cv2.imencode(".png", raw)[1].tobytes()  # noqa: E731
    yield Input("png/sound", lambda: depth(sound))
    for number in range(20):
        name = f"png/garbage {number}"
        rng = lambda name=name: chance(seed, name)  # noqa: E731
        make = lambda rng=rng: (lambda r: depth(lambda n, raw: mutated(sound(n, raw), r)))(rng())  # noqa: E731
        yield Input(name, make, by_chance=True)
        name = f"rvl/garbage {number}"
        rng = lambda name=name: chance(seed, name)  # noqa: E731
        body = lambda n, raw, r: rvl(raw.shape[1], raw.shape[0], []) + r.randbytes(r.choice([0, 3, 40, 4000]))  # noqa: E731
        garbage = lambda rng=rng, body=body: (lambda r: depth(lambda n, raw: body(n, raw, r), "rvl"))(rng())  # noqa: E731
        yield Input(name, garbage, by_chance=True)
    for side in (4096, 16384):
        zeros = lambda s=side: (lambda one: depth(lambda n, raw: one if n == 4 else sound(n, raw)))(png(s, s))  # noqa: E731
        yield Input(f"png/{side} x {side}, one", zeros, large=True)
        run = lambda n, raw, s=side: rvl(s, s, [s * s - 1, 1, 3000])  # noqa: E731
        yield Input(f"rvl/{side} x {side}, all", lambda run=run: depth(run, "rvl"), large=True)
    for side in (16_384, 60_000):
        lie = lambda s=side: (lambda one: depth(lambda n, raw: one))(png(100, 100, (s, s)))  # noqa: E731
        yield Input(f"png/{side} x {side} said", lie)
    for name, numbers in {"2^60": [2**60, 2**60], "2^63": [2**63, 2**62, 1], "-5 x -5": [25, 0]}.items():
        size = base.images[0].width, base.images[0].height
        columns, rows = (-5, -5) if name.startswith("-") else size
        image = lambda n, raw, c=columns, r=rows, k=numbers: rvl(c, r, k)  # noqa: E731
        yield Input(f"rvl/{name}", lambda image=image: depth(image, "rvl"))
    yield from _stereo(base, seed)


def _stereo(base: Base, seed: int) -> Iterator[Input]:
    def pair(data: Callable[[int, str], bytes]) -> bytes:
        log = base.log.without(base.depth, base.info)
        for side, shift in (("left", 0.0), ("right", -12.0)):
            camera = base.parsed(base.info)[0]
            camera.p = np.array(camera.p, float)
            camera.p[3] = shift
            log = log.added(f"/stereo/{side}/camera_info", ros(S + "CameraInfo"), "cdr", [(base.times[0], cdr(camera))])
            items = [(time, jpeg(n, data(n, side))) for n, time in enumerate(base.times)]
            log = log.added(f"/stereo/{side}/image/compressed", ros(S + "CompressedImage"), "cdr", items)
        return written(log)

    def jpeg(n: int, data: bytes) -> bytes:
        return cdr(T[S + "CompressedImage"](base.header(n), "jpeg", np.frombuffer(data, np.uint8)))

    def picture(n: int, rows: int = 124, columns: int = 160) -> bytes:
        pixels = np.random.default_rng(n).integers(0, 256, (rows, columns, 3), np.uint8)
        return cv2.imencode(".jpg", pixels)[1].tobytes()

    def sized(n: int, side: int) -> bytes:
        made = picture(n)
        at = made.index(b"\xff\xc0")
        return made[: at + 5] + struct.pack(">HH", side, side) + made[at + 9 :]

    yield Input("jpeg/noise", lambda: pair(lambda n, side: picture(n)), large=True)
    for side in (0, 30_000, 60_000):
        yield Input(f"jpeg/{side} x {side} said", lambda s=side: pair(lambda n, _: sized(n, s)))
    yield Input(
        "jpeg/sides differ", lambda: pair(lambda n, side: picture(n, *((124, 160) if side == "left" else (60, 80))))
    )
    yield Input("jpeg/empty", lambda: pair(lambda n, side: b"\xff\xd8\xff\xd9"))
    for number in range(6):
        name = f"jpeg/garbage {number}"
        rng = lambda name=name: chance(seed, name)  # noqa: E731
        make = lambda rng=rng: (lambda r: pair(lambda n, side: mutated(picture(n), r)))(rng())  # noqa: E731
        yield Input(name, make, by_chance=True)


def markers(base: Base) -> Iterator[Input]:
    """Named points beside the images: many, absurd, or with absurd names."""

    def made(count: int, name: Callable[[int], str], x: float = 0.0) -> bytes:
        quaternion, scale = T[G + "Quaternion"](0.0, 0.0, 0.0, 1.0), T[G + "Vector3"](1.0, 1.0, 1.0)
        nothing = T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](0, 0), "")
        rest: dict[str, Any] = {
            "type": 2,
            "action": 0,
            "pose": T[G + "Pose"](T[G + "Point"](x, 0.0, 2.0), quaternion),
            "scale": scale,
            "color": T["std_msgs/msg/ColorRGBA"](1.0, 1.0, 1.0, 1.0),
            "lifetime": T["builtin_interfaces/msg/Duration"](0, 0),
            "frame_locked": False,
            "points": [],
            "colors": [],
            "texture_resource": "",
            "texture": T[S + "CompressedImage"](nothing, "", np.zeros(0, np.uint8)),
            "uv_coordinates": [],
            "text": "",
            "mesh_resource": "",
            "mesh_file": T[V + "MeshFile"]("", np.zeros(0, np.uint8)),
            "mesh_use_embedded_materials": False,
        }
        items = []
        for n, time in enumerate(base.times):
            each: list[Any] = [T[V + "Marker"](header=base.header(n), ns=name(i), id=i, **rest) for i in range(count)]
            items.append((time, cdr(T[V + "MarkerArray"](each))))
        return written(base.log.added("/markers", ros(V + "MarkerArray"), "cdr", items), Style("zstd"))

    yield Input("markers/none", lambda: made(0, str))
    yield Input("markers/2000 of one name", lambda: made(2000, lambda i: "LASI"), large=True)
    yield Input("markers/2000 names", lambda: made(2000, lambda i: f"m{i}"), large=True)
    yield Input("markers/name of 1 MB", lambda: made(1, lambda i: "n" * 10**6))
    yield Input("markers/control characters", lambda: made(1, lambda i: "\x1b[31mLASI\n"))
    for value in (float("nan"), 1e8, 1e30):
        yield Input(f"markers/at {value}", lambda v=value: made(3, lambda i: "LASI", v))


def everything(base: Base, seed: int) -> list[Input]:
    """All inputs."""
    from experiments.fuzz import kinds

    groups = (
        kinds.files(base, seed),
        kinds.names(base),
        kinds.schemas(base),
        kinds.messages(base, seed),
        images(base),
        calibrations(base),
        times(base),
        transforms(base),
        clouds(base, seed),
        packed_images(base, seed),
        markers(base),
    )
    return [one for group in groups for one in group]
