"""Does the body have the shape of people? python -m experiments.people.sections BODIES.npz [--body FILE]

BODIES.npz as bodies.py writes it. All of them stand with arms hanging, as shares of their stature, hips at one place:
how far their skin reaches before and behind, and to both sides, at each height, and the limbs of a body over it.
Writes sections.png.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import tyro
from matplotlib.axes import Axes
from scipy.spatial.transform import Rotation

from experiments.people.figure import BONES, Figure, read_meshes
from experiments.people.motions import PARENT, Clip
from voodoo_jax.model.body import Body, joint_centres
from voodoo_jax.model.body_file import load_on_host
from voodoo_jax.solve.names import V1_NAMES

LEVELS = np.linspace(0.02, 0.99, 98)  # shares of the stature
THICK = 0.012  # of a level, each way
LEGS = 0.5  # height below which legs are apart from the trunk
TRUNK, LEG, ARM = (
    ("head", "neck", "spine", "root", "pelvis", "breast"),
    ("upperleg", "lowerleg"),
    ("upperarm", "lowerarm"),
)


def standing(figure: Figure) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and joints, arms and legs hanging, as shares of the stature; the hips' middle at x = y = 0."""
    still = Clip({name: Rotation.identity(1) for name in PARENT}, np.zeros((1, 3)))
    vertices, joints = (found[0] for found in figure.posed(still, np.ones(1)))
    hips = joints[[list(BONES).index(f"{side}_hip") for side in "lr"]].mean(0) * [1, 1, 0]
    return (vertices - hips) / figure.dims["stature"], (joints - hips) / figure.dims["stature"]


def extents(vertices: np.ndarray, axis: int) -> np.ndarray:
    """Least and greatest of a coordinate at each of the levels [2, level]; NaN where there is nothing."""
    found = np.full((2, len(LEVELS)), np.nan)
    for k, level in enumerate(LEVELS):
        near = vertices[np.abs(vertices[:, 2] - level) < THICK, axis]
        if len(near):
            found[:, k] = near.min(), near.max()
    return found


def outline(body: Body, limb: int, axis: int) -> np.ndarray:
    """Corners [4, 2] (coordinate, height) of a limb as seen along the other level axis, shares of the scale."""
    sizes, scale = np.asarray(body.sizes[limb]), float(body.scale)
    turn = Rotation.from_quat(np.asarray(body.rest.rotation[limb]), scalar_first=True)
    corners = []
    for at, axes in ((0.0, sizes[0:2]), (sizes[4], sizes[2:4])):
        # an ellipse reaches so far along an axis
        reach = np.linalg.norm(turn.as_matrix()[axis, :2] * axes)
        middle = np.asarray(body.rest.translation[limb]) + turn.apply([0, 0, at])
        corners += [(middle[axis] + sign * reach, middle[2]) for sign in ((-1, 1) if at == 0 else (1, -1))]
    return np.array(corners) / scale


def drawn(axes: Axes, body: Body, people: list[tuple[np.ndarray, np.ndarray]], of: list[np.ndarray], axis: int) -> None:
    """People's mean skin and what two thirds of them have, the limbs' outlines, and joint centres of both."""
    centres = dict(zip(body.topology.centres, np.asarray(joint_centres(body, body.rest)) / float(body.scale)))
    hips = (centres["l_hip"] + centres["r_hip"]) / 2 * [1, 1, 0]
    for part in of:
        found = np.array([extents(vertices[part], axis) for vertices, _ in people])
        there = np.isfinite(found).all((0, 1))
        for middle, spread in zip(found.mean(0)[:, there], found.std(0)[:, there]):
            (skin,) = axes.plot(middle, LEVELS[there], color="tab:blue")
            axes.fill_betweenx(
                LEVELS[there], middle - spread, middle + spread, color="tab:blue", alpha=0.25, linewidth=0
            )
    for limb, name in enumerate(body.topology.limbs):
        if not name.startswith("r_") and not name.endswith(("foot", "hand")) and not (axis == 0 and "arm" in name):
            (edge,) = axes.fill(*(outline(body, limb, axis) - hips[[axis, 2]]).T, fill=False, edgecolor="tab:red")
    axes.legend([skin, edge], ["skin, mean and spread of all", "limbs of the body"], loc="upper left", fontsize="small")
    joints = np.mean([joints for _, joints in people], 0)
    for k, name in enumerate(BONES):
        if name.startswith("r_") or (axis == 0 and name[2:] in ("elbow", "wrist")):
            continue
        centre = centres[V1_NAMES.get(name, name)] - hips
        axes.plot(joints[k, axis], joints[k, 2], "o", color="tab:blue", markersize=5)
        axes.plot(centre[axis], centre[2], "x", color="tab:red", markersize=7)
    axes.set(aspect="equal", xlabel=("ahead", "to the left")[axis] + ", statures", ylabel="height, statures")


def main(bodies: tyro.conf.Positional[Path], body: str = "human", out: Path = Path(__file__).parent) -> None:
    """Draws people's skin and a body's limbs.

    Args:
        bodies: what bodies.py has written.
        body: a built-in body or a file.
        out: folder for sections.png.
    """
    meshes = read_meshes(bodies)
    bones = np.array(meshes.bones)[meshes.skin[np.arange(len(meshes.skin)), meshes.weights.argmax(1)]]
    starts = lambda names: np.array([bone.startswith(names) for bone in bones])  # noqa: E731
    left = np.array([bone.endswith(".L") for bone in bones])
    leg = starts(LEG) & left & (meshes.vertices[0, :, 2] < LEGS * np.ptp(meshes.vertices[0, :, 2]))
    parts = [starts(TRUNK), leg, starts(ARM) & left]
    people = [standing(Figure(meshes, k)) for k in range(len(meshes.vertices))]
    figure, axes = plt.subplots(1, 2, figsize=(9, 11), layout="constrained")
    limbs = load_on_host(body)
    for axis, shown in enumerate((parts[:2], parts)):
        drawn(axes[axis], limbs, people, shown, axis)
    figure.savefig(out / "sections.png", dpi=70)


if __name__ == "__main__":
    tyro.cli(main)
