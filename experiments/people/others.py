"""Other people, recorded as the 18 were: python -m experiments.people.others BODIES.npz MOTIONS LOGS

BODIES.npz as `bodies.py BODIES.npz SEED 24 recorded` writes it; MOTIONS the folder of *.bvh of the Bandai-Namco
Research Motiondataset-1 (CC BY-NC 4.0: for research; arXiv 2306.08861). The recordings' truth tells how they were
made: turns of the clip's joints are taken on by the bones, arms and legs begin along the clip's in a frame in which
somebody stands, and nothing puts feet on the floor. Of the recordings' own people and clips this gives their joints to
0.01 mm, but for the 12 frames in which the clip's first pose is taken (1 to 9 mm).
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tyro
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from experiments.common import human, table, write
from experiments.judged import HEAD, HONEST_HEAD, Verdict, cells, honest_cells, judge, read, trials
from experiments.people.figure import BONES, Figure, read_meshes
from experiments.people.making import START_NS
from experiments.people.motions import RATE, turned
from experiments.people.recorded import Found, write_truth
from experiments.people.recorded import write as write_log
from experiments.people.sight import before, beside, detections, marked
from experiments.people.takes import camera_of
from voodoo_jax.config.options import Settings
from voodoo_jax.simulate.room import Box, Room, render_room
from voodoo_jax.simulate.sensor import TOF_NOISE, add_noise, tof_camera

STANDS = "bow_normal_001"  # in its first frame somebody stands relaxed
STILL, EASED, CLIP = 15, 12, 83  # frames: relaxed at first, taking the clip's first pose, of the clip at most
FARTHEST = 2.4  # metres from where a clip begins: there it is cut
HEIGHT, AWAY, MIDDLE = 1.25, 1.705, 0.52  # of the camera, metres; how far away hips are at least and how high it looks,
# at the middle of where they go, in statures
BEHIND = 1.2  # metres from the farthest hips to the wall
ASIDE = np.pi / 4  # from facing the camera, at most
EDGE, MIXED = 0.05, 0.5  # step between neighbours that makes a depth edge, metres; share of all pixels there that mix
NOISE = replace(TOF_NOISE, flying=0.0, dropout=0.01, grazing=0.0)
AXES = Rotation.from_matrix([[0, 0, 1], [1, 0, 0], [0, 1, 0.0]])  # z forward, x left, y up becomes x, y, z
# joints of a clip and the bones that turn with them; bones without one turn with their parents
JOINTS = {"root": "Hips", "spine04": "Spine", "spine01": "Chest", "neck01": "Neck", "head": "Head"} | {
    f"{bone}.{side}": f"{joint}_{side}"
    for side in "LR"
    for bone, joint in (
        ("clavicle", "Shoulder"), ("upperarm01", "UpperArm"), ("lowerarm01", "LowerArm"), ("wrist", "Hand"),
        ("upperleg01", "UpperLeg"), ("lowerleg01", "LowerLeg"), ("foot", "Foot"),
        *((f"toe{k}-1", "Toes") for k in range(1, 6)),
    )
}  # fmt: skip
# bones that lie along the clip's in the frame STANDS, and where each ends
ALONG = {"upperarm01": "lowerarm01", "lowerarm01": "wrist", "upperleg01": "lowerleg01", "lowerleg01": "foot"}


class Moves(NamedTuple):
    """A clip: x forward, y left, z up, metres."""

    turns: dict[str, Rotation]  # of joints against the fixed axes, [frame]
    places: dict[str, np.ndarray]  # [frame, 3]

    def cut(self, first: int, last: int) -> "Moves":
        turns, places = ({k: v[first:last] for k, v in part.items()} for part in self)
        return Moves(turns, places)  # pyright: ignore[reportArgumentType]

    def heading(self, left: str, right: str) -> float:
        """Where who has `left` and `right` on these sides faces in the first frame, from x to y."""
        x, y, _ = (self.places[left] - self.places[right])[0]
        return float(np.arctan2(-x, y))


def read_bvh(path: Path) -> Moves:
    """A clip of which every joint has six channels, turns in the order z, x, y."""
    skeleton, text = path.read_text().split("Frame Time:")
    frames = np.array([row.split() for row in text.splitlines()[1:] if row.strip()], float)
    moves, above = Moves({}, {}), [""]
    for word, name in re.findall(r"(ROOT|JOINT|End|\})(?: (\w+))?", skeleton):
        if word == "}":
            above.pop()
            continue
        if word != "End":
            column = 6 * len(moves.turns)
            place = AXES.apply(frames[:, column : column + 3]) / 100
            turn = AXES * Rotation.from_euler("ZXY", frames[:, column + 3 : column + 6], degrees=True) * AXES.inv()
            if parent := above[-1]:
                place = moves.places[parent] + moves.turns[parent].apply(place)
                turn = moves.turns[parent] * turn
            moves.turns[name], moves.places[name] = turn, place
        above.append(name)
    return moves


def posed(figure: Figure, stands: Moves, moves: Moves, yaw: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices [frame, vertex, 3] and joints [frame, joint, 3] of somebody who stands relaxed, facing `yaw`, and then
    does what the clip has."""
    bones, heads = figure.meshes.bones, figure.heads
    ahead = Rotation.from_euler("z", -stands.heading("UpperArm_L", "UpperArm_R"))
    headings = [m.heading("UpperLeg_L", "UpperLeg_R") for m in (moves, stands)]
    first = Rotation.from_euler("z", yaw - headings[0] + headings[1]) * ahead
    begins = {joint: Rotation.identity() for joint in stands.turns}
    for bone, end in ALONG.items():
        for side in "LR":
            joint, child = JOINTS[f"{bone}.{side}"], JOINTS[f"{end}.{side}"]
            rest = heads[bones.index(f"{end}.{side}")] - heads[bones.index(f"{bone}.{side}")]
            along = ahead.apply(stands.places[child][0] - stands.places[joint][0])
            begins[joint] = Rotation.align_vectors([along], [rest])[0]
    begins |= {f"Hand_{side}": begins[f"LowerArm_{side}"] for side in "LR"}
    # relaxed, then the clip's first pose, then the clip: turns of each joint from how the bone is at rest
    relaxed = Rotation.from_euler("z", yaw)
    share, turns = np.arange(1, EASED + 1) / (EASED + 1), {}
    for joint, start in begins.items():
        clip = first * moves.turns[joint] * stands.turns[joint][0].inv() * ahead.inv() * start
        stood = relaxed * start
        turns[joint] = Rotation.concatenate([*[stood] * STILL, turned(stood, clip[0], share), clip])
    of_bone: list[np.ndarray] = []
    for bone, parent in zip(bones, figure.meshes.parents):
        of_bone.append(turns[JOINTS[bone]].as_matrix() if bone in JOINTS else of_bone[parent])
    vertices, place = figure.skinned(np.stack(of_bone, 1))
    hips = bones.index("spine05")
    goes = first.apply(moves.places["Hips"] - moves.places["Hips"][0] * [1, 1, 0])
    goes *= heads[hips, 2] / stands.places["Hips"][0, 2]
    stood = np.array([0, 0, heads[hips, 2]])
    goes = np.concatenate([np.repeat(stood[None], STILL, 0), stood + share[:, None] * (goes[0] - stood), goes])
    shift = (goes - place[:, hips])[:, None]
    return vertices + shift.astype(np.float32), figure.joints_of(place) + shift


