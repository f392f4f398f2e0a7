"""Tracks written and read back: the npz contract, and the MCAP file as a viewer reads it."""

import json
from dataclasses import replace

import jax
import numpy as np
import pytest
import trimesh
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from voodoo_jax.exporters import foxglove
from voodoo_jax.exporters.foxglove import write_tracks_mcap
from voodoo_jax.exporters.limb_shapes import loft, profile
from voodoo_jax.exporters.npz import TracksFileError, read_tracks_npz, write_tracks_npz
from voodoo_jax.geometry.rigid import Poses, compose, quat_exp
from voodoo_jax.model.body import joint_centres, scaled
from voodoo_jax.model.body_file import load_body, parse_body
from voodoo_jax.records.tracks import Evidence, Status, Tracks

FRAMES = 75
START = 1_700_000_000_123_456_789


def make_tracks(name: str = "human") -> Tracks:
    body = scaled(load_body(name), 1.83)
    rng = np.random.default_rng(0)
    walk = np.cumsum(rng.normal(0, 0.02, (FRAMES, 1, 3)), 0).astype(np.float32)
    turn = quat_exp(walk[..., ::-1] * np.float32(3))
    poses = compose(Poses(turn, walk + np.float32(1)), Poses(body.rest.rotation[None], body.rest.translation[None]))
    joints = jax.vmap(lambda p: joint_centres(body, p))(poses)
    rotation, translation, joints = np.array(poses.rotation), np.array(poses.translation), np.array(joints)
    status = np.zeros(FRAMES, np.int8)
    status[:3], status[40] = Status.NOT_STARTED, Status.LOST
    residual = rng.uniform(0.01, 0.02, FRAMES).astype(np.float32)
    confidence = np.full(joints.shape[:2], 0.9, np.float32)
    for array in (rotation, translation, joints, residual, confidence):
        array[:3] = np.nan
    return Tracks(
        source="logs/walk ä.mcap", fixed_frame="world", body=body,
        time_ns=START + np.arange(FRAMES, dtype=np.int64) * 33_333_333,
        rotation=rotation, translation=translation, joints=joints, status=status,
        evidence=Evidence(
            residual, rng.uniform(0.8, 1, FRAMES).astype(np.float32), np.full(FRAMES, 6, np.int32),
            rng.integers(500, 900, FRAMES).astype(np.int32),
            rng.uniform(0, 50, (FRAMES, body.limb_count)).astype(np.float32),
            depth_inside=np.zeros((FRAMES, body.limb_count), np.float32),
        ),
        seconds=1.25, marker_residual={"LASI": 0.01, "RASI": 0.02},
        joint_confidence=confidence, notes=("one log only", "no ground"),
    )  # fmt: skip


def read_all(path) -> tuple[dict[str, list], object]:
    found: dict[str, list] = {}
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message in reader.iter_messages():
            if channel.message_encoding == "json":
                found.setdefault(channel.topic, []).append((message, json.loads(message.data)))
        for _, channel, message, decoded in reader.iter_decoded_messages(
            topics=["/voodoo/tf", "/voodoo/poses", "/voodoo/body", "/voodoo/joints"]
        ):
            found.setdefault(channel.topic, []).append((message, decoded))
        extra = (list(reader.iter_metadata()), list(reader.iter_attachments()))
    return found, extra


@pytest.mark.parametrize("name", ["human", "arm"])
def test_npz_round_trip(name, tmp_path):
    tracks = make_tracks(name)
    path = tmp_path / "a.tracks.npz"
    write_tracks_npz(tracks, path)
    again = read_tracks_npz(path)
    assert [p.name for p in tmp_path.iterdir()] == ["a.tracks.npz"]
    assert {**again.marker_residual} == pytest.approx({**tracks.marker_residual}, abs=1e-7)
    both = [vars(t) | vars(t.evidence) for t in (tracks, again)]
    for field in both[0].keys() - {"evidence", "marker_residual"}:
        x, y = (each[field] for each in both)
        if field == "body":
            assert x.topology == y.topology and x.name == y.name
            for u, v in zip(jax.tree.leaves(x), jax.tree.leaves(y)):
                np.testing.assert_allclose(u, v, atol=1e-6)
        elif isinstance(x, np.ndarray):
            assert x.dtype == y.dtype
            np.testing.assert_array_equal(x, y)
        else:
            assert x == y


