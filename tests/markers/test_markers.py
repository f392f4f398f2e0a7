"""Optical markers alone: sizes, start, tracking and reports, whatever axis is up and however the names are damaged."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.logs import Log, ros_marker, ros_markers
from voodoo_jax.config.options import FeatureSettings, ReadSettings, Settings
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.kernels.landmarks import named_points
from voodoo_jax.markers.diagnostics import in_few_lines
from voodoo_jax.markers.first_pose import agreed, first_poses, rigid
from voodoo_jax.markers.own_sites import named_subject
from voodoo_jax.markers.priors import Chain, Priors
from voodoo_jax.markers.size_fit import Fit, Markers, personal
from voodoo_jax.markers.table import marker_table, places, without_gaps
from voodoo_jax.model.body import joint_centres, scaled, segment_lengths, with_proportions
from voodoo_jax.model.body_file import human, load_body
from voodoo_jax.model.marker_sets import PLUG_IN_GAIT, harrington_hips, newington_hips, plain_name
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.recording import Pairs, Recording
from voodoo_jax.simulate.motion import make_motion, placed, pose_body, sequence
from voodoo_jax.solve.names import FeatureNames
from voodoo_jax.trackers.front import track, track_people

RATE = 60.0
LENGTHS = {"l_thigh": 1.06, "r_thigh": 1.06, "l_forearm": 1.08, "r_forearm": 1.08, "chest": 0.96}
Y_UP = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], float)
SIDED = "FHD BHD SHO UPA ELB FRM WRA WRB FIN ASI PSI THI KNE TIB ANK HEE TOE".split()
WORN = {"C7", "T10", "CLAV", "STRN", "RBAK", *(side + name for side in "LR" for name in SIDED)}
LEG = "THI", "KNE", "TIB", "ANK", "HEE", "TOE"
DRAWN = "l_shoulder", "l_elbow", "l_radiocarpal", "l_hip", "l_knee", "l_talocrural"


def person():
    """Not of the usual proportions; her joint centres are the model's joints."""
    body = with_proportions(scaled(human(), 1.62), LENGTHS)
    none = Markers((), np.zeros(0, int), np.zeros((0, 0, 3)), np.zeros((0, 0), bool))
    at = [np.asarray(a.translation, float) for a in (body.parent_anchor, body.child_anchor)]
    whole = np.ones((body.limb_count, 3))
    poses = np.zeros((0, 1, 4)), np.zeros((0, 1, 3))
    fit = Fit(float(body.scale), whole, at[0], at[1], np.zeros((0, 3)), *poses, np.zeros(0), 0.0)
    return personal(body, none, fit)


@pytest.fixture(scope="module")
def everywhere():
    """All sites of a body in a walk and a bow with 1 mm of noise, each put 5 mm off; the joint centres, and poses."""
    body, rng = person(), np.random.default_rng(3)
    body = replace_sites(body, np.asarray(body.sites) + rng.normal(0, 0.005, body.sites.shape))
    motion = sequence(make_motion(body, "walk", 1.2, RATE), make_motion(body, "bow", 1.3, RATE))
    poses = pose_body(body, placed(motion, 1.0, -2.0, 2.0).root, motion.rotations)
    count = len(body.topology.sites)
    both = places(body, np.arange(count + len(body.topology.centres)), poses)
    sites, joints = both[:, :count] + rng.normal(0, 0.001, both[:, :count].shape), both[:, count:]
    return body, sites, joints, poses


@pytest.fixture(scope="module")
def moving(everywhere):
    """The same as markers of Plug-in Gait."""
    body, sites, joints, _ = everywhere
    names = {m: body.topology.sites.index(s) for m, s in PLUG_IN_GAIT.items() if m in WORN}
    return body, [{m: f[k] for m, k in names.items()} for f in sites], joints


def replace_sites(body, sites):
    return eqx.tree_at(lambda b: b.sites, body, jnp.asarray(sites, jnp.float32))


