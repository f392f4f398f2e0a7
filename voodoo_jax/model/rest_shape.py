"""Box and height of a body in its rest pose. Host side."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from voodoo_jax.model.body import Body


def rest_box(body: Body) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Lowest and highest coordinates of all limbs' end ellipses in the rest pose, metres."""
    turn = Rotation.from_quat(np.asarray(body.rest.rotation), scalar_first=True).as_matrix()
    sizes = np.asarray(body.sizes, np.float64)
    bottom = np.asarray(body.rest.translation, np.float64)
    ends = np.stack([bottom, bottom + sizes[:, 4:] * turn[:, :, 2]])
    reach = np.stack(
        [np.hypot(sizes[:, k, None] * turn[:, :, 0], sizes[:, k + 1, None] * turn[:, :, 1]) for k in (0, 2)]
    )
    return np.min(ends - reach, (0, 1)), np.max(ends + reach, (0, 1))


def rest_height(body: Body) -> float:
    """Height of the body above the floor in its rest pose, metres: its stature, or the top of its highest limb."""
    return float(body.scale) if body.scale_name == "stature" else float(rest_box(body)[1][2])
