"""Free parameters of a fit: names, the unconstrained vector, priors, and the changes to body and options.

The zero vector is the start body. Lengths, radii, weights and settings are logarithms of factors, so that they stay
positive; joints move by shares of the body's scale. Priors are normal, centred at the start; those of a person's
lengths are centred at the usual lengths of people of that stature, for any start.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Float64

from voodoo_jax.geometry.rigid import matrix, on_device, on_host, quat_exp, rotate, unrotate
from voodoo_jax.kernels.correspondences import Points
from voodoo_jax.model.body import Body, Topology, scaled, with_proportions, with_rest_from_joints, without_side
from voodoo_jax.model.marker_sets import V1_NAMES
from voodoo_jax.solve.pulls import IcpOptions
from voodoo_jax.solve.scan import TrackOptions

# Standard deviations of the priors. Adults of one stature differ by 4 to 5 % in the length of a limb (ANSUR II:
# standard deviation of a segment after regression on stature over its mean), by 12 to 15 % in girth; a joint of a body
# of cylinders lies within 1.5 cm (1 % of stature) of a person's. Scale is common to all lengths; height is held in
# addition. Bands and settings belong to this method: a factor of two either way is usual.
PRIORS = {
    "shape": 1.0, "scale": 0.02, "lengths": 0.045, "radii": 0.13, "anchors": 0.009, "bands.weight": 0.7,
    "bands.axes": 0.3, "solve": 0.5, "features": 0.7, "track": 0.5,
    "sensors.weight": 0.7, "sensors.shift": 0.03, "sensors.turn": 0.035,
}  # fmt: skip
# Error of fitted sizes because people are not cylinders, share of the priors' deviations (2.5 % of a length: fits of
# rendered people from correct bodies moved by 0.5 to 4 %, see experiments/fit): smaller changes are not significant.
SYSTEMATIC = 0.55
HEIGHT = 0.005  # logarithm: before a fit the height is measured on the standing person to half a percent
WORDS = {  # words of users -> patterns of names; "segments": see segment_limbs
    "shape": ("scale", "shape.*"),
    "scale": ("scale",),
    "lengths": ("lengths.*",),
    "radii": ("radii.*",),
    "joint centres": ("anchors.*",),
    "anchors": ("anchors.*",),
    "bands": ("bands.*",),
    # not solve.prior: a fit predicts frames at their tracked poses, so it would grow without limit
    "measurement weights": ("features.*.weight", "solve.ratio"),
}
# of SolveSettings and of TrackSettings
SETTINGS = ("ratio", "floor", "prior", "robust_scale", "prior_radius", "steady", "steady_distance", "limits")
TRACK = ("damping", "still_speed", "hidden_weight")
# of each sensor: weight of its measurements, and its place, in axes of the fixed frame. It turns about the centre of
# its points: turning about the sensor by 2 degrees moves them by 10 cm, and searches hardly find the opposite shift
SENSOR = ("weight", "x", "y", "z", "turn_x", "turn_y", "turn_z")


Entry = tuple[str, int, tuple[int, ...], float, str]


class Changes(NamedTuple):
    """A parameter vector by quantity; all zero: no change."""

    scale: Float[Array, ""]  # logarithm
    lengths: Float[Array, " limb"]  # logarithms
    radii: Float[Array, "limb 2"]  # logarithms, bottom and top
    anchors: Float[Array, "joint 3"]  # x, y, z of the body frame at rest, shares of the scale
    weights: Float[Array, " joint"]  # logarithms
    axes: Float[Array, "joint 2"]  # logarithms
    settings: Float[Array, " setting"]  # logarithms
    features: Float[Array, " feature"]  # logarithms
    track: Float[Array, " setting"]  # logarithms
    sensors: Float[Array, "sensor 7"]  # see SENSOR: logarithm, metres, radians


Maps = tuple[Float[np.ndarray | Array, "..."], ...]  # of the fields of Changes: [*field, free]


@dataclass(frozen=True)
class Parameters:
    """The free parameters of a fit: one row per entry of the unconstrained vector."""

    names: tuple[str, ...]
    sd: Float64[np.ndarray, " free"]  # of the prior
    maps: Maps
    mirrored: bool

    def changes(self, x: Float[Array, " free"]) -> Changes:
        """The changes of a parameter vector."""
        return changes_at(self.maps, x)


def changes_at(maps: Maps, x: Float[Array, " free"]) -> Changes:
    """The changes of a parameter vector."""
    return Changes(*(jnp.sum(jnp.asarray(m, x.dtype) * x, -1) for m in maps))


def _list_modes(body: Body, known: list[Entry]) -> dict[str, list[Entry]]:
    """The entries that each mode of a body changes, with the amount in place of the sign."""
    found = {}
    for mode in body.modes:
        changes = dict(mode.changes)
        entries = [(e, changes.get(e[0], changes.get(_remove_side(e[0])))) for e in known]
        found[f"shape.{mode.name}"] = [(n, part, i, sign * by, "shape") for (n, part, i, sign, _), by in entries if by]
    return found


def _list_entries(
    topology: Topology, features: tuple[str, ...], axes: Bool[np.ndarray, "joint 2"], sensors: int = 0
) -> list[Entry]:
    """Name, field of Changes, index in it, sign under mirroring, and key of the prior, for every possible parameter;
    `axes` which axes joints have."""
    t = topology
    out: list[Entry] = [("scale", 0, (), 1.0, "scale")]
    for i, limb in enumerate(t.limbs):
        if i in t.held:
            continue
        out.append((f"lengths.{limb}", 1, (i,), 1.0, "lengths"))
        out += [(f"radii.{limb}.{end}", 2, (i, k), 1.0, "radii") for k, end in enumerate(("bottom", "top"))]
    for j, joint in enumerate(t.joints):
        for k, axis in enumerate("xyz"):
            sign = -1.0 if axis == "y" and joint.startswith("r_") else 1.0
            out.append((f"anchors.{joint}.{axis}", 3, (j, k), sign, "anchors"))
        out.append((f"bands.{joint}.weight", 4, (j,), 1.0, "bands.weight"))
        out += [
            (f"bands.{joint}.axes.{axis}", 5, (j, k), 1.0, "bands.axes") for k, axis in enumerate("xy") if axes[j, k]
        ]
    out += [(f"solve.{name}", 6, (k,), 1.0, "solve") for k, name in enumerate(SETTINGS)]
    out += [(f"features.{name}.weight", 7, (k,), 1.0, "features") for k, name in enumerate(features)]
    out += [(f"track.{name}", 8, (k,), 1.0, "track") for k, name in enumerate(TRACK)]
    kinds = ("weight", *["shift"] * 3, *["turn"] * 3)
    out += [
        (f"sensors.{sensor}.{name}", 9, (sensor, k), 1.0, f"sensors.{kinds[k]}")
        for sensor in range(sensors)
        for k, name in enumerate(SENSOR)
    ]
    return out


def parameters(
    body: Body,
    free: tuple[str, ...] | list[str],
    features: tuple[str, ...] = (),
    mirrored: bool = True,
    sensors: int = 0,
) -> Parameters:
    """The parameters named by words (see WORDS) and patterns such as "lengths.*thigh".

    **Arguments:** `features` names of the measured features; `mirrored` left and right share one parameter, whose name
    has no side. Raises ValueError for a pattern without a match.
    """
    known = _list_entries(body.topology, features, np.asarray(body.axes) > 0, sensors)
    modes = _list_modes(body, known)
    reported = tuple(f"lengths.{limb}" for limb in segment_limbs(body.topology))
    words = WORDS | {"segments": reported or WORDS["lengths"]}
    if not modes:
        words["shape"] = words["segments"]
    patterns = [p for word in free for p in (words.get(word) or (word,))]
    for pattern in patterns:
        if not any(_matches(name, pattern) for name in (*modes, *(name for name, *_ in known))):
            groups = ", ".join(words)
            examples = ", ".join([known[1][0], known[-1][0]])
            raise ValueError(
                f"free parameter '{pattern}': this body has nothing of that name; "
                f"use one of {groups}, or a pattern of names such as {examples}"
            )
    rows: dict[str, list[Entry]] = {}
    for entry in known:
        if any(_matches(entry[0], p) for p in patterns):
            name = entry[0]
            if mirrored:
                name = _remove_side(name)
                if entry[1] == 3 and entry[0] == name and name.endswith(".y"):
                    continue  # joints in the middle stay there
            rows.setdefault(name, []).append(entry)
    rows |= {name: entries for name, entries in modes.items() if any(_matches(name, p) for p in patterns)}
    maps = [np.zeros((*shape, len(rows))) for shape in _list_shapes(body.topology, len(features), sensors)]
    for column, entries in enumerate(rows.values()):
        for _, part, index, sign, _ in entries:
            maps[part][(*index, column)] = sign if mirrored or entries[0][4] == "shape" else 1.0
    sd = np.array([PRIORS[entries[0][4]] for entries in rows.values()])
    return Parameters(tuple(rows), sd, tuple(maps), mirrored)


def _list_shapes(t: Topology, features: int, sensors: int) -> list[tuple[int, ...]]:
    """Shapes of the fields of Changes."""
    joints = len(t.joints)
    return [
        (), (len(t.limbs),), (len(t.limbs), 2), (joints, 3), (joints,), (joints, 2), (len(SETTINGS),), (features,),
        (len(TRACK),), (sensors, len(SENSOR)),
    ]  # fmt: skip


def segment_limbs(topology: Topology) -> list[str]:
    """The limbs whose lengths are reported: those that span a whole segment."""
    ends = dict(zip(topology.joints, zip(topology.parents, topology.children)))
    found = [(ends[a][1], ends[b][0]) for _, a, b in topology.segments if a in ends and b in ends]
    return [topology.limbs[first] for first, last in found if first == last]


@cache
def _load_people() -> Body:
    """The body with usual proportions, on the host, since arrays of a traced call must not be cached."""
    from voodoo_jax.model.body_file import load_on_host

    return load_on_host("human")


def _is_person(body: Body) -> bool:
    """Whether people's proportions apply to a body: it has a person's limbs, and perhaps held objects."""
    limbs = [limb for i, limb in enumerate(body.topology.limbs) if i not in body.topology.held]
    return body.scale_name == "stature" and limbs == list(_load_people().topology.limbs)


def usual_lengths(
    body: Body, free: Parameters, longer: Mapping[str, float] | None = None
) -> Float64[np.ndarray, " free"]:
    """Centres of the priors of a body's parameters: its own sizes, but for a person the usual lengths of people of that
    stature, so that a wrong body file does not affect them.

    **Arguments:** `longer` measured lengths over the usual ones, by limb without side.
    """
    centre = np.zeros(len(free.names))
    if _is_person(body):
        own, people = on_host(body), _load_people()
        there = [body.topology.limbs.index(limb) for limb in people.topology.limbs]
        share = np.zeros(body.limb_count)
        usual, has = (np.asarray(b.sizes)[:, 4] / float(b.scale) for b in (people, own))
        share[there] = np.log(usual / has[there])
        share += [np.log((longer or {}).get(without_side(limb), 1.0)) for limb in body.topology.limbs]
        of_limb, one = np.asarray(free.maps[1]), np.array([not name.startswith("shape.") for name in free.names], bool)
        centre[one] = ((of_limb * share[:, None]).sum(0) / np.maximum(of_limb.sum(0), 1))[one]
        if not one.all():
            # the modes closest to these lengths, limited by their own priors
            by, left = of_limb[:, ~one], share - of_limb[:, one] @ centre[one]
            normal = by.T @ by / PRIORS["lengths"] ** 2 + np.diag(1 / free.sd[~one] ** 2)
            centre[~one] = np.linalg.solve(normal, by.T @ left / PRIORS["lengths"] ** 2)
    return np.where(np.abs(centre) > 1e-3, centre, 0.0)  # below: rounding


def with_lengths(body: Body, free: Parameters, x: Float64[np.ndarray, " free"]) -> Body:
    """The body with its limbs as long as a parameter vector makes them, and its scale as before."""
    factors = np.exp(np.asarray(free.maps[1]) @ x)
    return with_proportions(body, dict(zip(body.topology.limbs, map(float, factors))))


@cache
def _people_height() -> float:
    with jax.ensure_compile_time_eval():
        return float(height_of(on_device(_load_people()))) / float(_load_people().scale)


def height_ratio(body: Body) -> Float[Array, ""] | float:
    """Nominal height of a body's rest pose over its scale: that of people, or the body's own."""
    return _people_height() if _is_person(body) else height_of(body) / body.scale


def _matches(name: str, pattern: str) -> bool:
    """Whether a pattern matches a parameter's full name or its name without side."""
    return fnmatchcase(name, pattern) or fnmatchcase(_remove_side(name), pattern)


