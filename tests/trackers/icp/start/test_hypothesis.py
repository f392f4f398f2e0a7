"""Start hypotheses: rivals that face the other way, and sizes that nobody has."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from tests.support.in_front import in_front
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human, load_body
from voodoo_jax.solve.scan import at_rest
from voodoo_jax.trackers.icp.body_size import unlikely
from voodoo_jax.trackers.icp.start.hypothesis import trial as best_trial
from voodoo_jax.trackers.icp.trials import Trial, opposite

BODY = scaled(human(), 1.75)


def test_opposite_is_the_best_that_faces_away():
    turn = jnp.array([[1.0, 0, 0, 0], [0.9848, 0, 0, 0.1736], [0, 0, 0, 1.0], [0.1736, 0, 0, 0.9848]])
    rest = BODY.rest.rotation
    poses = Poses(jnp.repeat(turn[:, None], len(rest), 1), jnp.zeros((4, len(rest), 3)))
    body = eqx.tree_at(lambda b: b.rest.rotation, BODY, jnp.tile(jnp.array([1.0, 0, 0, 0]), (len(rest), 1)))
    trial = lambda *cost: Trial(at_rest(poses), jnp.array(cost))  # noqa: E731
    assert opposite(body, trial(1.0, 1.01, 1.08, 1.05), 1.1) == [0, 3]
    assert opposite(body, trial(1.0, 1.01, 1.3, 1.2), 1.1) == [0]
    assert opposite(body, trial(1.2, 1.21, 1.1, 1.3), 1.1) == [2, 0]


def test_nobody_is_two_and_a_half_metres_tall(tmp_path):
    """What a start costs tells of the size, too; not where the size is known, nor of a dog."""
    assert [unlikely(scaled(BODY, size)) for size in (1.2, 1.75, 2.0)] == [1, 1, 1]
    assert unlikely(scaled(BODY, 2.1)) == pytest.approx(np.e, rel=1e-3) and unlikely(scaled(BODY, 2.5)) > 100
    assert unlikely(scaled(load_body("dog"), 3.0)) == 1
    _, run = in_front(tmp_path / "log.mcap", BODY, {}, 8)
    giant = scaled(human(), 2.3)
    costs = [best_trial(run, 0, giant).cost]
    run.body = giant  # as if it were known
    costs.append(best_trial(run, 0, giant).cost)
    assert costs[0] == pytest.approx(unlikely(giant) * costs[1], rel=1e-5)
