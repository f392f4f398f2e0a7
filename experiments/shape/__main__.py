"""How do people of one stature differ? python -m experiments.shape BODIES.npz [--modes 10] [--body human.toml]

BODIES.npz as experiments/people/bodies.py writes it, of many people. Each of them stands with arms hanging; the sizes
of the built-in human are changed until its joints lie where theirs are, its radii by what their skin has more than the
usual skin. What measured people differ by more than the meshes do is added. The main modes of all that are written as
the [[mode]] tables of a body file.
"""

import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from jaxtyping import Float

from experiments.people.figure import BONES, Figure, read_meshes
from experiments.people.sections import standing
from voodoo_jax.fitting.parameters import Parameters, changed, height_of, parameters
from voodoo_jax.geometry.rigid import unrotate
from voodoo_jax.model.body import Body, joint_centres, without_side
from voodoo_jax.model.body_file import MODES_LINE, load_body
from voodoo_jax.model.marker_sets import V1_NAMES

NOISE = 0.002  # shares of the stature: how well joints and height are met, 3 mm
ENDS = {"bottom": (0.0, 0.4), "top": (0.6, 1.0)}  # parts of a limb's length whose skin tells of the radii of its ends
# a limb's skin: first letters of the bones that it hangs on; hands, feet and hair tell nothing of a girth
TRUNK = ("root", "pelvis", "spine", "breast", "clavicle", "shoulder")
SKIN = {
    "pelvis": TRUNK, "chest": TRUNK, "head": ("head", "jaw", "levator", "temporalis", "risorius", "special"),
    "upper_arm": ("upperarm",), "forearm": ("lowerarm",), "thigh": ("upperleg",), "shank": ("lowerleg",),
}  # fmt: skip
# How far measured people differ (ANSUR II, 6068 adults: standard deviation of the ratio to stature within a sex, over
# its mean): acromion to radiale, radiale to stylion, hand, trochanterion to tibiale, tibiale to malleolus, foot,
# tragion to vertex; halves of the biacromial and bicristal breadths (shares of the stature); circumferences.
MEASURED = {
    "lengths.upper_arm": 0.031, "lengths.forearm": 0.040, "lengths.hand": 0.036, "lengths.thigh": 0.045,
    "lengths.shank": 0.036, "lengths.foot": 0.033, "lengths.head": 0.05,
    "anchors.shoulder.y": 0.005, "anchors.hip.y": 0.0045,
    "radii.pelvis.bottom": 0.07, "radii.pelvis.top": 0.12, "radii.chest.bottom": 0.10, "radii.chest.top": 0.08,
    "radii.head.bottom": 0.04, "radii.head.top": 0.04, "radii.upper_arm.bottom": 0.10, "radii.upper_arm.top": 0.08,
    "radii.forearm.bottom": 0.07, "radii.forearm.top": 0.05, "radii.thigh.bottom": 0.09, "radii.thigh.top": 0.08,
    "radii.shank.bottom": 0.075, "radii.shank.top": 0.06,
}  # fmt: skip
HELD = 0.003  # logarithm: a mode changes the height by no more, as people of one stature have one height
LEAST = 0.05  # of a mode's greatest effect: smaller ones are left out of the file


def _places(body: Body, usual: Float[jax.Array, ""]) -> Float[jax.Array, "row 3"]:
    """Joint centres from the hips' middle, the hips' height and the whole height; shares of the usual scale."""
    centres, names = joint_centres(body, body.rest), body.topology.centres
    hips = (centres[names.index("l_hip")] + centres[names.index("r_hip")]) / 2
    up = jnp.array([0, 0, 1.0])
    above = hips[2] - jnp.min(body.rest.translation[:, 2])
    return jnp.concatenate([centres - hips, (above * up)[None], (height_of(body) * up)[None]]) / usual