def changed(body: Body, by: Changes) -> Body:
    """The body after changes; anchors, sites and centres move with their limbs, and the rest pose is recomputed."""
    t = body.topology
    parents = jnp.array(t.parents, int)
    along = jnp.exp(by.lengths)
    stretch = lambda points, limbs: points.at[:, 2].multiply(along[jnp.array(limbs, int)])  # noqa: E731
    # shifts of joints are in the body frame
    shift = unrotate(body.rest.rotation[parents], by.anchors) * body.scale
    on_parent = stretch(body.parent_anchor.translation, t.parents) + shift
    on_child = stretch(body.child_anchor.translation, t.children)
    ends = jnp.exp(by.radii)
    sizes = body.sizes * jnp.stack([ends[:, 0], ends[:, 0], ends[:, 1], ends[:, 1], along], -1)
    site_limbs = jnp.array(t.site_limbs, int)
    share = jnp.clip(body.sites[:, 2] / body.sizes[site_limbs, 4], 0.0, 1.0)
    girth = jnp.exp(by.radii[site_limbs, 0] * (1 - share) + by.radii[site_limbs, 1] * share)
    sites = stretch(body.sites, t.site_limbs).at[:, :2].multiply(girth[:, None])
    centres = stretch(body.centres, t.centre_limbs)
    for j, joint in enumerate(t.joints):
        # a reported centre on the parent moves with its joint, as one on the child does already
        name = V1_NAMES.get(joint, joint)
        if name in t.centres and t.centre_limbs[t.centres.index(name)] == t.parents[j]:
            centres = centres.at[t.centres.index(name)].add(shift[j])
    leaves = lambda b: (  # noqa: E731
        b.sizes, b.parent_anchor.translation, b.child_anchor.translation, b.axes, b.weights, b.centres, b.sites,
    )  # fmt: skip
    axes, weights = body.axes * jnp.exp(by.axes), body.weights * jnp.exp(by.weights)
    new = eqx.tree_at(leaves, body, (sizes, on_parent, on_child, axes, weights, centres, sites))
    grown = scaled(with_rest_from_joints(new), body.scale * jnp.exp(by.scale))
    # its scale in proportion to its height, as for people or as before, since limbs may have grown: else a start that
    # measures a person's height makes a long-legged body too small
    return eqx.tree_at(lambda b: b.scale, grown, height_of(grown) / height_ratio(body))


