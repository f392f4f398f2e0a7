"""Floor, walls, flying pixels, furniture, background: the body told apart from its surroundings."""

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tests.support.rooms import FLOOR, ORIGIN, box, build_of, figure, frame, grid, room
from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect.body_likelihood import Build
from voodoo_jax.detect.scene import find_scene
from voodoo_jax.detect.segmentation import BodySegmenter
from voodoo_jax.geometry.plane import Plane
from voodoo_jax.geometry.point_cloud import fair_share, point_gap, point_spacing, without_strays
from voodoo_jax.geometry.voxels import components
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Scene


def heights_of(scene: Scene, points) -> np.ndarray:
    return scene.floor.height(np.asarray(points, np.float32))


@pytest.mark.parametrize("degrees", [0, 20, -20, 35])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_floor_is_found_although_up_is_wrong(rng, degrees, axis):
    """A tilted camera whose log has no transform: `up` is off, floor and wall are found as they are."""
    cloud = np.concatenate([room(rng), figure(2.5, 0.0) + rng.normal(0, 0.006, (len(figure(2.5, 0)), 3))])
    tilt = Rotation.from_euler(axis, degrees, degrees=True)
    moved = tilt.apply(cloud).astype(np.float32)
    scene = find_scene([frame(moved)], np.array([0, 0, 1], np.float32), up_is_sure=False)
    assert scene.floor_seen
    angle = np.degrees(np.arccos(np.clip(scene.floor.normal @ tilt.apply([0, 0, 1]), -1, 1)))
    assert angle < 0.5
    np.testing.assert_allclose(heights_of(scene, tilt.apply([[2.5, 0, 0], [2.5, 0, 1.75]])), [0, 1.75], atol=0.02)
    assert max(abs(w.normal @ tilt.apply([1, 0, 0])) for w in scene.walls) > 0.999


def test_no_floor_in_view(rng):
    """Only the upper body in view: z = 0 where the frame is known to stand on the floor, else the lowest points."""
    upper = figure(1.5, 0.0)
    upper = upper[upper[:, 2] > 0.9]
    up = np.array([0, 0, 1], np.float32)
    sure = find_scene([frame(upper - [0, 0, 0.8])], up, up_is_sure=True)
    unsure = find_scene([frame(upper)], up, up_is_sure=False)
    cut_off = find_scene([frame(upper)], up, up_is_sure=True)  # no legs in the picture: nothing speaks against z = 0
    assert not cut_off.floor_seen and cut_off.floor.offset == 0.0
    assert unsure.floor_open and not cut_off.floor_open and not sure.floor_open
    assert not sure.floor_seen and sure.floor.offset == 0.0
    assert not unsure.floor_seen and unsure.floor.offset == pytest.approx(
        0.9, abs=0.03
    )  # the figure's rows are 2.5 cm apart
    below = find_scene([frame(figure(1.5, 0.0) - [0, 0, 0.08])], up, up_is_sure=True)  # feet that stand lower
    assert not below.floor_seen and not below.floor_open and below.floor.offset == pytest.approx(-0.08, abs=0.03)
    nothing = find_scene([], up)
    assert not nothing.floor_seen and nothing.walls == ()


@pytest.mark.parametrize("cut, floor", [(0.7, 0.0), (0.3, 0.3)])
def test_who_is_cut_off_stands_lower_than_the_picture_ends(cut, floor):
    """Nobody knows the floor: it is under the body as far as a body is high, if little of it is seen."""
    person, low = figure(2.0, 0.0), box(2.5, 1.2, 0.5, 0.4) + [0, 0, cut]
    scene = Scene(Plane(FLOOR.normal, cut), (), False, floor_open=True)
    finder = BodySegmenter(scene, build_of(1.75), DetectSettings())
    assert not len(finder(frame(low)).points)  # furniture before anybody comes
    got = finder(frame(np.concatenate([person[person[:, 2] > cut], low]), 1)).points
    assert len(got) > 1000 and got[:, 1].max() < 0.5
    assert finder.scene.floor.offset == pytest.approx(floor, abs=0.03) and finder.scene.floor_open == (floor == cut)
    np.testing.assert_allclose(
        finder.clearing.places(np.zeros((1, 3), np.float32))[0], -finder.scene.floor.offset, atol=1e-6
    )


