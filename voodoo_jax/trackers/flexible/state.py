"""Inputs, state and results of the flexible tracker's program."""

from typing import Any, NamedTuple

from jaxtyping import Array, Bool, Float, Int

from voodoo_jax.trackers.flexible.scores import Guess, Score, View, Weighing


class Shape(NamedTuple):
    """Static settings, for which a program is compiled."""

    particles: int
    layers: int
    relaxations: int
    refine: int
    hypotheses: int  # bodies tracked at once
    points: bool  # whether measured points are used


class Numbers(NamedTuple):
    """Traced settings: changing them does not compile again."""

    weighing: Weighing
    velocity: Float[Array, ""]
    depth_share: Float[Array, ""]
    depth_noise: Float[Array, "3"]  # metres
    base_noise: Float[Array, ""]
    spread_noise: Float[Array, ""]
    motion_noise: Float[Array, ""]
    follow: Float[Array, "2"]  # horizontal, vertical
    gravity: Float[Array, ""]
    masses: Float[Array, "3"]  # base, variable, falloff per metre
    legs_apart: Float[Array, ""]
    floor: Float[Array, "4"]  # normal upwards and offset, metres
    turning: Float[Array, "2"]  # spread of hypotheses about the vertical and any axis, radians per second
    sharpness: Float[Array, ""]  # factor on the logarithm of a body's weight when hypotheses are resampled


class State(NamedTuple):
    """State carried from frame to frame."""

    x: Float[Array, "16 3"]  # metres, fixed frame
    before: Float[Array, "16 3"]  # one frame earlier
    particles: Float[Array, "4 particle 3 3"]
    previous: Float[Array, "4 particle 3 3"]
    spread: Float[Array, "4 3"]  # standard deviation of the particles, metres
    colours: Float[Array, "4 2 ring 3"]
    learnt: Float[Array, "4 2 ring"]
    rate: Float[Array, ""]  # turning rate about the vertical, radians per second


class Inputs(NamedTuple):
    """Measurements of one frame."""

    view: View
    points: Float[Any, "point 3"]  # on the person, metres
    share: Float[Any, "point"]  # 0: none
    bare: Float[Any, "point"]  # probability that each is skin, 0..1
    head: Float[Any, "3"]  # metres
    head_seen: Float[Any, ""]  # 0 or 1
    up: Float[Any, "3"]
    dt: Float[Any, ""]  # seconds since the last frame
    index: Int[Any, ""]
    learn: Float[Any, ""]  # weight of the image for the reference colours; 0: none
    valid: Bool[Any, ""]  # False: padding
    guess: Guess


class Seen(NamedTuple):
    """Results of the filters in one frame."""

    x: Float[Array, "16 3"]
    spread: Float[Array, "4 3"]
    masses: Float[Array, " 16"]
    score: Score  # of each limb
    explained: Float[Array, ""]  # share of the points near the body
    residual: Float[Array, ""]  # root mean square of their distances, metres
    support: Float[Array, " part"]  # number of points near each part, see cylinders
    off: Float[Array, " part"]  # root mean square distance of each part's points, metres
    fit: Float[Array, ""]  # logarithm of the body's weight, without Numbers.sharpness
    wide: Float[Array, "16"]  # standard deviation between the hypotheses, metres
    follows: Int[Array, ""]  # hypothesis of this frame that this one continues in the next frame
    anew: Float[Array, ""]  # 1: this hypothesis restarted in this frame
