"""What the program of the flexible tracker takes, keeps from frame to frame and gives."""

from typing import Any, NamedTuple

from jaxtyping import Array, Bool, Float, Int

from voodoo_jax.trackers.flexible.scores import Score, View, Weighing


class Shape(NamedTuple):
    """What a program is compiled for."""

    particles: int
    layers: int
    relaxations: int
    refine: int
    hypotheses: int  # bodies that are followed at once
    points: bool  # whether measured points are used at all


class Numbers(NamedTuple):
    """Settings that are traced: changing them compiles nothing."""

    weighing: Weighing
    velocity: Float[Array, ""]
    depth_share: Float[Array, ""]
    depth_noise: Float[Array, "3"]  # metres
    base_noise: Float[Array, ""]
    spread_noise: Float[Array, ""]
    motion_noise: Float[Array, ""]
    follow: Float[Array, "2"]  # level, up
    gravity: Float[Array, ""]
    masses: Float[Array, "3"]  # base, variable, falloff per metre
    legs_apart: Float[Array, ""]
    floor: Float[Array, "4"]  # normal upwards and offset, metres
    turning: Float[Array, "2"]  # of a hypothesis, about the vertical and about any axis, radians per second
    sharpness: Float[Array, ""]  # what the logarithm of a body's weight counts when hypotheses are drawn again


class State(NamedTuple):
    """What goes from frame to frame."""

    x: Float[Array, "16 3"]  # metres, fixed frame
    before: Float[Array, "16 3"]  # a frame earlier
    particles: Float[Array, "4 particle 3 3"]
    previous: Float[Array, "4 particle 3 3"]
    spread: Float[Array, "4 3"]  # standard deviation of the particles, metres
    colours: Float[Array, "4 2 ring 3"]
    learnt: Float[Array, "4 2 ring"]
    rate: Float[Array, ""]  # of turning about the vertical, radians per second


class Inputs(NamedTuple):
    """What is seen in a frame."""

    view: View
    points: Float[Any, "point 3"]  # on the person, metres
    share: Float[Any, "point"]  # 0: none
    bare: Float[Any, "point"]  # how likely each is skin, 0..1
    head: Float[Any, "3"]  # metres
    head_seen: Float[Any, ""]  # 0 or 1
    up: Float[Any, "3"]
    dt: Float[Any, ""]  # seconds since the last frame
    index: Int[Any, ""]
    learn: Float[Any, ""]  # what the image counts for the colours; 0: nothing
    valid: Bool[Any, ""]  # False: no frame, only there to fill up
    guess: Float[Any, "16 3"]  # the body as it seems to be in this frame alone, metres
    guessed: Float[Any, ""]  # 0 or 1


class Seen(NamedTuple):
    """What a frame says of itself."""

    x: Float[Array, "16 3"]
    spread: Float[Array, "4 3"]
    masses: Float[Array, " 16"]
    score: Score  # of each limb
    explained: Float[Array, ""]  # share of the points near the body
    residual: Float[Array, ""]  # root mean square distance of these, metres
    support: Float[Array, " part"]  # points of each part, see cylinders
    off: Float[Array, " part"]  # root mean square distance of each part's points, metres
    fit: Float[Array, ""]  # logarithm of the body's weight, not yet tempered
    wide: Float[Array, "16"]  # how far the hypotheses are apart, standard deviation, metres
    follows: Int[Array, ""]  # the hypothesis of this frame that the one in this place goes on from in the next frame
    anew: Float[Array, ""]  # 1: this hypothesis began in this frame
