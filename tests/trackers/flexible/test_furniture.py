"""What is at rest and no part of the flexible body goes."""

import numpy as np
import pytest

from tests.support.beside_a_stool import BODY, COUNT, OF_BODY, frames
from voodoo_jax.trackers.flexible.flexible_body import flexible_body
from voodoo_jax.trackers.flexible.state import Seen
from voodoo_jax.trackers.flexible.tracker import without_furniture


@pytest.mark.parametrize("explained", [0.93, 0.997])
def test_a_stool_goes_if_it_is_unexplained(rng, explained):
    people, rest = frames(rng), np.asarray(flexible_body(BODY, float(BODY.scale)).rest)
    others = {name: np.zeros(COUNT, np.float32) for name in Seen._fields}
    found = Seen(**others | {"x": np.tile(rest, (COUNT, 1, 1)), "explained": np.full(COUNT, explained, np.float32)})
    left = without_furniture(BODY, people, 0, found)
    if explained > 0.99:
        assert left is None
        return
    assert left is not None and len(left) == COUNT
    for before, after in zip(people, left):
        kept = np.isin(before.points[:, 0], after.points[:, 0])
        assert kept[:OF_BODY].mean() > 0.9 and kept[OF_BODY:].mean() < 0.5
