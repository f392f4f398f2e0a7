"""Bodies of robot descriptions and skinned meshes: limbs on surfaces, joints where they turn; a robot is tracked."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import voodoo_jax as vj
from tests.exporters.test_tracks_files import make_tracks
from tests.support import logs
from voodoo_jax.cli.main import main
from voodoo_jax.config.options import Settings, StartSettings
from voodoo_jax.exporters.formats import export
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.model.body import joint_centres, segment_lengths
from voodoo_jax.model.body_file import BodyFileError
from voodoo_jax.model.foreign.assembly import fit_frustum
from voodoo_jax.model.foreign.sources import body_from

# name, parent, kind, origin in the parent (metres), axis, limits (radians), shape in the link: kind, size, centre
LINKS = [
    ("base", "", "", (0, 0, 0), None, None, ("cylinder", (0.11, 0.3), (0, 0, 0.15))),
    ("turret", "base", "revolute", (0, 0, 0.3), (0, 0, 1), (-2.9, 2.9), ("box", (0.16, 0.14, 0.12), (0, 0, 0.06))),
    ("upper", "turret", "revolute", (0, 0, 0.12), (0, 1, 0), (-1.9, 1.9), ("box", (0.09, 0.07, 0.42), (0, 0, 0.21))),
    ("lower", "upper", "revolute", (0, 0, 0.44), (0, 1, 0), (-0.2, 2.6), ("cylinder", (0.04, 0.36), (0, 0, 0.18))),
    ("flange", "lower", "fixed", (0, 0, 0.36), None, None, ("cylinder", (0.03, 0.02), (0, 0, 0.01))),
    ("hand", "flange", "revolute", (0, 0, 0.03), (1, 0, 0), (-1.5, 1.5), ("box", (0.12, 0.05, 0.18), (0, 0, 0.09))),
]
REST = {"upper_joint": 0.5, "lower_joint": 1.2}


def urdf() -> str:
    """The arm above, with a tool frame that has no shape."""
    text = ['<?xml version="1.0"?>', '<robot name="arm_of_tests">']
    for name, parent, kind, origin, axis, limits, (shape, size, centre) in LINKS:
        geometry = (
            f'<box size="{" ".join(map(str, size))}"/>'
            if shape == "box"
            else f'<cylinder radius="{size[0]}" length="{size[1]}"/>'
        )
        at = " ".join(map(str, centre))
        text.append(f'<link name="{name}"><visual><origin xyz="{at}"/><geometry>{geometry}</geometry></visual></link>')
        if parent:
            text.append(f'<joint name="{name}_joint" type="{kind}"><parent link="{parent}"/><child link="{name}"/>')
            text.append(f'<origin xyz="{" ".join(map(str, origin))}"/>')
            if axis:
                text.append(f'<axis xyz="{" ".join(map(str, axis))}"/>')
                text.append(f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="1" velocity="1"/>')
            text.append("</joint>")
    text.append('<link name="tool"/><joint name="tool_joint" type="continuous"><parent link="hand"/>')
    text.append('<child link="tool"/><origin xyz="0 0 0.2"/></joint></robot>')
    return "\n".join(text)


def placed(values: dict[str, float]) -> dict[str, np.ndarray]:
    """T_world_link by the robot's own kinematics."""
    out: dict[str, np.ndarray] = {}
    for name, parent, _, origin, axis, *_ in LINKS:
        local = np.eye(4)
        local[:3, 3] = origin
        if axis:
            local[:3, :3] = Rotation.from_rotvec(np.array(axis) * values.get(f"{name}_joint", 0.0)).as_matrix()
        out[name] = out[parent] @ local if parent else local
    return out


