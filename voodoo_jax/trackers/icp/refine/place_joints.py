"""Moves joint centres to their anatomical places: by the pose, the visible side, and the stretch of the bands.

A joint centre is not fixed on a cylinder: shoulders rise and come forward with the arm; the visible side of a limb is
nearer or farther than a cylinder's; points are matched to a neighbouring limb; and thighs longer than usual for the
stature stretch the bands of knee and hip. Ridge regression learned the offsets on people with known joints
(experiments/offsets, `learn.py`), from directions, their products, and waves over all of them (random Fourier features:
Rahimi and Recht 2007). In recordings with few measurements, the bands count for little.
"""

import tomllib
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float, Float64, Int

from voodoo_jax.geometry.rigid import Poses, apply, on_host, rotate, unrotate
from voodoo_jax.model.body import Body, scaled
from voodoo_jax.model.marker_sets import V1_NAMES
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.icp.joint_spread import of_moved_joints
from voodoo_jax.trackers.icp.refine.fit_forearms import in_usual_proportions, usual_body
from voodoo_jax.trackers.icp.runner import Runner
from voodoo_jax.trackers.shared.confidence import BATCH

# joint centre -> the limb in whose axes it is moved, and the limb whose direction tells how the joint is bent
LIMBS = {
    "skullbase": ("head", "chest"), "vc7": ("chest", "head"), "shoulder": ("chest", "upper_arm"),
    "elbow": ("forearm", "upper_arm"), "radiocarpal": ("forearm", "hand"), "hip": ("pelvis", "thigh"),
    "knee": ("shank", "thigh"), "talocrural": ("shank", "foot"),
}  # fmt: skip
# limbs whose upward axes tell of the pose; of those with sides first the centre's own side
TRUNK, SIDED = ("chest", "pelvis", "head"), ("upper_arm", "forearm", "thigh", "shank")
UPPER, LEGS = ("waist", "neck", "shoulder", "elbow", "wrist"), ("hip", "knee", "ankle")  # whose bands are looked at
SIDES = ("l_", "r_")
EVERY = slice(None)
UNLIKE = 0.4  # logarithm of a size over the usual one: girths of people differ by 13 % (ANSUR II), three deviations


# segments measured between placed centres: in 124 logs errors of 1.25 cm instead of 1.96 and of 0.57 instead of 0.69,
# less in each of four sets; for upper arms and shanks of people who bend the body is better (experiments/offsets)
MEASURED = ("thigh", "forearm")
# of the waves over all directions: how many, the standard deviation of their frequencies, how high; chosen on people
# left out (experiments/offsets)
WAVES, FREQUENCY, HEIGHT = 200, 0.3, 0.3


class Gaps(NamedTuple):
    """How far the bands of joints are stretched over a recording; left and right averaged, right mirrored."""

    gap: Float64[np.ndarray, "joint 3"]  # in the parent limb's frame, hundredths of the stature; NaN: never seen
    count: Float64[np.ndarray, " joint"]  # frames of one side in which both limbs are seen


class Learned(NamedTuple):
    """The regression of one joint centre."""

    weights: Float64[np.ndarray, "feature 3"]  # shift in the limb's axes at rest (forward, left, up), of the stature
    usual: Float64[np.ndarray, " gap"]  # gaps of people, mean
    spread: Float64[np.ndarray, " gap"]  # and standard deviation


@cache
def learned() -> dict[str, Learned]:
    """The regressions in the package, by joint centre without its side."""
    text = files("voodoo_jax.trackers.icp.refine").joinpath("place_joints.toml").read_text()
    found = tomllib.loads(text)
    return {name: Learned(*(np.array(found[name][key]) for key in Learned._fields)) for name in LIMBS}


@cache
def waves(directions: int) -> tuple[Float64[np.ndarray, "direction wave"], Float64[np.ndarray, " wave"]]:
    """Frequencies and phases of the waves over that many numbers, from a generator whose numbers NumPy guarantees."""
    random = np.random.RandomState(0)  # noqa: NPY002
    return FREQUENCY * random.standard_normal((directions, WAVES)), random.uniform(0, 2 * np.pi, WAVES)


