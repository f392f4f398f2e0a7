"""Tracks in Python: names of other conventions, what is printed, tables."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.exporters.test_tracks_files import make_tracks
from voodoo_jax.config.options import FeatureSettings
from voodoo_jax.kernels.correspondences import ON_BODY
from voodoo_jax.model.body_file import load_body
from voodoo_jax.model.joint_names import LIMB_WORDS, row_of
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.recording import Recording
from voodoo_jax.solve.names import FeatureNames, PartNames

NAMES = {
    "l_radiocarpal": [
        "left_wrist",
        "LWrist",
        "l_wrist",
        "WRIST_LEFT",
        "K4ABT_JOINT_WRIST_LEFT",
        "leftWrist",
        "WristLeft",
    ],
    "r_talocrural": ["right_ankle", "RAnkle", "r_ankle", "ANKLE_RIGHT", "ankle_r", "r.ankle", "JointType_AnkleRight"],
    "l_hip": ["left_hip", "LHip", "HIP_LEFT", "LeftUpLeg", "lhip"],
    "r_shoulder": ["RShoulder", "right shoulder", "mixamorig:RightArm", "shoulder-right"],
    "l_elbow": ["LeftForeArm", "ELBOW_LEFT", "lElbow", "lelbow"],
    "r_knee": ["RKnee", "rightKnee", "RightLeg", "knee_right"],
    "vc7": ["neck", "Neck", "C7", "SpineShoulder", "K4ABT_JOINT_NECK"],
    "skullbase": ["head", "Head", "HEAD", "K4ABT_JOINT_HEAD"],
}


def test_limbs_and_features_under_the_names_of_other_conventions():
    """In settings: which limb a segmentation means, which point of the body a feature is."""
    t = load_body("human").topology
    names = {
        "l_forearm": ["left_forearm", "LForearm", "LeftLowerArm", "lower_arm_l"],
        "r_shank": ["RightLeg", "r_calf"],
        "r_upper_arm": ["RightArm", "right upper arm"],
        "pelvis": ["Hips"],
        "l_thigh": ["LeftUpLeg", "left_femur"],
    }
    for own, others in names.items():
        assert [row_of(t.limbs, other, LIMB_WORDS) for other in others] == [t.limbs.index(own)] * len(others), own
    assert row_of(t.limbs, "tail", LIMB_WORDS) is None
    parts = PartNames(t)
    frame = BodyObservation(0, np.zeros((3, 3), np.float32), np.zeros(3, np.int32), np.zeros((1, 3), np.float32),
                            part=np.array([0, 1, 2], np.int32), parts=("left_forearm", "body", "wing"))  # fmt: skip
    assert parts.rows(frame).tolist() == [t.limbs.index("l_forearm"), ON_BODY, ON_BODY] and parts.unknown == {"wing"}
    features = FeatureNames(t, FeatureSettings(names=("a=left_wrist", "b=WRIST_LEFT|nose_of_nobody", "c=nothing")))
    wrist = len(t.sites) + t.centres.index("l_radiocarpal")
    assert features.look_up("a") == features.look_up("b") == (wrist,) and features.look_up("c") is None


def test_joints_under_the_names_of_other_conventions():
    tracks = make_tracks()
    for own, others in NAMES.items():
        for name in others:
            np.testing.assert_array_equal(tracks.joint(name), tracks.joint(own), err_msg=f"{name} is not {own}")
    np.testing.assert_array_equal(make_tracks("dog").joint("left_elbow"), make_tracks("dog").joint("l_elbow"))


@pytest.mark.parametrize(
    "name, near", [("l_radiocarpl", "l_radiocarpal"), ("left_knie", "did you mean 'left_knee'"), ("", "there are")]
)
def test_unknown_joints_are_refused_with_near_names(name, near):
    with pytest.raises(ValueError, match=near):
        make_tracks().joint(name)


def test_what_is_printed_is_short_and_says_something():
    tracks = replace(make_tracks(), source="<b>.mcap")
    assert repr(tracks).startswith("Tracks(<b>.mcap, 75 frames in 2.47 s, 95 % tracked, residual 1")
    assert len(repr(tracks)) < 200 and "stature 1.830 m" in repr(tracks)
    page = tracks._repr_html_()
    assert "&lt;b&gt;.mcap" in page and "<b>" not in page and "no ground" in page
    assert repr(load_body("dog")) == "Body(dog: 12 limbs, 11 joints, withers_height 0.600 m)"
    printed = []
    jax.jit(lambda body: printed.append(repr(body)))(load_body("dog"))
    assert "being computed" in printed[0]
    recording = Recording("a<b.mcap", "base", np.array([0, 0, 1], np.float32), ("/depth",), ())
    assert repr(recording).startswith("Recording(a<b.mcap: 0 frames") and "a&lt;b" in recording._repr_html_()


def test_a_table_for_pandas():
    tracks = make_tracks()
    table = tracks.to_pandas()
    assert table.index.name == "time_s" and len(table) == 75
    np.testing.assert_allclose(table["l_knee_z_m"], tracks.joint("l_knee")[:, 2])
    assert table["tracked"].sum() == 71 and table["l_knee_flexion_deg"].notna().sum() == 71
