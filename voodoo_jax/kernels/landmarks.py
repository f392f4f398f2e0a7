"""Named features: lines of sight through a point of the body, and measured places of such points (Knoop 2007, 5.2).

A place is a line without direction, so that both are one formula: the measured point is the closest one on the line.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from voodoo_jax.geometry.rigid import Poses, rotate, unrotate
from voodoo_jax.geometry.robust import geman_mcclure
from voodoo_jax.model.body import Body


class Features(eqx.Module):
    """One frame's named features (or a batch of frames), padded. A padded entry has weight zero.

    A feature that may be one of several points of the body (a patch of skin: face or hand) is taken for the one that is
    nearest to it in each step.
    """

    point: Int[Array, "*frame feature choice"]  # rows of `named_points`
    origin: Float[Array, "*frame feature 3"]  # a point of the line, or the measured place; world frame, metres
    direction: Float[Array, "*frame feature 3"]  # unit vector of the line; zero: a place
    weight: Float[Array, "*frame feature"]


class FeatureOptions(eqx.Module):
    """Wrong detections happen: one must not throw a limb off."""

    robust_scale: Float[Array, ""]  # metres
    max_distance: Float[Array, ""]  # metres


def named_points(body: Body) -> tuple[Int[Array, " name"], Float[Array, "name 3"]]:
    """Limb and place in the limb frame (metres) of every feature point, then of every joint centre of the body."""
    limbs = jnp.array((*body.topology.site_limbs, *body.topology.centre_limbs), int)
    return limbs, jnp.concatenate([body.sites, body.centres])


class FeatureSums(eqx.Module):
    """What the features add to the limbs' problems."""

    moments: Float[Array, "limb 4 4"]  # sum of w [1, c] [1, p]^T, limb frame
    normals: Float[Array, "limb 6 6"]  # Gauss-Newton: only what is across the line counts
    rhs: Float[Array, "limb 6"]
    squares: Float[Array, ""]  # weighted sum of squared distances, square metres
    weight: Float[Array, " limb"]


class SettledFeatures(eqx.Module):
    """Which point of the body each feature is taken for, a row of named_points, and whether it is near enough."""

    point: Int[Array, " feature"]
    kept: Bool[Array, " feature"]


def _gaps(poses: Poses, limb, place, features: Features) -> Float[Array, "feature 3"]:
    """From each feature's point of the body to its line or place, metres."""
    world = rotate(poses.rotation[limb], place) + poses.translation[limb]
    d = features.direction
    along = jnp.sum(d * (world - features.origin), -1, keepdims=True)
    return features.origin + d * along - world


def _nearest_points(body: Body, poses: Poses, features: Features) -> Int[Array, " feature"]:
    """Which of the points that it may be each feature is taken for: the nearest one."""
    limbs, places = named_points(body)
    if features.point.shape[1] == 1:
        return features.point[:, 0]
    gaps = jax.vmap(lambda p: _gaps(poses, limbs[p], places[p], features), 1, 1)(features.point)
    away = jnp.where(body.present[limbs[features.point]], jnp.sum(gaps * gaps, -1), jnp.inf)
    nearest = jnp.argmin(away, 1)
    return jnp.sum(jnp.where(jnp.arange(features.point.shape[1]) == nearest[:, None], features.point, 0), 1)


def settled_features(body: Body, poses: Poses, features: Features, options: FeatureOptions) -> SettledFeatures:
    """The choices in feature_sums."""
    limbs, places = named_points(body)
    point = _nearest_points(body, poses, features)
    gap = _gaps(poses, limbs[point], places[point], features)
    return SettledFeatures(point, (jnp.sum(gap * gap, -1) <= options.max_distance**2) & body.present[limbs[point]])


def feature_sums(
    body: Body, poses: Poses, features: Features, options: FeatureOptions, fixed: SettledFeatures | None = None
) -> FeatureSums:
    """Pairs of all features with their points of the body, robustly weighted, summed per limb; `fixed` choices that are
    settled."""
    limbs, places = named_points(body)
    point = _nearest_points(body, poses, features) if fixed is None else fixed.point
    limb, c, d = limbs[point], places[point], features.direction
    pose = poses[limb]
    gap = _gaps(poses, limb, c, features)
    e2 = jnp.sum(gap * gap, -1)
    robust = geman_mcclure(e2, options.robust_scale)
    kept = (e2 <= options.max_distance**2) & body.present[limb] if fixed is None else fixed.kept
    w = jnp.where(kept, robust * features.weight, 0.0)

    gap_limb, d_limb = unrotate(pose.rotation, gap), unrotate(pose.rotation, d)

    def one(w, c, gap, d):
        x, y, z = c
        # derivative of the point by the limb's twist (turn, shift), across the line
        jacobian = jnp.array([[0, z, -y, 1, 0, 0], [-z, 0, x, 0, 1, 0], [y, -x, 0, 0, 0, 1]])
        across = jacobian - d[:, None] * jnp.sum(d[:, None] * jacobian, 0)
        normal = w * jnp.sum(across[:, :, None] * across[:, None, :], 0)
        ones = jnp.ones(1, c.dtype)
        moment = w * jnp.concatenate([ones, c])[:, None] * jnp.concatenate([ones, c + gap])[None]
        return moment, normal, w * jnp.sum(across * gap[:, None], 0)

    moment, normal, rhs = jax.vmap(one)(w, c, gap_limb, d_limb)
    add = lambda values: jnp.zeros((body.limb_count, *values.shape[1:]), values.dtype).at[limb].add(values)  # noqa: E731
    return FeatureSums(add(moment), add(normal), add(rhs), jnp.sum(w * e2), add(w))
