"""Options of the flexible tracker."""

from dataclasses import dataclass


@dataclass(frozen=True)
class FlexibleSettings:
    """The flexible tracker (Hecht, Azad, Dillmann 2009): masses and springs, particle filters on images."""

    particles: int = 25
    """Particles of each of the four limbs' filters (the paper: 200)."""
    head_particles: int = 25
    """Particles of the head's filter."""
    hypotheses: int = 16
    """Bodies that are followed at once, each by filters of its own, and drawn again by how well they fit; 1: one."""
    turning: float = 4.0
    """How much faster or slower than before each of them turns about the vertical, radians per second (standard
    deviation)."""
    leaning: float = 1.0
    """And about any axis."""
    sharpness: float = 0.3
    """What the logarithm of a body's weight counts when they are drawn again: less keeps doubtful ones longer."""
    seed: int = 0
    """Random numbers begin here: the same seed gives the same tracks."""
    layers: int = 3
    """Annealing: how often each frame the particles are spread, weighed and drawn again, ever finer (the paper: 1)."""
    velocity: float = 0.6
    """Share of a particle's velocity that is expected to go on (the paper: 0.5 to 0.8)."""
    depth_share: float = 0.25
    """Share of the particles that are spread along the line of sight (alpha in the paper)."""
    depth_noise: tuple[float, ...] = (0.05, 0.12, 0.2)
    """How far they are spread: roots, middles and ends of limbs, metres (the paper: 0.15, 0.5, 1.0)."""
    base_noise: float = 0.02
    """How far all others are spread in any case, metres."""
    spread_noise: float = 0.3
    """And in addition, as a share of how far the particles are apart."""
    motion_noise: float = 0.1
    """And in addition where all the image moves, metres."""
    edge_weight: float = 3.0
    """What the edge score (0 to 1) weighs in the logarithm of a particle's weight."""
    surface_weight: float = 4.0
    """The same of the surface score: colours."""
    depth_weight: float = 10.0
    """The same of the share of a limb's surface that is where depth is measured; 0: no dense depth is used."""
    points_weight: float = 60.0
    """The same of the mean squared distance of measured points to the body; 0: no points are used."""
    skin_weight: float = 6.0
    """The same of the share of skin on a hand as far as it is seen; skin is what has the face's colours and not those
    of clothes. 0: colours of hands are not looked at."""
    hidden_edge: float = 0.35
    """Edge score of a sample that is hidden or outside of the image."""
    hidden_surface: float = 0.5
    """Surface score of such a sample."""
    seen_length: bool = True
    """Scores count by the length of limb that is seen; false: means, as in the paper, which like limbs that point at
    the camera."""
    unseen: float = 1.0
    """What the length of limb that is not seen scores then, as a share of what hidden samples score (0: nothing, so
    that limbs that point at the camera score least)."""
    relaxations: int = 6
    """How often springs and limits are applied after each step."""
    refine: int = 8
    """Rounds of the refinement, in which points pull the cylinders onto themselves; 0: none, as in the paper."""
    follow_level: float = 0.6
    """Share of the head's level motion that all other points follow at once (the paper: 0.8)."""
    follow_up: float = 0.2
    """Share of its motion up and down (the paper: 0.8)."""
    gravity: float = 9.81
    """With which the body dangles from its head, metres per square second."""
    mass_base: float = 0.5
    """m_base: mass of a point whose particles are far apart."""
    mass_variable: float = 6.0
    """m_variable: what is added where they are together: m = m_base + m_variable exp(-mass_falloff sigma)."""
    mass_falloff: float = 20.0
    """How fast it falls with how far they are apart (-s in the paper), per metre."""
    legs_apart: float = 0.0
    """Knees and ankles stay so far on their own side of the plane between the legs, as a share of the stature."""
    legs_cross: float = 0.1
    """They may cross it by so much instead, as those of people do who walk (the paper: not at all)."""
    learn_frames: int = 8
    """Images in which colours are learnt, then they are frozen."""
    points: int = 384
    """Measured points of a frame that are used, at most."""
    backwards: bool = True
    """Also track backwards in time and take, limb by limb, what explains more (not online)."""
    lost_confidence: float = 0.4
    """So small a share of the joints expected within 10 cm: the frame counts as lost."""
