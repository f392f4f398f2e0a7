"""Exports are read back by other libraries: joints, skeleton, units and gaps."""

import csv
import json
import os
import subprocess
import sys
from dataclasses import replace

import bvhio
import ezc3d
import numpy as np
import pandas
import pybvh
import pygltflib
import pytest
import trc
from pxr import Gf, Usd, UsdGeom, UsdSkel
from scipy.spatial.transform import Rotation

import voodoo_jax as vj
from tests.exporters.test_tracks_files import make_tracks
from voodoo_jax.config.output_style import Style
from voodoo_jax.exporters.formats import FORMATS, ExportError, check_formats, export, gaps_note
from voodoo_jax.exporters.frames import evenly, upright
from voodoo_jax.exporters.npz import read_tracks_npz, write_tracks_npz
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.model.body import joint_centres
from voodoo_jax.records.tracks import Status, Tracks

HUMAN = {
    "skullbase": "Head", "vc7": "Neck", "l_shoulder": "LeftArm", "l_elbow": "LeftForeArm",
    "l_radiocarpal": "LeftHand", "l_hip": "LeftUpLeg", "l_knee": "LeftLeg", "l_talocrural": "LeftFoot",
    "r_shoulder": "RightArm", "r_elbow": "RightForeArm", "r_radiocarpal": "RightHand", "r_hip": "RightUpLeg",
    "r_knee": "RightLeg", "r_talocrural": "RightFoot",
}  # fmt: skip
DOG = {"skull": "head", "l_elbow": "l_forepaw", "l_stifle": "l_hindpaw", "tail": "tail", "r_hindfoot": "r_hindfoot"}
Y_UP = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]], float)  # fixed frame (z up) to the animation formats' axes
LOST = 10


def loose_tracks(name: str = "human", frames: int = 24) -> Tracks:
    """A body that turns and walks, whose limbs each have a turn and a place of their own: elastic bands are stretched
    by some centimetres, and joints are beside them. Not tracked at first, and in one frame in between."""
    tracks, rng = make_tracks(name), np.random.default_rng(5)
    limbs, part = tracks.body.limb_count, slice(30, 30 + frames)
    shake = Rotation.from_rotvec(np.cumsum(rng.normal(0, 0.06, (frames, limbs, 3)), 0).reshape(-1, 3))
    turn = Rotation.from_quat(np.nan_to_num(tracks.rotation[part], nan=0.5).reshape(-1, 4), scalar_first=True) * shake
    turn = turn.as_quat(scalar_first=True).reshape(frames, limbs, 4).astype(np.float32)
    place = (tracks.translation[part] + rng.normal(0, 0.01, (frames, limbs, 3))).astype(np.float32)
    turn[:3] = np.nan
    tracks.status[30:33] = Status.NOT_STARTED
    joints = np.stack([joint_centres(tracks.body, Poses(q, p)) for q, p in zip(turn, place)])
    # joints that are moved and poses that are not, as by place_joints
    joints = (joints + 0.01 + np.cumsum(rng.normal(0, 0.003, joints.shape), 0)).astype(np.float32)
    return tracks.only(part).having(rotation=turn, translation=place, joints=joints)


def bvh_positions(path) -> tuple[dict[str, np.ndarray], float]:
    """World position of each joint over time by bvhio's own forward kinematics, centimetres; frame time."""
    root = bvhio.readAsHierarchy(str(path))
    parsed = bvhio.readAsBvh(str(path))
    found: dict[str, list] = {}
    for frame in range(parsed.FrameCount):
        root.loadPose(frame)
        for joint, _, _ in root.layout():
            found.setdefault(joint.Name, []).append(list(joint.PositionWorld))
    return {name: np.array(rows) for name, rows in found.items()}, parsed.FrameTime


