"""Optical marker sets: the body's feature point for each marker name, and the accuracy of placement."""

from math import cos, sin

import numpy as np
from jaxtyping import Float

# Plug-in Gait (Vicon; Davis 1991, Kadaba 1990): marker, its site on the left or in the middle of the body.
_SIDES = {
    "FHD": "front_head",
    "BHD": "back_head",
    "SHO": "acromion",
    "UPA": "lateral_upper_arm",
    "ELB": "humeral_lateral_epicondyle",
    "FRM": "lateral_forearm",
    "FRA": "lateral_forearm",
    "WRA": "wrist_thumb_side",
    "WRB": "wrist_little_side",
    "FIN": "metacarpal_phalanx_2",
    "ASI": "asis",
    "PSI": "psis",
    "THI": "lateral_thigh",
    "KNE": "femoral_lateral_epicondyle",
    "TIB": "lateral_shank",
    "ANK": "lateral_malleolus",
    "HEE": "calcaneus_posterior",
    "TOE": "metatarsal_phalanx_2",
}
_MIDDLE = {
    "C7": "cervicale",
    "T10": "thoracic_10",
    "CLAV": "suprasternale",
    "STRN": "substernale",
    "RBAK": "r_scapula",
    "SACR": "mid_psis",
}
PLUG_IN_GAIT: dict[str, str] = _MIDDLE | {
    side + marker: f"{side.lower()}_{site}" for side in "LR" for marker, site in _SIDES.items()
}

# H-Anim v1 names that logs still use
V1_NAMES = {
    "l_wrist": "l_radiocarpal",
    "r_wrist": "r_radiocarpal",
    "l_ankle": "l_talocrural",
    "r_ankle": "r_talocrural",
    "skull_tip": "skull_vertex",
}

# Metres by which a marker may lie off its site, along its limb's axes (one standard deviation). Bony landmarks are felt
# for, and at the end of a limb their height is surest. Markers of thigh and shank are put into the plane of the limb's
# two joints and the axis of the lower one, at any height; on the arm they may be anywhere.
LANDMARK = (0.015, 0.015, 0.015)
_PLACED = {
    "lateral_malleolus": (0.015, 0.015, 0.006),
    "femoral_lateral_epicondyle": (0.015, 0.015, 0.008),
    "humeral_lateral_epicondyle": (0.015, 0.015, 0.01),
    "wrist_thumb_side": (0.015, 0.015, 0.01),
    "wrist_little_side": (0.015, 0.015, 0.01),
    "lateral_thigh": (0.012, 0.03, 0.08),
    "lateral_shank": (0.015, 0.03, 0.08),
    "lateral_upper_arm": (0.04, 0.02, 0.06),
    "lateral_forearm": (0.04, 0.02, 0.06),
    "scapula": (0.03, 0.03, 0.04),
    "thoracic_10": (0.03, 0.015, 0.04),
    "metatarsal_phalanx_2": (0.015, 0.02, 0.04),
    "acromion": (0.01, 0.01, 0.01),
}
# Sites that go with a joint rather than with the limb that carries both.
RIDES = {"l_acromion": "l_shoulder", "r_acromion": "r_shoulder"}
# Joints whose centre is the middle between two places, on both sides of it (ISB's definitions: Wu 2002, 2005)
MIDDLES = {
    "knee": ("femoral_lateral_epicondyle", "femoral_medial_epicondyle"),
    "ankle": ("lateral_malleolus", "medial_malleolus"),
    "elbow": ("humeral_lateral_epicondyle", "humeral_medial_epicondyle"),
    "wrist": ("radial_styloid", "ulnar_styloid"),
}
# Between joint centres, as shares of stature (from means of ANSUR II: radiale to stylion, acromion to radiale less the
# height of the acromion over the joint, trochanterion, tibiale and lateral malleolus heights).
USUAL_LENGTHS = {"upper_arm": 0.168, "forearm": 0.150, "thigh": 0.245, "shank": 0.240}


def placement(site: str) -> tuple[float, float, float]:
    """Standard deviation in metres of a marker's placement on a site, from person to person."""
    return next((v for end, v in _PLACED.items() if site.endswith(end)), LANDMARK)


def plain_name(name: str) -> str:
    """Marker name without the subject's: LFHD of "Subject:LFHD" and "Name_LFHD", in capitals; else as it is."""
    for mark in (":", "/", "_"):
        last = name.rsplit(mark, 1)[-1].strip()
        if last.upper() in PLUG_IN_GAIT:
            return last.upper()
    return name


def harrington_hips(spines: Float[np.ndarray, "4 3"]) -> Float[np.ndarray, "2 3"]:
    """Left and right hip centre by the regression to magnetic resonance images of Harrington 2007
    (doi:10.1016/j.jbiomech.2006.02.003), in the frame of the markers, metres.

    **Arguments:** `spines` as for `newington_hips`. Radius of markers: 7 mm.
    """
    middle, aside, ahead, width, depth = _pelvis(spines)
    depth -= 2 * 0.007
    forward, up = -0.24 * depth - 0.0099 - 0.007, -0.30 * width - 0.0109
    centre = middle + forward * ahead + up * np.cross(ahead, aside)
    out = (0.33 * width + 0.0073) * aside
    return np.stack([centre + out, centre - out])


def newington_hips(spines: Float[np.ndarray, "4 3"], leg: float) -> Float[np.ndarray, "2 3"]:
    """Left and right hip centre by the Newington regression (Davis 1991), in the frame of the markers, metres.

    **Arguments:** `spines` markers on the spines of the pelvis: front left and right, back left and right; `leg` length
    from front spine to inner ankle, metres. Radius of markers: 7 mm.
    """
    middle, aside, ahead, width, _ = _pelvis(spines)
    theta, beta = 0.5, 0.314
    c, deep = 0.115 * leg - 0.0153, 0.1288 * leg - 0.04856 + 0.007
    forward = c * cos(theta) * sin(beta) - deep * cos(beta)
    up = -c * cos(theta) * cos(beta) - deep * sin(beta)
    centre = middle + forward * ahead + up * np.cross(ahead, aside)
    out = (width / 2 - c * sin(theta)) * aside
    return np.stack([centre + out, centre - out])


def _pelvis(spines: Float[np.ndarray, "4 3"]) -> tuple:
    """Middle between the front spines, unit vectors to the left and ahead, and their distances from each other and from
    the back ones; metres."""
    middle, aside = (spines[0] + spines[1]) / 2, spines[0] - spines[1]
    width = np.linalg.norm(aside)
    aside, behind = aside / width, middle - spines[2:].mean(0)
    ahead = behind - (behind @ aside) * aside
    return middle, aside, ahead / np.linalg.norm(ahead), width, np.linalg.norm(behind)