def test_npz_contract(tmp_path):
    tracks = make_tracks()
    write_tracks_npz(tracks, tmp_path / "a.tracks.npz")
    data = np.load(tmp_path / "a.tracks.npz", allow_pickle=False)
    assert data["time_ns"].dtype == np.int64 and data["tracked"].dtype == bool
    assert data["tracked"].sum() == FRAMES - 4
    assert [str(n) for n in data["joint_names"]] == list(tracks.body.topology.centres)
    assert data["joints"].shape == (FRAMES, 14, 3) and np.isnan(data["joints"][:3]).all()
    body = json.loads(str(data["body_json"]))
    assert body["stature"] == pytest.approx(1.83) and set(body["segment_lengths"]) == {
        "upper_arm", "forearm", "thigh", "shank",
    }  # fmt: skip
    longer = replace(tracks, segments={"thigh": 0.5})
    write_tracks_npz(longer, tmp_path / "a.tracks.npz")
    assert read_tracks_npz(tmp_path / "a.tracks.npz").segment_lengths() == pytest.approx(longer.segment_lengths())
    odd = dict(data) | {"body_json": np.array('{"name": "x", "stature": 1.8, "segment_lengths": 3}')}
    odd.pop("digest", None)
    np.savez(tmp_path / "odd.npz", **odd)
    assert read_tracks_npz(tmp_path / "odd.npz").segment_lengths() == tracks.segment_lengths()
    write_tracks_npz(make_tracks("arm"), tmp_path / "b.npz")
    body = json.loads(str(np.load(tmp_path / "b.npz", allow_pickle=False)["body_json"]))
    assert "stature" not in body and body["reach"] == pytest.approx(1.83)


def test_npz_that_is_something_else(tmp_path):
    path = tmp_path / "x.npz"
    for write in (
        lambda: path.write_bytes(b"not a zip file"),
        lambda: path.write_bytes(b""),
        lambda: path.write_bytes(b"PK\x03\x04 cut off"),
        lambda: np.savez(path, time_ns=np.zeros(3)),
        lambda: np.savez(path, time_ns=np.array([{}], object)),
        lambda: np.save(tmp_path / "x.npy", np.zeros(3)) or (tmp_path / "x.npy").rename(path),
    ):
        write()
        with pytest.raises(TracksFileError, match="x.npz"):
            read_tracks_npz(path)
    with pytest.raises(FileNotFoundError):
        read_tracks_npz(tmp_path / "none.npz")


def test_mcap_transforms_reproduce_the_tracks(tmp_path):
    tracks = make_tracks()
    write_tracks_mcap(tracks, tmp_path / "a.voodoo.mcap")
    found, _ = read_all(tmp_path / "a.voodoo.mcap")
    limbs, centres = tracks.body.topology.limbs, tracks.body.topology.centres
    assert len(found["/voodoo/tf"]) == len(found["/voodoo/poses"]) == FRAMES - 3
    for topic in ("/voodoo/tf", "/voodoo/poses"):
        assert [m.log_time for m, _ in found[topic]] == tracks.time_ns[3:].tolist()
    for i, (_, tf) in enumerate(found["/voodoo/tf"], 3):
        by_name = {t.child_frame_id: t for t in tf.transforms}
        assert set(by_name) == {f"voodoo/{n}" for n in limbs} | {f"voodoo/joint/{n}" for n in centres}
        assert {t.parent_frame_id for t in tf.transforms} == {"world"}
        assert tf.transforms[0].timestamp.ToNanoseconds() == tracks.time_ns[i]
        xyz = lambda v: [v.x, v.y, v.z]  # noqa: E731
        places = [xyz(by_name[f"voodoo/{n}"].translation) for n in limbs]
        np.testing.assert_allclose(places, tracks.translation[i], atol=1e-3)
        turns = [by_name[f"voodoo/{n}"].rotation for n in limbs]
        np.testing.assert_allclose([[q.w, *xyz(q)] for q in turns], tracks.rotation[i], atol=1e-4)
        joints = [by_name[f"voodoo/joint/{n}"] for n in centres]
        np.testing.assert_allclose([xyz(t.translation) for t in joints], tracks.joints[i], atol=1e-3)
        assert all(t.rotation.w == 1 for t in joints)
    _, cloud = found["/voodoo/joints"][-1]
    table = np.frombuffer(cloud.data, "<f4").reshape(-1, 4)
    np.testing.assert_allclose(table, np.c_[tracks.joints[-1], np.full(len(table), 0.9)], rtol=1e-6)
    assert [f.name for f in cloud.fields] == ["x", "y", "z", "confidence"] and cloud.frame_id == tracks.fixed_frame
    _, poses = found["/voodoo/poses"][-1]
    np.testing.assert_allclose([xyz(p.position) for p in poses.poses], tracks.translation[-1], atol=1e-3)
    assert poses.frame_id == "world" and all(abs(q.orientation.w) + abs(q.orientation.x) > 0 for q in poses.poses)


