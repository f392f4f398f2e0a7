"""Body files: built-in bodies, round trip, and refusal of bad files by name, line and reason."""

import re

import jax
import numpy as np
import pytest

from voodoo_jax.geometry.rigid import apply
from voodoo_jax.model.body import bands, joint_centres, scaled, segment_lengths, site_points
from voodoo_jax.model.body_file import BUILT_IN, BodyFileError, format_body, human, load_body, parse_body, read_body
from voodoo_jax.model.body_file import write_body as write

GOOD = """\
name = "two"
scale = 2.0

[[limb]]
name = "a"
bottom = [0, 0, 0]
top = [0, 0, 0.5]
bottom_axes = [0.1, 0.1]
top_axes = [0.1, 0.05]

[[limb]]
name = "b"
bottom = [0, 0, 0.5]
top = [0.5, 0, 0.5]
bottom_axes = [0.1, 0.1]
top_axes = [0.1, 0.1]

[[joint]]
name = "j"
parent = "a"
child = "b"
at = [0, 0, 0.5]
axes = [0, 0.1]

[[centre]]
name = "c"
limb = "b"
at = [0.25, 0.1, 0.5]
"""


def line_of(text: str) -> int:
    return next(i for i, line in enumerate(GOOD.splitlines(), 1) if line == text)


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_bodies_are_connected_and_round_trip(name, tmp_path):
    body = load_body(name)
    assert body.name == name and body.limb_count == len(body.topology.joints) + 1
    b = bands(body)
    parent = apply(body.rest[np.array(body.topology.parents, int)][:, None], b.first_points)
    child = apply(body.rest[np.array(body.topology.children, int)][:, None], b.second_points)
    np.testing.assert_allclose(parent, child, atol=1e-6)  # in the rest pose every band has length zero
    path = tmp_path / "body.toml"
    write(body, path)
    again = read_body(path)
    assert again.topology == body.topology and again.name == body.name and again.scale_name == body.scale_name
    assert again.modes == body.modes and bool(body.modes) == (name == "human")
    for x, y in zip(jax.tree.leaves(body), jax.tree.leaves(again)):
        assert x.dtype == y.dtype and x.dtype in (np.float32, bool) and x.shape == y.shape
        np.testing.assert_allclose(x, y, atol=1e-6)
    assert [p.name for p in tmp_path.iterdir()] == ["body.toml"]


@pytest.mark.parametrize("name", ["human", "human10"])
def test_people_are_mirror_images_and_as_tall_as_said(name):
    body = load_body(name)
    t = body.topology
    flip = np.array([1, -1, 1])
    swap = lambda n: {"l_": "r_", "r_": "l_"}.get(n[:2], n[:2]) + n[2:]  # noqa: E731
    for names, points in ((t.centres, joint_centres(body, body.rest)), (t.sites, site_points(body, body.rest))):
        points = np.asarray(points)
        for i, n in enumerate(names):
            np.testing.assert_allclose(points[i], points[names.index(swap(n))] * flip, atol=1e-6)
    sides = ("shoulder", "elbow", "radiocarpal", "hip", "knee", "talocrural")
    assert set(t.centres) == {"skullbase", "vc7"} | {f"{s}_{n}" for s in "lr" for n in sides}
    vertex = np.asarray(site_points(body, body.rest))[t.sites.index("skull_vertex")]
    np.testing.assert_allclose(vertex[2], body.scale, rtol=1e-5)
    lengths = segment_lengths(scaled(body, 2.0))
    assert set(lengths) == {"upper_arm", "forearm", "thigh", "shank"} and 0.47 < lengths["thigh"] < 0.51


def test_body_read_first_within_a_traced_function_is_usable_outside():
    inside = jax.jit(lambda factor: factor * human().sizes)(1.0)
    assert np.allclose(human().sizes, inside)