def test_the_lower_edge_of_what_is_seen_is_no_floor(rng):
    """A camera that looks over the floor: the wall and the person end on a plane that is nearly level."""
    seen = np.concatenate([room(rng), figure(2.5, 0.0) + rng.normal(0, 0.006, (len(figure(2.5, 0.0)), 3))])
    edge = 1.2 - 0.15 * seen[:, 0]  # of the picture: a ray that falls 15 cm a metre
    scene = find_scene([frame(seen[seen[:, 2] > edge])], np.array([0, 0, 1], np.float32))
    assert not scene.floor_seen and scene.floor.offset == 0.0
    whole = find_scene([frame(seen)], np.array([0, 0, 1], np.float32))
    assert whole.floor_seen and abs(whole.floor.offset) < 0.01


def test_a_chest_is_no_floor(rng):
    """An upper body and nothing else, close by: least squares turn a plane that may be a floor until it stands."""
    y, z = rng.uniform(-0.22, 0.22, 8000), rng.uniform(0.85, 1.25, 8000)
    chest = np.stack([0.85 + 0.6 * y**2 + 0.12 * (z - 0.85) + rng.normal(0, 0.004, 8000), y, z], 1)
    y, z = rng.uniform(-0.08, 0.08, 8000), rng.uniform(1.25, 1.46, 8000)
    head = np.stack([1.03 - np.sqrt(0.01 - y**2), y, z], 1)
    scene = find_scene([frame(np.concatenate([chest, head]))], np.array([0, 0, 1], np.float32))
    assert not scene.floor_seen and scene.floor.normal[2] == 1.0


def test_noise_behind_a_wall_is_the_wall_and_the_next_room_is_not(rng):
    wall = Plane(np.array([-1, 0, 0], np.float32), -3.5)
    finder = lambda: BodySegmenter(Scene(FLOOR, (wall,), True), build_of(1.75), DetectSettings())  # noqa: E731
    assert not len(finder()(frame(figure(3.78, 0.0))).points)  # 10 cm behind it
    assert len(finder()(frame(figure(4.5, 0.0))).points) > 100


def test_a_noisy_wall_leaves_nothing_that_might_be_somebody(rng):
    """Far walls are noisy: what seems to stand out from one is the wall, as far out as others seem to be behind it."""
    around = room(rng, 6.0, 0.07)
    scene = find_scene([frame(around)], np.array([0, 0, 1], np.float32))
    back = [w for w in scene.walls if w.normal[0] < -0.99]
    assert back and all(0.08 < w.noise < 0.25 for w in back)
    seen = np.concatenate([around, figure(5.0, 0.0) + rng.normal(0, 0.03, (len(figure(5.0, 0.0)), 3))])
    got = BodySegmenter(scene, build_of(1.75), DetectSettings())(frame(seen)).points
    assert len(got) > 1000 and (got[:, 0] < 5.3).mean() > 0.99


@pytest.mark.parametrize("gap", [0.4, 0.25])
def test_a_wall_does_not_eat_the_person_before_it(rng, gap):
    """All of the wall goes, all of the person stays."""
    wall = 3.5
    person = figure(wall - gap, 0.3)
    person += rng.normal(0, 0.006, person.shape)
    around = room(rng, wall)
    hidden = (np.abs(around[:, 1] - 0.3) < 0.18) & (around[:, 0] > wall - 0.1) & (around[:, 2] < 1.75)
    around = around[~hidden]
    seen = frame(np.concatenate([around, person]))
    scene = find_scene([seen], np.array([0, 0, 1], np.float32))
    assert any(abs(w.normal[0]) > 0.999 and abs(abs(w.offset) - wall) < 0.02 for w in scene.walls)
    got = BodySegmenter(scene, build_of(1.75), DetectSettings())(seen).points
    expected = person[person[:, 2] > 0.05]
    assert (cKDTree(got).query(expected)[0] < 1e-6).mean() > 0.99
    assert (cKDTree(person).query(got)[0] < 1e-6).all()