@pytest.mark.parametrize("name, bones", [("human", HUMAN), ("human10", HUMAN), ("dog", DOG)])
def test_forward_kinematics_of_bvh_gives_the_joints(name, bones, tmp_path):
    tracks = loose_tracks(name)
    write_tracks_npz(tracks, tmp_path / "a.tracks.npz")
    found, step = bvh_positions(export(read_tracks_npz(tmp_path / "a.tracks.npz"), tmp_path / "a.bvh"))
    assert step == pytest.approx(1 / 30, rel=1e-4)
    for centre, bone in bones.items():
        expected = tracks.joint(centre)[tracks.tracked] @ Y_UP.T * 100
        np.testing.assert_allclose(found[bone][tracks.tracked], expected, atol=0.1, err_msg=centre)  # 1 mm
        np.testing.assert_allclose(found[bone][LOST], found[bone][LOST - 1], atol=1e-3)  # held
    if name != "dog":
        hips = (tracks.joint("l_hip") + tracks.joint("r_hip"))[tracks.tracked] / 2 @ Y_UP.T * 100
        np.testing.assert_allclose(found["Hips"][tracks.tracked], hips, atol=0.1)
        assert list(found)[:2] == ["Hips", "LeftUpLeg"] and {"Spine", "Spine1", "Spine2"} <= set(found)


# what others' files have: of Mixamo's characters, Unity's HumanBodyBones, LAFAN1's BVH, in its order
LAFAN1 = (
    "Hips LeftUpLeg LeftLeg LeftFoot LeftToe RightUpLeg RightLeg RightFoot RightToe Spine Spine1 Spine2 Neck Head "
    "LeftShoulder LeftArm LeftForeArm LeftHand RightShoulder RightArm RightForeArm RightHand"
)
UNITY = (
    "Hips LeftUpperLeg LeftLowerLeg LeftFoot LeftToes RightUpperLeg RightLowerLeg RightFoot RightToes Spine Chest "
    "UpperChest Neck Head LeftShoulder LeftUpperArm LeftLowerArm LeftHand RightShoulder RightUpperArm RightLowerArm "
    "RightHand"
)


@pytest.mark.parametrize("rig, names", [("lafan1", LAFAN1), ("humanoid", UNITY)])
def test_rigs_have_the_bones_that_programs_know(rig, names, tmp_path):
    tracks = loose_tracks()
    found, _ = bvh_positions(export(tracks, tmp_path / "a.bvh", style=Style(rig=rig)))
    assert list(found) == names.split()
    # on the feet's balls and under the collar, with the limbs
    ball = next(name for name in found if name.startswith("LeftToe"))
    limb, t = tracks.body.topology.limbs.index("l_foot"), tracks.body.topology
    sites = [np.asarray(tracks.body.sites)[t.sites.index(f"l_metatarsal_phalanx_{k}")] for k in (1, 5)]
    turn = Rotation.from_quat(tracks.rotation[20, limb], scalar_first=True)
    expected = (turn.apply(np.mean(sites, 0)) + tracks.translation[20, limb]) @ Y_UP.T * 100
    np.testing.assert_allclose(found[ball][20], expected, atol=0.1)


def test_the_bind_pose_is_a_t_or_an_a(tmp_path):
    for pose, down in (("t", 0.0), ("a", 1.0)):
        root = bvhio.readAsHierarchy(str(export(make_tracks(), tmp_path / "a.bvh", style=Style(pose=pose))))
        root.loadRestPose()
        at = {joint.Name: np.array(joint.PositionWorld) for joint, _, _ in root.layout()}
        for side in ("Left", "Right"):
            arm = at[f"{side}ForeArm"] - at[f"{side}Arm"]
            assert -arm[1] / abs(arm[0]) == pytest.approx(down, abs=0.12), (pose, side)


BLENDER = """
import json, sys
import bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
path, frames = sys.argv[-2], json.loads(sys.argv[-1])
if path.endswith(".bvh"):
    bpy.ops.import_anim.bvh(filepath=path, global_scale=0.01, update_scene_fps=True)
else:
    bpy.ops.import_scene.gltf(filepath=path)
rig = next(o for o in bpy.data.objects if o.type == "ARMATURE")
found = {}
for frame in frames:
    bpy.context.scene.frame_set(frame)
    found[frame] = {b.name: list(rig.matrix_world @ b.head) for b in rig.pose.bones}
print("FOUND" + json.dumps(found))
"""