@pytest.mark.parametrize("name", ["human", "human10", "arm", "dog"])
def test_mcap_body_has_the_sizes_of_its_limbs(name, tmp_path):
    tracks = make_tracks(name)
    write_tracks_mcap(tracks, tmp_path / "a.mcap")
    found, _ = read_all(tmp_path / "a.mcap")
    times = [m.log_time for m, _ in found["/voodoo/body"]]
    assert times[0] == tracks.time_ns[3] and len(times) == 3 and (np.diff(times) >= 1_000_000_000).all()
    kinds = set()
    for _, scene in found["/voodoo/body"]:
        assert [e.id for e in scene.entities] == list(tracks.body.topology.limbs)
        for entity, sizes in zip(scene.entities, np.asarray(tracks.body.sizes)):
            a0, b0, a1, b1, length = sizes
            assert entity.frame_id == f"voodoo/{entity.id}" and entity.frame_locked
            assert entity.lifetime.ToNanoseconds() == 0
            assert {p.key: float(p.value) for p in entity.metadata} == pytest.approx(
                dict(zip(("a0", "b0", "a1", "b1", "length"), sizes.tolist())), rel=1e-6
            )
            assert len(entity.cylinders) + len(entity.triangles) == 1
            for c in entity.cylinders:
                kinds.add("cylinder")
                assert c.pose.position.z == pytest.approx(length / 2) and c.pose.orientation.w == 1
                assert max(c.bottom_scale, c.top_scale) == 1
                ends = [c.size.x * c.bottom_scale, c.size.y * c.bottom_scale]
                ends += [c.size.x * c.top_scale, c.size.y * c.top_scale]
                assert ends == pytest.approx([2 * a0, 2 * b0, 2 * a1, 2 * b1], rel=0.011)
                assert c.size.z == pytest.approx(length) and c.color.a > 0
            for t in entity.triangles:
                kinds.add("triangles")
                assert t.pose.orientation.w == 1 and t.color.a > 0
                if entity.id == "head":  # round
                    continue
                p = np.array([[q.x, q.y, q.z] for q in t.points])
                low, high = np.abs(p[p[:, 2] < 1e-9]).max(0), np.abs(p[p[:, 2] > length - 1e-6]).max(0)
                np.testing.assert_allclose([*low[:2], *high[:2], high[2]], sizes, atol=1e-6)
                faces = np.array(t.indices).reshape(-1, 3)
                assert faces.max() < len(p)
                # outward faces that close: the signed volume is that of the frustum, 24 sides are 1.2 % short
                volume = np.einsum("ni,ni->n", p[faces[:, 0]], np.cross(p[faces[:, 1]], p[faces[:, 2]])).sum() / 6
                exact = np.pi * length * (2 * a0 * b0 + 2 * a1 * b1 + a0 * b1 + a1 * b0) / 6
                assert volume == pytest.approx(exact, rel=0.013) and volume < exact
    assert kinds == ({"cylinder", "triangles"})


