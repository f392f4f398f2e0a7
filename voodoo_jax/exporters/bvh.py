"""BVH for animation programs: centimetres, y up, z forwards, x to the figure's left; degrees, order Z X Y.

`write`: every joint has six channels, as Blender and others read them: its position is that of the tracks to the last
digit. `write_rigid`: rotations alone but for the root, for programs that know nothing else; limbs keep their lengths,
so joints are as far off the tracks as elastic bands were stretched. Frames without pose repeat the last one.
"""

import os
import warnings
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from voodoo_jax.config.output_style import Style
from voodoo_jax.exporters.frames import ANIMATION, evenly
from voodoo_jax.exporters.skeleton import Skeleton, skeleton
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.storage.atomic import replacing

TURNS = "Zrotation Xrotation Yrotation"
PLACES = "Xposition Yposition Zposition"
CENTIMETRES = 100.0


def write(tracks: Tracks, path: str | os.PathLike[str], style: Style | None = None, rigid: bool = False) -> None:
    """Writes a BVH whose joints are those of the tracks; `rigid`: of limbs of fixed lengths, without positions but the
    root's. Raises OSError."""
    tracks, rate = evenly(tracks)
    bones = skeleton(tracks, ANIMATION, style, rigid)
    lines = ["HIERARCHY", *_joint(bones, 0, 0, rigid), "MOTION", f"Frames: {len(tracks.time_ns)}"]
    lines.append(f"Frame Time: {1 / rate:.9f}")
    columns = []
    for i in range(len(bones.names)):
        if i == 0 or not rigid:
            columns.append(CENTIMETRES * bones.translation[:, i])
        columns.append(_angles(bones.rotation[:, i]))
    for row in np.concatenate(columns, 1):
        lines.append(" ".join(f"{value:.6f}" for value in row))
    with replacing(path) as partial:
        partial.write_text("\n".join(lines) + "\n", encoding="utf-8")


write_rigid = partial(write, rigid=True)


def _joint(bones: Skeleton, bone: int, depth: int, rigid: bool) -> list[str]:
    pad, offset = "\t" * depth, CENTIMETRES * bones.offsets[bone]
    if bone == 0:  # it lies where its channels say
        offset = np.zeros(3)
    channels = f"CHANNELS 3 {TURNS}" if rigid and bone else f"CHANNELS 6 {PLACES} {TURNS}"
    lines = [f"{pad}{'JOINT' if bone else 'ROOT'} {bones.names[bone]}", pad + "{"]
    lines += [f"{pad}\t{_offset(offset)}", f"{pad}\t{channels}"]
    children = bones.children(bone)
    for child in children:
        lines += _joint(bones, child, depth + 1, rigid)
    if not children:
        tip = CENTIMETRES * (bones.tips[bone] - bones.bind[bone])
        lines += [f"{pad}\tEnd Site", pad + "\t{", f"{pad}\t\t{_offset(tip)}", pad + "\t}"]
    return [*lines, pad + "}"]


def _offset(values: np.ndarray) -> str:
    return "OFFSET " + " ".join(f"{value + 0.0:.6f}" for value in np.round(values, 6))


def _angles(turn: np.ndarray) -> np.ndarray:
    """Degrees about Z, X, Y of unit quaternions wxyz, without jumps of a full turn."""
    if not len(turn):
        return np.zeros((0, 3))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # at gimbal lock the third is set to 0, which is as good
        found = Rotation.from_quat(turn, scalar_first=True).as_euler("ZXY", degrees=True)
    return np.unwrap(found, period=360, axis=0)
