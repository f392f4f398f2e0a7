"""Changes of the body during tracking: scale, sizes, limbs and held objects (Knoop 2006, sec. IV).

The body contains all parts that appear at any time, and `Body.present` states which are present. So a change is one of
numbers, and compiles nothing.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial.transform import Rotation

from voodoo_jax.config.options import Change, SettingsError
from voodoo_jax.geometry.rigid import Poses, compose, inverse
from voodoo_jax.model.body import Body, scaled, tree_order, with_rest_from_joints
from voodoo_jax.model.body_file import load_body


# 8 parameters: what a held thing is, each by name
def attach(
    body: Body,
    thing: Body,
    limb: str,
    at: Sequence[float] = (0.0, 0.0, 0.0),
    grip: Sequence[float] = (0.0, 0.0, 0.0),
    axis: Sequence[float] = (0.0, 0.0, 1.0),
    joint_axes: Sequence[float] = (0.0, 0.0),
    weight: float = 1.0,
) -> Body:
    """The body with a thing (a body of its own) on one of its limbs by a new joint `<thing's root>_grip`.

    **Arguments:** `limb` of the body that carries it; `at` the joint in that limb's frame; `grip` the joint in the
    frame of the thing's first limb; `axis` where that limb's z axis points at first, in the carrying limb's frame;
    `joint_axes`, `weight` as of any joint (2007, sec. 4.2). Metres. Held things do not follow the body's `scale`.

    Raises ValueError where the limb is unknown or a name occurs twice.
    """
    b, t, n = body.topology, thing.topology, body.limb_count
    if limb not in b.limbs:
        raise ValueError(f"'{body.name}' has no limb '{limb}' to hold an object: it has {', '.join(b.limbs)}")
    for kind in ("limbs", "joints", "centres", "sites"):
        twice = sorted(set(getattr(b, kind)) & set(getattr(t, kind)))
        if twice:
            raise ValueError(f"both '{body.name}' and '{thing.name}' have {kind} named {', '.join(twice)}")
    carrier = b.limbs.index(limb)
    anchor = Poses(_turn_to(axis), jnp.asarray(at, jnp.float32))
    held = Poses(jnp.array([1.0, 0, 0, 0]), jnp.asarray(grip, jnp.float32))
    root = compose(compose(body.rest[carrier], anchor), inverse(held))
    rest = compose(root[None], compose(inverse(thing.rest[:1]), thing.rest))
    joint = {
        "parent_anchor": anchor[None], "child_anchor": held[None], "axes": jnp.asarray([joint_axes]),
        "weights": jnp.asarray([weight]), "limits": jnp.full((1, 3, 2), jnp.inf) * jnp.array([-1.0, 1.0]),
    }  # fmt: skip
    parts = {name: [getattr(body, name), own, getattr(thing, name)] for name, own in joint.items()}
    parts |= {name: [getattr(body, name), getattr(thing, name)] for name in ("sizes", "centres", "sites", "presence")}
    topology = b._replace(
        limbs=b.limbs + t.limbs,
        joints=(*b.joints, f"{t.limbs[0]}_grip", *t.joints),
        parents=(*b.parents, carrier, *(p + n for p in t.parents)),
        children=(*b.children, n, *(c + n for c in t.children)),
        centres=b.centres + t.centres,
        centre_limbs=b.centre_limbs + tuple(i + n for i in t.centre_limbs),
        sites=b.sites + t.sites,
        site_limbs=b.site_limbs + tuple(i + n for i in t.site_limbs),
        held=b.held + tuple(range(n, n + thing.limb_count)),
    )
    more = lambda a, *others: jnp.concatenate([a, *(jnp.asarray(o, a.dtype) for o in others)])  # noqa: E731
    arrays = {name: jax.tree.map(more, *some) for name, some in parts.items()}
    return replace(body, rest=jax.tree.map(more, body.rest, rest), topology=topology, **arrays)


def _turn_to(axis: Sequence[float]):
    """The smallest rotation that takes z to `axis`."""
    z = np.asarray(axis, float)
    if not np.linalg.norm(z) > 1e-9:
        raise ValueError("the axis of a held object must not be zero")
    turn = Rotation.align_vectors([z / np.linalg.norm(z)], [[0.0, 0.0, 1.0]])[0]
    return jnp.asarray(turn.as_quat(scalar_first=True), jnp.float32)


def with_limbs(body: Body, names: Sequence[str], present: bool) -> Body:
    """The body with limbs present or absent, and with them their descendants; held things only by name. Raises
    ValueError for an unknown limb, the root, and a limb whose parent is absent."""
    t = body.topology
    unknown = sorted(set(names) - set(t.limbs))
    if unknown:
        raise ValueError(f"'{body.name}' has no limb '{unknown[0]}': it has {', '.join(t.limbs)}")
    chosen = {t.limbs.index(name) for name in names}
    if 0 in chosen and not present:
        raise ValueError(f"'{t.limbs[0]}' is the root of '{body.name}' and cannot be removed")
    hanging = [(p, c) for p, c in zip(t.parents, t.children) if not (present and c in t.held)]
    while more := {c for p, c in hanging if p in chosen} - chosen:
        chosen |= more
    for p, c in zip(t.parents, t.children):
        if present and c in chosen and p not in chosen and not body.present[p]:
            raise ValueError(f"'{t.limbs[c]}' is attached to '{t.limbs[p]}', which is missing: add that first")
    rows = jnp.array(sorted(chosen), int)
    return eqx.tree_at(lambda b: b.presence, body, body.presence.at[rows].set(float(present)))


def hung_on(body: Body, poses: Poses, limbs: Sequence[int]) -> Poses:
    """Poses with some limbs moved to their places on the parents in the rest pose, in the order of the tree."""
    t = body.topology
    for j in tree_order(t):
        limb = t.children[j]
        if limb not in limbs:
            continue
        own = compose(compose(poses[t.parents[j]], body.parent_anchor[j]), inverse(body.child_anchor[j]))
        rotation, translation = jnp.asarray(poses.rotation), jnp.asarray(poses.translation)
        poses = Poses(rotation.at[limb].set(own.rotation), translation.at[limb].set(own.translation))
    return poses


def loaded(changes: Sequence[Change]) -> tuple[Change, ...]:
    """The changes in order of time, with the things' body files read. Raises BodyFileError, SettingsError."""
    out = []
    for change in sorted(changes, key=lambda c: c.time):
        if change.to and not change.add:
            raise SettingsError(
                f"change at {change.time:g} s: 'to' names a limb to carry an object, but 'add' is missing"
            )
        out.append(replace(change, add=load_body(change.add)) if change.to and isinstance(change.add, str) else change)
    return tuple(out)