def test_a_person_who_fills_the_picture_is_no_wall(rng):
    person = figure(1.2, 0.0, radius=0.25)
    scene = find_scene([frame(person + rng.normal(0, 0.004, person.shape))], np.array([0, 0, 1], np.float32))
    assert scene.walls == ()


@pytest.mark.parametrize("beside", ["a box", "more of the wall"])
def test_a_person_and_a_box_in_one_plane_are_no_wall_but_a_wall_behind_a_desk_is(rng, beside):
    """Somebody's flat back, and two metres from there something else, as far away."""
    high = (0.05, 0.8) if beside == "a box" else (0.7, 2.2)  # over the desk
    flat = np.concatenate([grid((-0.6, -0.1), (0.05, 1.9), 0.02), grid((0.5, 1.6), high, 0.02)])
    points = np.column_stack([np.full(len(flat), 3.0), flat]) + rng.normal(0, 0.006, (len(flat), 3))
    ground = np.column_stack(
        [grid((1.5, 3.0), (-1.0, 2.0), 0.04), rng.normal(0, 0.006, len(grid((1.5, 3.0), (-1.0, 2.0), 0.04)))]
    )
    scene = find_scene([frame(np.concatenate([points, ground]))], np.array([0, 0, 1], np.float32))
    assert scene.floor_seen and len(scene.walls) == (beside != "a box")


def test_flying_pixels_go_and_the_surface_stays(rng):
    spacing = 0.008
    a = grid((-0.3, 0.3), (-0.6, 0.6), spacing * 2.0)
    surface = np.column_stack([np.full(len(a), 2.0), a]) + rng.normal(0, 0.008, (len(a), 3))
    flying = np.column_stack([rng.uniform(2.2, 3.8, 60), np.full(60, 0.31), rng.uniform(-0.6, 0.6, 60)])
    points = np.concatenate([surface, flying]).astype(np.float32)
    keep = without_strays(points, np.zeros(3, np.float32), spacing)
    assert keep[: len(surface)].mean() > 0.99 and keep[len(surface) :].mean() < 0.15
    assert not without_strays(points[:4], np.zeros(3, np.float32), spacing).any()


def test_flying_pixels_are_those_that_a_search_tree_finds(rng):
    """A wall, a thing before it, and pixels between them, unevenly thinned."""
    spacing, u, v = 0.006, *np.meshgrid(np.arange(-0.5, 0.5, 0.006), np.arange(-0.4, 0.4, 0.006))
    depth = np.where((np.abs(u) < 0.1) & (v < 0.3), 2.5 + 0.3 * u, 4.0 + rng.normal(0, 0.02, u.shape))
    edge = np.abs(np.abs(u) - 0.1) < 0.006
    depth[edge] = rng.uniform(2.5, 4.0, edge.sum())
    points = (np.stack([np.ones_like(u), u, v], -1) * depth[..., None]).reshape(-1, 3).astype(np.float32)
    points = points[rng.uniform(size=len(points)) < np.linspace(0.1, 1, len(points))]
    near = 0.02 + 3 * spacing * np.linalg.norm(points, axis=1)
    expected = cKDTree(points).query(points, k=4)[0][:, 3] < near
    found = without_strays(points, np.zeros(3, np.float32), spacing)
    assert 200 < (~expected).sum() < 0.2 * len(points)
    assert (found & ~expected).sum() < 0.05 * (~expected).sum() and (~found & expected).sum() < 0.01 * expected.sum()


def test_what_was_gone_through_is_not_gone_through_again_and_who_comes_is_found():
    """A cupboard, a look at it that finds nobody, and one with somebody before it."""
    cupboard = box(3.0, -1.0, 0.6, 0.6)
    scene, person = Scene(FLOOR, (), True), figure(2.2, 0.3)
    first = BodySegmenter(scene, build_of(1.75), DetectSettings())
    assert not len(first(frame(cupboard)).points) and len(first.asked) > 100

    def looked(points) -> tuple[BodySegmenter, int]:
        finder = first.another(DetectSettings())
        finder.passed = first.asked
        return finder, len(finder(frame(points)).points)

    finder, count = looked(cupboard + [0.01, 0, 0])
    assert count == 0 and not finder.others.size and finder.likely == 0.0  # nothing was weighed
    assert looked(np.concatenate([cupboard, person]))[1] > 0.8 * len(person)