@pytest.mark.parametrize("ending", [".bvh", ".glb"])
def test_blender_opens_rigs(ending, tmp_path):
    python = os.environ.get("VOODOO_JAX_BPY", sys.executable)  # a Python that has Blender as a module
    if subprocess.run([python, "-c", "import bpy"], capture_output=True).returncode:
        pytest.skip("Blender is not installed as a module: pip install bpy (350 MB); VOODOO_JAX_BPY names its Python")
    tracks = loose_tracks()
    path = export(tracks, tmp_path / f"a{ending}", style=Style(rig="mixamo", pose="a"))
    # Blender's frames: BVH begins with 1, glTF's seconds are 24 frames long
    rows = {1 + row if ending == ".bvh" else round(0.8 * row): row for row in (5, 20)}
    (tmp_path / "open.py").write_text(BLENDER)
    done = subprocess.run([python, tmp_path / "open.py", path, json.dumps(list(rows))], capture_output=True, text=True)
    assert done.returncode == 0 and "FOUND" in done.stdout, done.stderr
    found = json.loads(done.stdout.split("FOUND")[1].splitlines()[0])
    for frame, row in rows.items():
        for centre, bone in HUMAN.items():  # z up, as in the tracks, but turned: the figure looks along -y there
            expected = tracks.joint(centre)[row] @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], float).T
            np.testing.assert_allclose(found[str(frame)][bone], expected, atol=2e-3, err_msg=f"{centre} {frame}")


def test_files_have_joints_by_the_names_asked_for(tmp_path):
    tracks, other = make_tracks(), {}
    for names in ("common", "h36m", "smpl", "opensim"):
        header = export(tracks, tmp_path / "a.csv", style=Style(names=names)).read_text().split("\n", 1)[0]
        other[names] = [name.removesuffix("_x_m") for name in header.split(",") if name.endswith("_x_m")]
    assert other["common"][:5] == ["head", "neck", "left_shoulder", "left_elbow", "left_wrist"] == other["smpl"][:5]
    assert other["h36m"][-3:] == ["RHip", "RKnee", "RFoot"] and other["opensim"][-3:] == ["RHJC", "RKJC", "RAJC"]
    named = tracks.with_names("common")
    write_tracks_npz(named, tmp_path / "a.tracks.npz")
    again = read_tracks_npz(tmp_path / "a.tracks.npz")
    with np.load(tmp_path / "a.tracks.npz") as file:
        assert list(file["joint_names"]) == other["common"] == list(again.joint_names)
    for name in ("left_wrist", "l_radiocarpal", "LWJC", "LWrist"):
        np.testing.assert_array_equal(again.joint(name), tracks.joint("l_radiocarpal"))
    assert again.with_names("hanim").joint_names == tracks.joint_names
    with pytest.raises(ValueError, match="did you mean 'left_wrist'"):
        tracks.joint("left_wrst")
    assert bvh_positions(export(again, tmp_path / "a.bvh"))[0].keys() >= set(HUMAN.values())


def test_a_rigid_bvh_is_read_by_strict_readers(tmp_path):
    tracks = make_tracks("human")  # moves as one piece: no band is stretched
    bvh = pybvh.read_bvh_file(str(export(tracks, tmp_path / "a.rigid.bvh")))
    assert bvh.nodes[0].name == "Hips" and len(bvh.root_pos) == len(tracks.time_ns)
    places = dict(zip([node.name for node in bvh.nodes], np.swapaxes(bvh.node_positions(), 0, 1)))
    for centre, bone in HUMAN.items():
        expected = tracks.joint(centre)[tracks.tracked] @ Y_UP.T * 100
        # the reported shoulder lies beside the model's joint, where the arm hangs in a T it is elsewhere on the chest
        off = 1.5 if bone.endswith(("Arm", "ForeArm", "Hand")) else 0.1
        np.testing.assert_allclose(places[bone][tracks.tracked], expected, atol=off, err_msg=centre)