def test_limbs_start_at_their_joint():
    body = human()
    t = body.topology
    hand = t.limbs.index("l_hand")
    np.testing.assert_allclose(body.rest.translation[hand, 2] / body.scale, 0.502, atol=1e-6)
    down = apply(body.rest[hand], np.array([0.0, 0, 1], np.float32)) - body.rest.translation[hand]
    np.testing.assert_allclose(down, [0, 0, -1], atol=1e-6)


def test_positions_are_multiples_of_scale_in_limb_frames():
    body = parse_body(GOOD)
    np.testing.assert_allclose(body.sizes, [[0.2, 0.2, 0.2, 0.1, 1], [0.2, 0.2, 0.2, 0.2, 1]], atol=1e-6)
    np.testing.assert_allclose(joint_centres(body, body.rest), [[0.5, 0.2, 1.0]], atol=1e-6)
    np.testing.assert_allclose(body.parent_anchor.translation, [[0, 0, 1]], atol=1e-6)
    np.testing.assert_allclose(body.axes, [[0, 0.2]], atol=1e-6)
    assert body.scale_name == "scale" and body.weights.tolist() == [1.0]


def test_anchors_that_differ_between_parent_and_child_round_trip():
    extra = "axes = [0, 0.1]\nchild_at = [0.01, 0, 0.5]\nx_axis = [1, 1, 0]\nchild_z_axis = [0, 1, 1]\nweight = 0.25"
    body = parse_body(GOOD.replace("axes = [0, 0.1]", extra))
    again = parse_body(format_body(body))
    for x, y in zip(jax.tree.leaves(body), jax.tree.leaves(again)):
        np.testing.assert_allclose(x, y, atol=1e-6)
    assert body.weights.tolist() == [0.25]


def test_single_limb():
    body = parse_body(GOOD.split('[[limb]]\nname = "b"')[0])
    assert body.axes.shape == (0, 2) and body.parent_anchor.rotation.shape == (0, 4) and body.sites.shape == (0, 3)
    assert bands(body).weights.shape == (0, 4)


CASES = [  # text, put in its place, line of the fault, part of the reason
    ("scale = 2.0", "scale = 2.0.0", "scale = 2.0", "not TOML"),
    ("scale = 2.0", "scale = 0", "scale = 2.0", "above 0"),
    ("scale = 2.0", "scale = 1e-300", "scale = 2.0", "at least 1e-06"),
    ("scale = 2.0", "scale = 2000.0", "scale = 2.0", "a body of 2000 m"),
    ("scale = 2.0", f"scale = {'9' * 400}", "scale = 2.0", "at most 1e+06"),
    ("scale = 2.0", 'scale = 2.0\nscale_name = "segment_lengths"', 3, "results use it for something else"),
    ("scale = 2.0", 'scale = 2.0\nscale_name = "name"', 3, "results use it for something else"),
    ("scale = 2.0", 'scale = 2.0\nscale_name = "\\u001b[31m"', 3, "all printable"),
    ("bottom = [0, 0, 0]", "bottom = [0, 1e38, 0]", 6, "at most 1e+06"),
    ("top_axes = [0.1, 0.05]", "top_axes = [0.1, 1e-38]", 9, "at least 1e-06"),
    ("scale = 2.0", "scael = 2.0", "scale = 2.0", "unknown key 'scael' in the top of the file; did you mean 'scale'?"),
    ("scale = 2.0", "", 1, "has no 'scale'"),
    ("bottom = [0, 0, 0]", "", 4, "[[limb]] 'a' has no 'bottom'"),
    ("bottom = [0, 0, 0]", "bottom = [0, 0]", 6, "must be 3 numbers"),
    ("bottom = [0, 0, 0]", "bottom = [0, 0, true]", 6, "must be 3 numbers"),
    ("bottom = [0, 0, 0]", "bottom = [0, nan, 0]", 6, "must be finite"),
    ("bottom = [0, 0, 0]", "bottom = [\n  0,\n 0, 0, 1]", 6, "must be 3 numbers"),
    ("top_axes = [0.1, 0.05]", "top_axes = [0.1, -0.05]", 9, "above 0"),
    ("top_axes = [0.1, 0.05]", "radius = 1\ntop_axes = [0.1, 0.05]", 9, "unknown key 'radius'"),
    ("top_axes = [0.1, 0.05]", "top_axes = [0.1, 0.05]\nx_axis = [0, 0, 1]", 10, "along the z axis"),
    ("top = [0.5, 0, 0.5]", "top = [0, 0, 0.5]", "top = [0.5, 0, 0.5]", "limb 'b' has no length"),
    ("axes = [0, 0.1]", "axes = [0, -0.1]", "axes = [0, 0.1]", "at least 0"),
    ('child = "b"', 'child = "bb"', 'child = "b"', "there is no limb 'bb'; did you mean 'b'?"),
    ('child = "b"', "child = 3", 'child = "b"', "must be a text"),
    ('parent = "a"\nchild = "b"', 'parent = "b"\nchild = "a"', 'child = "b"', "is the root"),
    ('parent = "a"', 'parent = "b"', 11, "in a loop: b on b"),
    ('name = "b"', 'name = "a"', 'name = "b"', "two of [[limb]] 'a'"),
    ('limb = "b"', 'limb = "z"', 'limb = "b"', "there is no limb 'z'"),
    ("[[joint]]", "[joint]", "[[joint]]", "must be written as [[joint]]"),
]