@pytest.mark.parametrize("link", [0.06, 0.12, 0.3])
def test_components_against_brute_force(rng, link):
    """Cells make the limit fuzzy: nearer than half of `link` is always one thing, farther than twice the cell's
    diagonal never."""
    points = (rng.uniform(-3, 3, (40, 1, 3)) + rng.normal(0, link / 3, (40, 12, 3))).reshape(-1, 3).astype(np.float32)
    label = components(points, link)

    def within(distance):
        pairs = cKDTree(points).query_pairs(distance, output_type="ndarray")
        graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
        return connected_components(graph, directed=False)[1]

    same = lambda of: of[:, None] == of[None]  # noqa: E731
    tight, loose = same(within(link / 2)), same(within(2 * np.sqrt(3) * link / 2 + 1e-5))
    assert np.all(~tight | same(label)) and np.all(~same(label) | loose)
    assert len(np.unique(label)) > 5
    # neither the order of the points nor where the room begins matters beyond the cells
    order = rng.permutation(len(points))
    np.testing.assert_array_equal(same(components(points[order], link)), same(label)[np.ix_(order, order)])


def test_things_far_apart_on_a_line_are_not_joined():
    """A far outlier in one direction only: cell numbers must not run into each other."""
    points = np.array([[0, 0, 0], [0, 0, 50.0], [0, 0.1, -50], [70, 0, 0], [0.01, 0, 0]], np.float32)
    label = components(points, 0.12)
    assert len(np.unique(label)) == 4 and label[0] == label[4]


def test_the_person_and_not_the_larger_wardrobe(rng):
    """A wardrobe is larger, but of another height than the body."""
    person, wardrobe = figure(2.5, 0.8), box(3.0, -0.8, 0.8, 2.2)
    scene = Scene(FLOOR, (), True)
    got = BodySegmenter(scene, build_of(1.7), DetectSettings())(frame(np.concatenate([wardrobe, person]))).points
    assert len(got) > 100 and (got[:, 1] > 0.4).all()


def test_the_person_and_not_the_pole_before_them(rng):
    """What is near has many points, and a lamp may be as high as a person."""
    pole, person = figure(1.0, 0.4, 1.7, radius=0.04), figure(3.5, -0.5)
    person = person[rng.random(len(person)) < 0.3]
    assert len(person) < len(pole) / 3
    both, scene = frame(np.concatenate([pole, person])), Scene(FLOOR, (), True)
    got = BodySegmenter(scene, Build(1.7, 0.5), DetectSettings())(both).points
    assert len(got) > 100 and (got[:, 1] < 0).all()
    assert (
        len(BodySegmenter(scene, Build(1.7, 0.5), DetectSettings())(frame(pole)).points) > 100
    )  # alone it might be anybody


def test_low_high_or_hanging_things_are_not_taken(rng):
    scene = Scene(FLOOR, (), True)
    lamp = figure(2.5, 0.0, 0.4) + [0, 0, 1.3]  # from 1.3 to 1.7 m: nothing below
    for thing in (box(2.5, 0, 0.5, 0.8), box(2.5, 0, 0.5, 2.4), lamp):
        assert len(BodySegmenter(scene, build_of(1.7), DetectSettings())(frame(thing)).points) == 0


def test_head_and_trunk_behind_a_counter_are_taken_and_not_the_counter():
    scene = Scene(FLOOR, (), True)
    half = figure(2.5, 0.0, 0.7) + [0, 0, 1.0]  # from 1.0 to 1.7 m
    counter = np.concatenate([np.full((len(at := grid((-1.0, 1.0), (0, 1.15))), 1), 1.9), at], 1)
    for others in (np.zeros((0, 3)), counter):
        both = frame(np.concatenate([half, others]))
        got = BodySegmenter(scene, build_of(1.7), DetectSettings())(both).points
        assert len(got) > 100 and got[:, 2].min() > 0.9 and got[:, 0].min() > 2.0


