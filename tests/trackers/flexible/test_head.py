"""Colours of skin are told from clothes and the room; the face's depth is found in pairs that have no other depth."""

import numpy as np
import pytest

import voodoo_jax as vj
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.simulate.colour import simulate_colour, stereo_cameras
from voodoo_jax.simulate.mcap import write_colour
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.trackers.flexible.flexible_body import LIMBS, flexible_body
from voodoo_jax.trackers.flexible.head import HeadFilter, find_start, with_bare_legs
from voodoo_jax.trackers.flexible.image_features import Extractor, SkinModel, cells, depth_points

SKIN, SHIRT, TROUSERS, ROOM = (110, 150, 205), (160, 90, 40), (60, 40, 30), (140, 160, 175)  # blue, green, red


def scene() -> dict[str, np.ndarray]:
    """A picture with head and neck, shirt, trousers and hands, and the mask of each."""
    rng, size = np.random.default_rng(0), (120, 160)
    masks = {name: np.zeros(size, bool) for name in ("face", "shirt", "trousers", "hands")}
    masks["face"][10:26, 72:88] = True
    masks["shirt"][26:60, 60:100] = True
    masks["trousers"][60:110, 64:96] = True
    masks["hands"][58:68, 50:58] = True
    image = np.broadcast_to(np.array(ROOM, float), (*size, 3)).copy()
    for name, colour in (("face", SKIN), ("shirt", SHIRT), ("trousers", TROUSERS), ("hands", SKIN)):
        image[masks[name]] = colour
    image = np.clip(image + rng.normal(0, 4, image.shape), 0, 255).astype(np.uint8)
    return {"cell": cells(image), "image": image, **masks}


def test_hands_are_skin_and_a_shirt_is_none_though_the_face_was_cut_out_with_its_collar():
    s, skin = scene(), SkinModel()
    face = s["face"].copy()
    face[26:32, 72:88] = True  # of the shirt
    skin.learn(s["cell"], face, s["shirt"] & ~face | s["trousers"])
    found = skin.on_person(s["cell"]) / 255
    inner = {name: found[s[name]].mean() for name in ("face", "shirt", "trousers", "hands")}
    assert inner["hands"] > 0.8 and inner["face"] > 0.8
    assert inner["shirt"] < 0.3 and inner["trousers"] < 0.1
    general = skin.map(s["cell"])
    assert general[s["hands"]].mean() > 0.6 and general[s["shirt"]].mean() < 0.3


def test_nothing_is_skin_where_clothes_have_its_colour():
    s, skin = scene(), SkinModel()
    image = s["image"].copy()
    image[s["shirt"]] = image[s["face"]].mean(0).astype(np.uint8)
    skin.learn(cells(image), s["face"], s["shirt"])
    assert skin.on_person(cells(image))[s["hands"]].mean() / 255 < 0.4


def test_depth_of_the_face_alone_needs_no_image_again(tmp_path):
    """In the second frame only corners of the face are matched, in what was kept of the pair."""
    body = vj.human()
    motion = placed(make_motion(body, "stand", 0.3, 10.0), 2.6, 0.0, np.pi)
    sim = simulate_colour(body, motion, stereo_cameras(width=640))
    frames = read_log(write_colour(sim, tmp_path / "pair.mcap"), vj.preset("flexible").read).frames
    extract, skin = Extractor(), SkinModel()
    dense, sparse = (
        extract(frame, frame.pictures[0], first) for first, frame in ((True, frames[0]), (False, frames[1]))
    )
    assert dense.pair.size == 0 and not sparse.depth.any()
    points = depth_points(dense)[0]
    person = points[(np.abs(points[:, :2] - (2.6, 0)).max(1) < 0.4) & (points[:, 2] > 0.1)]
    floor = Plane(np.array([0, 0, 1], np.float32), 0.0)
    begin = find_start(dense, person, floor, skin)
    head = HeadFilter(skin, begin.stature, 100, np.random.default_rng(0))
    head.begin(dense, begin.head, True)
    true = sim.joints[1, body.topology.centres.index("skullbase")]
    found = head(sparse)
    assert found is not None and np.linalg.norm(found - true) < 0.06
    assert head(sparse._replace(pair=np.zeros_like(sparse.pair))) is None  # nothing else tells its depth


@pytest.mark.parametrize(("thigh", "shank"), [(0.0, 0.0), (0.1, 0.6), (0.6, 0.6)])
def test_legs_on_which_skin_is_seen_as_on_the_face_are_bare(rng, thigh, shank):
    model = flexible_body(vj.human(), 1.75)
    x = np.asarray(model.rest)
    bones = [(x[rows[k]], x[rows[k + 1]]) for rows in LIMBS[2:] for k in range(2)]
    ends = [(x[0], x[0]), *bones]
    points = np.concatenate([a + rng.uniform(0.1, 0.9, (50, 1)) * (b - a) + [0.05, 0, 0] for a, b in ends])
    skin = np.repeat(np.array([0.6, *(thigh, shank) * 2], np.float32), 50)
    found = with_bare_legs(model, x, points.astype(np.float32), np.ones(250, np.float32), skin)
    covered, usual = np.asarray(found.covered), np.asarray(model.covered)
    np.testing.assert_array_equal(covered[[6, 7, 8]], covered[[9, 10, 11]])
    for part, share in ((6, thigh), (7, shank)):
        if share == 0:
            assert covered[part] == 1
        elif share == 0.6:
            assert covered[part] < 0.05
        else:
            assert 0.3 < covered[part] < 0.7
    others = [*range(6), 8, 12, 13, 14]  # nothing is seen on feet
    np.testing.assert_array_equal(covered[others], usual[others])
