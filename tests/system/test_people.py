"""The makings of experiments/people: drawing against trimesh, clips of motion."""

import importlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)


def part(name: str):
    return importlib.import_module(f"experiments.people.{name}")


def test_what_is_drawn_is_where_rays_meet_the_mesh():
    mesh = trimesh.creation.icosphere(2, 0.3)
    mesh.apply_translation([0.1, -0.05, 1.2])
    fx, fy, cx, cy, shape = 30.0, 28.0, 15.5, 11.5, (24, 32)
    depth, cosine = np.full(shape, np.inf), np.ones(shape)
    part("sight").draw(mesh.vertices, mesh.faces, fx, fy, cx, cy, depth, cosine)
    v, u = np.mgrid[: shape[0], : shape[1]].reshape(2, -1)
    rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(u.size)], -1)
    place, ray, face = mesh.ray.intersects_location(np.zeros_like(rays), rays, multiple_hits=True)
    nearest, facing = np.full(u.size, np.inf), np.ones(u.size)
    for z, r, f in sorted(zip(place[:, 2], ray, face), reverse=True):
        nearest[r] = z
        facing[r] = abs(mesh.face_normals[f] @ rays[r]) / np.linalg.norm(rays[r])
    assert np.isfinite(nearest).sum() > 100
    np.testing.assert_array_equal(np.isfinite(depth.ravel()), np.isfinite(nearest))
    np.testing.assert_allclose(depth.ravel(), nearest, atol=1e-9)
    np.testing.assert_allclose(cosine.ravel(), facing, atol=1e-9)


@pytest.fixture
def clip(tmp_path):
    """Turns left by a right angle in a second, walking one metre ahead, the right knee bent by one radian."""
    motions, frames = part("motions"), []
    for share in np.linspace(0, 1, 11):
        frame = np.zeros(44)
        frame[0], frame[1:4] = 0.1, [share, 0.9, 0.0]
        for column in motions.BALLS.values():
            frame[column] = 1.0
        angle = np.pi / 4 * share  # half of it, about y, which is up
        frame[4:8] = [np.cos(angle), 0, np.sin(angle), 0]
        frame[motions.HINGES["r_shank"]] = -1.0
        frames.append(frame.tolist())
    path = tmp_path / "clip.txt"
    path.write_text(json.dumps({"Frames": frames}))
    return motions.read_clip(path, 1.0, 2)


def test_a_clip_goes_on_where_it_ended(clip):
    leg, ahead = part("motions").LEG, clip.world()["root"].apply([1.0, 0, 0])
    half = len(ahead) // 2
    np.testing.assert_allclose(ahead[0], [1, 0, 0], atol=1e-9)
    np.testing.assert_allclose(ahead[half], ahead[half - 1], atol=1e-9)
    assert ahead[half - 1][1] > 0.99 * np.sin(np.pi / 2 * 0.95)  # x towards y: to the left
    np.testing.assert_allclose(clip.place[0, :2], 0, atol=1e-9)
    np.testing.assert_allclose(clip.place[half], [*clip.place[half - 1, :2], 0.9 / leg], atol=1e-9)
    gone = clip.place[-1, :2] - clip.place[half, :2]
    assert gone @ ahead[half - 1][:2] > 0.9 / leg


def test_knees_bend_backwards_on_the_other_side_when_mirrored(clip):
    for some, bent, straight in ((clip, "r", "l"), (clip.mirrored(), "l", "r")):
        down = {s: some.world()[f"{s}_shank"][0].apply([0, 0, -1.0]) for s in "lr"}
        np.testing.assert_allclose(down[straight], [0, 0, -1], atol=1e-9)
        np.testing.assert_allclose(down[bent], [-np.sin(1), 0, -np.cos(1)], atol=1e-9)


@pytest.fixture
def bvh(tmp_path):
    """Somebody of the Bandai-Namco data set who faces its x axis and raises the left arm ahead by a right angle."""

    def joint(name, offset, *inside):
        return f"JOINT {name}\n{{\nOFFSET {offset}\n{' '.join(inside) or 'End Site { OFFSET 0 0 0 }'}\n}}\n"

    def chain(side, *names):
        name, *rest = names
        return joint(f"{name}_{side}", "0 0 0", *([chain(side, *rest)] if rest else []))

    legs = [chain(side, "UpperLeg", "LowerLeg", "Foot") for side in "LR"]
    arms = [chain(side, "UpperArm", "LowerArm", "Hand") for side in "LR"]
    text = joint("Hips", "0 0 0", joint("Chest", "0 0 0", joint("Head", "0 0 0"), *arms), *legs)
    names = re.findall(r"JOINT (\w+)", text)
    frames = np.zeros((5, len(names), 6))
    frames[:, names.index("Hips"), 1] = 90
    bones = dict(Chest=40, Head=20, LowerLeg=-40, Foot=-60, LowerArm=-30, Hand=-25)
    for name, length in bones.items():
        for k in (k for k, each in enumerate(names) if each.startswith(name)):
            frames[:, k, 1] = length
    for side, z in (("L", -10), ("R", 10)):  # x ahead and y up: z is to the right
        frames[:, names.index(f"UpperLeg_{side}"), 2] = frames[:, names.index(f"UpperArm_{side}"), 2] = z
    frames[:, names.index("UpperArm_L"), 3] = np.linspace(0, 90, 5)  # about z: the hand goes to x
    rows = "\n".join(" ".join(map(str, row)) for row in frames.reshape(5, -1).tolist())
    path = tmp_path / "dataset-1_raise_001.bvh"
    path.write_text(f"HIERARCHY\n{text.replace('JOINT', 'ROOT', 1)}MOTION\nFrames: 5\nFrame Time: 0.0333333\n{rows}\n")
    return path