def changed_options(options: IcpOptions, by: Changes) -> IcpOptions:
    """The solve's options after changes."""
    factor = jnp.exp(by.settings)
    where = {"robust_scale": lambda o: o.match.robust_scale, "limits": lambda o: o.plausible.limits}
    for name, f in zip(SETTINGS, factor):
        leaf = where.get(name, lambda o, name=name: getattr(o, name))
        if leaf(options) is not None:  # options that are switched off stay off
            options = eqx.tree_at(leaf, options, leaf(options) * f)
    return options


def changed_tracking(options: TrackOptions, by: Changes) -> TrackOptions:
    """The options of tracking and of the solve after changes."""
    leaves = lambda o: tuple(getattr(o, name) for name in TRACK)  # noqa: E731
    changed = tuple(v * f for v, f in zip(leaves(options), jnp.exp(by.track)))
    options = eqx.tree_at(leaves, options, changed)
    return eqx.tree_at(lambda o: o.icp, options, changed_options(options.icp, by))


def middles(points: Points) -> Float[Array, "sensor 3"]:
    """Centre of each sensor's points, metres; any leading axes."""
    mine = (jnp.arange(points.origins.shape[-2]) == points.sensor[..., None]) & (points.weight > 0)[..., None]
    total = jnp.einsum("...ps,...pk->sk", mine.astype(points.xyz.dtype), points.xyz, precision="highest")
    count = jnp.sum(mine, tuple(range(mine.ndim - 1)))
    return total / jnp.maximum(count, 1)[:, None]