def recorded(tmp_path, frames) -> Recording:
    """The markers as a real log."""
    log = Log()
    for i, frame in enumerate(frames):
        stamp = 10**18 + round(i * 1e9 / RATE)
        log.add("/markers", stamp, ros_markers(*(ros_marker(stamp, "lab", n, p) for n, p in frame.items())))
    return read_log(log.write(tmp_path / "markers.mcap"))


def check(tracks, body, joints, mean=0.02, frames=slice(None)):
    """Joints, sizes and the tracker's own word."""
    error = np.linalg.norm(tracks.joints - joints, axis=-1)[frames]
    chosen = [i for i, n in enumerate(body.topology.centres) if n[2:] in {d[2:] for d in DRAWN}]
    assert error[:, chosen].mean() < mean and error[:, chosen].mean(1).max() < 0.03
    assert tracks.tracked[frames].all() and tracks.evidence.explained[frames].mean() > 0.9
    assert tracks.joint_confidence is not None and tracks.joint_confidence[frames][:, chosen].mean() > 0.9
    true, found = segment_lengths(body), segment_lengths(tracks.body)
    assert max(abs(found[k] - true[k]) for k in true) < 0.015
    assert abs(float(tracks.body.scale) - 1.62) < 0.05


@pytest.mark.parametrize("turn", [np.eye(3), Y_UP], ids=["z_up", "y_up"])
def test_markers_alone(moving, tmp_path, turn):
    body, frames, joints = moving
    turned = [{f"Subject:{n}": turn @ p for n, p in f.items()} for f in frames]
    tracks = track(human(), recorded(tmp_path, turned))
    check(tracks, body, joints @ turn.T)
    assert tracks.evidence.residual.max() < 0.03 and tracks.evidence.limb_weight.sum(0).min() > 0
    assert not any("arker" in note for note in tracks.notes)


def test_left_handed_coordinates_or_names_on_the_wrong_sides(moving, tmp_path):
    """Both look the same: it is asked, with little confidence, and what a user says settles it."""
    body, frames, joints = moving
    frames, joints = frames[::4], joints[::4]
    unity = np.array([[0.0, -1, 0], [0, 0, 1], [1, 0, 0]])  # x to the right, y up, z ahead
    log = recorded(tmp_path, [{n: unity @ p for n, p in f.items()} for f in frames])
    doubted = track(human(), log)
    assert len([note for note in doubted.notes if "read.mirror" in note]) == 1
    assert doubted.joint_confidence is not None and doubted.joint_confidence.max() <= 0.2 and doubted.tracked.all()
    assert float(np.median(doubted.evidence.residual)) < 0.02  # it fits all the same
    settings = Settings(read=ReadSettings(mirror=("/markers=x",)))
    tracks = track(human(), read_log(log.path, settings.read), settings)
    error = np.linalg.norm(tracks.joints - joints @ (np.diag([-1.0, 1, 1]) @ unity).T, axis=-1)
    assert error.mean() < 0.03 and not any("read.mirror" in note for note in tracks.notes)
    assert tracks.joint_confidence is not None and tracks.joint_confidence.mean() > 0.9
    settings = Settings(read=ReadSettings(mirror=("/markers=none",)))
    named = track(human(), read_log(log.path, settings.read), settings)
    assert named.joint_confidence is not None and named.joint_confidence.mean() > 0.9


def test_damaged_names(moving, tmp_path):
    """One renamed, one away for a second, one at zero, two exchanged for a while, two exchanged throughout."""
    body, frames, joints = moving
    damaged = []
    for i, frame in enumerate(frames):
        f = dict(frame)
        f["LOUT"] = f.pop("LANK")
        if 30 <= i < 90:
            del f["RWRA"]
        if 60 <= i < 110:
            f["RKNE"] = np.zeros(3)
        if 100 <= i < 140:
            f["LASI"], f["RASI"] = f["RASI"], f["LASI"]
        f["LELB"], f["RELB"] = f["RELB"], f["LELB"]
        damaged.append(f)
    tracks = track(human(), recorded(tmp_path, damaged))
    error = np.linalg.norm(tracks.joints - joints, axis=-1)
    assert error.mean() < 0.03 and tracks.tracked.all()
    notes = "\n".join(tracks.notes)
    assert "'RWRA' is missing for 1.0 s (frames 30 to 89)" in notes and "'RKNE' is missing for 0.8 s" in notes
    assert "LASI and RASI were exchanged in frames 100 to 139" in notes
    assert "LELB and RELB were exchanged in all frames" in notes
    assert "'LOUT' was not used" in notes and "--features.names 'LOUT=l_lateral_malleolus'" in notes


