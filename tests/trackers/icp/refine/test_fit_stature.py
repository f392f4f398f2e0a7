"""A person is as tall as frames from all of the recording tell."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.in_front import in_front
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.trackers.icp.initialise import begin
from voodoo_jax.trackers.icp.refine.fit_stature import FitStature
from voodoo_jax.trackers.icp.segment import forwards
from voodoo_jax.trackers.icp.sequence import track_whole

BODY = scaled(human(), 1.8)


@pytest.mark.parametrize("wrong", [0.93, 0.96, 1.0])
def test_frames_tell_how_much_larger_the_person_is(tmp_path, wrong):
    """Of a body that is too small, or right, which was tracked as it is."""
    _, run = in_front(tmp_path / "log.mcap", BODY, {"l_shoulder": np.tile([-1.2, 0.0, 0.0], (12, 1))}, 12)
    run.body = scaled(human(), 1.8 * wrong)
    run.sized = True
    segment = forwards(run, begin(run, 0).poses, 0, 12)
    found, gain = FitStature().cheapest(run, segment, np.arange(0, 12, 2))
    assert gain >= 0
    # poses that were found in a wrong size hold back a part
    assert -0.6 * np.log(wrong) - 0.01 < found < -1.1 * np.log(wrong) + 0.01


def test_a_size_that_is_given_or_right_stays(tmp_path, monkeypatch):
    _, run = in_front(tmp_path / "log.mcap", BODY, {}, 12)
    run.body, run.sized = BODY, True
    whole = track_whole(run, 0, 0, np.ones(12, bool), ())
    assert FitStature()(whole) is whole  # as large as it is
    monkeypatch.setattr(FitStature, "larger_by", lambda *_: 0.1)
    larger = FitStature(passes=1)(replace(whole, notes=("of a stage before",)))
    assert larger.notes == ("of a stage before",)
    assert float(larger.run.body.scale) == pytest.approx(1.8 * np.exp(0.1), rel=1e-5) and larger.run.known
    assert FitStature()(larger) is larger  # not again
    assert float(larger.run.anew(run.people).body.scale) == float(larger.run.body.scale)
    run.settings = replace(run.settings, start=replace(run.settings.start, scale=1.8))
    assert FitStature()(whole) is whole