def changed_points(points: Points, by: Changes, about: Float[Array, "sensor 3"]) -> Points:
    """Points and origins after changes of their sensors, each turned about its place in `about`, metres; any leading
    axes."""
    if not by.sensors.shape[0]:
        return points
    moved = lambda xyz, here, by: here + by[..., 1:4] + rotate(quat_exp(by[..., 4:7]), xyz - here)  # noqa: E731
    mine = by.sensors[points.sensor]
    xyz = moved(points.xyz, about[points.sensor], mine)
    parts = xyz, points.weight * jnp.exp(mine[..., 0]), moved(points.origins, about, by.sensors)
    return eqx.tree_at(lambda p: (p.xyz, p.weight, p.origins), points, parts)


def named_changes(
    body: Body, values: Mapping[str, Float[ArrayLike, ""]], features: tuple[str, ...] = (), sensors: int = 0
) -> Changes:
    """The changes of values by name; a name without side sets both sides. Raises ValueError for a name that the body
    does not have."""
    t = body.topology
    known = _list_entries(t, features, np.ones((len(t.joints), 2), bool), sensors)  # a joint without an axis gets none
    modes = _list_modes(body, known)
    parts = [jnp.zeros(shape, body.sizes.dtype) for shape in _list_shapes(t, len(features), sensors)]
    for name, value in values.items():
        said = modes.get(name) or [entry for entry in known if name in (entry[0], _remove_side(entry[0]))]
        if not said:
            examples = ", ".join((known[1][0], known[-1][0]))
            raise ValueError(f"parameter '{name}': this body has nothing of that name, but for example {examples}")
        for entry, part, index, sign, _ in said:
            parts[part] = parts[part].at[index].add((1.0 if name == entry else sign) * value)
    return Changes(*parts)


def _remove_side(name: str) -> str:
    return ".".join(map(without_side, name.split(".")))


def height_of(body: Body) -> Float[Array, ""]:
    """Height of the rest pose: from the lowest to the highest point of the limbs' end ellipses, metres."""
    turn = matrix(body.rest.rotation)[:, 2]  # [limb] row of z
    a0, b0, a1, b1, length = (body.sizes[:, k] for k in range(5))
    bottom = body.rest.translation[:, 2]
    top = bottom + length * turn[:, 2]
    reach0, reach1 = (jnp.sqrt((a * turn[:, 0]) ** 2 + (b * turn[:, 1]) ** 2 + 1e-12) for a, b in ((a0, b0), (a1, b1)))
    return jnp.maximum(jnp.max(bottom + reach0), jnp.max(top + reach1)) - jnp.minimum(
        jnp.min(bottom - reach0), jnp.min(top - reach1)
    )