def test_all_markers_gone_for_a_while(moving, tmp_path):
    body, frames, joints = moving
    gone = [{} if 60 <= i < 100 else f for i, f in enumerate(frames)]
    recording = recorded(tmp_path, [f or {"X": np.ones(3)} for f in gone])
    tracks = track(human(), recording)
    assert tracks.tracked[:60].all() and not tracks.tracked[60:100].any() and tracks.tracked[100:].all()
    check(tracks, body, joints, frames=np.r_[:60, 100:150])


def test_legs_that_no_marker_tells_of_go_with_the_pelvis(moving, tmp_path):
    """They hang from it at rest; without that they are drawn along behind, held by nothing but their hips' bands."""
    _, frames, joints = moving
    upper = [{n: p for n, p in f.items() if n[1:] not in LEG} for f in frames]
    tracks = track(human(), recorded(tmp_path, upper))
    ankles = [tracks.body.topology.centres.index(f"{s}_talocrural") for s in "lr"]
    off = np.linalg.norm((tracks.joints - joints)[:, ankles].mean(1)[:, :2], axis=-1)
    assert tracks.joint_confidence is not None and tracks.joint_confidence[:, ankles].max() < 0.11
    assert tracks.tracked.all() and off.mean() < 0.25 and off.max() < 0.4, (off.mean(), off.max())


def test_too_few_markers_are_said(moving, tmp_path):
    frames = [
        {n: f[n] for n in ("LASI", "RASI", "C7", "LELB")} | {f"m{k}": np.ones(3) for k in range(4)} for f in moving[1]
    ]
    tracks = track(human(), recorded(tmp_path, frames[:5]))
    assert not tracks.tracked.any() and any("No frame has 6 markers" in note for note in tracks.notes)


PAIRS = {  # ends of the middles that are joints' centres
    "knee": ("femoral_lateral_epicondyle", "femoral_medial_epicondyle"),
    "talocrural": ("lateral_malleolus", "medial_malleolus"),
    "elbow": ("humeral_lateral_epicondyle", "humeral_medial_epicondyle"),
    "radiocarpal": ("radial_styloid", "ulnar_styloid"),
}
WORDS = {
    "Knee.Lat": PAIRS["knee"][0], "Knee.Med": PAIRS["knee"][1], "Ankle.Lat": PAIRS["talocrural"][0],
    "Ankle.Med": PAIRS["talocrural"][1], "Elbow.Lat": PAIRS["elbow"][0], "Elbow.Med": PAIRS["elbow"][1],
    "Wrist.Lat": PAIRS["radiocarpal"][0], "Wrist.Med": PAIRS["radiocarpal"][1], "ASIS": "asis", "PSIS": "psis",
    "Shoulder": "acromion", "Heel": "calcaneus_posterior", "MT5": "metatarsal_phalanx_5",
}  # fmt: skip
CLUSTERS = ("thigh", "shank", "upper_arm")  # limbs that carry three markers anywhere


def in_words(everywhere):
    """Markers of another set: on both sides of joints, and clusters whose places are nobody's sites."""
    body, sites, _, poses = everywhere
    t, rng = body.topology, np.random.default_rng(7)
    frames = [{"C7": f[t.sites.index("cervicale")], "Sternum": f[t.sites.index("suprasternale")]} for f in sites]
    for side, s in (("R", "r_"), ("L", "l_")):
        for name, site in WORDS.items():
            for frame, f in zip(frames, sites):
                frame[f"{side}.{name}"] = f[t.sites.index(s + site)]
        for limb in CLUSTERS:
            k = t.limbs.index(s + limb)
            turn = Rotation.from_quat(np.asarray(poses.rotation)[:, k], scalar_first=True).as_matrix()
            for n in range(3):
                place = [*rng.choice([-1, 1], 2) * rng.uniform(0.03, 0.07, 2), rng.uniform(0.3, 0.8) * 0.3]
                at = turn @ place + np.asarray(poses.translation)[:, k]
                for frame, p in zip(frames, at):
                    frame[f"{side}.{limb}{n + 1}"] = p + rng.normal(0, 0.001, 3)
    return frames


