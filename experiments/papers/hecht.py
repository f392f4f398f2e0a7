"""The system of Hecht, Azad and Dillmann 2009 with its own start and edge image, and its Fig. 7: the wrist's error by
direction, along time.

The start as the text has it (sec. III-C): a background, the head in the largest patch of skin before it, a body that
dangles from it until its edge score says that somebody stands like that. The first image of our recordings is never
empty: each pixel's median over the recording is the background. The person's stature is given.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from experiments.common import load_dims, load_truth, nearest, table
from voodoo_jax.config.options import Settings
from voodoo_jax.config.presets import preset
from voodoo_jax.fitting.frames import Truth
from voodoo_jax.io.log_reader import open_log
from voodoo_jax.model.body_file import load_body
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.trackers.flexible.filters import start
from voodoo_jax.trackers.flexible.flexible_body import HEAD, IS_ARM, LIMBS, FlexibleBody, flexible_body
from voodoo_jax.trackers.flexible.head import BEHIND, FACE, Start, first_pose
from voodoo_jax.trackers.flexible.image_features import Features, SkinModel
from voodoo_jax.trackers.flexible.observed import FeatureStore, Look, Observed, observe, view_of
from voodoo_jax.trackers.flexible.physics import frames, inverse_masses, relax, verlet
from voodoo_jax.trackers.flexible.scores import LimbContext, limb_score
from voodoo_jax.trackers.flexible.tracker import (
    Begun,
    Heads,
    camera_places,
    chosen,
    descent,
    filtered,
    follow,
    nobody_of,
    numbers,
    shape_of,
    tracks_of,
)
from voodoo_jax.trackers.flexible.vectors import vectors

LOGS = ("stereo-bow-wave", "stereo-byebye-happy", "stereo-guide-active")  # in which a hand is raised
WRIST = "r_radiocarpal"
DIFFERENT = 25.0  # grey levels from the background; the paper gives no thresholds
GRADIENT, MOVING = 18.0, 9.0  # grey levels; as the product's edge image
CR, CB = (133, 173), (77, 127)  # of skin: limits in common use
FITS = 3.0  # times a face's area, or this part of it
MATCHED = 0.3  # of the edge score: somebody stands as the body dangles
DANGLING, DAMPING = 90, 0.1  # steps in which the body comes to rest, of 1/30 s
DIRECTIONS = ("across", "up and down", "in depth")
PAPER, EDGES, OURS = "its own start and edges", "our start, its own edges", "our start and edges"


@dataclass(frozen=True)
class Seen:
    """A recording with the paper's edge image and background."""

    observed: Observed
    background: np.ndarray  # [row, column, 3]


def with_papers_edges(seen: Observed) -> Seen:
    """Edges where gradient and difference to the last image are both above a threshold, blurred (sec. III-B)."""
    store, last, images = FeatureStore(), None, []
    for i in range(len(seen.features)):
        f = seen.features[i]
        grey = cv2.GaussianBlur(cv2.cvtColor(f.colour, cv2.COLOR_BGR2GRAY), (0, 0), 0.8)
        dx, dy = (cv2.Sobel(grey, cv2.CV_32F, *d, ksize=3, scale=0.25) for d in ((1, 0), (0, 1)))
        moving = np.zeros(grey.shape, np.uint8) if last is None else (cv2.absdiff(grey, last) > MOVING).astype(np.uint8)
        both = (np.hypot(dx, dy) > GRADIENT) & (cv2.dilate(moving, np.ones((3, 3), np.uint8)) > 0)
        edge = cv2.GaussianBlur(both.astype(np.float32), (0, 0), 1.5)
        scaled = np.clip(edge / max(float(edge.max()), 0.25) * 255, 0, 255).astype(np.uint8)
        store.add(f._replace(edge=scaled), seen.features.place(i))
        last = grey
        images.append(f.colour)
    return Seen(replace(seen, features=store), np.median(np.stack(images), 0).astype(np.uint8))