def test_clips_of_the_other_data_set_mean_the_same(bvh):
    clip = part("motions").find_clip(bvh.parent, "raise_001", 1.0, 1)
    world, down = clip.world(), [0, 0, -1.0]
    angle = np.linspace(0, np.pi / 2, 5)
    raised = np.stack([np.sin(angle), 0 * angle, -np.cos(angle)], 1)
    np.testing.assert_allclose(world["l_upper_arm"].apply(down), raised, atol=1e-9)
    np.testing.assert_allclose(world["l_forearm"].apply(down), raised, atol=1e-9)
    for name in ("r_upper_arm", "root", "chest", "l_thigh", "r_shank"):
        np.testing.assert_allclose(world[name].magnitude(), 0, atol=1e-9)
    np.testing.assert_allclose(clip.place, [[0, 0, 0.9]] * 5, atol=1e-9)
    assert len(part("motions").find_clip(bvh.parent, "raise_001", 1.0, 1, most=3).place) == 3


def test_standing_comes_first(clip):
    whole = part("motions").after_standing(clip, 5, 4, 3)
    assert {len(v) for v in whole.turns.values()} == {len(clip.place) + 12} == {len(whole.place)}
    assert whole.turns["r_shank"].magnitude()[:5].max() < 1e-9 < whole.turns["r_shank"].magnitude()[6]
    np.testing.assert_allclose(whole.turns["r_shank"].magnitude()[9:], 1.0)
    assert np.ptp(whole.place[:9], 0).max() == 0 == np.ptp(whole.place[-4:], 0).max()


def test_there_and_back(clip):
    whole = part("motions").there_and_back(clip, 3)
    count = len(clip.place)
    assert {len(v) for v in whole.turns.values()} == {2 * count + 3} == {len(whole.place)}
    np.testing.assert_array_equal(whole.place[0], clip.place[-1])
    np.testing.assert_allclose((whole.turns["root"][:count] * clip.turns["root"][::-1].inv()).magnitude(), 0, atol=1e-9)
    assert np.ptp(whole.place[count - 1 : count + 4], 0).max() == 0


def test_poses_are_what_they_are_called():
    poses, down, ahead = part("poses"), [0, 0, -1.0], [1.0, 0, 0]

    def along(name, **what):
        clip = poses.sequence([poses.pose(**what)], np.zeros(1), np.zeros(1))
        return clip.world()[name][0].apply(ahead if name.endswith("foot") else down)

    for side, sign in (("l", 1), ("r", -1)):
        np.testing.assert_allclose(along(f"{side}_upper_arm", arms=(poses.SIDE, poses.SIDE)), [0, sign, 0], atol=0.1)
        np.testing.assert_allclose(along(f"{side}_upper_arm", arms=(poses.AHEAD, poses.AHEAD)), ahead, atol=0.1)
        assert along(f"{side}_forearm", arms=(poses.PRAYS, poses.PRAYS))[1] * sign < -0.3  # to the middle
        assert along(f"{side}_forearm", arms=(poses.WAVES, poses.WAVES))[2] > 0.7
        for root in ((0, 0, 0), (0, 0.3, 0)):  # who leans forward sits as well
            seated = dict(root=root, left=poses.SITS, right=poses.SITS)
            np.testing.assert_allclose(along(f"{side}_thigh", **seated), ahead, atol=0.15)
            np.testing.assert_allclose(along(f"{side}_shank", **seated), down, atol=0.15)
            np.testing.assert_allclose(along(f"{side}_foot", **seated), ahead, atol=0.15)


@pytest.mark.parametrize("what", ["exercise", "sitting"])
@pytest.mark.parametrize("whole", [True, False])
def test_clips_of_poses_hold_together(what, whole):
    poses = part("poses")
    clip = getattr(poses, what)(np.random.default_rng(3), whole)
    assert 90 < len(clip.place) < 300 and {len(v) for v in clip.turns.values()} == {len(clip.place)}
    for name, turn in clip.turns.items():
        assert (turn[1:] * turn[:-1].inv()).magnitude().max() < 0.6, name


