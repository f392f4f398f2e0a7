"""Point clouds, a file for each frame, in a folder or alone: PCD and PLY; metres."""

from io import BytesIO
from pathlib import Path

import numpy as np
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud

from voodoo_jax.config.limited import too_large
from voodoo_jax.geometry.arrays_file import array_at
from voodoo_jax.io.convert.target import ConvertError, content, named_times, new_log, putter
from voodoo_jax.storage.guarded import Answer

TOPIC, FRAME = "/points", "sensor"
ENDINGS = (".pcd", ".ply")
AXES = ("x", "y", "z")
MOST = 88  # bytes that a byte of LZF can become: 264 for a repetition of 3


def convert(source: Path, target: Answer, rate: float) -> list[str]:
    """Writes x, y, z of all points, 32 bits; non-finite points are left out. Raises ConvertError, OSError."""
    clouds = named_times(source, ENDINGS, rate)
    notes, written = [], 0
    with new_log(target) as writer:
        put = putter(writer)
        for stamp, path in clouds:
            try:
                read = read_pcd if path.suffix.lower() == ".pcd" else _read_ply
                points = read(content(path, source if source.is_dir() else None), path.name)
                if trouble := too_large("the cloud has", len(points), "points", "points"):
                    raise ConvertError(f"'{path.name}': {trouble}")
            except (ConvertError, OSError) as problem:
                notes.append(str(problem))
                continue
            points = points[np.isfinite(points).all(1)].astype("<f4")
            message = PointCloud(frame_id=FRAME, point_stride=12, data=points.tobytes())
            message.pose.orientation.w = 1
            for k, name in enumerate(AXES):
                message.fields.append(PackedElementField(name=name, offset=4 * k, type=PackedElementField.FLOAT32))
            put(TOPIC, stamp, message)
            written += 1
        if not written:
            raise ConvertError(f"'{source}': no cloud could be read; {notes[0] if notes else 'there is none'}")
    return notes


def read_pcd(data: bytes, name: str) -> np.ndarray:
    """x, y, z of the points of a PCD file of this name [point, 3]. Raises ConvertError.

    The format: pointclouds.org, "The PCD file format", version 0.7.
    """
    header, at = {}, 0
    while "DATA" not in header:
        end = data.find(b"\n", at)
        if end < 0 or at > 4096:
            raise ConvertError(f"'{name}' is not a PCD file: it has no DATA line")
        words = data[at:end].decode("ascii", "replace").split()
        if words and not words[0].startswith("#"):
            header[words[0]] = words[1:]
        at = end + 1
    try:
        names, count = header["FIELDS"], int(header["POINTS"][0])
        if trouble := too_large("it has", count, "points", "points"):
            raise ValueError(trouble)
        widths = [int(n) for n in header.get("COUNT", ["1"] * len(names))]
        kinds = [f"<{ {'F': 'f', 'I': 'i', 'U': 'u'}[t] }{s}" for t, s in zip(header["TYPE"], header["SIZE"])]
        # fields of no name occur several times in padded clouds
        row = np.dtype(
            [(f"{field}.{i}", kind, (width,)) for i, (field, kind, width) in enumerate(zip(names, kinds, widths))]
        )
        where = [names.index(axis) for axis in AXES]
        if header["DATA"] == ["ascii"]:
            starts = np.cumsum([0, *widths])
            table = np.array([line.split() for line in data[at:].decode().splitlines() if line.strip()], float)
            return table[:count, [starts[i] for i in where]].reshape(-1, 3)
        if header["DATA"] == ["binary_compressed"]:
            table = _columns(data[at:], row, count)
        elif header["DATA"] == ["binary"]:
            table = array_at(data, row, (count,), at)
        else:
            raise ConvertError(f"'{name}': PCD data '{' '.join(header['DATA'])}' are not supported")
        return np.stack([table[f"{names[i]}.{i}"][:, 0].astype(float) for i in where], 1)
    except (KeyError, IndexError, ValueError) as problem:
        if isinstance(problem, ConvertError):
            raise
        raise ConvertError(f"'{name}' cannot be read as PCD: {type(problem).__name__}: {problem}") from problem


def _columns(data: bytes, row: np.dtype, count: int) -> np.ndarray:
    """Rows of compressed data: two sizes, then all values of the first field, of the second, ... Raises ValueError."""
    packed, size = array_at(data, "<u4", (2,)).tolist()
    if size != count * row.itemsize or size > MOST * packed or len(data) < 8 + packed:
        raise ValueError(f"{packed} bytes for {count} points of {row.itemsize} bytes")
    plain, at = _unpacked(data[8 : 8 + packed], size), 0
    table = np.empty(count, row)
    for name in row.names or ():
        field = row[name]
        table[name] = array_at(plain, field.base, (count, field.shape[0]), at)
        at += count * field.itemsize
    return table


def _unpacked(data: bytes, size: int) -> bytes:
    """Bytes that were packed by LZF (M. Lehmann's LibLZF, as PCL has it): its packages on PyPI come without wheels, and
    it is this loop. Raises ValueError."""
    out, at = bytearray(), 0
    while at < len(data):
        control, at = data[at], at + 1
        if control < 32:  # so many bytes and one as they are
            out += data[at : at + control + 1]
            at += control + 1
            continue
        length = (control >> 5) + 2
        if control >> 5 == 7:
            length, at = length + data[at], at + 1
        back, at = ((control & 31) << 8) + data[at] + 1, at + 1
        if back > len(out):
            raise ValueError("damaged data")
        piece = bytes(out[-back:])  # may be shorter than what is written: it repeats itself
        out += (piece * (length // back + 1))[:length]
    if len(out) != size:
        raise ValueError(f"{len(out)} bytes in place of {size}")
    return bytes(out)


def _read_ply(data: bytes, name: str) -> np.ndarray:
    import trimesh  # takes a second, which other recordings need not wait for

    try:
        made = trimesh.load(BytesIO(data), file_type="ply", process=False)
        return np.asarray(made.vertices, float).reshape(-1, 3)  # type: ignore[union-attr]
    except Exception as problem:  # trimesh has no error of its own
        raise ConvertError(f"'{name}' cannot be read as PLY: {type(problem).__name__}: {problem}") from problem
