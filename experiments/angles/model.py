"""An OpenSim model of a tracked body: its limbs and joint centres, its markers where they were. Needs `opensim`.

Degrees of freedom are those of usual models of gait (Rajagopal 2016): pelvis 6, hips 3, knees 1, ankles 2, lumbar 3,
shoulders 3, elbows 2. Wrists and neck are fixed. Coordinates are counted as the ISB and `tracks.angles()` count them.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from voodoo_jax.model.body import Body
from voodoo_jax.model.isb_angles import UPRIGHT

X, Y, Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)


class Turning(NamedTuple):
    """A joint of the model: the body's joint, and its coordinates as turns about axes one after the other."""

    joint: str  # of the body file, with l_ or r_ before it where `paired`
    coordinates: tuple[tuple[str, tuple[int, int, int]], ...]  # name, axis on the right side
    paired: bool = True


# axes of left joints are mirrored as a plane at the body's middle does it: about Z they stay
JOINTS = (
    Turning("waist", (("trunk_flexion", (0, 0, -1)), ("trunk_bending", X), ("trunk_rotation", Y)), False),
    Turning("hip", (("hip_flexion", Z), ("hip_adduction", X), ("hip_rotation", Y))),
    Turning("knee", (("knee_flexion", (0, 0, -1)),)),
    Turning("ankle", (("ankle_dorsiflexion", Z), ("ankle_inversion", X))),
    Turning("shoulder", (("arm_flexion", Z), ("arm_adduction", X), ("arm_rotation", Y))),
    Turning("elbow", (("elbow_flexion", Z), ("elbow_pronation", Y))),
    Turning("neck", (), False),
    Turning("wrist", ()),
)
ROOT = (("pelvis_tilt", Z), ("pelvis_list", X), ("pelvis_rotation", Y))


def at_rest(body: Body, limb: int, place: np.ndarray) -> np.ndarray:
    """A place in a limb's frame as one in the model's ground while the body rests: x forwards, y up, z to the right."""
    turn = Rotation.from_quat(np.asarray(body.rest.rotation[limb], float), scalar_first=True)
    return (turn.apply(place) + np.asarray(body.rest.translation[limb], float)) @ UPRIGHT


def build(body: Body, markers: dict[str, tuple[int, np.ndarray]], path: Path) -> None:
    """Writes the model of a body; `markers`: number of the limb, and place in its frame, metres."""
    import opensim as osim  # pyright: ignore[reportMissingImports]

    t = body.topology
    model = osim.Model()
    model.setName("tracked")
    # origin of each limb's frame, in ground at rest: its proximal joint; the pelvis': where our frame of it is
    origin = {0: at_rest(body, 0, np.zeros(3))}
    for j, child in enumerate(t.children):
        origin[child] = at_rest(body, t.parents[j], np.asarray(body.parent_anchor.translation[j], float))
    limbs = [osim.Body(name, 1.0, osim.Vec3(0), osim.Inertia(0.1, 0.1, 0.1)) for name in t.limbs]
    for limb in limbs:
        model.addBody(limb)
    moves = [(f"pelvis_t{axis}", unit) for axis, unit in zip("xyz", (X, Y, Z))]
    model.addJoint(_joint(osim, "ground_pelvis", model.getGround(), limbs[0], np.zeros(3), ROOT, moves))
    for name, coordinates, paired in JOINTS:
        for side in ("l_", "r_") if paired else ("",):
            j = t.joints.index(side + name)
            parent, child = t.parents[j], t.children[j]
            mirror = np.array([-1, -1, 1]) if side == "l_" else np.ones(3, int)
            turns = tuple((side + c, tuple((mirror * a).tolist())) for c, a in coordinates)
            at = origin[child] - origin[parent]
            model.addJoint(_joint(osim, side + name, limbs[parent], limbs[child], at, turns))
    for name, (limb, place) in markers.items():
        spot = at_rest(body, limb, place) - origin[limb]
        model.addMarker(osim.Marker(name, limbs[limb], osim.Vec3(*spot.tolist())))
    model.finalizeConnections()
    model.printToXML(str(path))


# 7 parameters: what a joint is between, where, and how it moves
def _joint(osim: Any, name: str, parent: Any, child: Any, at: np.ndarray, turns, moves=()) -> Any:
    """A joint that turns about the given axes one after the other, and moves along the others."""
    zero = osim.Vec3(0)
    if not turns:
        return osim.WeldJoint(name, parent, osim.Vec3(*at.tolist()), zero, child, zero, zero)
    transform = osim.SpatialTransform()
    spare = [unit for unit in (Z, X, Y) if unit not in [tuple(np.abs(a)) for _, a in turns]]
    turns = [*turns, *(("", unit) for unit in spare)]  # OpenSim wants three axes that are independent
    moves = moves or [("", unit) for unit in (X, Y, Z)]
    for k, (coordinate, axis) in enumerate([*turns, *moves]):
        about = transform.updTransformAxis(k)
        about.setAxis(osim.Vec3(*map(float, axis)))
        if coordinate:
            names = osim.ArrayStr()
            names.append(coordinate)
            about.setCoordinateNames(names)
        about.set_function(osim.LinearFunction(1.0, 0.0) if coordinate else osim.Constant(0.0))
    return osim.CustomJoint(name, parent, osim.Vec3(*at.tolist()), zero, child, zero, zero, transform)


def solved(model: Path, trc: Path, start: dict[str, float], seconds: tuple[float, float]) -> dict[str, np.ndarray]:
    """The model's coordinates over time, degrees and metres, by OpenSim's InverseKinematicsTool, all markers with the
    same weight; `start` are coordinates to begin with, radians and metres."""
    import opensim as osim  # pyright: ignore[reportMissingImports]

    osim.Logger.removeFileSink()  # else it writes opensim.log where one stands
    known = osim.Model(str(model))
    for name, value in start.items():
        known.updCoordinateSet().get(name).setDefaultValue(value)
    known.finalizeConnections()
    known.printToXML(str(model))
    out = model.with_suffix(".mot")
    tool = osim.InverseKinematicsTool()
    tool.set_model_file(str(model))
    tool.set_marker_file(str(trc))
    tool.set_time_range(0, seconds[0])
    tool.set_time_range(1, seconds[1])
    tool.set_results_directory(str(model.parent))
    tool.setOutputMotionFileName(str(out))
    tasks = tool.upd_IKTaskSet()
    for marker in known.getMarkerSet():
        task = osim.IKMarkerTask()
        task.setName(marker.getName())
        task.setApply(True)
        task.setWeight(1.0)
        tasks.cloneAndAppend(task)
    if not tool.run():
        raise SystemExit(f"{model}: OpenSim's inverse kinematics failed")
    found = osim.TimeSeriesTable(str(out))
    columns = {name: found.getDependentColumn(name).to_numpy() for name in found.getColumnLabels()}
    return {"time": np.array(found.getIndependentColumn()), **columns}