@pytest.mark.parametrize("old, new, line, reason", CASES, ids=[c[3][:30] + str(i) for i, c in enumerate(CASES)])
def test_bad_files_are_refused_with_line_and_reason(old, new, line, reason, tmp_path):
    line = line if isinstance(line, int) else line_of(line)
    path = tmp_path / "bad.toml"
    assert old in GOOD
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(BodyFileError, match=re.escape(reason)) as error:
        read_body(path)
    assert error.value.line == line and str(error.value).startswith(f"{path}:{line}: ")


@pytest.mark.parametrize("changes, reason", [
    ('{ "lengths.c" = 0.1 }', "there is no 'lengths.c'"), ('{ "anchors.j.x" = "far" }', "must be a number"),
    ('{ "radii.a.top" = inf }', "must be a number"), ("{ }", "must be a table of names"),
    ("0.1", "must be a table of names"),
])  # fmt: skip
def test_modes_that_change_nothing_of_the_body_are_refused(changes, reason):
    with pytest.raises(BodyFileError, match=reason) as error:
        parse_body(f'{GOOD}\n[[mode]]\nname = "m"\nchanges = {changes}\n')
    assert error.value.line == len(GOOD.splitlines()) + 4


@pytest.mark.parametrize("value", ["9" * 6000, "[" * 3000], ids=["digits", "brackets"])
def test_what_no_parser_takes(value):
    with pytest.raises(BodyFileError, match="^mine: not TOML"):
        parse_body(f"scale = {value}", "mine")


def test_faults_of_the_tree():
    joint = '\n[[joint]]\nname = "k"\nparent = "a"\nchild = "b"\nat = [0, 0, 0.5]\naxes = [0, 0]\n'
    with pytest.raises(BodyFileError, match="already has the parent 'a'") as error:
        parse_body(GOOD + joint)
    assert error.value.line == len(GOOD.splitlines()) + 5
    with pytest.raises(BodyFileError, match="limb 'b' has no parent"):
        parse_body(re.sub(r"\[\[joint\]\][^[]*\[0, 0, 0\.5\]\naxes = \[0, 0\.1\]\n", "", GOOD))


@pytest.mark.parametrize("name", ["humn", "no/such.toml"])
def test_missing_file(name):
    with pytest.raises(BodyFileError, match="(?i)no such file"):
        load_body(name)


def test_binary_file(tmp_path):
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(BodyFileError, match="not UTF-8"):
        read_body(tmp_path / "b.toml")


def test_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "body.toml"
    path.write_text("old")

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(OSError, match="disk full"):
        write(human(), path)
    assert path.read_text() == "old" and len(list(tmp_path.iterdir())) == 1