def test_another_set_has_clusters_and_joints_between_two_markers(everywhere, tmp_path):
    """Centres of joints are the middles; a marker with a name that nobody knows is told by where it sits."""
    body, sites, _, _ = everywhere
    frames = in_words(everywhere)
    frames = [{**f, "zebra": f["R.Heel"], "*1": np.ones(3)} for f in frames]
    for frame in frames:
        del frame["R.Heel"]
    tracks = track(human(), recorded(tmp_path, frames))
    t = body.topology
    for joint, ends in PAIRS.items():
        for side in ("l_", "r_"):
            middle = np.mean([sites[:, t.sites.index(side + end)] for end in ends], 0)
            off = np.linalg.norm(tracks.joint(side + joint) - middle, axis=-1)
            assert off.mean() < 0.012 and off.max() < 0.025, (side + joint, off.mean(), off.max())
    assert tracks.tracked.all() and tracks.body.topology == human().topology
    assert len(tracks.marker_residual) == len(frames[0]) - 2
    assert max(tracks.marker_residual.values()) < 0.015 and tracks.evidence.residual.max() < 0.015
    notes = "\n".join(tracks.notes)
    assert "OpenSim" in notes and "--features.names 'zebra=r_calcaneus_posterior'" in notes
    assert "1 unnamed points" in notes
    # the same by the setting that the note gives, and for a marker of which only the limb is known
    named = FeatureSettings(names=("zebra=r_calcaneus_posterior", "R.thigh1=r_thigh"))
    again = track(human(), recorded(tmp_path, frames), Settings(features=named))
    assert "zebra" in again.marker_residual and not any("zebra" in note for note in again.notes)


def test_key_points_of_two_subjects(everywhere, tmp_path):
    """Joint centres by their names in pose nets; of two people in a log the one that is seen more is the first."""
    body, _, joints, _ = everywhere
    t, rng = body.topology, np.random.default_rng(8)
    names = {"hip": "hip", "knee": "knee", "talocrural": "ankle", "shoulder": "shoulder", "elbow": "elbow"}
    names = {
        f"{s[0]}_{c}": f"{s}_{n}" for s in ("left", "right") for c, n in [*names.items(), ("radiocarpal", "wrist")]
    }
    noisy = joints + rng.normal(0, 0.005, joints.shape)
    frames = []
    for k, f in enumerate(noisy):
        mine = {f"Anna:{n}": f[t.centres.index(c)] for c, n in names.items()}
        other = {f"Ben:{n}": f[t.centres.index(c)] + [0.3, 0.8, 0.0] for c, n in names.items()} if k % 2 else {}
        frames.append({**other, **mine})
    recording = recorded(tmp_path, frames)
    tracks = track(human(), recording)
    chosen = [t.centres.index(c) for c in names]
    off = np.linalg.norm(tracks.joints - joints, axis=-1)[:, chosen]
    assert tracks.tracked.all() and off.mean() < 0.02 and off.max() < 0.06, (off.mean(), off.max())
    assert any("'Anna' is tracked" in note and "'Ben'" in note for note in tracks.notes)
    anna, ben = track_people(human(), recording)
    np.testing.assert_array_equal(anna.joints, tracks.joints)
    off = np.linalg.norm(ben.joints - joints - [0.3, 0.8, 0.0], axis=-1)[1::2, chosen]
    assert (ben.person, ben.people) == (2, 2) and off.mean() < 0.03, off.mean()
    assert any("these tracks are of 'Ben'" in note for note in ben.notes)


