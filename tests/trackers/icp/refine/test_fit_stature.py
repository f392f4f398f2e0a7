"""A person is as tall as frames from all of the recording tell."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.in_front import in_front
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.trackers.icp.body_size import sized
from voodoo_jax.trackers.icp.initialise import begin
from voodoo_jax.trackers.icp.refine import fit_stature
from voodoo_jax.trackers.icp.refine.fit_stature import FitStature, standing_height
from voodoo_jax.trackers.icp.segment import forwards
from voodoo_jax.trackers.icp.sequence import track_whole

BODY = scaled(human(), 1.8)


@pytest.mark.parametrize(
    ("bent", "raised", "arm", "known"),
    [(6, 0.0, 0.0, True), (12, 0.0, 0.0, False), (6, 0.3, 0.0, False), (6, 0.0, 2.8, False)],
)
def test_the_top_tells_the_stature_where_the_body_stands_on_its_feet(tmp_path, bent, raised, arm, known):
    """Bent in the first frames; not where it is bent in all, or is in the air or raises an arm where it is not."""
    bow, lifted = np.zeros((12, 3)), np.tile([arm, 0.0, 0.0], (12, 1))
    bow[:bent, 1] = 0.9
    _, run = in_front(tmp_path / "log.mcap", BODY, {"waist": bow, "l_shoulder": lifted}, 12)
    up = run.scene.floor.normal
    run.people = [
        frame if k < bent else replace(frame, points=frame.points + np.float32(raised) * up)
        for k, frame in enumerate(run.people)
    ]
    size = float(sized(BODY, run.people[bent:] or run.people, run.scene.floor, run.settings.start).scale) - raised
    run.body, run.sized = scaled(BODY, size), True
    segment = forwards(run, begin(run, 0).poses, 0, 12)
    found = standing_height(run, segment)
    if known:
        assert found == pytest.approx(size, rel=0.02)
    else:
        assert np.isnan(found)
    run.scene = replace(run.scene, floor_seen=False)
    assert np.isnan(standing_height(run, segment))


def test_a_size_that_is_given_or_right_stays(tmp_path, monkeypatch):
    _, run = in_front(tmp_path / "log.mcap", BODY, {}, 12)
    run.body, run.sized = sized(BODY, run.people, run.scene.floor, run.settings.start), True
    size = float(run.body.scale)
    whole = track_whole(run, 0, 0, np.ones(12, bool), ())
    assert FitStature()(whole) is whole  # as large as it is
    monkeypatch.setattr(fit_stature, "standing_height", lambda *_: float("nan"))
    assert FitStature()(whole) is whole  # it never stands
    monkeypatch.setattr(fit_stature, "standing_height", lambda *_: size * np.exp(0.1))
    larger = FitStature(passes=1)(replace(whole, notes=("of a stage before",)))
    assert larger.notes == ("of a stage before",)
    assert float(larger.run.body.scale) == pytest.approx(size * np.exp(0.1), rel=1e-5) and larger.run.known
    assert FitStature()(larger) is larger  # not again
    assert float(larger.run.anew(run.people).body.scale) == float(larger.run.body.scale)
    run.settings = replace(run.settings, start=replace(run.settings.start, scale=1.8))
    assert FitStature()(whole) is whole
