"""Colours of skin are told from clothes and the room."""

import numpy as np

from voodoo_jax.trackers.flexible.image_features import SkinModel

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
    return {"image": image, **masks}


def test_hands_are_skin_and_a_shirt_is_none_though_the_face_was_cut_out_with_its_collar():
    s, skin = scene(), SkinModel()
    face = s["face"].copy()
    face[26:32, 72:88] = True  # of the shirt
    skin.learn(s["image"], face, s["shirt"] & ~face | s["trousers"])
    found = skin.on_person(s["image"]) / 255
    inner = {name: found[s[name]].mean() for name in ("face", "shirt", "trousers", "hands")}
    assert inner["hands"] > 0.8 and inner["face"] > 0.8
    assert inner["shirt"] < 0.3 and inner["trousers"] < 0.1
    general = skin.map(s["image"])
    assert general[s["hands"]].mean() > 0.6 and general[s["shirt"]].mean() < 0.3


def test_nothing_is_skin_where_clothes_have_its_colour():
    s, skin = scene(), SkinModel()
    image = s["image"].copy()
    image[s["shirt"]] = image[s["face"]].mean(0).astype(np.uint8)
    skin.learn(image, s["face"], s["shirt"])
    assert skin.on_person(image)[s["hands"]].mean() / 255 < 0.4