def plain(name: str) -> tuple[str, str]:
    """Side ("l_", "r_" or nothing) and name without it."""
    return (name[:2], name[2:]) if name[:2] in SIDES else ("", name)


def gaps_for(centre: str, gaps: dict[str, Gaps]) -> Gaps:
    """The band gaps that are used for a joint centre."""
    return gaps["legs" if centre in ("hip", "knee", "talocrural") else "upper"]


def band_gaps(body: Body, tracks: Tracks, among: slice = EVERY) -> dict[str, Gaps]:
    """Gaps of the joints in UPPER and in LEGS in the tracked ones of some frames.

    **Arguments:** `body` in its usual proportions.
    """
    t = body.topology
    seen = np.arange(len(tracks.tracked))[among]
    seen = seen[tracks.tracked[seen]]
    found: dict[str, tuple[np.ndarray, int]] = {}
    for j, joint in enumerate(t.joints):
        pair = [t.parents[j], t.children[j]]
        frames = seen[(tracks.evidence.limb_weight[seen][:, pair] > 0).all(1)]
        ends = [
            apply(Poses(tracks.rotation[frames, limb], tracks.translation[frames, limb]), anchor.translation[j])
            for limb, anchor in zip(pair, (body.parent_anchor, body.child_anchor))
        ]
        gap = unrotate(tracks.rotation[frames, pair[0]], ends[1] - ends[0])
        middle = np.median(gap, 0) if len(frames) else np.full(3, np.nan)
        found[joint] = 100 * middle.astype(float) / float(body.scale), len(frames)
    return {"upper": _averaged(found, UPPER), "legs": _averaged(found, LEGS)}


def _averaged(found: dict[str, tuple[np.ndarray, int]], joints: tuple[str, ...]) -> Gaps:
    gaps, counts = [], []
    for joint in joints:
        both = [(found[n], m) for n, m in ((joint, 1), (f"l_{joint}", 1), (f"r_{joint}", -1)) if n in found]
        weight = np.array([count for (_, count), _ in both], float)
        side = np.array([gap * [1, mirror, 1] for (gap, _), mirror in both])
        some = weight > 0
        gaps.append(side[some].mean(0) if some.any() else np.full(3, np.nan))
        if joint in ("waist", "neck"):
            gaps[-1][1] = 0.0  # nobody leans to one side on average
        counts.append(weight.mean())
    return Gaps(np.array(gaps), np.array(counts))


class Seen(NamedTuple):
    """Frames in which poses are known."""

    frames: Int[np.ndarray, " seen"]
    eyes: Float[np.ndarray, "seen 3"]  # where the sensor is, metres
    axes: Float64[np.ndarray, "seen limb 2 3"]  # where the axes of limbs point that point forward and up at rest


def seen_in(body: Body, tracks: Tracks, frames: Int[np.ndarray, " seen"], eyes: Float64[np.ndarray, "frame 3"]) -> Seen:
    """Some frames of tracks; `eyes` of sensor_places."""
    ahead = unrotate(body.rest.rotation[:, None], np.eye(3)[[0, 2]])
    return Seen(frames, eyes[frames], rotate(tracks.rotation[frames][:, :, None], ahead).astype(float))