def test_followed_while_sitting_down_and_found_anew_after_leaving():
    """Height counts at the start only; who is away for `forget` frames is looked for everywhere."""
    settings = DetectSettings(forget=5)
    finder = BodySegmenter(Scene(FLOOR, (), True), build_of(1.75), settings)
    count = lambda points, i: len(finder(frame(points, i)).points)  # noqa: E731
    heights = [*np.linspace(1.75, 0.8, 12)]
    assert all(count(figure(2.5, 0, h), i) > 100 for i, h in enumerate(heights))
    nothing = np.zeros((0, 3))
    assert [count(nothing, 20 + i) for i in range(3)] == [0] * 3
    elsewhere = figure(2.5, 2.5)
    assert count(elsewhere, 24) == 0  # too far from where she was
    assert [count(nothing, 25 + i) for i in range(6)] == [0] * 6
    assert count(elsewhere, 40) > 100


def test_background_is_learned():
    """What stood apart from the person for a while does not become part of her when she touches it."""
    chair = box(2.5, 0.9, 0.4, 0.9)
    finder = BodySegmenter(Scene(FLOOR, (), True), build_of(1.75), DetectSettings())
    far, near = figure(2.5, 0.0), figure(2.5, 0.5)
    for i in range(8):
        finder(frame(np.concatenate([far + [0, 0.05 * i, 0], chair]), i))
    got = finder(frame(np.concatenate([near, chair]), 9)).points
    assert (cKDTree(chair).query(got)[0] < 1e-5).mean() < 0.02
    fresh = BodySegmenter(Scene(FLOOR, (), True), build_of(1.75), DetectSettings())
    joined = fresh(frame(np.concatenate([near, chair]), 0)).points
    # without the look before, the two are one thing
    assert (cKDTree(joined).query(chair[chair[:, 2] > 0.05])[0] < 1e-5).mean() > 0.9


def test_a_chair_beside_the_person_is_not_taken_but_an_arm_that_swings_out_is():
    chair, arm = box(2.5, 0.64, 0.6, 0.9), box(2.4, -0.26, 0.1, 0.4) + [0, 0, 0.8]
    finder, body = BodySegmenter(Scene(FLOOR, (), True), build_of(1.75), DetectSettings()), figure(2.5, 0.0)
    share = lambda got, thing: (cKDTree(got).query(thing)[0] < 1e-5).mean()  # noqa: E731
    for i, swing in enumerate([0.0, 0.0, 0.05, 0.1, 0.1, 0.1]):  # then as far away as the chair
        out = arm - [0, swing, 0]
        got = finder(frame(np.concatenate([body, chair, out]), i)).points
        # a narrow strip of it is small enough for a foot, once the rest is known as background
        assert share(got, chair) < 0.15 and share(got, out) > 0.85


def test_a_room_without_anybody_is_learned():
    """Somebody comes in and touches what stood there before: it does not become part of them."""
    chair = box(2.5, 0.5, 0.5, 0.9)
    finder = BodySegmenter(Scene(FLOOR, (), True), build_of(1.75), DetectSettings())
    for i in range(25):
        assert not len(finder(frame(chair, i)).points)
    person = figure(2.5, 0.0)
    got = finder(frame(np.concatenate([person, chair]), 26)).points
    assert (cKDTree(chair).query(got)[0] < 1e-5).mean() < 0.02 and len(got) > 0.9 * (person[:, 2] > 0.1).sum()


def test_a_box_with_more_points_than_the_body_is_left_too():
    """The body is what is tall, not what has most points."""
    finder = BodySegmenter(Scene(FLOOR, (), True), build_of(1.75), DetectSettings())
    thing, body = box(2.45, 0.68, 1.0, 0.84), figure(2.5, 0.0).reshape(112, -1, 3)[::5].reshape(-1, 3)
    assert len(thing) > 1.2 * len(body)
    frames = [finder(frame(np.concatenate([body - [0, 0.12 * i, 0], thing]), i)) for i in range(12)]
    assert (frames[-1].points[:, 1] < -1).all() and len(frames[-1].points) > 0.9 * len(body)


