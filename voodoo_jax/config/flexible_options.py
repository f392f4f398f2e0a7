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
    """Seed of the random numbers: the same seed gives the same tracks."""
    layers: int = 3
    """Annealing layers per frame: particles are spread, weighed and resampled, finer in each layer (the paper: 1)."""
    velocity: float = 0.6
    """Share of a particle's velocity in the prediction (the paper: 0.5 to 0.8)."""
    depth_share: float = 0.25
    """Share of the particles that are spread along the line of sight (alpha in the paper)."""
    depth_noise: tuple[float, ...] = (0.05, 0.12, 0.2)
    """Noise of these particles at roots, middles and ends of limbs, metres (the paper: 0.15, 0.5, 1.0)."""
    base_noise: float = 0.02
    """Noise of all other particles, metres."""
    spread_noise: float = 0.3
    """Additional noise, as a share of the particles' spread."""
    motion_noise: float = 0.1
    """Additional noise if the whole image moves, metres."""
    edge_weight: float = 3.0
    """Weight of the edge score (0 to 1) in the logarithm of a particle's weight."""
    surface_weight: float = 4.0
    """Weight of the surface score (colours) there."""
    depth_weight: float = 10.0
    """Weight of the share of a limb's surface that agrees with measured depth; 0: no dense depth is used."""
    points_weight: float = 60.0
    """Weight of the mean squared distance of measured points to the body; 0: no points are used."""
    skin_weight: float = 6.0
    """Weight of the share of skin colour on the visible part of a hand; skin has colours of the face that clothes have
    not. 0: colours of hands are not used."""
    hidden_edge: float = 0.35
    """Edge score of a sample that is hidden or outside of the image."""
    hidden_surface: float = 0.5
    """Surface score of such a sample."""
    seen_length: bool = True
    """Weight scores by the visible length of a limb; false: use means, as in the paper, which favours limbs that point
    at the camera."""
    unseen: float = 1.0
    """Score of the invisible length with seen_length, relative to that of hidden samples (0: none, so that limbs that
    point at the camera get the lowest score)."""
    relaxations: int = 6
    """Rounds of springs and limits after each step."""
    refine: int = 8
    """Rounds of the refinement, in which points pull the cylinders; 0: none, as in the paper."""
    follow_level: float = 0.6
    """Share of the head's horizontal motion that all other points follow at once (the paper: 0.8)."""
    follow_up: float = 0.2
    """Share of its vertical motion (the paper: 0.8)."""
    gravity: float = 9.81
    """Gravity on the body, which hangs from its head, metres per square second."""
    mass_base: float = 0.5
    """m_base: mass of a point whose particles are far apart."""
    mass_variable: float = 6.0
    """m_variable: additional mass if they agree: m = m_base + m_variable exp(-mass_falloff sigma)."""
    mass_falloff: float = 20.0
    """Decrease of the additional mass with the particles' spread (-s in the paper), per metre."""
    legs_apart: float = 0.0
    """Distance of knees and ankles from the plane between the legs, on their own side, as a share of the stature."""
    legs_cross: float = 0.1
    """Distance by which they may cross it instead, as in walking, as a share of the stature (the paper: 0)."""
    learn_frames: int = 8
    """Images in which colours are learnt; then they are frozen."""
    points: int = 384
    """Largest number of measured points of a frame."""
    backwards: bool = True
    """Also track backwards in time; each limb comes from the pass that explains more (not online)."""
    lost_confidence: float = 0.4
    """A frame is lost if the mean confidence of the joints is below this."""
