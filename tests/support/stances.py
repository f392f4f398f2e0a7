"""Stances of people, as turns of joints: arms raised, both or one, stretched out; sitting."""

from voodoo_jax.model.pose_library import both

LEFT, RIGHT = both("shoulder", "x", 170.0)
SITTING = (
    *both("hip", "y", -85.0), *both("knee", "y", 85.0), *both("shoulder", "y", -25.0), *both("elbow", "y", -50.0),
)  # fmt: skip
STANCES = ((LEFT,), (RIGHT,), (LEFT, RIGHT), both("shoulder", "x", 90.0), SITTING)