def test_a_leg_that_seems_apart_is_the_body_still():
    """The thighs are hidden: what is under the body is a leg, and so is what moves beside it."""
    body, shank = figure(2.5, 0.0), figure(2.4, 0.0, 0.45, radius=0.07)
    upper = body[body[:, 2] > 0.8]
    for step in (0.0, 0.07):  # metres a frame, aside
        finder = BodySegmenter(Scene(FLOOR, (), True), build_of(1.75), DetectSettings())
        finder(frame(body, 0))
        for i in range(8):
            leg = shank + [0, step * i, 0]
            got = finder(frame(np.concatenate([upper, leg]), i + 1)).points
            assert (cKDTree(got).query(leg[leg[:, 2] > 0.05].astype(np.float32))[0] < 1e-5).mean() > 0.9


@pytest.mark.parametrize("every, stays", [(24, True), (2, False)])
def test_a_hand_that_hides_its_arm_stays_part_of_who_is_sparsely_seen(every, stays):
    """Four points are a hand of a body of some hundreds, and nothing beside one of thousands."""
    finder, body = BodySegmenter(Scene(FLOOR, (), True), build_of(1.75), DetectSettings()), figure(2.5, 0.0)[::every]
    hand = np.array([1.9, -0.05, 1.2]) + [[0.0, y, z] for y in (0.0, 0.06) for z in (0.0, 0.06)]
    arm = np.array([[x, 0.0, 1.2] for x in np.arange(1.95, 2.35, 0.05)])
    finder(frame(np.concatenate([body, hand, arm]), 0))
    for i in range(1, 12):
        got = finder(frame(np.concatenate([body, hand]), i))
    assert (shares(got, hand)[0] > 0.9) == stays


def known(free, sure, names: tuple[str, ...] = ("body",), part: int = 0, i: int = 0) -> Frame:
    """A frame of free points and of points that are assigned to one part."""
    points = np.concatenate([np.asarray(free, np.float32).reshape(-1, 3), np.asarray(sure, np.float32)])
    parts = np.repeat([-1, part], [len(free), len(sure)]).astype(np.int32)
    both = frame(points, i)
    return Frame(both.time_ns, both.points, both.sensor, both.origins, part=parts, parts=names)


def shares(got, *clouds) -> list[float]:
    """Share of each cloud's points that are among those found."""
    if not len(got.points):
        return [0.0 for _ in clouds]
    return [float((cKDTree(got.points).query(c.astype(np.float32))[0] < 1e-5).mean()) for c in clouds]


def test_assigned_points_pass_all_tests():
    """Below the floor's margin, on a wall, alone, in the background: somebody knows better."""
    scene = Scene(FLOOR, (Plane(np.array([1, 0, 0], np.float32), 3.0),), True)
    lone = np.array([[2.5, 0, 0.01], [3.0, 0.5, 1.0], [1.0, -2.0, 1.5]])
    got = BodySegmenter(scene, build_of(1.75), DetectSettings())(known(np.zeros((0, 3)), lone))
    np.testing.assert_array_equal(got.points, lone.astype(np.float32))
    assert got.part is not None and got.part.tolist() == [0, 0, 0] and got.parts == ("body",)
    with_others = BodySegmenter(scene, build_of(1.75), DetectSettings())(
        known(figure(2.5, 0.0), lone, ("head", "body"), 1)
    )
    assert with_others.part is not None and (with_others.part == 1).sum() == 3 and len(with_others.points) > 1000


def test_what_assigned_points_touch_is_the_person():
    """A hand says which of two people it is, and that a low thing is somebody who sits."""
    scene, settings = Scene(FLOOR, (), True), DetectSettings()
    big, small = figure(2.5, 0.8, radius=0.25), figure(2.5, -0.8)[::2]
    alone = BodySegmenter(scene, build_of(1.75), settings)(frame(np.concatenate([big, small])))
    assert shares(alone, small[small[:, 2] > 0.05]) == [0.0]
    hand = small[np.abs(small[:, 2] - 1.0) < 0.1] + np.array([-0.05, 0, 0])
    finder = BodySegmenter(scene, build_of(1.75), settings)
    got = finder(known(np.concatenate([big, small]), hand, ("l_forearm",)))
    of_big, of_small, of_hand = shares(got, big, small[small[:, 2] > 0.05], hand)
    assert of_big == 0 and of_small > 0.99 and of_hand == 1
    later = finder(frame(np.concatenate([big, small]), 1))  # followed without the hand too
    assert shares(later, big)[0] == 0 and shares(later, small[small[:, 2] > 0.05])[0] > 0.99
    sitting = figure(2.5, 0.0, 0.9)
    assert len(BodySegmenter(scene, build_of(1.75), settings)(frame(sitting)).points) == 0
    face = sitting[sitting[:, 2] > 0.8]
    assert (
        shares(BodySegmenter(scene, build_of(1.75), settings)(known(sitting, face, ("head",))), sitting[20:])[0] > 0.9
    )


