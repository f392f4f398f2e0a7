"""Which of several things that might be the body is followed: the one that moves."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.rooms import FLOOR, ORIGIN, box, build_of, figure, frame
from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect.body_likelihood import candidate
from voodoo_jax.detect.motion import ENOUGH, Motion
from voodoo_jax.detect.segmentation import BodySegmenter
from voodoo_jax.detect.tracklets import HELD, PATIENCE, Tracklets
from voodoo_jax.records.observation import whole
from voodoo_jax.records.recording import Frame
from voodoo_jax.records.scene import Scene
from voodoo_jax.simulate.room import Box, hit_box

SCENE = Scene(FLOOR, (), True)
COATS = figure(3.2, -0.6, 1.75)  # on a stand: as high and wide as a person
SETTINGS = DetectSettings()


def chosen(clouds, ahead=True) -> tuple[list[np.ndarray], Tracklets]:
    tracklets = Tracklets(SCENE, build_of(1.75), SETTINGS, ahead)
    return [f.points for f in tracklets(frame(c, i) for i, c in enumerate(clouds))], tracklets


def of_person(points) -> bool:
    return len(points) > 100 and bool((points[:, 1] > -0.35).all())


def waits_then_walks(still: int, moving: int):
    """A person before the coats' stand, and farther to the left from some frame on."""
    for i in range(still + moving):
        yield np.concatenate([COATS, figure(3.0, 0.6 + 0.04 * max(0, i - still), 1.6)])


def test_without_looking_ahead_the_coats_are_likelier():
    assert not of_person(BodySegmenter(SCENE, build_of(1.75), SETTINGS)(frame(next(waits_then_walks(1, 0)))).points)


@pytest.mark.parametrize("still", [0, 40])
def test_the_one_that_moves_is_the_body_from_the_first_frame_on(still):
    got, tracklets = chosen(waits_then_walks(still, 30))
    assert len(got) == still + 30 and all(map(of_person, got))
    assert tracklets.finder.last is not None and of_person(tracklets.finder.last)