def lengths(joints: Float[np.ndarray, "person joint 3"], body: Body, free: Parameters) -> tuple[np.ndarray, float]:
    """Changes [person, free] that put a body's joints where people's are, and how far these are off then, cm at 1.7 m.

    `joints` in the order of BONES, shares of the stature; what all have in common is left out.
    """
    names = [V1_NAMES.get(name, name) for name in BONES]
    other = {"l": "r", "r": "l"}
    sides = [names.index(other[n[0]] + n[1:]) if n[1] == "_" else k for k, n in enumerate(names)]
    joints = (joints + joints[:, sides] * [1, -1, 1]) / 2  # a body's left and right are alike
    hips = joints[:, [names.index("l_hip"), names.index("r_hip")]].mean(1, keepdims=True)
    order = [names.index(name) for name in body.topology.centres]
    rows = np.concatenate([(joints - hips)[:, order], hips * [0, 0, 1], np.full_like(hips, 1) * [0, 0, 1]], 1)
    off = (rows - rows.mean(0)).reshape(len(rows), -1)
    slope = _slope(body, free, lambda b: _places(b, body.scale).reshape(-1))
    slope[:, [name.startswith("radii.") for name in free.names]] = 0  # skin tells of them, not joints
    found = np.linalg.solve(slope.T @ slope / NOISE**2 + np.diag(1 / free.sd**2), slope.T @ off.T / NOISE**2).T
    return found, float(np.sqrt(((off - found @ slope.T) ** 2).sum(-1).mean() / len(order)) * 170)


def _slope(body: Body, free: Parameters, of) -> np.ndarray:
    """How what a function tells of a body changes with its parameters."""
    return np.asarray(jax.jacobian(lambda x: of(changed(body, free.changes(x))))(jnp.zeros(len(free.names))), float)


def girths(people: list, skin: dict[str, np.ndarray], bodies: Body, body: Body) -> dict[str, np.ndarray]:
    """Logarithms of people's radii over the usual ones [person], by the names that a fit has for them.

    `people` vertices and joints, shares of the stature; `bodies` with their lengths, one a person.
    """
    pair = [list(BONES).index(f"{side}_hip") for side in "lr"]
    centres = np.array([body.topology.centres.index(f"{side}_hip") for side in "lr"])
    hips = np.asarray(jax.vmap(lambda b: joint_centres(b, b.rest)[centres].mean(0))(bodies)) / float(body.scale)
    found = {}
    for limb, mine in skin.items():
        i = body.topology.limbs.index(limb)
        places = np.asarray(bodies.rest.translation[:, i]) / float(body.scale)
        long = np.asarray(bodies.sizes[:, i, 4]) / float(body.scale)
        points = np.array([v[mine] - j[pair].mean(0) for v, j in people], np.float32) + (hips - places)[:, None]
        local = np.asarray(unrotate(body.rest.rotation[i], jnp.asarray(points, jnp.float32)))
        share, far = local[..., 2] / long[:, None], np.linalg.norm(local[..., :2], axis=-1)
        for end, (low, high) in ENDS.items():
            mean = np.nanmean(np.where((share >= low) & (share <= high), far, np.nan), 1)
            found[f"radii.{without_side(limb)}.{end}"] = np.log(mean / np.exp(np.log(mean).mean()))
    return found


def spread(found: np.ndarray, free: Parameters, body: Body) -> np.ndarray:
    """Covariance of people's changes: that of the meshes, and what measured people have beyond it, one height given."""
    of_meshes = np.cov(found.T)
    wanted = np.array([MEASURED.get(name, 0.0) for name in free.names])
    # who is stout is stout all over, but the length of an arm tells nothing of a leg's
    girth = np.array([name.startswith("radii.") for name in free.names])
    more = np.where(girth, np.maximum(wanted / np.maximum(np.sqrt(np.diag(of_meshes)), 1e-6), 1.0), 1.0)
    of_meshes = of_meshes * np.outer(more, more)
    more = np.diag(np.maximum(wanted**2 - np.diag(of_meshes), 0.0))
    slope = _slope(body, free, lambda b: jnp.log(height_of(b))[None])[0]
    # as if a measured height of every person were known
    told = lambda c: c - np.outer(c @ slope, c @ slope) / (slope @ c @ slope + HELD**2)  # noqa: E731
    return told(of_meshes + more)