def test_names_of_the_body_and_of_the_settings_come_before_sets():
    """Unless the log speaks of markers: then r_knee is one on the knee."""
    empty, t = np.zeros((0, 3), np.float32), human().topology

    def known(*names):
        pairs = Pairs(names, np.ones((len(names), 3), np.float32))
        frames = [BodyObservation(0, empty, np.zeros(0, int), empty, pairs=pairs)]
        return named_subject(frames, t, FeatureSettings()).known

    few = known("l_wrist", "r_wrist", "l_elbow", "skullbase", "face", "left_hand", "right_hand")
    assert not few.titles and not few.weights and few.places["l_wrist"] == "l_radiocarpal"
    markers = known("r_knee", "r_ankle", "r_calc", "r_5meta", "r_toe", "r.ASIS", "r.PSIS", "r_thigh1", "r_sh2")
    assert markers.titles and markers.places["r_knee"] == "r_femoral_lateral_epicondyle"


def test_many_notes_of_one_kind_are_one_line():
    found = [(f"'m{k}'", f"is missing for {k} s") for k in range(20)]
    assert len(in_few_lines(found[:3], "markers are missing", "Marker ")) == 3
    (line,) = in_few_lines(found, "markers are missing", "Marker ")
    assert line.startswith("20 markers are missing: 'm0' is missing for 0 s; 'm1'") and line.endswith("and 14 more.")


def test_names_and_sites():
    assert [plain_name(n) for n in ("Bob:LFHD", "A_b_LFHD", "lfhd", "l_asis")] == ["LFHD", "LFHD", "LFHD", "l_asis"]
    for name in ("human", "human10"):
        t = load_body(name).topology
        names = FeatureNames(t, FeatureSettings(names=("LASI=navel",)))
        assert names.look_up("X:LASI") == (t.sites.index("navel"),)  # what the settings say comes first
        missing = {m for m in WORN if names.look_up(m) is None}
        assert missing == (set() if name == "human" else {s + m for s in "LR" for m in ("FIN", "HEE", "TOE")})


def test_table_and_lost_markers():
    points = np.array([[0, 0, 0], [1, 2, 3], [np.nan, 0, 0], [4, 5, 6]], np.float32)
    empty = np.zeros((0, 3), np.float32)
    frame = BodyObservation(0, empty, np.zeros(0, int), empty, pairs=Pairs(("LASI", "RASI", "C7", "odd"), points))
    cleaned = without_gaps([frame, replace(frame, pairs=Pairs())])
    table = marker_table(cleaned, FeatureNames(human().topology, FeatureSettings()))
    assert table.markers.names == ("RASI",) and table.unknown.names == ("odd",)
    np.testing.assert_array_equal(table.markers.seen, [[True], [False]])
    np.testing.assert_array_equal(table.markers.points[0], [[1, 2, 3]])


def test_rigid_and_agreed(rng):
    """Four of ten points are anywhere: the others decide, with their scale."""
    model = rng.normal(size=(10, 3)) * 0.5
    turn, shift = Rotation.random(rng=rng).as_matrix(), rng.normal(size=3)
    found = rigid(model, model @ turn.T + shift, np.ones(10))
    np.testing.assert_allclose(found[0], turn, atol=1e-9)
    np.testing.assert_allclose(found[1], shift, atol=1e-9)
    data = 1.2 * model @ turn.T + shift
    data[:4] += rng.normal(size=(4, 3))
    found = agreed(model, data)
    np.testing.assert_allclose(found[0], turn, atol=0.02)
    assert found[2] == pytest.approx(1.2, abs=0.02)