def pose_features(
    body: Body, centre: str, tracks: Tracks, seen: Seen, side: str = ""
) -> Float64[np.ndarray, "seen feature"]:
    """Regression inputs of a joint from the pose and the visible side: 1, direction to the sensor, rotation of the
    other limb's upward axis, both axes of the trunk's limbs, upward axes of arms and legs, products of the first two
    and their squares, waves over all directions. Directions are forward, left, up of the limb at rest; those of right
    joints are mirrored.

    **Arguments:** `side` of a centre in the middle: "r_" mirrors it.
    """
    side, name = plain(centre) if plain(centre)[0] else (side, centre)
    own = side or SIDES[0]
    frames, axes = seen.frames, seen.axes
    toward = seen.eyes - tracks.joints[frames, body.topology.centres.index(centre)]
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    middle = axes[:, [limb_of(body, own, limb) for limb in TRUNK]].reshape(-1, 2 * len(TRUNK), 3)
    sided = [limb_of(body, s, limb) for s in sorted(SIDES, reverse=own == "r_") for limb in SIDED]
    other = limb_of(body, own, LIMBS[name][1])
    all_of_it = np.concatenate([toward[:, None], axes[:, [other], 1], middle, axes[:, sided, 1]], 1)
    limb = limb_of(body, own, LIMBS[name][0])
    v = to_rest(body, tracks, frames[:, None], limb, all_of_it) * [1, -1 if side == "r_" else 1, 1]
    v[:, 1] -= [0.0, 0.0, 1.0]
    both = v[:, :2].reshape(-1, 6)
    products = (both[:, :, None] * both[:, None])[:, *np.triu_indices(6)]
    flat = v.reshape(-1, 3 * v.shape[1])
    frequencies, phases = waves(flat.shape[1])
    return np.concatenate([np.ones((len(v), 1)), flat, products, HEIGHT * np.cos(flat @ frequencies + phases)], 1)


def limb_of(body: Body, side: str, limb: str) -> int:
    """Number of a limb of LIMBS, of that side if it has one."""
    names = body.topology.limbs
    return names.index(limb if limb in names else side + limb)


def to_rest(body: Body, tracks: Tracks, frames: np.ndarray, limb: int, v: np.ndarray) -> np.ndarray:
    """Vectors of the fixed frame in a limb's axes at rest."""
    return rotate(body.rest.rotation[limb], unrotate(tracks.rotation[frames, limb], v)).astype(float)


def sensor_places(people: list[BodyObservation]) -> Float64[np.ndarray, "frame 3"] | None:
    """Where the sensor is in the fixed frame, metres; None where there is not one sensor alone."""
    if any(len(f.origins) != 1 for f in people):
        return None
    places = np.array([f.origins[0] for f in people], float).reshape(-1, 3)
    for k, frame in enumerate(people):
        if (T := frame.T_fixed_steady) is not None:
            places[k] = T[:3, :3] @ places[k] + T[:3, 3]
    return places