def test_the_skeleton_stands_in_a_t_and_knows_its_limbs_lengths(tmp_path):
    tracks = make_tracks("human")
    root = bvhio.readAsHierarchy(str(export(tracks, tmp_path / "a.bvh")))
    root.loadRestPose()
    at = {joint.Name: np.array(joint.PositionWorld) for joint, _, _ in root.layout()}
    arm = at["LeftForeArm"] - at["LeftArm"]
    assert arm[0] > 20 and abs(arm[1]) < 2 and at["RightForeArm"][0] < at["RightArm"][0]
    centres = dict(zip(tracks.body.topology.centres, np.asarray(joint_centres(tracks.body, tracks.body.rest))))
    for a, b in (("l_hip", "l_knee"), ("l_knee", "l_talocrural"), ("l_elbow", "l_radiocarpal")):
        length = np.linalg.norm(at[HUMAN[a]] - at[HUMAN[b]])
        assert length == pytest.approx(100 * np.linalg.norm(centres[a] - centres[b]), abs=0.1)


def gltf_accessor(document: pygltflib.GLTF2, number: int) -> np.ndarray:
    accessor = document.accessors[number]
    view = document.bufferViews[accessor.bufferView]
    kind = {5126: np.float32, 5125: np.uint32, 5121: np.uint8}[accessor.componentType]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor.type]
    data = document.get_data_from_buffer_uri(document.buffers[0].uri) if document.buffers[0].uri else None
    data = document.binary_blob() if data is None else data
    flat = np.frombuffer(data, kind, accessor.count * width, view.byteOffset + (accessor.byteOffset or 0))
    return flat.reshape(accessor.count, width)


@pytest.mark.parametrize("ending", [".glb", ".gltf"])
def test_gltf_has_joints_mesh_and_times(ending, tmp_path):
    tracks = loose_tracks()
    document = pygltflib.GLTF2().load(str(export(tracks, tmp_path / f"a{ending}")))
    nodes, animation, skin = document.nodes, document.animations[0], document.skins[0]
    parent = {child: i for i, node in enumerate(nodes) for child in node.children or []}
    turn, place = {}, {}
    for channel in animation.channels:
        values = gltf_accessor(document, animation.samplers[channel.sampler].output).astype(float)
        (turn if channel.target.path == "rotation" else place)[channel.target.node] = values
    times = gltf_accessor(document, animation.samplers[0].input)[:, 0]
    np.testing.assert_allclose(times, (tracks.time_ns - tracks.time_ns[0]) / 1e9, atol=1e-5)

    def world(node: int, frame: int) -> np.ndarray:
        own = np.eye(4)
        own[:3, :3], own[:3, 3] = Rotation.from_quat(turn[node][frame]).as_matrix(), place[node][frame]
        return (world(parent[node], frame) if node in parent else np.eye(4)) @ own

    names = {node.name: i for i, node in enumerate(nodes)}
    for frame in (3, 20, 23):
        for centre, bone in HUMAN.items():
            np.testing.assert_allclose(world(names[bone], frame)[:3, 3], Y_UP @ tracks.joint(centre)[frame], atol=1e-3)
    # the skinned mesh of a frame lies on the limbs as the tracks have them
    inverse = gltf_accessor(document, skin.inverseBindMatrices).reshape(-1, 4, 4).transpose(0, 2, 1)
    points = []
    for primitive in document.meshes[0].primitives:
        vertices = gltf_accessor(document, primitive.attributes.POSITION).astype(float)
        bones = gltf_accessor(document, primitive.attributes.JOINTS_0)[:, 0]
        moves = np.stack([world(skin.joints[b], 20) @ inverse[b] for b in range(len(skin.joints))])
        points.append(np.einsum("nij,nj->ni", moves[bones], np.c_[vertices, np.ones(len(vertices))])[:, :3])
    middle = {}
    t = tracks.body.topology
    for limb in range(tracks.body.limb_count):
        axis = Rotation.from_quat(tracks.rotation[20, limb], scalar_first=True).apply([0, 0, 1])
        middle[limb] = tracks.translation[20, limb] + axis * float(tracks.body.sizes[limb, 4]) / 2
    cloud = np.concatenate(points) @ Y_UP
    for limb, centre in middle.items():
        radius = float(np.max(tracks.body.sizes[limb]))
        assert (np.linalg.norm(cloud - centre, axis=1) < radius).sum() > 20, t.limbs[limb]
    assert animation.extras["frames_without_pose"] == [0, 1, 2, LOST]
    assert {m.name for m in document.materials} == {"left", "right", "middle"}