def test_who_may_not_wait_changes_over_once_it_is_known():
    got, _ = chosen(waits_then_walks(40, 60), False)
    right = np.array([of_person(points) for points in got])
    assert not right[: PATIENCE - 1].any() and right[40 + PATIENCE // 2 + 8 :].all()


def test_the_frame_says_so_from_which_on_something_else_is_taken():
    changed = {}
    for ahead in (True, False):
        tracklets = Tracklets(SCENE, build_of(1.75), SETTINGS, ahead)
        got = list(tracklets(frame(c, i) for i, c in enumerate(waits_then_walks(40, 60))))
        changed[ahead] = [i for i, f in enumerate(got) if f.other]
        right = [of_person(f.points) for f in got]
    assert changed == {True: [], False: [right.index(True)]}


def test_who_comes_in_late_was_nowhere_before():
    clouds = [COATS] * 30 + [np.concatenate([COATS, figure(3.0, 2.4 - 0.04 * i)]) for i in range(40)]
    got, _ = chosen(clouds)
    assert not any(map(len, got[:30])) and all(map(of_person, got[36:]))


def test_a_body_of_many_more_points_than_are_kept_is_thinned_before_all_else():
    """Once it is known, and down to somewhat more than are kept."""
    clouds = [figure(3.0, -0.2 + 0.04 * i) for i in range(40)]
    some, many = replace(SETTINGS, points=450), replace(SETTINGS, points=8000)
    single = [frame(c, i) for i, c in enumerate(clouds)]
    # of two sensors one may see little
    double = [replace(f, origins=np.repeat(f.origins, 2, 0)) for f in single]
    every, one, two = (
        [f.points for f in Tracklets(SCENE, build_of(1.75), s)(frames)]
        for s, frames in ((many, single), (some, single), (some, double))
    )
    assert len(every[-1]) > 4 * some.points  # else this tells nothing
    assert some.points <= len(one[-1]) < 1.6 * some.points and len(one[0]) == len(every[0])
    assert {tuple(p) for p in one[-1].tolist()} <= {tuple(p) for p in every[-1].tolist()}
    assert list(map(len, two)) == list(map(len, every))


def test_nobody_moves():
    """The likeliest is taken, as if nothing else were there; frames come out before the log ends."""
    clouds = [np.concatenate([COATS, figure(3.0, 0.6, 1.6)])] * (HELD + 5)
    frames = iter([frame(c, i) for i, c in enumerate(clouds)])
    out = Tracklets(SCENE, build_of(1.75), SETTINGS)(frames)
    first = next(out)
    assert sum(1 for _ in frames) == 5 and not of_person(first.points)


def test_a_passer_by_is_not_taken_for_somebody_who_moves_too():
    """Somebody walks past behind; the person before them only nods, later on."""

    def cloud(i):
        body = figure(2.0, 0.0)
        nod = np.where((body[:, 2:] > 1.2) & (i > 20), [0.25, 0.0, 0.0], 0.0)
        return np.concatenate([body - nod, figure(4.0, -2.0 + 0.08 * i, 1.9)[::4]])

    got, _ = chosen([cloud(i) for i in range(50)])
    assert all(len(points) > 100 and points[:, 0].max() < 2.5 for points in got)


def test_what_is_known_is_no_longer_compared(monkeypatch):
    """Once the body has moved, each frame is looked at once."""
    calls, one = [], BodySegmenter.__call__
    monkeypatch.setattr(BodySegmenter, "__call__", lambda self, *a, **b: calls.append(self) or one(self, *a, **b))
    clouds = [np.concatenate([COATS[::3], figure(2.0, 0.4 + 0.03 * i)]) for i in range(100)]
    assert len(chosen(clouds)[0]) == 100
    assert 100 + ENOUGH < len(calls) < 100 + 3 * ENOUGH and len(set(calls[-20:])) == 1


def in_shadow(points, person):
    """Which points an upright person hides from the sensor."""
    away, before = points - ORIGIN, person - ORIGIN
    at, bearing = (np.arctan2(p[:, 1], p[:, 0]) for p in (away, before))
    slope, over = (p[:, 2] / np.hypot(p[:, 0], p[:, 1]) for p in (away, before))
    return (at > bearing.min()) & (at < bearing.max()) & (slope < over.max())


class Told(BodySegmenter):
    """Finds what is within some distances ahead of the sensor."""

    def __init__(self, near: float, far: float):
        super().__init__(SCENE, build_of(1.75), SETTINGS)
        self.near, self.far = near, far

    def __call__(self, frame):
        seen = whole(frame).only((frame.points[:, 0] > self.near) & (frame.points[:, 0] < self.far))
        self.last = seen.points
        return seen


def moved(clouds, near: float, far: float) -> int:
    """In how many frames what is so far ahead of the sensor is thought to have moved."""
    finder, motion = Told(near, far), Motion()
    for i, cloud in enumerate(clouds):
        motion.note(finder(seen := frame(cloud, i)), seen, False, None)
    return motion.moved


@pytest.mark.parametrize("step", [(0.0, 0.03), (0.0, -0.02), (-0.03, 0.0), (0.03, 0.01)])
def test_what_comes_out_from_behind_somebody_has_not_moved(step):
    """A cupboard, and somebody who hides a part of it and walks on, aside, nearer or farther away."""
    cupboard, clouds = box(3.6, 0.0, 0.9, 1.75), []
    for i in range(60):
        person = figure(2.2 + np.clip(step[0] * i, -0.9, 0.9), -0.2 + step[1] * i, 1.6)
        clouds.append(np.concatenate([cupboard[~in_shadow(cupboard, person)], person]))
    assert moved(clouds, 3.5, 4.0) == 0 and moved(clouds, 0.5, 3.5) > 40


def going_round(standing: bool) -> list[Frame]:
    """A cupboard, and somebody, before a wall, as a camera sees them that goes from the right to the left."""
    v, u = np.mgrid[-0.45:0.3:90j, -0.7:0.7:160j].reshape(2, -1)
    frames = []
    for i in range(50):
        origin = np.array([0.0, -1.5 + 0.06 * i, 1.2])
        rays = np.stack([np.ones(u.size), u - 0.5 * (origin[1] / 3), v], 1)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.minimum((5.0 - origin[0]) / rays[:, 0], np.where(v < 0, -origin[2] / rays[:, 2], np.inf))
            person = 0.0 if standing else 0.03 * i
            for thing in (Box(3.0, -0.6, (0.6, 0.8, 1.8)), Box(3.0 + person, 0.8, (0.3, 0.4, 1.7))):
                hit = hit_box(thing, origin, rays)[0]
                distance = np.where(hit > 0, np.minimum(distance, hit), distance)
        points = (origin + rays * distance[:, None]).astype(np.float32)
        frames.append(replace(frame(points, i), origins=origin[None].astype(np.float32)))
    return frames


class Between(Told):
    """Finds what is between two places to the left of the camera, before the wall and above the floor."""

    def __call__(self, frame):
        x, y, z = frame.points.T
        seen = whole(frame).only((y > self.near) & (y < self.far) & (x < 4.9) & (z > 0.05))
        self.last = seen.points
        return seen


@pytest.mark.parametrize("standing", [True, False])
def test_for_a_camera_that_goes_round_a_thing_it_has_not_moved(standing):
    """Other sides of it are seen, and those seen before no longer."""
    frames = going_round(standing)
    finders, (cupboard, person) = (Between(-1.1, -0.1), Between(0.4, 1.2)), (Motion(), Motion())
    for seen in frames:
        for finder, motion in zip(finders, (cupboard, person)):
            motion.note(finder(seen), seen, False, None)
    assert cupboard.seen == 50 and cupboard.moved == 0
    assert person.moved == 0 if standing else person.moved > 30


def test_who_was_followed_all_the_time_is_taken_from_the_beginning_on():
    """The camera turns away from coats, which were likelier, to somebody who goes away much later."""
    clouds = [np.concatenate([COATS, figure(3.0, 0.6, 1.6)])] * 12
    clouds += [figure(3.0, 0.6 + 0.04 * max(0, i - 60), 1.6) for i in range(100)]
    got, tracklets = chosen(clouds)
    assert len(got) == 112 and all(map(of_person, got))


def test_of_what_more_is_seen_from_the_second_frame_on_has_not_moved():
    cupboard, desk = box(3.0, -1.4, 0.6, 1.75), box(3.0, -0.5, 1.2, 0.9)
    clouds = [np.concatenate([cupboard, *[desk][: i > 0]]) for i in range(40)]
    assert moved(clouds, 2.5, 3.5) == 0


def test_who_was_mixed_up_with_something_is_found_again():
    """What is followed as another thing ends up at the likeliest one, as somebody may who passes close by it."""
    person = [figure(3.0, 0.6 + 0.03 * max(0, i - 8), 1.6) for i in range(60)]
    tracklets = Tracklets(SCENE, build_of(1.75), SETTINGS)
    clouds = iter([frame(np.concatenate([COATS, p]), i) for i, p in enumerate(person)])
    first = [next(clouds) for _ in range(6)]

    def mixed_up():
        yield from first
        (other,) = (t for t in tracklets.followed if t is not tracklets.main)
        other.finder.last = tracklets.finder.last
        yield from clouds

    got = [f.points for f in tracklets(mixed_up())]
    assert len(got) == 60 and all(map(of_person, got[11:]))


def test_the_fourth_thing_may_be_the_one_that_moves():
    """Three coat stands, and a child who is less like a body than they are."""
    stands = np.concatenate([figure(3.2, y, 1.75) for y in (-1.6, -0.6, 0.4)])
    clouds = [np.concatenate([stands, figure(3.0, 1.5 + 0.03 * max(0, i - 40), 1.35)]) for i in range(80)]
    got, _ = chosen(clouds)
    assert all(len(points) > 100 and points[:, 1].min() > 1.0 for points in got[40:])


def test_assigned_points_need_no_choice():
    """A segmentation has found a hand of the person who stands beside the coats."""
    person = figure(3.0, 0.6, 1.6)
    points = np.concatenate([COATS, person]).astype(np.float32)
    part = np.where((np.arange(len(points)) >= len(COATS)) & (points[:, 2] > 1.4), 0, -1).astype(np.int32)
    seen = Frame(0, points, np.zeros(len(points), np.int32), ORIGIN, part=part, parts=("head",))
    got = next(Tracklets(SCENE, build_of(1.75), SETTINGS)(iter([seen] * 3)))
    assert of_person(got.points)


def test_what_stood_there_all_the_time_is_not_the_body_when_that_has_left():
    far = COATS + [0, -1.5, 0]  # out of reach of the body
    clouds = [np.concatenate([far, figure(3.0, 0.6 + 0.03 * i)]) for i in range(60)]
    got, _ = chosen(clouds + [far] * (SETTINGS.forget + 40))
    assert all(map(of_person, got[:60])) and not any(map(len, got[60:]))


def test_as_broad_at_the_top_as_below_is_less_likely():
    """A cupboard as high as the body beside a person with a head."""
    cupboard, person = box(3.0, -0.8, 0.7, 1.75), box(3.0, 0.8, 0.36, 1.45)
    head = box(3.0, 0.8, 0.16, 0.3) + [0, 0, 1.45]
    points = np.concatenate([cupboard, person, head]).astype(np.float32)
    label = np.repeat([0, 1], [len(cupboard), len(person) + len(head)])
    area = np.full(len(points), 0.02**2)
    places = np.stack([points[:, 2], points[:, 0], points[:, 1]])
    assert candidate(points, label, area, area, places, build_of(1.75), 0.65)[0] == 1
    alone = label == 0
    assert (
        candidate(points[alone], label[alone], area[alone], area[alone], places[:, alone], build_of(1.75), 0.65)[0] == 0
    )


def test_who_may_not_wait_gets_frames_one_by_one():
    """A frame is given back before the next one is asked for."""
    asked = []

    def source():
        for i in range(3):
            asked.append(i)
            yield frame(figure(2.5, 0.0), i)

    stream = Tracklets(SCENE, build_of(1.75), SETTINGS, False)(source())
    assert len(next(stream).points) > 100 and asked == [0]


def test_who_has_left_before_it_is_decided_is_where_they_were_and_where_they_come_back():
    """Coats that never move are likelier; somebody passes by and comes back after that is decided."""
    passes = {i: figure(3.0, 2.0 - 0.05 * (i % 400 - 10), 1.6) for i in (*range(10, 40), *range(410, 440))}
    clouds = [np.concatenate([COATS, passes[i]]) if i in passes else COATS for i in range(450)]
    got, _ = chosen(clouds)
    there = np.array([of_person(points) for points in got])
    seen = np.array([i in passes for i in range(450)])
    assert len(got) == 450 and not there[~seen].any() and there[seen].mean() > 0.9
