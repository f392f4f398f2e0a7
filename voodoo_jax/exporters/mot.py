"""MOT, coordinates over time for OpenSim: joint angles in degrees, the pelvis in metres; x forwards, y up.

Coordinates have the names and signs of the Rajagopal 2016 model where the body is a person: they move it. Its shoulder
turns about Z, X, Y (arm_flex, arm_add, arm_rot), unlike the ISB's of tracks.angles(), which are in the CSV file. Frames
that are not tracked are left out. OpenSim's older reader ends without a word at the first value that is no number:
where a limb is hidden its coordinate is that of the predicted pose, near gimbal lock it is interpolated, and the header
says how much of it. The CSV file has no value there. Other bodies have the angles of tracks.angles().
"""

import os

import numpy as np

from voodoo_jax.exporters.frames import OPENSIM, seconds, upright
from voodoo_jax.geometry.rotations import rotations
from voodoo_jax.model.body import Body
from voodoo_jax.model.isb_angles import UPRIGHT, Convention, cardan_zxy, joint_angles, without_jumps
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.storage.atomic import replacing

# angle of tracks.angles() for the right side or the middle: coordinate, and the sign that it has there
COORDINATES = {
    "hip_flexion": ("hip_flexion", 1), "hip_adduction": ("hip_adduction", 1), "hip_rotation": ("hip_rotation", 1),
    "knee_flexion": ("knee_angle", 1), "ankle_dorsiflexion": ("ankle_angle", 1),
    "ankle_inversion": ("subtalar_angle", 1), "elbow_flexion": ("elbow_flex", 1), "elbow_pronation": ("pro_sup", 1),
    "wrist_flexion": ("wrist_flex", 1), "wrist_deviation": ("wrist_dev", 1), "trunk_flexion": ("lumbar_extension", -1),
    "trunk_bending": ("lumbar_bending", 1), "trunk_rotation": ("lumbar_rotation", 1),
}  # fmt: skip
ARM = Convention("arm", ("chest", "torso"), "upper_arm", ("flex", "add", "rot"))  # order Z X Y


def write(tracks: Tracks, path: str | os.PathLike[str]) -> None:
    """Writes the coordinates of the tracked frames. Raises OSError."""
    time = seconds(tracks)[tracks.tracked]
    seen, whole = coordinates(tracks), coordinates(tracks, hidden=True)
    table, guessed = {"time": time}, []
    for name, values in whole.items():
        own = values[tracks.tracked]
        known = np.isfinite(own)
        if known.any() or not len(own):  # of a coordinate that is never known there is no column
            table[name] = np.interp(time, time[known], own[known]) if len(own) else own
            share = 1 - float(np.isfinite(seen[name][tracks.tracked]).mean()) if len(own) else 0.0
            guessed += [f"{name} {100 * share:.0f} %"] if share > 0 else []
    rows = np.stack(list(table.values()), 1)
    lines = ["Coordinates", "version=1", f"nRows={len(rows)}", f"nColumns={rows.shape[1]}", "inDegrees=yes", ""]
    lines += ["Units are S.I. units (second, meters, Newtons, ...)", "Angles are in degrees."]
    lines += [f"Guessed, because limbs were hidden, in so many of the rows: {', '.join(guessed)}"] if guessed else []
    lines += ["", "endheader", "\t".join(table)]
    lines += ["\t".join(f"{value:.6f}" for value in row) for row in rows]
    with replacing(path) as partial:
        partial.write_text("\n".join(lines) + "\n", encoding="utf-8")


def coordinates(tracks: Tracks, hidden: bool = False) -> dict[str, np.ndarray]:
    """Values over time by name: degrees, metres; with `hidden` also of limbs without any measurement."""
    body, angles = tracks.body, tracks.angles(hidden)
    degrees = dict(zip(angles.columns, np.degrees(angles.table).T))
    if not any(name.endswith("hip_flexion") for name in degrees):
        return degrees
    found = _pelvis(tracks, body)
    seen = ((tracks.evidence.limb_weight > 0) | hidden) & tracks.tracked[:, None]
    arms = joint_angles(body, tracks.rotation, seen, conventions=(ARM,))
    for name, value in zip(arms.columns, np.degrees(arms.table).T):
        found[f"{name[2:]}_{name[0]}"] = value
    for name, value in degrees.items():
        side, plain = (name[0], name[2:]) if name[:2] in ("l_", "r_") else ("", name)
        if plain in COORDINATES:
            own, sign = COORDINATES[plain]
            found[f"{own}_{side}" if side else own] = sign * value
    return found


def _pelvis(tracks: Tracks, body: Body) -> dict[str, np.ndarray]:
    """Tilt, list and rotation of the root limb in degrees, and its place in metres, in OpenSim's axes."""
    out = OPENSIM @ upright(tracks)
    there = tracks.tracked & np.isfinite(tracks.rotation[:, 0]).all(1)
    rest = rotations(np.asarray(body.rest.rotation, float)[0])
    turn = out @ (rotations(tracks.rotation[:, 0]) * rest.inv()).as_matrix() @ UPRIGHT
    angles = np.degrees(without_jumps(np.where(there[:, None], cardan_zxy(turn), np.nan)))
    # between the hips, where the pelvis of that model has its hips in the middle
    hips = [i for i, name in enumerate(body.topology.centres) if name in ("l_hip", "r_hip")]
    place = (tracks.joints[:, hips].mean(1) if hips else tracks.translation[:, 0]) @ out.T
    values = np.where(there[:, None], np.concatenate([angles, place], 1), np.nan)
    names = ("pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz")
    return dict(zip(names, values.T))