def test_usd_has_joints_and_states_units_and_axes(tmp_path):
    tracks = loose_tracks()
    for ending in (".usda", ".usd"):
        stage = Usd.Stage.Open(str(export(tracks, tmp_path / f"a{ending}")))
        assert UsdGeom.GetStageUpAxis(stage) == "Z" and UsdGeom.GetStageMetersPerUnit(stage) == 1
        prim = UsdSkel.Skeleton(stage.GetPrimAtPath("/body/skeleton"))
        query = UsdSkel.Cache().GetSkelQuery(prim)
        names = [str(path).rsplit("/", 1)[-1] for path in query.GetJointOrder()]
        rate = stage.GetTimeCodesPerSecond()
        for frame in (3, 20):
            time = (tracks.time_ns[frame] - tracks.time_ns[0]) / 1e9 * rate
            found = query.ComputeJointSkelTransforms(Usd.TimeCode(time))
            for centre, bone in HUMAN.items():
                at = Gf.Matrix4d(found[names.index(bone)]).ExtractTranslation()
                np.testing.assert_allclose(at, tracks.joint(centre)[frame], atol=1e-3)
        held = stage.GetRootLayer().customLayerData["voodoo_jax"]["frames_without_pose"]
        assert list(held) == [0, 1, 2, LOST]
        assert UsdSkel.BindingAPI(stage.GetPrimAtPath("/body/left")).GetJointIndicesPrimvar().Get()
    assert (tmp_path / "a.usda").read_text().startswith("#usda")


def test_c3d_has_joints_and_landmarks(tmp_path):
    tracks = loose_tracks()
    file = ezc3d.c3d(str(export(tracks, tmp_path / "a.c3d")))
    point = file["parameters"]["POINT"]
    assert point["UNITS"]["value"] == ["mm"] and point["Y_SCREEN"]["value"] == ["+Z"]
    assert point["RATE"]["value"][0] == pytest.approx(30, rel=1e-4)
    labels, points = point["LABELS"]["value"], file["data"]["points"][:3].transpose(2, 1, 0) / 1000
    for centre in ("l_radiocarpal", "skullbase"):
        there = points[:, labels.index(centre)]
        np.testing.assert_allclose(there[tracks.tracked], tracks.joint(centre)[tracks.tracked], atol=1e-4)
        assert np.isnan(there[LOST]).all() and np.isnan(there[:3]).all()
    limb = tracks.body.topology.limbs.index("pelvis")
    site = np.asarray(tracks.body.sites)[tracks.body.topology.sites.index("l_asis")]
    expected = Rotation.from_quat(tracks.rotation[9, limb], scalar_first=True).apply(site) + tracks.translation[9, limb]
    np.testing.assert_allclose(points[9, labels.index("l_asis")], expected, atol=1e-4)
    assert (file["data"]["meta_points"]["residuals"][0, 0, LOST]) == -1


