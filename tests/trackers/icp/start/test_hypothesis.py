"""Start hypotheses: sizes that nobody has."""

import numpy as np
import pytest

from tests.support.in_front import in_front
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human, load_body
from voodoo_jax.trackers.icp.body_size import rarity
from voodoo_jax.trackers.icp.start.hypothesis import trial as best_trial

BODY = scaled(human(), 1.75)


def test_nobody_is_two_and_a_half_metres_tall(tmp_path):
    """What a start costs tells of the size, too; not where the size is known, nor of a dog."""
    odds = [rarity(scaled(BODY, size)) for size in (1.7, 1.75, 1.2, 2.0, 2.5)]
    assert (
        odds == sorted(odds)
        and odds[0] == pytest.approx(0, abs=1e-9)
        and odds[1] < 0.02
        and odds[2] < 0.25
        and odds[4] > 1
    )
    assert rarity(scaled(load_body("dog"), 3.0)) == 0
    _, run = in_front(tmp_path / "log.mcap", BODY, {}, 8)
    giant = scaled(human(), 2.3)
    costs = [best_trial(run, 0, giant).cost]
    run.body = giant  # as if it were known
    costs.append(best_trial(run, 0, giant).cost)
    assert costs[0] == pytest.approx(np.exp(rarity(giant)) * costs[1], rel=1e-5)
