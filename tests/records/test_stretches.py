"""Stretches of frames against a walk through them."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from voodoo_jax.records.stretches import stretches


@given(st.lists(st.tuples(st.booleans(), st.booleans()), max_size=12))
def test_each_run_is_one_stretch(frames):
    there, breaks = (np.array([f[k] for f in frames], bool) for k in range(2))
    walked = []
    for k, (here, new) in enumerate(frames):
        if here and (new or k == 0 or not there[k - 1]):
            walked.append((k, k + 1))
        elif here:
            walked[-1] = (walked[-1][0], k + 1)
    assert stretches(there, breaks) == walked
    assert stretches(there) == stretches(there, np.zeros(len(there), bool))