def test_first_poses(moving):
    """Of several frames at once, each as if it were alone; some points of the second one are missing."""
    body, frames, joints = moving
    rows = np.array([body.topology.sites.index(PLUG_IN_GAIT[n]) for n in frames[0]])
    data, seen = np.array([list(frames[k].values()) for k in (70, 40)]), np.ones((2, len(rows)), bool)
    seen[1, ::5], data[1, ::5] = False, np.nan
    turn, at, scale = first_poses(body, rows, data, seen)
    q = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_quat(scalar_first=True).reshape(*turn.shape[:2], 4)
    for k, frame in enumerate((70, 40)):
        found = np.asarray(joint_centres(body, Poses(q[k].astype(np.float32), at[k].astype(np.float32))))
        assert np.linalg.norm(found - joints[frame], axis=-1).mean() < 0.06
    alone = first_poses(body, rows[seen[1]], data[1:][:, seen[1]], seen[1:][:, seen[1]])
    for both, one in zip((turn, at, scale), alone):
        np.testing.assert_allclose(both[1], one[0], atol=1e-9)


def test_newington_hips():
    """By hand for a leg of 0.9 m, spines 0.24 m apart in front, level: 47 mm behind, 98 mm below, 78 mm aside."""
    spines = np.array([[0, 0.12, 0], [0, -0.12, 0], [-0.17, 0.05, 0], [-0.17, -0.05, 0]])
    left, right = newington_hips(spines, 0.9)
    np.testing.assert_allclose(left, [-0.0468, 0.0777, -0.0966], atol=5e-4)
    np.testing.assert_allclose(right, left * [1, -1, 1], atol=1e-12)


def test_harrington_hips():
    """By hand, of the same pelvis: 54 mm behind, 83 mm below, 87 mm aside."""
    spines = np.array([[0, 0.12, 0], [0, -0.12, 0], [-0.17, 0.05, 0], [-0.17, -0.05, 0]])
    left, right = harrington_hips(spines)
    np.testing.assert_allclose(left, [-0.0543, 0.0865, -0.0829], atol=1e-4)
    np.testing.assert_allclose(right, left * [1, -1, 1], atol=1e-12)


def test_derivatives(rng):
    """Of the chain and of the priors, against differences."""
    body = human()
    sites = list(body.topology.sites)
    rows = np.array(
        [sites.index(s) for s in ("l_asis", "r_asis", "l_psis", "r_psis", "l_acromion", "l_lateral_malleolus")]
    )
    chain = Chain(body, rows)
    priors = Priors(chain, body, [sites[r] for r in rows], 0.5)
    x = 0.01 * rng.normal(size=chain.unknowns)
    turn = Rotation.random(body.limb_count, rng=rng).as_matrix()[None]
    root = rng.normal(size=(1, 3))
    n, h = len(rows), 1e-6
    by_pose, by_x = chain.slopes(x, turn)
    for k in rng.permutation(chain.unknowns)[:40]:
        e = h * np.eye(chain.unknowns)[k]
        ahead, behind = (chain.points(chain.sized(x + s * e), turn, root)[:, :n] for s in (1, -1))
        np.testing.assert_allclose(by_x[..., k], (ahead - behind) / (2 * h), atol=1e-6)
        slope = (priors.at(x + e) - priors.at(x - e)) / (2 * h)
        np.testing.assert_allclose(priors.slope(x)[:, k], slope, atol=1e-3)
    small = pose_body(body, body.rest[0], rng.normal(0, 0.5, (len(body.topology.joints), 3)))
    turn = Rotation.from_quat(np.asarray(small.rotation), scalar_first=True).as_matrix()[None]
    by_pose, _ = chain.slopes(x, turn)
    by_turn = chain.angles(turn)[1]
    for k in range(3 * body.limb_count):
        spin = Rotation.from_rotvec(h * np.eye(3 * body.limb_count)[k].reshape(-1, 3)).as_matrix()
        turns = [turn @ spin, turn @ spin.swapaxes(-1, -2)]
        ahead, behind = (chain.points(chain.sized(x), t, root)[:, :n] for t in turns)
        np.testing.assert_allclose(by_pose[..., 3 + k], (ahead - behind) / (2 * h), atol=1e-6)
        ahead, behind = (chain.angles(t)[0] for t in turns)
        np.testing.assert_allclose(by_turn[..., 3 + k], (ahead - behind) / (2 * h), atol=1e-5)
    assert len(named_points(body)[0]) == len(sites) + len(body.topology.centres)