def test_trc_and_mot_and_csv(tmp_path):
    tracks = loose_tracks()
    lines = export(tracks, tmp_path / "a.trc").read_text().split("\n")
    assert lines[2].split("\t")[2:5] == ["24", str(14 + len(tracks.body.topology.sites)), "m"]
    names = [name for name in lines[3].split("\t")[2:] if name]
    rows = [line.split("\t") for line in lines[6:-1]]
    at = 2 + 3 * names.index("l_knee")
    x, y, z = tracks.joint("l_knee")[9]
    np.testing.assert_allclose([float(v) for v in rows[9][at : at + 3]], [x, z, -y], atol=1e-5)
    assert rows[LOST][at : at + 3] == ["NaN"] * 3 and len({len(row) for row in rows}) == 1

    lines = export(tracks, tmp_path / "a.mot").read_text().split("\n")
    end = lines.index("endheader")
    names, rows = lines[end + 1].split("\t"), [line.split("\t") for line in lines[end + 2 : -1]]
    assert f"nRows={len(rows)}" in lines and f"nColumns={len(names)}" in lines and "inDegrees=yes" in lines
    assert len(rows) == tracks.tracked.sum()
    knee = np.degrees(tracks.angles()["r_knee_flexion"][tracks.tracked])
    np.testing.assert_allclose([float(row[names.index("knee_angle_r")]) for row in rows], knee, atol=1e-4)
    # a hidden shank's angle is that of the predicted pose, and this is said
    weight = tracks.evidence.limb_weight.copy()
    weight[20:40, tracks.body.topology.limbs.index("r_shank")] = 0
    text = export(tracks.having(limb_weight=weight), tmp_path / "b.mot").read_text()
    share = f"knee_angle_r {100 * float(tracks.tracked[20:40].sum() / tracks.tracked.sum()):.0f} %"
    assert "nan" not in text and share in text and text.split("\n")[-len(rows) - 1 :] == [*lines[end + 2 :]]
    hips = (tracks.joint("l_hip") + tracks.joint("r_hip"))[tracks.tracked] / 2
    np.testing.assert_allclose([float(row[names.index("pelvis_ty")]) for row in rows], hips[:, 2], atol=1e-4)

    with open(export(tracks, tmp_path / "a.csv"), newline="") as file:
        table = list(csv.DictReader(file))
    assert table[7]["frame_id"] == "world" and int(table[7]["time_ns"]) == tracks.time_ns[7]
    assert float(table[7]["vc7_z_m"]) == pytest.approx(float(tracks.joint("vc7")[7, 2]), abs=1e-5)
    assert [row["tracked"] for row in table[:4]] == ["0", "0", "0", "1"] and table[0]["vc7_z_m"] == ""
    assert float(table[9]["l_hip_flexion_deg"]) == pytest.approx(
        np.degrees(tracks.angles()["l_hip_flexion"][9]), abs=0.01
    )


def test_readers_of_others_take_tables(tmp_path, monkeypatch):
    """trc-data-reader, pandas, and OpenSim where it is installed, which most is written for."""
    monkeypatch.chdir(tmp_path)  # where OpenSim leaves a log
    tracks = loose_tracks()
    knee = tracks.joint("l_knee")[:, [0, 2, 1]] * [1, 1, -1]
    file = trc.TRCData()
    file.load(str(export(tracks, tmp_path / "a.trc")))
    np.testing.assert_allclose(np.array(file["l_knee"])[tracks.tracked], knee[tracks.tracked], atol=1e-5)
    assert file["NumFrames"] == len(knee) and np.isnan(file["l_knee"][LOST]).all() and file["Units"] == "m"
    table = pandas.read_csv(export(tracks, tmp_path / "a.csv"))
    columns = [f"l_knee_{axis}_m" for axis in "xyz"]
    np.testing.assert_allclose(table[columns][tracks.tracked], tracks.joint("l_knee")[tracks.tracked], atol=1e-5)
    assert table["tracked"].tolist() == tracks.tracked.astype(int).tolist() and table["l_knee_x_m"].isna().sum() == 3
    opensim = pytest.importorskip("opensim", reason="OpenSim is not installed: pip install opensim (220 MB)")
    markers = opensim.TimeSeriesTableVec3(str(tmp_path / "a.trc"))
    at = list(markers.getColumnLabels()).index("l_knee")
    np.testing.assert_allclose(markers.getRowAtIndex(9)[at].to_numpy(), knee[9], atol=1e-5)
    assert markers.getNumRows() == len(knee) and markers.getTableMetaDataString("Units") == "m"
    path = str(export(tracks, tmp_path / "a.mot"))
    motion, older = opensim.TimeSeriesTable(path), opensim.Storage(path)
    assert motion.getNumRows() == older.getSize() == tracks.tracked.sum() and older.isInDegrees()
    angle = np.degrees(tracks.angles()["r_knee_flexion"][tracks.tracked])
    np.testing.assert_allclose(motion.getDependentColumn("knee_angle_r").to_numpy(), angle, atol=1e-4)