def test_drawn_limbs_are_closed_and_a_head_sits_on_its_neck():
    mesh = trimesh.Trimesh(*loft(np.array([[0, 0.1, 0.2], [0.4, 0.05, 0.03]])), process=False)
    assert mesh.is_watertight and mesh.volume > 0
    np.testing.assert_allclose(mesh.bounds, [[-0.1, -0.2, 0], [0.1, 0.2, 0.4]], atol=1e-9)
    body = load_body("human")
    head, chest = (body.topology.limbs.index(name) for name in ("head", "chest"))
    mesh = trimesh.Trimesh(*loft(profile(body, head)), process=False)
    a0, b0, a1, b1, length = np.asarray(body.sizes)[head]
    assert mesh.is_watertight and mesh.volume > 0 and mesh.bounds[1, 2] == pytest.approx(length)
    assert (mesh.bounds[1, :2] <= [max(a0, a1), max(b0, b1)]).all() and (mesh.bounds[1, :2] > [a1, b1]).all()
    low = float(body.rest.translation[head, 2]) + mesh.bounds[0, 2]
    assert low == pytest.approx(float(body.rest.translation[chest, 2] + body.sizes[chest, 4]), abs=2e-3)


def test_mcap_quality_metadata_and_attachment(tmp_path):
    tracks = make_tracks()
    write_tracks_mcap(tracks, tmp_path / "a.mcap", {"icp.steps": "6"})
    found, (meta, attachments) = read_all(tmp_path / "a.mcap")
    quality = [q for _, q in found["/voodoo/quality"]]
    assert len(quality) == FRAMES and quality[0]["residual_m"] is None and not quality[0]["tracked"]
    assert quality[40]["status"] == Status.LOST and quality[5]["tracked"] is True and quality[5]["steps"] == 6
    assert quality[5]["confidence"] == pytest.approx(0.9) and quality[0]["confidence"] is None
    assert quality[5]["residual_m"] == pytest.approx(float(tracks.evidence.residual[5]))
    (record,) = meta
    assert record.name == "voodoo_jax" and set(record.metadata) == {"version", "source", "fixed_frame", "icp.steps"}
    assert record.metadata["source"] == "logs/walk ä.mcap" and record.metadata["fixed_frame"] == "world"
    (attached,) = attachments
    body = parse_body(attached.data.decode())
    assert attached.name == "body.toml" and body.topology == tracks.body.topology
    np.testing.assert_allclose(body.sizes, tracks.body.sizes, atol=1e-6)


def test_limb_without_pose_is_left_out(tmp_path):
    tracks = make_tracks()
    tracks.translation[10, 4] = np.nan
    write_tracks_mcap(tracks, tmp_path / "a.mcap")
    found, _ = read_all(tmp_path / "a.mcap")
    counts = [len(tf.transforms) for _, tf in found["/voodoo/tf"]]
    assert sorted(set(counts)) == [28, 29] and counts.index(28) == 7 and len(found["/voodoo/poses"]) == FRAMES - 4


def test_failure_in_the_middle_leaves_nothing(tmp_path, monkeypatch):
    tracks = make_tracks()
    real = foxglove.quality_of

    def dies(t, frame, confidence):
        if frame == 50:
            raise RuntimeError("out of luck")
        return real(t, frame, confidence)

    monkeypatch.setattr(foxglove, "quality_of", dies)
    with pytest.raises(RuntimeError, match="out of luck"):
        write_tracks_mcap(tracks, tmp_path / "a.mcap")

    def half(file, **_):
        file.write(b"PK")
        raise OSError("disk full")

    monkeypatch.setattr(np, "savez_compressed", half)
    with pytest.raises(OSError, match="disk full"):
        write_tracks_npz(tracks, tmp_path / "a.npz")
    assert list(tmp_path.iterdir()) == []


def test_recording_without_a_person(tmp_path):
    tracks = make_tracks()
    for array in (tracks.rotation, tracks.translation, tracks.joints):
        array[:] = np.nan
    write_tracks_mcap(tracks, tmp_path / "a.mcap")
    found, _ = read_all(tmp_path / "a.mcap")
    assert set(found) == {"/voodoo/quality"}