def effects(body: Body, free: Parameters) -> np.ndarray:
    """Metres that surface or joints move by for each parameter's unit: what modes are ordered by."""
    sizes = np.asarray(body.sizes)
    found = []
    for row in jnp.eye(len(free.names)):
        by = free.changes(row)
        parts = (by.lengths * sizes[:, 4], by.radii * sizes[:, [0, 2]], by.anchors * body.scale)
        found.append(np.sqrt(sum(float(jnp.sum(part**2)) for part in parts)))
    return np.array(found)


def text(names: tuple[str, ...], modes: np.ndarray, metres: np.ndarray) -> str:
    """[[mode]] tables."""
    out = []
    for k, mode in enumerate(modes, 1):
        kept = np.abs(mode * metres) > LEAST * np.max(np.abs(mode * metres))
        rows = ", ".join(f'"{n}" = {v:.4g}' for n, v in zip(np.array(names)[kept], mode[kept]))
        out.append(f'[[mode]]\nname = "{k}"\nchanges = {{ {rows} }}\n')
    return "\n".join(out)


def table(free: Parameters, found: np.ndarray, cov: np.ndarray, modes: np.ndarray) -> str:
    """Markdown: how far people differ."""
    lines = [
        "| size | meshes, % | measured people, % | one height, % | told by the modes, % |",
        "|---|---:|---:|---:|---:|",
    ]
    for k, name in enumerate(free.names):
        told, all_of_it = np.sqrt((modes[:, k] ** 2).sum()), np.sqrt(cov[k, k])
        if all_of_it > 0.002:
            measured = f"{100 * MEASURED[name]:.1f}" if name in MEASURED else "-"
            lines.append(
                f"| {name} | {100 * found[:, k].std():.1f} | {measured} | {100 * all_of_it:.1f} | {100 * told:.1f} |"
            )
    return "\n".join(lines) + "\n"


def main(
    bodies: tyro.conf.Positional[Path],
    modes: int = 10,
    body: Path = Path("voodoo_jax/model/bodies/human.toml"),
    out: Path = Path(__file__).parent,
) -> None:
    """Learns modes.

    Args:
        bodies: what bodies.py has written.
        modes: how many.
        body: the body file whose modes are replaced.
        out: folder for modes.md.
    """
    meshes, human = read_meshes(bodies), load_body("human")
    people = [standing(Figure(meshes, k)) for k in range(len(meshes.vertices))]
    bones = np.array(meshes.bones)[meshes.skin[np.arange(len(meshes.skin)), meshes.weights.argmax(1)]]
    left, skin = np.array([bone.endswith(".L") for bone in bones]), {}
    for limb in human.topology.limbs:
        plain = without_side(limb)
        if plain in SKIN and not limb.startswith("r_"):
            mine = np.array([bone.startswith(SKIN[plain]) for bone in bones])
            skin[limb] = mine if limb == plain else mine & left
    free = parameters(human, ("lengths", "radii", "anchors"))
    found, off = lengths(np.array([joints for _, joints in people]), human, free)
    print(f"{len(people)} people; their joints are met to {off:.2f} cm")
    own = jax.jit(jax.vmap(lambda x: changed(human, free.changes(x))))(jnp.asarray(found, jnp.float32))
    for name, values in girths(people, skin, own, human).items():
        found[:, free.names.index(name)] = values
    cov, metres = spread(found, free, human), effects(human, free)
    values, vectors = np.linalg.eigh(cov * np.outer(metres, metres))
    best = np.argsort(values)[::-1][:modes]
    kept = (vectors[:, best] * np.sqrt(values[best])).T / metres
    shares = np.cumsum(values[best]) / values.sum()
    head = f"{len(people)} meshes. Of what people of one stature differ by, modes tell together: "
    told = head + ", ".join(f"{100 * s:.0f} %" for s in shares) + ".\n\n" + table(free, found, cov, kept)
    (out / "modes.md").write_text(told, encoding="utf-8")
    print(told)
    before = re.split(re.escape(MODES_LINE), body.read_text(encoding="utf-8"))[0].rstrip()
    body.write_text(f"{before}\n\n{MODES_LINE}\n\n{text(free.names, kept, metres)}", encoding="utf-8")


if __name__ == "__main__":
    tyro.cli(main)
