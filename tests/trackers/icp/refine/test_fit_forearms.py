"""Forearms as long as the wrists of a recording say."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from tests.support.segments import tracked_segment
from voodoo_jax.config.options import FeatureSettings, Settings
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.model.body import scaled, segment_lengths, with_proportions
from voodoo_jax.model.body_file import human, load_body
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.recording import Rays
from voodoo_jax.records.segment import Segment
from voodoo_jax.records.tracks import Status
from voodoo_jax.solve.names import FeatureNames
from voodoo_jax.trackers.icp.refine.fit_forearms import FitForearms, Stretch, stretch

BODY = scaled(human(), 1.8)
NAMES = FeatureNames(BODY.topology, FeatureSettings())
COUNT = 40
STAGE = FitForearms()
BY_POINTS, BY_NAMES, HAND, FARTHEST, FEW = STAGE.by_points, STAGE.by_names, STAGE.hand, STAGE.farthest, STAGE.few


def tracked(body=BODY, off: float = 0.0) -> Segment:
    """The rest pose, hands moved along the forearms by `off` metres: the forearms hang straight down."""
    place = np.array(body.rest.translation)
    for hand in (body.topology.limbs.index(f"{side}_hand") for side in "lr" if f"{side}_hand" in body.topology.limbs):
        place[hand, 2] -= off
    return tracked_segment(Poses(*(np.tile(x, (COUNT, 1, 1)) for x in (np.array(body.rest.rotation), place))))


def people(*named: str) -> list[BodyObservation]:
    """Frames in which a detector names these points."""
    flat = np.zeros((len(named), 3), np.float32)
    rays = Rays(named, flat, flat + 1) if named else Rays()
    none = np.zeros((0, 3), np.float32)
    return [BodyObservation(k, none, np.zeros(0, int), none, rays) for k in range(COUNT)]


@pytest.mark.parametrize("off", [-0.01, 0.0, 0.02])
def test_the_gap_is_how_far_the_hand_is_off(off):
    found = stretch(BODY, people(), NAMES, tracked(off=off))
    assert found is not None and found.named == 0.0 and found.count == 2 * COUNT
    assert found.gap == pytest.approx(off / 1.8, abs=1e-6)


def test_what_does_not_count():
    """Hands that nothing was seen of, lost frames, detections that may be the face, other limbs' detections."""
    seen = tracked(off=0.02)
    seen.translation[:10, BODY.topology.limbs.index("l_hand")] += 1.0
    seen.limb_weight[:10, BODY.topology.limbs.index("l_hand")] = 0.0
    seen.translation[30:] += np.linspace(0, 1, BODY.limb_count)[:, None]
    seen.status[30:] = Status.LOST
    found = stretch(BODY, people("left_hand", "skin", "face"), NAMES, seen)
    assert found is not None and found.gap == pytest.approx(0.02 / 1.8, abs=1e-6)
    assert found.count == 50 and found.named == pytest.approx(20 / 50)
    seen.status[:] = Status.LOST
    assert stretch(BODY, people(), NAMES, seen) is None
    assert STAGE.fitted(BODY, people(), NAMES, seen) is BODY


def test_detections_stretch_more():
    usual, many = HAND * BY_POINTS, 10**6
    assert STAGE.lengthened(Stretch(usual, 0.0, many)) == pytest.approx(0.0, abs=1e-6)
    one = 0.005  # of the stature
    assert STAGE.lengthened(Stretch((HAND + one) * BY_POINTS, 0.0, many)) == pytest.approx(one, rel=1e-3)
    assert STAGE.lengthened(Stretch((HAND + one) * (BY_POINTS + BY_NAMES), 1.0, many)) == pytest.approx(one, rel=1e-3)
    assert STAGE.lengthened(Stretch((HAND + one) * BY_POINTS, 0.0, FEW)) == pytest.approx(one / 2, rel=1e-3)
    assert STAGE.lengthened(Stretch(0.1, 0.0, many)) == pytest.approx(FARTHEST, rel=1e-3)
    assert STAGE.lengthened(Stretch(-0.1, 1.0, many)) == pytest.approx(-FARTHEST, rel=1e-3)


def test_only_forearms_change():
    seen = tracked(off=0.0028)
    longer = STAGE.lengthened(stretch(BODY, people(), NAMES, seen) or Stretch(0, 0, 0))
    assert longer > 0.005
    found = segment_lengths(STAGE.fitted(BODY, people(), NAMES, seen))
    usual = segment_lengths(BODY)
    top, bottom = (float(BODY.sizes[BODY.topology.limbs.index("l_forearm"), 4]), usual["forearm"])
    # the joints are not quite at the limb's ends
    assert found["forearm"] - usual["forearm"] == pytest.approx(1.8 * longer * bottom / top, rel=0.02)
    assert {k: v for k, v in found.items() if k != "forearm"} == pytest.approx(
        {k: v for k, v in usual.items() if k != "forearm"}, rel=1e-5
    )


@pytest.mark.parametrize("other", [with_proportions(BODY, {"l_thigh": 1.05}), load_body("human10"), load_body("dog")],
                         ids=["fitted", "human10", "dog"])  # fmt: skip
def test_other_bodies_stay(other):
    assert STAGE.fitted(other, people(), FeatureNames(other.topology, FeatureSettings()), tracked(other, 0.02)) is other


def test_tracks_say_what_they_found():
    """The demo with and without: poses are the same, wrists and forearms are not; one pass leaves the body alone."""
    from voodoo_jax.detect.pipeline import find_body
    from voodoo_jax.io.log_reader import open_log
    from voodoo_jax.trackers.base import LogInfo, Task
    from voodoo_jax.trackers.of_points import track_person

    source = open_log(str(files("voodoo_jax") / "data" / "demo.mcap"))
    frames = [frame for frame, _ in zip(source.frames(), range(40))]
    settings = Settings()
    scene, found = find_body(frames, source.up, human(), settings)
    lengths = {}
    for name, skip in (("on", ()), ("off", ("fit_forearms",)), ("one pass", ("looks_ahead",))):
        how = replace(settings, track=replace(settings.track, skip=skip))
        tracks = track_person(Task(human(), LogInfo("demo", "base"), how), scene, found)
        lengths[name] = segment_lengths(tracks.body)["forearm"], tracks
    usual = segment_lengths(scaled(human(), float(lengths["off"][1].body.scale)))["forearm"]
    assert lengths["off"][0] == pytest.approx(usual, rel=1e-4) == lengths["one pass"][0]
    assert abs(lengths["on"][0] - usual) > 0.001
    on, off = lengths["on"][1], lengths["off"][1]
    np.testing.assert_array_equal(on.rotation, off.rotation)
    wrist = on.body.topology.centres.index("l_radiocarpal")
    moved = np.linalg.norm(on.joints - off.joints, axis=2).max(0)
    assert moved[wrist] > 0.001 and moved[on.body.topology.centres.index("l_elbow")] < 1e-3
