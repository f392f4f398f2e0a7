"""The stances of the pose library."""

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Float

from voodoo_jax.geometry.rigid import apply
from voodoo_jax.model.body import Body, joint_centres, scaled
from voodoo_jax.model.body_file import human, load_body
from voodoo_jax.model.pose_library import STANCES, in_stance

BODY = scaled(human(), 1.75)


def centre(body: Body, name: str) -> Float[np.ndarray, "3"]:
    return np.asarray(joint_centres(body, body.rest))[body.topology.centres.index(name)]


@pytest.mark.parametrize("stance", STANCES)
def test_joints_hold_together_and_the_feet_stay_down(stance):
    posed = in_stance(BODY, stance)
    assert posed is not None
    t = posed.topology
    parents, children = jnp.array(t.parents), jnp.array(t.children)
    first = apply(posed.rest[parents], posed.parent_anchor.translation)
    second = apply(posed.rest[children], posed.child_anchor.translation)
    np.testing.assert_allclose(first, second, atol=1e-5)
    lowest = float(jnp.min(BODY.rest.translation[:, 2]))
    assert float(jnp.min(posed.rest.translation[:, 2])) == pytest.approx(lowest, abs=1e-5)


def test_arms_go_up_and_out_and_knees_forward():
    left, right, both, stretched, seated = (in_stance(BODY, s) for s in STANCES)
    assert left and right and both and stretched and seated
    head = centre(BODY, "skullbase")[2]
    for body, up, down in ((left, "l", "r"), (right, "r", "l")):
        assert centre(body, f"{up}_radiocarpal")[2] > head > centre(body, f"{down}_radiocarpal")[2]
    assert min(centre(both, f"{s}_radiocarpal")[2] for s in "lr") > head
    for side, sign in (("l", 1), ("r", -1)):  # level with the shoulders
        wrist, shoulder = centre(stretched, f"{side}_radiocarpal"), centre(stretched, f"{side}_shoulder")
        assert abs(wrist[2] - shoulder[2]) < 0.1 and sign * (wrist[1] - shoulder[1]) > 0.4
    knee, hip = centre(seated, "l_knee"), centre(seated, "l_hip")
    assert knee[0] > hip[0] + 0.35 and abs(knee[2] - hip[2]) < 0.1
    assert centre(seated, "l_talocrural")[2] == pytest.approx(centre(BODY, "l_talocrural")[2], abs=0.05)


def test_who_is_no_person_has_none():
    assert all(in_stance(load_body(name), stance) is None for name in ("dog", "arm") for stance in STANCES)
