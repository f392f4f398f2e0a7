"""Appearance of people and rooms: colours and patterns of skin, hair, clothes, walls and floors. Host side, NumPy.

Colours are red, green, blue, 0 to 255. A paint is solid: what a place looks like follows from where it is in the body
at rest, or in the room, so that it stays there while a limb moves and is the same for every camera.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Float32, Float64, Int

from voodoo_jax.model.body import Body, without_side

Colour = tuple[float, float, float]
SKINS = ((190, 150, 120), (165, 120, 90), (115, 80, 60), (215, 175, 150))
HAIRS = ((35, 30, 25), (90, 60, 40), (160, 130, 90), (130, 130, 130))
ROOMS = ((160, 155, 150), (165, 150, 120), (150, 160, 165), (120, 105, 95))
_LEAST, _MOST = 0.2, 2.0  # of a colour that its pattern leaves
_CELLS = 48  # after so many cells a pattern repeats
_SMOOTHSTEP = 26 / 35  # mean of s^2 + (1 - s)^2 for s = 3 t^2 - 2 t^3, t from 0 to 1


@dataclass(frozen=True)
class Paint:
    """A colour and its pattern."""

    colour: Colour
    grain: float = 0.05  # standard deviation of the brightness, share
    coarse: float = 0.3  # lengths between which the grain is, metres
    fine: float = 0.01
    stripes: float = 0.0  # metres from one level stripe to the next; 0: none


@dataclass(frozen=True)
class Look:
    """Appearance of a person; other bodies have `skin` only. Heights at rest, shares of the stature."""

    skin: Paint = Paint(SKINS[0], 0.04, 0.1)
    hair: Paint = Paint(HAIRS[1], 0.1, 0.05)
    shirt: Paint = Paint((50, 80, 160), 0.1)
    trousers: Paint = Paint((45, 45, 50), 0.1)
    shoes: Paint = Paint((70, 45, 35), 0.1)
    sleeve: float = 0.51  # where sleeves end, of arms that hang: 0.70 is short
    waist: float = 0.58
    hem: float = 0.05  # where trousers end: 0.30 is short


@dataclass(frozen=True)
class Scenery:
    """Appearance of the room, and its light."""

    floor: Paint = Paint(ROOMS[3], 0.08, 0.5)
    wall: Paint = Paint(ROOMS[0], 0.08, 0.5)
    furniture: Paint = Paint(ROOMS[1], 0.08, 0.5)
    light: tuple[float, float, float] = (-0.6, 0.4, 0.7)  # towards where it comes from
    ambient: float = 0.45  # share of the light that comes from everywhere
    tint: Colour = (1.0, 1.0, 1.0)  # of all light


def random_look(rng: np.random.Generator) -> Look:
    """A random person in random clothes."""

    def cloth(brightest: float) -> Paint:
        striped = rng.random() < 0.25
        grain = float(rng.choice([0.04, 0.08, 0.15]))
        return Paint(_rgb(rng.uniform(20, brightest, 3)), grain, stripes=float(rng.uniform(0.03, 0.08)) * striped)

    return Look(
        skin=Paint(SKINS[rng.integers(len(SKINS))], 0.04, 0.1), hair=Paint(HAIRS[rng.integers(len(HAIRS))], 0.1, 0.05),
        shirt=cloth(200), trousers=cloth(110), shoes=cloth(100), sleeve=float(rng.choice([0.51, 0.70])),
        hem=float(rng.choice([0.05, 0.05, 0.30])),
    )  # fmt: skip


def random_scenery(rng: np.random.Generator) -> Scenery:
    """A random room in random light."""
    paints = [
        Paint(_rgb(np.array(ROOMS[k], float) * rng.uniform(0.7, 1.2)), float(rng.uniform(0.04, 0.12)), 0.5)
        for k in rng.permutation(len(ROOMS))[:3]
    ]
    light = (-1.0, float(rng.uniform(-1, 1)), float(rng.uniform(0.4, 1.5)))
    tint = _rgb(rng.uniform(0.9, 1.1, 3))
    return Scenery(paints[0], paints[1], paints[2], light, float(rng.uniform(0.35, 0.6)), tint)


def _rgb(values: np.ndarray) -> Colour:
    r, g, b = (float(v) for v in values)
    return r, g, b


def fractal(points: Float[np.ndarray, "*n 3"], coarse: float, fine: float, seed: int) -> Float64[np.ndarray, "*n"]:
    """Noise of standard deviation 1 at points (metres): an equal share from each octave between two lengths."""
    found, size, octaves = np.zeros(points.shape[:-1]), coarse, 0
    while size >= fine:
        at = points / size
        base = np.floor(at).astype(int)
        part = at - base
        part = part * part * (3 - 2 * part)
        weights = np.stack([1 - part, part])
        ends = np.stack([base, base + 1]) % _CELLS
        lattice = _lattice(seed, octaves)
        for i, j, k in np.ndindex(2, 2, 2):
            w = weights[i, ..., 0] * weights[j, ..., 1] * weights[k, ..., 2]
            found += w * lattice[ends[i, ..., 0], ends[j, ..., 1], ends[k, ..., 2]]
        size, octaves = size / 2, octaves + 1
    # its standard deviation over all places, not over these: a place looks alike whatever else is seen
    return found / (_SMOOTHSTEP**1.5 * np.sqrt(max(octaves, 1)))


@lru_cache(128)
def _lattice(seed: int, octave: int) -> Float32[np.ndarray, "cell cell cell"]:
    """Random numbers at the corners of cells; cached, because all pictures of a recording need the same ones."""
    return np.random.default_rng([seed, octave]).standard_normal((_CELLS,) * 3, np.float32)


def painted(paint: Paint, points: Float64[np.ndarray, "n 3"], seed: int) -> Float64[np.ndarray, "n 3"]:
    """Colours of places (metres) in white light from everywhere."""
    pattern = 1 + paint.grain * fractal(points, paint.coarse, paint.fine, seed)
    if paint.stripes:
        pattern = pattern + 0.35 * np.sign(np.sin(points[:, 2] * 2 * np.pi / paint.stripes))
    return np.array(paint.colour) * np.clip(pattern, _LEAST, _MOST)[:, None]


def body_colours(
    body: Body, look: Look, limb: Int[np.ndarray, " n"], place: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, "n 3"]:
    """Colours of places on limbs in white light from everywhere.

    **Arguments:** `place` in the body frame at rest, metres.
    """
    paints = look.skin, look.hair, look.shirt, look.trousers, look.shoes
    skin, hair, shirt, trousers, shoes = range(5)
    which, share = np.zeros(len(limb), int), place / float(body.scale)
    for number, name in enumerate(body.topology.limbs):
        mine, (x, _, z) = limb == number, share.T
        match without_side(name):
            case "chest" | "torso":
                which[mine] = shirt
            case "pelvis":
                which[mine] = np.where(z > look.waist, shirt, trousers)[mine]
            case "upper_arm" | "forearm":
                which[mine] = np.where(z > look.sleeve, shirt, skin)[mine]
            case "thigh" | "shank":
                which[mine] = np.where(z > look.hem, trousers, skin)[mine]
            case "foot":
                which[mine] = shoes
            case "head" if body.scale_name == "stature":
                which[mine] = np.where((z > 0.972) | ((x < 0.005) & (z > 0.9)), hair, skin)[mine]
    out = np.zeros((len(limb), 3))
    for number, paint in enumerate(paints):
        out[which == number] = painted(paint, place[which == number], 100 + number)
    if body.scale_name == "stature" and "head" in body.topology.limbs:
        face = (which == skin) & (limb == body.topology.limbs.index("head"))
        out[face] *= _features(share[face])
    return out


def _features(place: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    """Factor on the skin's colour for eyes, brows and a mouth; places as shares of the stature."""
    x, y, z = place.T
    front, side = x > 0.02, np.abs(y)
    eyes = front & (((side - 0.018) / 0.008) ** 2 + ((z - 0.94) / 0.0035) ** 2 < 1)
    brows = front & (np.abs(side - 0.018) < 0.011) & (np.abs(z - 0.951) < 0.002)
    mouth = front & (side < 0.015) & (np.abs(z - 0.904) < 0.003)
    nose = front & (np.abs(side - 0.006) < 0.002) & (np.abs(z - 0.918) < 0.003)
    out = np.ones((len(place), 3))
    out[eyes | brows | nose] = 0.35
    out[mouth] = 0.8, 0.5, 0.5
    return out
