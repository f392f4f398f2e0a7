"""Names of markers and key points: sets as files, ways of writing a side, subjects, numbers, names that nobody gave."""

import pytest

from voodoo_jax.config.options import FeatureSettings
from voodoo_jax.model.body_file import human
from voodoo_jax.model.marker_names import (
    describe_names,
    human_points,
    marker_sets,
    net_key_points,
    nobodys,
    places_of,
    split_place,
    subjects,
)

T = human().topology
POINTS = (*T.sites, *T.centres)
CAST = "FLE FME FAL TAM FCC FM1 FM5 IAS IPS TH1 TH2 SK1 SK2 HLE HME RSP USP"
# of each system some names on the left, with the place that each means
SYSTEMS = {
    "cast": ("SJN CV7", CAST, {"FLE": "femoral_lateral_epicondyle", "TAM": "medial_malleolus", "TH2": "thigh"}),
    "rajagopal": (
        "C7 CLAV", "ACR LEL MEL FAradius FAulna ASI PSI TH1 LFC MFC TB1 LMAL MMAL CAL TOE MT5",
        {"LFC": "femoral_lateral_epicondyle", "FAulna": "ulnar_styloid", "TB1": "shank"},
    ),
    "words": (
        "C7", "Knee_Lat Knee_Med Ankle_Lat Ankle_Med Elbow_Lat Elbow_Med ASIS PSIS Heel Thigh_Front Shank_Rear",
        {"Knee_Med": "femoral_medial_epicondyle", "Thigh_Front": "thigh", "Heel": "calcaneus_posterior"},
    ),
    "optitrack": (
        "HeadTop Chest BackTop", "ShoulderTop ElbowOut WristOut HandOut Thigh KneeOut Shin AnkleOut Heel ToeIn ToeTip",
        {"KneeOut": "femoral_lateral_epicondyle", "AnkleOut": "lateral_malleolus", "Shin": "shank"},
    ),
    "net": (
        "nose", "eye ear shoulder elbow wrist hip knee ankle heel",
        {"shoulder": "shoulder", "wrist": "radiocarpal", "ankle": "talocrural", "ear": "tragion"},
    ),
    "mixamo": (
        "Hips Spine2 Neck Head", "Shoulder Arm ForeArm Hand UpLeg Leg Foot ToeBase",
        {"Arm": "shoulder", "ForeArm": "elbow", "Hand": "radiocarpal", "UpLeg": "hip", "Leg": "knee"},
    ),
    "xsens": (
        "Pelvis T8 Neck Head", "UpperArm Forearm Hand UpperLeg LowerLeg Foot Toe",
        {"UpperArm": "shoulder", "UpperLeg": "hip", "LowerLeg": "knee", "Foot": "talocrural"},
    ),
}  # fmt: skip
WAYS = {
    "LKnee": lambda side, name: side + name,
    "L_Knee": lambda side, name: f"{side}_{name}",
    "L.Knee": lambda side, name: f"{side}.{name}",
    "Knee_L": lambda side, name: f"{name}_{side}",
    "Knee.L": lambda side, name: f"{name}.{side}",
    "mixamorig:LeftKnee": lambda side, name: "mixamorig:" + ("Left" if side == "L" else "Right") + name,
    "left knee": lambda side, name: ("left " if side == "L" else "right ") + name,
    "LeftKnee": lambda side, name: ("Left" if side == "L" else "Right") + name,
    "Bob:LKnee": lambda side, name: f"Bob:{side}{name}",
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("system", SYSTEMS)
def test_sides_and_case_are_written_in_any_way(system, way):
    middle, sided, some = SYSTEMS[system]
    names = [*middle.split(), *(WAYS[way](side, name) for name in sided.split() for side in "LR")]
    for case in (str, str.lower, str.upper):
        prefix, mark, _ = names[-1].partition(":")
        written = [case(n.removeprefix(prefix + mark)) if mark else case(n) for n in names]
        written = [f"{prefix}:{n}" for n in written] if mark else written
        (group,) = subjects(written).values()
        known = places_of(group, POINTS, T.limbs)
        assert len(known.places) == len(names) and not known.unknown, (case, known)
        for name, place in some.items():
            for side in "LR":
                full = written[names.index(WAYS[way](side, name))]
                assert split_place(known.places[full])[0] == f"{side.lower()}_{place}"


def test_every_place_of_every_set_is_on_the_default_body():
    assert len(marker_sets()) >= 10
    points, limbs = human_points()
    assert points == POINTS and limbs == T.limbs
    for one in marker_sets():
        for table, sides in ((one.middle, ("",)), (one.sides, ("l_", "r_"))):
            for _, place in table:
                point, metres = split_place(place)
                assert all({side + point, point} & {*points, *limbs} for side in sides), (one.title, place)
                assert metres is None or 0.01 <= metres <= 0.2


def test_what_is_one_word_in_two_systems_is_told_by_the_others():
    """R.Knee is a marker on the skin beside ASIS and clusters, and a joint's centre beside Neck and RHip."""
    markers = [f"{s}.{n}" for n in ("Knee", "Ankle", "Elbow", "Wrist", "ASIS", "PSIS", "TH1", "SH1") for s in "LR"]
    points = [s + n for n in ("Hip", "Knee", "Ankle", "Elbow", "Wrist", "Shoulder") for s in "LR"] + ["Neck"]
    place = lambda names, one: places_of({n: n for n in names}, POINTS, T.limbs).places[one]  # noqa: E731
    assert place(markers, "R.Knee") == "r_femoral_lateral_epicondyle"
    assert place(points, "RKnee") == "r_knee"
    assert net_key_points(points) and not net_key_points(markers)


def test_of_two_names_for_one_place_the_longer_one_is_meant():
    """R.Ulna is near the elbow where R.Wrist.Uln is there; alone it is the wrist's."""
    names = [
        f"{s}.{n}" for n in ("ASIS", "Knee.Lat", "Ankle.Lat", "Epi.Lat", "GT", "TTA", "Fibula", "Ulna") for s in "LR"
    ]
    known = places_of({n: n for n in names}, POINTS, T.limbs)
    assert known.places["R.Ulna"] == "r_ulnar_styloid" and not known.unknown
    for more in (["L.Wrist.Uln", "R.Wrist.Uln", *names], [*names, "L.Wrist.Uln", "R.Wrist.Uln"]):
        known = places_of({n: n for n in more}, POINTS, T.limbs)
        assert known.places["R.Wrist.Uln"] == "r_ulnar_styloid" and set(known.unknown) == {"L.Ulna", "R.Ulna"}
        assert known.places["L.TTA"] == "l_tibial_tuberosity" and known.places["L.GT"] == "l_trochanterion"


def test_chance_is_no_set():
    assert not places_of({n: n for n in ("head", "LHip", "cup", "door", "table", "box")}, POINTS, T.limbs).places


def test_subjects():
    names = "LASI RASI LKNE RKNE LANK RANK C7".split()
    two = [f"{who}{mark}{n}" for who in ("Anna", "Ben") for mark in (":",) for n in names]
    assert {s: list(g.values()) for s, g in subjects(two).items()} == {"Anna": names, "Ben": names}
    under = [f"{who}_{n}" for who in ("Anna", "Ben") for n in names]
    assert set(subjects(under)) == {"Anna", "Ben"}
    assert subjects(names) == {"": {n: n for n in names}}
    # first words of markers are no people, and points that nobody named are nobody's subject
    words = [f"{limb}_{where}" for limb in ("thigh", "shank") for where in ("1", "2", "3", "4", "5", "6")]
    assert set(subjects(words)) == {""}
    assert set(subjects([f"Anna:{n}" for n in names] + ["*1", "*2"])) == {"Anna"}
    # Azure Kinect's driver: 100 times the body, and the joint
    numbers = [str(100 * body + joint) for body in (1, 2) for joint in (3, 5, 6, 7, 12, 13, 14, 18)]
    found = subjects(numbers)
    assert list(found) == ["body 1", "body 2"] and found["body 1"]["106"] == "elbow_left"
    known = places_of(found["body 1"], POINTS, T.limbs)
    assert known.places["114"] == "r_radiocarpal" and known.weights["114"] > 0 and "Kinect" in known.titles[0]


@pytest.mark.parametrize(
    "word, count, right",
    [
        ("landmark_", 33, {14: "r_elbow", 23: "l_hip", 28: "r_talocrural"}),
        ("people/pose/keypoint ", 17, {6: "r_shoulder", 9: "l_radiocarpal", 13: "l_knee"}),
        ("skeleton/", 25, {2: "r_shoulder", 7: "l_radiocarpal", 10: "r_knee"}),
    ],
)
def test_numbers_behind_a_word_are_those_of_the_net_that_has_so_many(word, count, right):
    names = [f"{word}{k}" for k in range(count)]
    (found,) = subjects(names).values()
    known = places_of(found, POINTS, T.limbs)
    assert {k: split_place(known.places[f"{word}{k}"])[0] for k in right} == right
    # others are nobody's, and so are bare ones: any system gives such to what nobody named
    for other in ([f"{word}{k}" for k in range(14)], [f"marker_{k}" for k in range(count)]):
        assert not any(places_of(group, POINTS, T.limbs).places for group in subjects(other).values())


def test_points_that_nobody_named():
    assert all(map(nobodys, ("*12", "C_7", "Unlabeled 3", "x52", "M012", "17", "unnamed-4")))
    assert not any(map(nobodys, ("C7", "T10", "LASI", "RTH1", "S2", "L5")))


def test_what_info_says():
    (said,) = describe_names([s + n for n in CAST.split() for s in "LR"], FeatureSettings())
    assert "34 of 34" in said and "CAST" in said
    asked = describe_names([*(s + n for n in CAST.split() for s in "LR"), "zebra", "*3", "face"], FeatureSettings())[1]
    assert asked.endswith("--features.names 'zebra=...'")
    assert not describe_names(["l_wrist", "face", "skullbase"], FeatureSettings())