@pytest.mark.parametrize("name", ["arm", "stick", "dog"])
def test_every_format_takes_every_body(name, tmp_path):
    tracks = make_tracks(name)
    for key, how in FORMATS.items():
        assert export(tracks, tmp_path / f"a{how.suffix}", key).stat().st_size > 100


def test_every_format_takes_a_log_of_one_frame_and_refuses_none(tmp_path):
    tracks = make_tracks()
    with pytest.raises(ExportError, match="no frame"):
        export(tracks.only(slice(0)), tmp_path / "a.csv")
    tracks = tracks.only(slice(3, 4))
    for key, how in FORMATS.items():
        assert export(tracks, tmp_path / f"a{how.suffix}", key).stat().st_size > 100


def test_nothing_tracked_at_all(tmp_path):
    tracks = make_tracks()
    lost = np.full_like(tracks.status, Status.NOT_STARTED)
    none = {n: getattr(tracks, n) * np.nan for n in ("rotation", "translation", "joints")}
    tracks = replace(tracks, status=lost, **none)
    for key, how in FORMATS.items():
        assert export(tracks, tmp_path / f"a{how.suffix}", key).stat().st_size > 100
    assert "75 of 75 frames are not tracked: in bvh they repeat" in gaps_note(tracks, ["csv", "bvh"])


def test_dropped_frames_are_interpolated_where_there_is_no_time():
    tracks = make_tracks()
    keep = np.ones(75, bool)
    keep[[20, 50, 51, 52, 53, 54]] = False
    even, rate = evenly(tracks.only(np.flatnonzero(keep)))
    assert rate == pytest.approx(30, rel=1e-3) and len(even.time_ns) == 75
    np.testing.assert_allclose(even.joints[20], (tracks.joints[19] + tracks.joints[21]) / 2, atol=1e-5)
    assert even.tracked[20] and not even.tracked[50:55].any() and np.isnan(even.joints[52]).all()
    np.testing.assert_allclose(even.joints[60:], tracks.joints[60:], atol=1e-5)
    same, _ = evenly(tracks)
    assert same is tracks


@pytest.mark.parametrize("up", [[0, -1, 0], [0.5, 0.2, 0.7], [0, 0, -1], [0.01, 0, 1]])
def test_files_stand_upright_whatever_the_fixed_frame(up, tmp_path):
    tracks = replace(loose_tracks(), up=np.array(up, np.float32))
    turn = upright(tracks)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
    expected = 0.03 if up == [0.01, 0, 1] else 1e-6  # a floor that is measured to be level within its noise is level
    np.testing.assert_allclose(turn @ (np.array(up) / np.linalg.norm(up)), [0, 0, 1], atol=expected)
    found, _ = bvh_positions(export(tracks, tmp_path / "a.bvh"))
    height = (tracks.joint("l_knee") @ turn.T)[:, 2]
    np.testing.assert_allclose(found["LeftLeg"][tracks.tracked, 1] / 100, height[tracks.tracked], atol=1e-3)


def test_formats_that_do_not_exist_are_refused(tmp_path, monkeypatch):
    assert check_formats(["csv, trc", "CSV"]) == ("csv", "trc")
    with pytest.raises(ExportError, match="no format 'bhv' to export to; there are csv, .*, bvh, "):
        check_formats(["bhv"])
    with pytest.raises(ExportError, match="Names end in .csv"):
        vj.export(make_tracks(), tmp_path / "a.fbx")
    monkeypatch.setattr("voodoo_jax.exporters.formats.find_spec", lambda name: None)
    with pytest.raises(ExportError, match=r'pip install "voodoo_jax\[usd\]"'):
        check_formats(["usd"])
    assert list(tmp_path.iterdir()) == []