def test_assigned_points_say_that_the_person_is_somewhere_else():
    finder = BodySegmenter(Scene(FLOOR, (), True), build_of(1.75), DetectSettings())
    wrong, right = figure(2.5, -1.5), figure(2.5, 1.5)
    assert shares(finder(frame(np.concatenate([wrong, right * [1, 1, 0.7]]))), wrong)[0] > 0.9
    got = finder(known(np.concatenate([wrong, right]), right[right[:, 2] > 1.5], ("head",)))
    assert shares(got, wrong)[0] == 0 and shares(got, right)[0] > 0.9


def test_frames_with_a_limb_only_do_not_forget_the_rest():
    finder = BodySegmenter(Scene(FLOOR, (), True), build_of(1.75), DetectSettings())
    person = figure(2.5, 0.0)
    hand = person[np.abs(person[:, 2] - 1.0) < 0.1]
    finder(frame(person))
    for i in range(5):
        assert shares(finder(known(np.zeros((0, 3)), hand, ("l_forearm",), i=1 + i)), hand) == [1.0]
    assert shares(finder(frame(person, 7)), person[person[:, 2] > 0.05])[0] > 0.99


def test_a_log_of_assigned_points_only():
    """No floor or wall is made of the person, and nothing of her is lost on the way."""
    person = box(1.5, 0.0, 3.0, 1.7)  # as flat and wide as a wall
    frames = [known(np.zeros((0, 3)), person, i=i) for i in range(12)]
    scene = find_scene(frames[:5], np.array([0, 0, 1], np.float32), up_is_sure=False)
    assert not scene.floor_seen and scene.walls == () and scene.floor.offset == pytest.approx(0.0, abs=0.03)
    people = list(map(BodySegmenter(scene, build_of(1.75), DetectSettings()), frames))
    for got in people:
        np.testing.assert_array_equal(got.points, person.astype(np.float32))


@pytest.mark.parametrize("dense_first", [True, False])
def test_a_sparse_sensor_beside_a_dense_one_keeps_its_points(rng, dense_first):
    """A scanner of few lines on the other side, and a single line: no strays by their own measure."""
    person = figure(2.5, 0.0)
    angles, heights = np.arange(-1.2, 1.2, 0.12), np.arange(0.2, 1.7, 0.15)
    back = np.array([[2.5 + 0.18 * np.cos(a), 0.18 * np.sin(a), z] for z in heights for a in angles])
    line = np.array([[2.5 - 0.19 * np.cos(a), 0.19 * np.sin(a), 0.41] for a in np.arange(-1.2, 1.2, 0.2)])
    clouds = [person, back, line]
    origins = np.array([[0, 0, 1.2], [5, 0, 1.0], [0, 0, 0.4]], np.float32)
    order = [0, 1, 2] if dense_first else [2, 1, 0]
    points = np.concatenate([clouds[k] for k in order]).astype(np.float32)
    sensor = np.repeat(np.arange(3), [len(clouds[k]) for k in order]).astype(np.int32)
    seen = Frame(0, points, sensor, origins[order])
    got = BodySegmenter(Scene(FLOOR, (), True), build_of(1.75), DetectSettings())(seen)
    of_person, of_back, of_line = shares(got, person[person[:, 2] > 0.05], back, line)
    assert of_person > 0.99 and of_back > 0.95 and of_line > 0.8
    assert np.array_equal(got.sensor, sensor[[np.flatnonzero((points == p).all(1))[0] for p in got.points]])