def test_feet_that_stand_do_not_slide_and_the_chair_is_under_who_sits():
    poses, names, count = part("poses"), ["l_ankle", "r_ankle", "l_hip", "r_hip"], 30
    gone = np.linspace(0, 0.5, count)[:, None] * np.array([1.0, 0.2, 0])
    joints = np.zeros((count, 4, 3))
    joints[:, 0] = [0.4, 0.1, 0.08] - gone  # the left foot stands, so the rest goes ahead; the right one is lifted
    joints[:, 1] = [0.4, -0.1, 0.6]
    joints[:, 2:, 2] = np.linspace(0.9, 0.5, count)[:, None]
    vertices = np.tile(np.array([[0.05, 0, 0.4], [2.0, 0, 0.1]], np.float32), (count, 1, 1))
    moved, found = poses.planted(vertices, joints, names)
    np.testing.assert_allclose(np.ptp(found[:, 0], 0), 0, atol=1e-3)
    np.testing.assert_allclose(moved[-1] - vertices[-1], np.tile(gone[-1], (2, 1)), atol=1e-3)
    seat, back = poses.chair(vertices, joints, names, True)
    assert seat[2][2] == pytest.approx(0.39, abs=1e-6)
    assert back[2][2] > seat[2][2] and back[0] < seat[0] - seat[2][0] / 2
    assert len(poses.chair(vertices, joints, names, False)) == 1


def test_shoulders_go_along_with_raised_arms(clip):
    figures = part("figure")
    chest = {"clavicle.": (0.02, 0.02, 1.38), "shoulder01.": (0.02, 0.1, 1.39)}
    places = {"neck01": (0, 0, 1.45), "head": (0, 0, 1.55)}
    for side, sign in (("L", 1), ("R", -1)):
        arm = {"upperarm01.": (0.02, 0.17, 1.35), "lowerarm01.": (0.02, 0.17, 1.1), "wrist.": (0.02, 0.17, 0.85)}
        leg = {"upperleg01.": (0, 0.1, 0.9), "lowerleg01.": (0, 0.1, 0.5), "foot.": (0, 0.1, 0.08)}
        places |= {k + side: (x, sign * y, z) for k, (x, y, z) in (chest | arm | leg).items()}
    bones = ["spine01", *places]
    heads = np.array([(0, 0, 1.2), *places.values()])
    parents = np.zeros(len(bones), int) - 1
    for name in bones[1:]:
        stem, _, side = name.partition(".")
        before = {
            "shoulder01": "clavicle",
            "upperarm01": "shoulder01",
            "lowerarm01": "upperarm01",
            "wrist": "lowerarm01",
        }
        parents[bones.index(name)] = bones.index(f"{before[stem]}.{side}") if stem in before else 0
    skin, weights = np.arange(len(bones))[:, None], np.ones((len(bones), 1))
    vertices = np.concatenate([heads, [[0, 0, 0], [0, 0, 1.7]]])
    skin, weights = np.pad(skin, ((0, 2), (0, 0))), np.pad(weights, ((0, 2), (0, 0)), constant_values=1.0)
    one = figures.Figure(
        figures.Meshes(vertices[None], heads[None], np.zeros((0, 3), int), bones, parents, skin, weights), 0
    )
    still = part("motions").after_standing(clip, 1, 1, 1)
    for raised, (low, high) in ((0.0, (-0.002, 0.002)), (np.pi / 2, (0.02, 0.04)), (np.pi, (0.04, 0.07))):
        turns = {k: Rotation.identity(2) for k in still.turns} | {
            f"{side}_upper_arm": Rotation.from_rotvec([[0, -raised, 0]] * 2) for side in "lr"
        }
        joints = one.posed(still._replace(turns=turns, place=np.zeros((2, 3))), np.ones(2))[1]
        at = {name: joints[0, k] for k, name in enumerate(figures.BONES)}
        for side in "lr":
            gone = at[f"{side}_shoulder"] - at["vc7"] - (one.joints[f"{side}_shoulder"] - one.joints["vc7"])
            assert low < gone[2] < high
            elbow = at[f"{side}_elbow"] - at[f"{side}_shoulder"]  # as long as ever, where the clip has it
            np.testing.assert_allclose(elbow, 0.25 * np.array([np.sin(raised), 0, -np.cos(raised)]), atol=1e-6)


@pytest.mark.parametrize("path", ["drives up", "goes round", "turns", "in a hand"])
def test_a_camera_keeps_who_it_looks_at_in_view(path, rng):
    paths, sight = part("paths"), part("sight")
    camera = importlib.import_module("voodoo_jax.simulate.sensor").tof_camera()
    middle = np.stack([np.full(90, 3.2), np.linspace(-0.4, 0.4, 90), np.full(90, 0.9)], 1)
    cameras = paths.moved(camera, path, middle, rng)
    assert len(cameras) == 90 and paths.PATHS[3] == "in a hand"
    seen = np.array([sight.pixels(sight.in_camera(m[None], c), c)[0] for m, c in zip(middle, cameras)])
    assert (np.abs(seen - [camera.cx, camera.cy]) < [60, 45]).all()
    place, yaw = np.array([c.position for c in cameras]), np.array([c.yaw for c in cameras])
    assert np.linalg.norm(np.diff(place, axis=0), axis=1).max() < 0.1 and np.abs(np.diff(yaw)).max() < 0.05
    assert np.ptp(yaw) > 0.05 and (np.ptp(place, 0).max() > 0.01) == (path != "turns")