def skin_by_limits() -> SkinModel:
    """Skin by fixed limits of colour."""
    model = SkinModel()
    bins = 256 // len(model.share)
    share = np.zeros_like(model.share)
    share[CR[0] // bins : CR[1] // bins + 1, CB[0] // bins : CB[1] // bins + 1] = 1
    return SkinModel(share, share.copy())


def head_in(f: Features, seen: Seen, skin: SkinModel, stature: float, up: np.ndarray) -> np.ndarray | None:
    """The head point, metres: the highest patch of skin before the background that is about as large as a face at its
    depth ("a suitable skin blob"); None: there is none."""
    foreground = np.abs(f.colour.astype(float) - seen.background).max(-1) > DIFFERENT
    mask = ((skin.map(f.cell) > 0.5) & foreground).astype(np.uint8)
    count, labels, stats, centres = cv2.connectedComponentsWithStats(mask)
    found: list[np.ndarray] = []
    for patch in range(1, count):
        depth = f.depth[(labels == patch) & (f.depth > 0)]
        if len(depth) < 5:
            continue
        z = float(np.median(depth))
        face = np.pi * np.prod(np.array(FACE) * stature * f.focal[:2] / z)
        if not 1 / FITS < stats[patch, cv2.CC_STAT_AREA] / face < FITS:
            continue
        at = np.append((centres[patch] - f.focal[2:]) / f.focal[:2], 1.0)
        found.append((at * (z + BEHIND * stature) - f.shift) @ f.turn)
    return max(found, key=lambda head: float(head @ up), default=None)


def dangling(body: FlexibleBody, begin: Start, up: np.ndarray) -> jax.Array:
    """The relaxed state: the body hangs from its head until it rests."""
    x = jnp.asarray(first_pose(np.asarray(body.rest), begin, up))

    def one(carry, _):
        x, before = carry
        moved = verlet(x, before, jnp.broadcast_to(jnp.asarray(-9.81 * up), x.shape), jnp.asarray(1 / 30), DAMPING)
        held = jnp.where(inverse_masses(body.masses)[:, None] > 0, moved, x)
        return (relax(body, held, body.masses, 6, 0.0, True, None), x), None

    return jax.jit(lambda x: jax.lax.scan(one, (x, x), None, DANGLING)[0][0])(x)


def edge_score(body: FlexibleBody, x: jax.Array, f: Features, settings: Settings) -> float:
    """Mean over the four limbs."""
    s = settings.flexible
    view = view_of(Look(f, np.zeros(f.depth.shape, np.uint8), True))
    far, none = jnp.full((f.depth.shape[0] // 4, f.depth.shape[1] // 4), 1e6), jnp.zeros((1, 3))
    weighing, found = numbers(s).weighing, []
    for limb in range(4):
        context = LimbContext(
            far, jnp.full((2, 10, 3), 0.5), jnp.zeros((2, 10)), none, jnp.ones(1), jnp.zeros(1), jnp.zeros(2),
            frames(x).lower[0], jnp.asarray(float(IS_ARM[limb])), body.radii[limb], body.tips[limb],
            jnp.append(x[HEAD], 0.1),
        )  # fmt: skip
        points = tuple(vectors(x[row, None]) for row in LIMBS[limb])
        found.append(float(limb_score(points, context, view, weighing).edge[0]))  # pyright: ignore[reportArgumentType]
    return float(np.mean(found))


@dataclass(frozen=True)
class Followed:
    """What the paper's system gives of a recording."""

    tracks: Tracks
    first: int  # image in which it started
    score: float  # edge score there
    matched: bool  # whether that was enough


def followed(path: Path, seen: Seen, settings: Settings, stature: float, fixed_frame: str) -> Followed | None:
    """The paper's start, then its filters; None: no head was found while dense depth was there."""
    skin = skin_by_limits()
    observed, s, body = seen.observed, settings.flexible, load_body("human")
    model, up = flexible_body(body, stature), observed.scene.floor.normal.astype(np.float32)
    tried: list[tuple[float, int, jax.Array, Start]] = []
    for i in range(1, min(s.learn_frames, len(observed.features))):
        f = observed.features[i]
        head = head_in(f, seen, skin, stature, up)
        if head is None:
            continue
        toward = observed.features.place(i) - head
        left = np.cross(up, toward - (toward @ up) * up)
        left /= np.linalg.norm(left)
        begin = Start(stature, head.astype(np.float32), left.astype(np.float32), True)
        x = dangling(model, begin, up)
        tried.append((edge_score(model, x, f, settings), i, x, begin))
        if tried[-1][0] >= MATCHED:
            break
    if not tried:
        return None
    score, first, x, begin = max(tried, key=lambda one: one[0])
    key, order = jax.random.PRNGKey(s.seed), range(first, len(observed.features))
    state = start(jax.random.fold_in(key, 2**30), model, x, shape_of(s))
    states, heads = jax.tree.map(lambda a: a[None], state), Heads(observed, first, begin, skin, s)
    for i in order:
        heads.look(observed, i)
    on = Begun(observed, skin, first, begin, heads, None, model, states, key)
    every = filtered(on, states, observed, order, key, s)[1]
    found = chosen(every, descent(every))
    camera = camera_places(observed, order)
    tracks = tracks_of(
        nobody_of(body, observed.time_ns, observed.scene, str(path), fixed_frame), begin, observed, first, found, camera
    )
    return Followed(tracks, first, score, score >= MATCHED)


@dataclass(frozen=True)
class Known:
    """A truth, as tracks are compared with it."""

    stamps: np.ndarray  # [time] nanoseconds
    names: tuple[str, ...]
    joints: np.ndarray  # [time, joint, 3] metres


def wrist_errors(tracks: Tracks, truth: Truth, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[time] seconds, and [time, direction] how far the right wrist is off: across, up and down, in depth; metres."""
    frame, near = nearest(Known(truth.time_ns, truth.names, truth.joints), tracks)
    off = tracks.joints[frame, tracks.body.topology.centres.index(WRIST)] - truth.joints[:, truth.names.index(WRIST)]
    off[~near] = np.nan
    return (truth.time_ns - truth.time_ns[0]) / 1e9, off @ turn.T


def results(recordings: Path) -> tuple[str, Figure]:
    """Errors of the right wrist by direction, and of all joints, of some recordings; and their curves in the second."""
    settings, rows, curves = preset("hecht2009"), [], {}
    files = [recordings / f"{name}.mcap" for name in LOGS]
    for file in tqdm([f for f in files if f.exists()], "2009", leave=False, disable=None):
        log, truth = open_log(file, settings.read), load_truth(file)
        observed = observe(log.frames(), log.up, load_body("human"), settings, log.path)
        turn = observed.features[0].turn
        seen = with_papers_edges(observed)
        own = followed(file, seen, settings, load_dims(file)["stature"], log.fixed_frame)
        ours = follow(load_body("human"), observed, settings, log.path, log.fixed_frame)
        edges = follow(load_body("human"), seen.observed, settings, log.path, log.fixed_frame)
        seen.observed.features.close()
        observed.close()
        for name, tracks in ((PAPER, own and own.tracks), (EDGES, edges), (OURS, ours)):
            if tracks is None:
                rows.append([file.stem, name, "no head was found", *["-"] * 7])
                continue
            seconds, off = wrist_errors(tracks, truth, turn)
            curves[file.stem, name] = seconds, off
            rows.append([file.stem, name, said(own) if name == PAPER else "-", *numbers_of(off, tracks, truth)])
        print(rows[-3:], flush=True)
    head = ["recording", "", "start", *(f"{d}, cm" for d in DIRECTIONS), "wrist, cm", "all joints, cm"]
    head += ["the wrist's error goes with that in depth", "with that across"]
    return table(head, rows, 3), drawn(curves)


def said(own: Followed | None) -> str:
    assert own is not None
    return f"image {own.first}, edge score {own.score:.2f}{'' if own.matched else ' (the best; no match)'}"


def numbers_of(off: np.ndarray, tracks: Tracks, truth: Truth) -> list[str]:
    """Mean absolute errors, the wrist's and all joints', and how the wrist's correlates with parts of it."""
    known = np.isfinite(off).all(1)
    away, whole = np.abs(off[known]), np.linalg.norm(off[known], axis=1)
    alike = [float(np.corrcoef(whole, away[:, k])[0, 1]) for k in (2, 0)]
    frame, near = nearest(Known(truth.time_ns, truth.names, truth.joints), tracks)
    order = [tracks.body.topology.centres.index(name) for name in truth.names]
    every = np.linalg.norm(tracks.joints[frame][:, order] - truth.joints, axis=-1)[near]
    cells = [f"{100 * v:.0f}" for v in (*away.mean(0), whole.mean(), np.nanmean(every))]
    return [*cells, *(f"{v:.2f}" for v in alike)]


def drawn(curves: dict[tuple[str, str], tuple[np.ndarray, np.ndarray]]) -> Figure:
    """Fig. 7: the error by direction and the whole one, each in its own scale, as the paper draws them."""
    names = sorted({name for name, _ in curves})
    chosen = names[min(1, len(names) - 1)]
    figure, panels = plt.subplots(4, 1, figsize=(8, 7), sharex=True, layout="constrained")
    for way in (PAPER, EDGES, OURS):
        if (chosen, way) not in curves:
            continue
        seconds, off = curves[chosen, way]
        for k, panel in enumerate(panels[:3]):
            panel.plot(seconds, 100 * np.abs(off[:, k]), lw=1, label=way)
        panels[3].plot(seconds, 100 * np.linalg.norm(off, axis=1), lw=1, label=way)
    for panel, name in zip(panels, (*DIRECTIONS, "in all")):
        panel.set(ylabel=f"{name}, cm", ylim=(0, None))
        panel.grid(True, alpha=0.3)
    panels[3].set(xlabel="time, s")
    panels[0].legend(fontsize=8, ncols=3, loc="lower left", bbox_to_anchor=(0, 1))
    figure.suptitle(f"{chosen}: error of the right wrist", fontsize=9)
    return figure
