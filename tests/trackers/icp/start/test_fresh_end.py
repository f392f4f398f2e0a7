"""Where the pass back begins: a start of its own, if that explains more than the track."""

import numpy as np
import pytest

from tests.support.in_front import in_front
from voodoo_jax.model.body import joint_centres, scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.trackers.icp.start.fresh_end import FreshEnd
from voodoo_jax.trackers.icp.trials import facing, place


@pytest.fixture(scope="module")
def standing(tmp_path_factory):
    """A person who stands still, their size known: the truth, and what tracks them."""
    body = scaled(human(), 1.83)
    sim, run = in_front(tmp_path_factory.mktemp("standing") / "log.mcap", body, {}, 36)
    run.body = body
    return sim, run


def test_a_wrong_track_is_left_for_a_fresh_start_that_explains_more(standing, monkeypatch):
    sim, run = standing
    body, people, count, fresh = run.body, run.people, len(run.people), FreshEnd()
    ahead, up = np.eye(3, dtype=np.float32)[::2]
    towards, away = (np.tile(place(body, 0 * up, up, x).rotation, (count, 1, 1)) for x in (-ahead, ahead))
    assert fresh(run, 0, np.full(count, 1e-4), towards) is None  # the track is better
    assert fresh(run, count - 3, np.full(3, 1e-2), towards[:3]) is None  # too few frames to tell
    run.people = [f.only(np.zeros(len(f.points), bool)) for f in people]
    assert fresh(run, 0, np.full(count, 1e-2), towards) is None  # nothing to start from
    run.people = people
    poses = fresh(run, 0, np.full(count, 1e-2), towards)
    assert poses is not None
    error = np.linalg.norm(np.asarray(joint_centres(body, poses)) - sim.joints[-1], axis=-1)
    assert error.mean() < 0.03
    # where front and back cost the same it is the track that knows
    monkeypatch.setattr("voodoo_jax.trackers.icp.start.hypothesis.RIVAL", 1e6)
    for ways in (towards, away):
        found = fresh(run, 0, np.full(count, 1e-2), ways)
        assert found is not None
        assert np.prod(facing(body, np.stack([np.asarray(found.rotation), ways[0]]))[:, 0]) > 0.5