def flying(depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Depth [row, column] whose pixels at edges lie between the nearest and the farthest of them and their neighbours,
    above, below and to both sides; as in the recordings, half of all such pixels, anywhere between."""
    around = np.pad(depth, 1, mode="edge")
    cross = np.stack([depth, around[:-2, 1:-1], around[2:, 1:-1], around[1:-1, :-2], around[1:-1, 2:]])
    near, far = cross.min(0), cross.max(0)
    mixed = np.isfinite(far) & (rng.random(depth.shape) < MIXED)
    mixed &= np.where(np.isfinite(far), far, near) - near > EDGE
    return np.where(mixed, near + rng.random(depth.shape) * np.where(mixed, far - near, 0.0), depth)


@dataclass(frozen=True)
class Other:
    """One log."""

    name: str
    person: int
    clip: Path
    begins: float  # share of the clip's frames that are before those shown, where it has too many
    yaw: float  # from facing the camera, radians
    seed: int
    meshes: Path
    logs: Path


def others(meshes: Path, motions: Path, logs: Path, seed: int, count: int) -> list[Other]:
    """So many logs; kinds of movements take turns, people too, all else is drawn."""
    rng, people = np.random.default_rng(seed), len(read_meshes(meshes).vertices)
    kinds: dict[str, list[Path]] = {}
    for path in sorted(motions.glob("dataset-1_*.bvh")):
        kinds.setdefault(path.stem.split("_")[1], []).append(path)
    order, who = rng.permutation(sorted(kinds)), rng.permutation(people)
    found = []
    for k in range(count):
        some = kinds[order[k % len(order)]]
        clip, begins = some[int(rng.integers(len(some)))], float(rng.choice([0.0, rng.uniform()]))
        name = f"{clip.stem.removeprefix('dataset-1_')}-{seed}-{k}"
        yaw = float(rng.uniform(-ASIDE, ASIDE))
        found.append(Other(name, int(who[k % people]), clip, begins, yaw, seed + k, meshes, logs))
    return found


def make(other: Other) -> Path:
    """The log and its truth, made if there are none."""
    path = other.logs / f"{other.name}.mcap"
    if path.exists():
        return path
    figure, rng = Figure(read_meshes(other.meshes), other.person), np.random.default_rng(other.seed)
    moves = read_bvh(other.clip)
    first = int(other.begins * max(0, len(moves.places["Hips"]) - CLIP))
    stands = read_bvh(other.clip.with_name(f"dataset-1_{STANDS}.bvh"))
    vertices, joints = posed(figure, stands, moves.cut(first, first + CLIP), np.pi + other.yaw)
    stature = float(np.ptp(figure.vertices[:, 2]))  # of the mesh at rest, as the recordings' truth has it
    names = list(BONES)
    hips = (joints[:, names.index("l_hip")] + joints[:, names.index("r_hip")])[:, :2] / 2
    gone = np.linalg.norm(hips - hips[0], axis=1) > FARTHEST
    if gone.any():
        vertices, joints, hips = vertices[: gone.argmax()], joints[: gone.argmax()], hips[: gone.argmax()]
    shift = np.array([AWAY * stature - hips[:, 0].min(), -(hips[:, 1].min() + hips[:, 1].max()) / 2, 0.0])
    vertices, joints, hips = vertices + shift.astype(np.float32), joints + shift, hips + shift[:2]
    near, far = float(hips[:, 0].min()), float(hips[:, 0].max())
    camera = tof_camera(HEIGHT, float(np.arctan2(HEIGHT - MIDDLE * stature, (near + far) / 2)))
    box = Box(float(rng.uniform(2.6, 3.6)), 1.4, (0.5, 0.45, float(rng.uniform(0.4, 1.0))), 0.3)
    room = beside(Room(wall=far + BEHIND, boxes=(box,)), vertices, rng)
    colour = replace(camera_of(640, 480, 554.3), position=(0.0, 0.06, HEIGHT), pitch=camera.pitch)
    empty, where, depth = render_room(camera, room), marked(figure), []
    found: list[Found] = []
    for frame in vertices:
        exact, cosine = before(empty, frame, figure.meshes.faces, camera)
        depth.append(add_noise(flying(exact, rng), cosine, camera, NOISE, rng))
        found.append(detections(figure, frame, colour, where, rng))
    time_ns = START_NS + np.round(np.arange(len(depth)) / RATE * 1e9).astype(np.int64)
    write_truth(path.with_suffix(".truth.npz"), time_ns, joints, figure.dims | {"stature": stature})
    write_log(path, {"depth": [camera], "colour": [colour]}, time_ns, depth, found)
    return path


def work(other: Other) -> Verdict:
    """Makes the log, tracks it, judges the tracks."""
    recorded, body, settings = read(make(other), Settings()), human(), Settings()
    log = recorded.log(body, settings)
    return judge(recorded, log, log.track(body, settings))


def main(
    bodies: tyro.conf.Positional[Path],
    motions: tyro.conf.Positional[Path],
    logs: tyro.conf.Positional[Path],
    seed: int = 1,
    count: int = 48,
    processes: int = 2,
    out: Path = Path(__file__).parent,
) -> None:
    """How well people are tracked who are recorded as the 18 were.

    Args:
        bodies: what bodies.py has written, of kind "recorded".
        motions: folder with dataset-1_*.bvh.
        logs: folder for the logs; those that are there are taken as they are.
        seed: of who moves how, seen from where.
        count: of logs.
        processes: how many work at once.
        out: folder for others.md.
    """
    logs.mkdir(parents=True, exist_ok=True)
    jobs, rows = others(bodies, motions, logs, seed, count), dict[str, list[Verdict]]()
    for other, verdict in zip(jobs, tqdm(trials(work, jobs, processes), total=len(jobs), leave=False, disable=None)):
        for name in (other.clip.stem.split("_")[1], "all"):
            rows.setdefault(name, []).append(verdict)
        tqdm.write(f"{other.name}: {verdict.score.error_cm:.2f} cm, grade {verdict.score.grade}")
    names = [*sorted(set(rows) - {"all"}), "all"]
    lines = [[name, str(len(rows[name])), *cells(rows[name]), *honest_cells(rows[name])] for name in names]
    write(out, "others", table(["movement", "logs", *HEAD, *HONEST_HEAD], lines))


if __name__ == "__main__":
    tyro.cli(main)