def hit(kind: str, size: tuple[float, ...], start: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """How far along each ray a box, or a cylinder along z, is hit; inf: not."""
    with np.errstate(divide="ignore", invalid="ignore"):
        half = np.array(size) / 2 if kind == "box" else np.array([np.inf, np.inf, size[1] / 2])
        planes = np.sort(np.stack([(-half - start) / rays, (half - start) / rays]), axis=0)
        near, far = planes[0].max(1), planes[1].min(1)
        if kind == "cylinder":
            a, b = (rays[:, :2] ** 2).sum(1), rays[:, :2] @ start[:2]
            root = np.sqrt(b**2 - a * (start[:2] @ start[:2] - size[0] ** 2))  # NaN: passes by
            near, far = np.fmax(planes[0, :, 2], (-b - root) / a), np.fmin(planes[1, :, 2], (-b + root) / a)
            near = np.where(np.isfinite(root), near, np.inf)
        return np.where((near < far) & (near > 0), near, np.inf)


def depth_of(values: dict[str, float], T_world_optical: np.ndarray, shape: tuple[int, int], focal: float) -> np.ndarray:
    """Depth image (metres) of the links' true shapes, in the middles of the pixels, and of the floor."""
    v, u = np.mgrid[: shape[0], : shape[1]].reshape(2, -1)
    middle = (np.array(shape)[::-1] - 1) / 2
    rays = np.c_[(np.c_[u, v] - middle) / focal, np.ones(len(u))] @ T_world_optical[:3, :3].T
    eye, places = T_world_optical[:3, 3], placed(values)
    nearest = np.where(rays[:, 2] < 0, -eye[2] / np.minimum(rays[:, 2], -1e-9), np.inf)
    for name, *_, (kind, size, centre) in LINKS:
        turn, at = places[name][:3, :3], places[name][:3, 3] + places[name][:3, :3] @ centre
        nearest = np.minimum(nearest, hit(kind, size, (eye - at) @ turn, rays @ turn))
    return np.where(nearest < 6, nearest, 0.0).reshape(shape)


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("robot") / "arm.urdf"
    path.write_text(urdf())
    return path


def test_a_robots_links_become_limbs(arm, tmp_path, capsys):
    words = ["body", str(arm), "--out", str(tmp_path / "arm.toml"), "--rest", *(f"{k}={v}" for k, v in REST.items())]
    assert main(words) == 0 and main(words) == 2
    body = vj.read_body(tmp_path / "arm.toml")
    t = body.topology
    assert t.limbs == ("base", "turret", "upper", "lower", "hand")  # the flange is one with the lower arm
    assert "5 limbs, reach" in capsys.readouterr().out
    places = placed(REST)
    centres = dict(zip(t.centres, np.asarray(joint_centres(body, body.rest))))
    for name in t.limbs[1:]:
        np.testing.assert_allclose(centres[f"{name}_joint"], places[name][:3, 3], atol=1e-4)
    np.testing.assert_allclose(centres["hand_tip"], (places["hand"] @ [0, 0, 0.18, 1])[:3], atol=2e-3)
    # a hinge's bands are along its axis, its limits from the rest pose
    j = t.joints.index("lower_joint")
    child = Rotation.from_quat(np.asarray(body.rest.rotation[3], float), scalar_first=True)
    frame = Rotation.from_quat(np.asarray(body.child_anchor.rotation[j], float), scalar_first=True)
    np.testing.assert_allclose((child * frame).as_matrix()[:, 1], [0, 1, 0], atol=1e-5)
    assert body.axes[j, 0] == 0 and body.axes[j, 1] > 0.02
    np.testing.assert_allclose(np.degrees(body.limits[j, 1]), np.degrees([-1.4, 1.4]), atol=0.01)
    # sizes: cylinders are themselves, boxes between their half width and half diagonal
    sizes = dict(zip(t.limbs, np.asarray(body.sizes)))
    np.testing.assert_allclose(sizes["base"], [0.11, 0.11, 0.11, 0.11, 0.3], atol=0.003)
    np.testing.assert_allclose(sizes["upper"][[0, 2]], 0.05, atol=0.007)
    np.testing.assert_allclose(sizes["upper"][[1, 3]], 0.039, atol=0.007)


def test_frusta_are_found_again():
    from tests.support.helpers import frustum_mesh

    turn = Rotation.from_rotvec([0.3, 0.8, -0.4])
    mesh = frustum_mesh(np.array([0.06, 0.04, 0.04, 0.03, 0.35]))
    points, faces = trimesh.sample.sample_surface(mesh, 3000, seed=0)[:2]
    found = fit_frustum(turn.apply(points) + [1, 2, 3], turn.apply(mesh.face_normals[faces]))
    ends = [np.array([1, 2, 3.0]), turn.apply([0, 0, 0.35]) + [1, 2, 3]]
    turned = np.linalg.norm(found.bottom - ends[0]) > 0.1
    first, last = (found.top, found.bottom) if turned else (found.bottom, found.top)
    np.testing.assert_allclose([first, last], ends, atol=0.005)
    axes = [found.top_axes, found.bottom_axes] if turned else [found.bottom_axes, found.top_axes]
    np.testing.assert_allclose(axes, [[0.06, 0.04], [0.04, 0.03]], atol=0.003)
    assert found.off < 0.002


def test_a_robot_in_a_log_is_tracked_within_a_centimetre(arm, tmp_path):
    """Seen as it is, boxes and all, by one depth camera; nothing but its size is given."""
    body, _ = body_from(arm, REST)
    shape, focal, count = (96, 128), 120.0, 24
    eye, look = np.array([1.1, -1.9, 1.1]), np.array([0.25, 0.0, 0.55])
    z = (look - eye) / np.linalg.norm(look - eye)
    x = np.cross(z, [0, 0, 1]) / np.linalg.norm(np.cross(z, [0, 0, 1]))
    turn = np.stack([x, np.cross(z, x), z], 1)
    camera = np.eye(4)
    camera[:3, :3], camera[:3, 3] = turn, eye
    log, truth = logs.Log(), []
    q = Rotation.from_matrix(turn).as_quat()
    log.add("/tf_static", logs.START, logs.ros_tf((logs.START, "base", "depth_optical", tuple(eye), tuple(q))))
    k = np.array([[focal, 0, (shape[1] - 1) / 2], [0, focal, (shape[0] - 1) / 2], [0, 0, 1]])
    log.add("/depth/camera_info", logs.START, logs.ros_calibration("depth_optical", k, size=shape))
    for i in range(count):
        s = i / count * 2 * np.pi
        values = {
            "turret_joint": 0.5 * np.sin(s), "upper_joint": 0.5 + 0.25 * np.sin(2 * s),
            "lower_joint": 1.2 + 0.5 * np.sin(s + 1), "hand_joint": 0.3 * np.sin(s),
        }  # fmt: skip
        stamp = logs.START + i * 66_000_000
        log.add("/depth/image", stamp, logs.ros_image(stamp, "depth_optical", depth_of(values, camera, shape, focal)))
        places = placed(values)
        truth.append([*(places[n][:3, 3] for n in body.topology.limbs[1:]), (places["hand"] @ [0, 0, 0.18, 1])[:3]])
    recording = vj.read_log(log.write(tmp_path / "robot.mcap"))
    tracks = vj.track(body, recording, Settings(start=StartSettings(scale=float(body.scale))))
    order = [*(f"{name}_joint" for name in body.topology.limbs[1:]), "hand_tip"]
    found = np.stack([tracks.joint(name) for name in order], 1)
    errors = np.linalg.norm(found - np.array(truth), axis=2)
    print("cm:", dict(zip(order, np.round(100 * errors.mean(0), 2))))
    assert tracks.tracked.all() and errors.mean() < 0.01


def test_a_skinned_mesh_becomes_a_body(tmp_path):
    """What is exported as glTF comes back with its bones, lengths and girths."""
    tracks = make_tracks()
    path = export(tracks, tmp_path / "anna.glb")
    body, notes = body_from(path)
    own = tracks.body
    assert {"Hips", "LeftForeArm", "RightLeg", "Head"} <= set(body.topology.limbs)
    sizes, was = (dict(zip(b.topology.limbs, np.asarray(b.sizes))) for b in (body, own))
    for mine, theirs in (("l_forearm", "LeftForeArm"), ("r_shank", "RightLeg"), ("l_upper_arm", "LeftArm")):
        assert sizes[theirs][4] == pytest.approx(was[mine][4], abs=0.02)
        assert sizes[theirs][:4].mean() == pytest.approx(was[mine][:4].mean(), rel=0.15)
    rest = Poses(np.asarray(body.rest.rotation), np.asarray(body.rest.translation))
    at = dict(zip(body.topology.centres, np.asarray(joint_centres(body, rest))))
    for a, b, name in (("LeftArm", "LeftForeArm", "upper_arm"), ("RightUpLeg", "RightLeg", "thigh")):
        assert np.linalg.norm(at[a] - at[b]) == pytest.approx(segment_lengths(own)[name], abs=0.02)


def test_what_is_no_body_is_said(arm, tmp_path, capsys):
    (tmp_path / "a.urdf").write_text("<robot")
    (tmp_path / "b.urdf").write_text("<robot name='x'><link name='a'/><link name='b'/></robot>")
    (tmp_path / "c.urdf").write_text("<robot name='x'><link name='a'/></robot>")
    (tmp_path / "d.glb").write_bytes(b"glTF\2\0\0\0\x14\0\0\0\4\0\0\0JSON{bad")
    (tmp_path / "e.gltf").write_text('{"nodes": []}')
    (tmp_path / "f.obj").write_text("v 0 0 0")
    for name, said in zip("abcdef", ("XML", "without a parent", "no surface", "glTF", "skin", "supported files are")):
        (path,) = tmp_path.glob(f"{name}.*")
        with pytest.raises(BodyFileError, match=said):
            body_from(path)
    with pytest.raises(BodyFileError, match="'uper_joint'.*upper_joint"):
        body_from(arm, {"uper_joint": 1.0})
    with pytest.raises(BodyFileError, match="goes from"):
        body_from(arm, {"upper_joint": 2.5})
    assert main(["body", str(tmp_path / "a.urdf"), "--out", str(tmp_path / "x.toml")]) == 1
    assert main(["body", "--out", str(tmp_path / "x.toml")]) == 2
    assert main(["body", str(arm), "--rest", "upper", "--out", str(tmp_path / "x.toml")]) == 2
    assert not (tmp_path / "x.toml").exists()