@dataclass(frozen=True)
class PlaceJoints:
    """Moves joint centres by what was learned from people with known joints. Poses and the body do not change. Only for
    the package's own body or one fitted from it, and one sensor, as learned."""

    name: ClassVar = "place_joints"
    looks_ahead: ClassVar = False  # online, bands are those of the frames until then
    needs: ClassVar = frozenset({"points", "one body"})

    few: int = 30  # frames of a joint with which its bands count half, as in fit_forearms
    widest: float = 2.0  # standard deviations that people's bands differ by: farther, something else stretches them
    farthest: float = 0.025  # of the stature: no centre of the people learned from was moved farther
    again: float = 1.25  # online, bands are looked at anew once there are so many times as many frames

    def __call__(self, run: Runner, tracks: Tracks) -> Tracks:
        body = persons_body(tracks.body)
        eyes = sensor_places(run.people)
        if body is None or eyes is None:
            return tracks
        others = [k for k, frame in enumerate(run.people) if frame.other and k > 0]
        ahead = run.settings.looks_ahead("track")
        for first, last in zip([0, *others], [*others, len(run.people)]):  # bands of one body tell nothing of another
            for which, among in self.parts(first, last, ahead):
                tracks = self.placed(body, tracks, eyes, band_gaps(body, tracks, among), which)
        # a body in other proportions was fitted, and knows its lengths
        measured = ahead and not others and in_usual_proportions(body)
        return replace(tracks, segments=measured_segments(tracks)) if measured else tracks

    def parts(self, first: int, last: int, ahead: bool) -> list[tuple[slice, slice]]:
        """Parts of the frames with one body, and the frames whose bands are used for them: all frames of the body or,
        if not `ahead`, those up to the part's first."""
        if ahead:
            return [(slice(first, last), slice(first, last))]
        parts, begin = [], first
        while begin < last:
            end = min(last, self.part_end(begin, first))
            parts.append((slice(begin, end), slice(first, begin + 1)))
            begin = end
        return parts

    def part_end(self, begin: int, first: int) -> int:
        """The frame after the part that begins in frame `begin`, of a body that began in frame `first`."""
        return begin + max(1, int((self.again - 1) * (begin - first)))

    def placed(
        self, body: Body, tracks: Tracks, eyes: Float64[np.ndarray, "frame 3"], gaps: dict[str, Gaps],
        which: slice = EVERY,
    ) -> Tracks:  # fmt: skip
        """Tracks with the joints of frames `which` moved.

        **Arguments:** `body` in its usual proportions; `eyes` of sensor_places; `gaps` of the bands that are used.
        """
        known = np.isfinite(tracks.rotation).all((1, 2)), np.isfinite(tracks.translation).all((1, 2))
        there = np.logical_and(*known)
        frames = np.arange(len(there))[which]
        frames = frames[there[frames]]
        joints, covariance = tracks.joints.copy(), tracks.joint_covariance
        if covariance is not None:
            covariance = covariance.copy()
            for some in np.split(frames, np.arange(BATCH, len(frames), BATCH)):
                covariance[some] = of_moved_joints(tracks, some)
        now = seen_in(body, tracks, frames, eyes)
        for k, centre in enumerate(body.topology.centres):
            side, name = plain(centre)
            regression = learned()[name]
            seen = self.gap_features(gaps_for(name, gaps), regression)
            features = pose_features(body, centre, tracks, now)
            wide = np.broadcast_to(seen, (len(frames), len(seen)))
            shift = np.concatenate([features, wide], 1) @ regression.weights
            length = np.linalg.norm(shift, axis=1, keepdims=True)
            shift *= np.minimum(1.0, self.farthest / np.maximum(length, 1e-9)) * float(body.scale)
            if side == "r_":
                shift[:, 1] *= -1
            limb = limb_of(body, side, LIMBS[name][0])
            shift = rotate(tracks.rotation[frames, limb], unrotate(body.rest.rotation[limb], shift))
            joints[frames, k] += shift.astype(joints.dtype)
        return replace(tracks, joints=joints, joint_covariance=covariance)

    def gap_features(self, gaps: Gaps, regression: Learned) -> Float64[np.ndarray, " gap"]:
        """Gaps in standard deviations from people's mean, less where little was seen of a joint."""
        share = np.repeat(gaps.count / (gaps.count + self.few), 3)
        usual, spread = regression.usual, regression.spread
        away = np.where(spread > 0, (gaps.gap.ravel() - usual) / np.maximum(spread, 1e-9), 0.0)
        return np.clip(np.where(np.isfinite(away), away, 0.0), -self.widest, self.widest) * share


def measured_segments(tracks: Tracks) -> dict[str, float]:
    """Lengths of the segments of MEASURED, metres: median distance of their joint centres in frames in which their
    limbs are seen, left and right together."""
    t, found = tracks.body.topology, dict[str, list[np.ndarray]]()
    for name, *ends in t.segments:
        if name in MEASURED:
            centres = [t.centres.index(V1_NAMES.get(joint, joint)) for joint in ends]
            start, end = (tracks.joints[:, k].astype(float) for k in centres)
            limb = t.children[t.joints.index(ends[0])]
            seen = tracks.tracked & (tracks.evidence.limb_weight[:, limb] > 0)
            found.setdefault(name, []).append(np.linalg.norm(end - start, axis=1)[seen])
    return {name: float(np.median(each)) for name, some in found.items() if len(each := np.concatenate(some))}


def persons_body(body: Body) -> Body | None:
    """The default body in the scale of a body that equals it but for its forearms (fit_forearms); a body with its limbs
    in plausible sizes of a person unchanged; for others None."""
    usual = usual_body()
    if body.topology != usual.topology:
        return None
    usual = on_host(scaled(usual, float(body.scale)))
    off = np.abs(np.log(np.asarray(body.sizes) / usual.sizes))
    if (off > UNLIKE).any():
        return None
    for limb in ("l_forearm", "r_forearm"):
        off[body.topology.limbs.index(limb), 4] = 0.0
    return usual if (off < 1e-4).all() else on_host(body)