def test_fair_share():
    sensor = np.repeat([0, 1, 2], [50_000, 300, 9_000])
    np.random.default_rng(0).shuffle(sensor)
    kept = fair_share(sensor, 20_000)
    counts = np.bincount(sensor[kept])
    assert counts[1] == 300 and counts[2] == 9_000 and 8_000 < counts[0] <= 10_700 and (np.diff(kept) > 0).all()
    one = np.zeros(50_001, int)
    np.testing.assert_array_equal(fair_share(one, 20_000), np.arange(0, 50_001, 3))
    np.testing.assert_array_equal(fair_share(one[:20_000], 20_000), np.arange(20_000))
    assert len(fair_share(one[:0], 20)) == 0


@pytest.mark.parametrize("frames", [1, 8])
def test_after_a_gap_the_body_may_be_farther_away(frames):
    """A quarter of a second later she is 70 cm farther, and where she was is a chair; from one frame to the next
    nobody gets there."""
    chair, far = box(2.5, 0.9, 0.4, 0.9), figure(2.5, -0.7)
    finder = BodySegmenter(Scene(FLOOR, (), True), build_of(1.75), DetectSettings())
    for i in range(3):
        finder(frame(np.concatenate([figure(2.5, 0.0), chair]), i))
    got = finder(frame(np.concatenate([far, chair]), 2 + frames))
    of_person, of_chair = shares(got, far[far[:, 2] > 0.05], chair)
    assert of_chair == 0 and (of_person > 0.99 if frames > 1 else of_person < 0.1)


@pytest.mark.parametrize("rows", [16, 32])
def test_a_scanner_of_few_rows_sees_one_thing(rng, rows):
    """Rows of points 18 or 9 cm apart at 5 m, 2 cm within a row: one person, and a post that stands apart."""
    step = np.radians(30 / (rows - 1))
    level, rise = np.meshgrid(np.arange(-0.25, 0.25, 0.0035), np.arange(-0.26, 0.26, step), indexing="ij")
    rays = np.stack([np.cos(rise) * np.cos(level), np.cos(rise) * np.sin(level), np.sin(rise)], -1).reshape(-1, 3)
    clouds = []
    for x, y, radius, height in ((5.0, 0.0, 0.2, 1.75), (5.2, 0.9, 0.05, 1.0)):
        across = rays[:, :2] @ [y, -x] / np.linalg.norm(rays[:, :2], axis=1)
        near = np.sqrt(np.maximum(radius**2 - across**2, 0))
        distance = (rays[:, :2] @ [x, y] / np.linalg.norm(rays[:, :2], axis=1) - near) / np.hypot(*rays[:, :2].T)
        points = (ORIGIN[0] + rays * (distance + rng.normal(0, 0.01, len(rays)))[:, None]).astype(np.float32)
        clouds.append(points[(np.abs(across) < radius) & (points[:, 2] > 0.04) & (points[:, 2] < height)])
    assert point_gap(clouds[0], ORIGIN[0]) == pytest.approx(step, rel=0.25)
    assert point_spacing(clouds[0], ORIGIN[0]) < 0.006
    got = BodySegmenter(Scene(FLOOR, (), True), build_of(1.75), DetectSettings())(frame(np.concatenate(clouds)))
    of_person, of_post = shares(got, *clouds)
    assert of_person > 0.85 and of_post == 0  # grazing rays at both sides have no neighbours


@pytest.mark.parametrize("kept", [1.0, 0.1])
def test_gaps_of_an_image_are_its_pixels(rng, kept):
    """All around each point is another: of a full image the next pixel, of a thinned one a few pixels on."""
    v, u = np.mgrid[-60:60, -60:60].reshape(2, -1) * 0.005
    points = np.stack([np.ones(len(u)), u, v], -1).astype(np.float32)
    points = points[rng.random(len(points)) < kept]
    low, high = (0.004, 0.008) if kept == 1 else (0.015, 0.04)
    assert low < point_gap(points, np.zeros(3, np.float32)) < high
    assert point_gap(points[:20], np.zeros(3, np.float32)) == 0
