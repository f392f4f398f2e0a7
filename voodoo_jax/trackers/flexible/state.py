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
    restarts: int
    flow: bool
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


class State(NamedTuple):
    """What goes from frame to frame."""

    x: Float[Array, "16 3"]  # metres, fixed frame
    before: Float[Array, "16 3"]  # a frame earlier
    particles: Float[Array, "4 particle 3 3"]
    previous: Float[Array, "4 particle 3 3"]
    spread: Float[Array, "4 3"]  # standard deviation of the particles, metres
    colours: Float[Array, "4 2 ring 3"]
    learnt: Float[Array, "4 2 ring"]


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
