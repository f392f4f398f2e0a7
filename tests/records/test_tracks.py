"""Tracks in Python: names of other conventions, what is printed, tables."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.exporters.test_tracks_files import make_tracks
from voodoo_jax.model.body_file import load_body
from voodoo_jax.records.recording import Recording

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
    "r_shoulder": ["RShoulder", "right shoulder", "mixamorig:RightArm".split(":")[1], "shoulder-right"],
    "l_elbow": ["LeftForeArm", "ELBOW_LEFT", "lElbow", "lelbow"],
    "r_knee": ["RKnee", "rightKnee", "RightLeg", "knee_right"],
    "vc7": ["neck", "Neck", "C7", "SpineShoulder", "K4ABT_JOINT_NECK"],
    "skullbase": ["head", "Head", "HEAD", "K4ABT_JOINT_HEAD"],
}


def test_joints_under_the_names_of_other_conventions():
    tracks = make_tracks()
    for own, others in NAMES.items():
        for name in others:
            np.testing.assert_array_equal(tracks.joint(name), tracks.joint(own), err_msg=f"{name} is not {own}")
    np.testing.assert_array_equal(make_tracks("dog").joint("left_elbow"), make_tracks("dog").joint("l_elbow"))


@pytest.mark.parametrize(
    "name, near", [("l_radiocarpl", "l_radiocarpal"), ("left_knie", "there are"), ("", "there are")]
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