def prepared(body: Body, changes: Sequence[Change]) -> Body:
    """The body with all things that are ever attached, absent at first. Raises SettingsError for impossible changes."""
    held: dict[str, tuple] = {}  # how each thing is held
    for change in changes:
        thing = change.add
        if not isinstance(thing, Body):
            continue
        name, grip = thing.topology.limbs[0], (change.to, change.at, change.grip, change.joint_axes, change.weight)
        if held.setdefault(name, grip) != grip:
            raise SettingsError(
                f"change at {change.time:g} s: '{name}' was held differently before: an object that changes hands "
                "needs a body file for each hand, with other names"
            )
        if f"{name}_grip" not in body.topology.joints:
            with _naming(change):
                axis = change.axis or (0.0, 0.0, 1.0)
                body = attach(body, thing, change.to, change.at, change.grip, axis, change.joint_axes, change.weight)
                body = with_limbs(body, thing.topology.limbs, False)
    after = body
    for change in changes:
        after = applied(after, change)  # what cannot be done raises at the beginning
    return body


def applied(body: Body, change: Change) -> Body:
    """The body after a change. Raises SettingsError."""
    t = body.topology
    with _naming(change):
        if change.scale > 0:
            body = scaled(body, jnp.asarray(change.scale, jnp.float32))
        for limb, sizes in change.sizes:
            if limb not in t.limbs:
                raise ValueError(f"'{body.name}' has no limb '{limb}': it has {', '.join(t.limbs)}")
            body = resized(body, t.limbs.index(limb), jnp.asarray(sizes, jnp.float32))
        if change.remove:
            body = with_limbs(body, change.remove, False)
        if change.add:
            limbs = change.add.topology.limbs if isinstance(change.add, Body) else (change.add,)
            body = with_limbs(body, limbs, True)
    return body


@contextmanager
def _naming(change: Change) -> Iterator[None]:
    try:
        yield
    except ValueError as problem:
        raise SettingsError(f"change at {change.time:g} s: {problem}") from problem


def appeared(before: Body, after: Body) -> list[int]:
    """Limbs that are present now and were not before."""
    return np.flatnonzero(np.asarray(after.present) & ~np.asarray(before.present)).tolist()


def pointing(body: Body, joint: int, axis: Sequence[float]) -> Body:
    """The body with the z axis of one joint's frame on the parent turned towards `axis` (parent's limb frame)."""
    turned = jnp.asarray(body.parent_anchor.rotation).at[joint].set(_turn_to(axis))
    return eqx.tree_at(lambda b: b.parent_anchor.rotation, body, turned)


def directions(count: int) -> list[tuple[float, float, float]]:
    """Directions spread evenly over the sphere (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z * z)
    return list(zip((r * np.cos(turn)).tolist(), (r * np.sin(turn)).tolist(), z.tolist()))


def resized(body: Body, limb: int, sizes: Float[Array, "5"]) -> Body:
    """The body with other sizes of one limb; points on it follow length and thickness, the rest pose the joints."""
    t = body.topology
    old = body.sizes[limb]
    wide = jnp.sqrt((sizes[0] + sizes[2]) / (old[0] + old[2]) * (sizes[1] + sizes[3]) / (old[1] + old[3]))
    factor = jnp.array([1.0, 1.0, 0.0]) * wide + jnp.array([0.0, 0.0, 1.0]) * (sizes[4] / old[4])
    points = lambda b: (b.parent_anchor.translation, b.child_anchor.translation, b.centres, b.sites)  # noqa: E731
    mine = [jnp.array(of, int)[:, None] == limb for of in (t.parents, t.children, t.centre_limbs, t.site_limbs)]
    new = eqx.tree_at(lambda b: b.sizes, body, body.sizes.at[limb].set(sizes))
    new = eqx.tree_at(points, new, [jnp.where(on, at * factor, at) for on, at in zip(mine, points(body))])
    return with_rest_from_joints(new)
