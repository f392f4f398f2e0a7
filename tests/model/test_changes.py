"""The body changes while it is tracked: a stick is picked up and put down, sizes change, limbs come and go."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from voodoo_jax.config.options import Change, DetectSettings, Settings, SettingsError, StartSettings
from voodoo_jax.config.toml import read_settings, settings_text
from voodoo_jax.geometry.rigid import Poses, apply
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.model.attachments import applied, attach, hung_on, loaded, prepared, resized, with_limbs
from voodoo_jax.model.body import bands, segment_lengths, site_points
from voodoo_jax.model.body_file import format_body, human, load_body, parse_body
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.simulate.recording import simulate
from voodoo_jax.solve.scan import track_visits
from voodoo_jax.trackers.front import track

STILL = DetectSettings(skip=("drop_motionless",))  # simulated people may stand as still as nobody does


def with_stick():
    return attach(human(), load_body("stick"), "r_hand", at=(0, 0, 0.06), grip=(0, 0, 0.4), axis=(1, 0, 0.3))


def test_a_held_thing_hangs_where_it_is_held():
    body = with_stick()
    t = body.topology
    assert t.limbs[-1] == "stick" and t.joints[-1] == "stick_grip" and t.held == (15,)
    hand = t.limbs.index("r_hand")
    np.testing.assert_allclose(
        apply(body.rest[hand], jnp.array([0, 0, 0.06])), apply(body.rest[15], jnp.array([0, 0, 0.4])), atol=1e-6
    )
    again = parse_body(format_body(body))
    np.testing.assert_allclose(again.sizes, body.sizes, atol=1e-6)
    with pytest.raises(ValueError, match="no limb 'tail'"):
        attach(human(), load_body("stick"), "tail")
    with pytest.raises(ValueError, match="limbs named stick"):
        attach(body, load_body("stick"), "l_hand")


def test_an_absent_limb_pulls_at_nothing_and_takes_all_that_hangs_on_it():
    body = with_limbs(human(), ["r_upper_arm"], False)
    gone = [n for n, here in zip(body.topology.limbs, body.present.tolist()) if not here]
    assert gone == ["r_upper_arm", "r_forearm", "r_hand"]
    weights = dict(zip(body.topology.joints, np.asarray(bands(body).weights.sum(1))))
    assert weights["r_shoulder"] == weights["r_elbow"] == weights["r_wrist"] == 0 and weights["l_elbow"] == 1
    with pytest.raises(ValueError, match="root"):
        with_limbs(body, ["pelvis"], False)
    with pytest.raises(ValueError, match="'r_hand' is attached to 'r_forearm', which is missing"):
        with_limbs(body, ["r_hand"], True)


def test_a_limb_comes_back_without_the_things_that_nobody_gave_it():
    body = with_limbs(with_limbs(with_stick(), ["stick"], False), ["r_forearm"], False)
    there = lambda b: dict(zip(b.topology.limbs, b.present.tolist()))  # noqa: E731
    assert not there(body)["r_hand"]
    back = there(with_limbs(body, ["r_forearm"], True))
    assert back["r_forearm"] and back["r_hand"] and not back["stick"]
    assert there(with_limbs(body, ["r_forearm", "stick"], True))["stick"]
    taken = there(with_limbs(with_stick(), ["r_hand"], False))
    assert not taken["stick"]  # what is held goes with the hand


def test_limbs_are_hung_on_their_parents():
    body = with_stick()
    poses = Poses(body.rest.rotation, body.rest.translation + jnp.array([1.0, 2.0, 3.0]))
    lost = Poses(poses.rotation.at[7:9].set(jnp.array([0, 1.0, 0, 0])), poses.translation.at[7:9].set(9.0))
    found = hung_on(body, lost, [8, 7])
    np.testing.assert_allclose(found.translation, poses.translation, atol=1e-5)


def test_new_sizes_move_what_sits_on_the_limb():
    body = human()
    limb = body.topology.limbs.index("l_forearm")
    longer = resized(body, limb, body.sizes[limb] * jnp.array([1, 1, 1, 1, 1.2]))
    joint = body.topology.joints.index("l_wrist")
    before, after = body.parent_anchor.translation[joint], longer.parent_anchor.translation[joint]
    np.testing.assert_allclose(after, before * jnp.array([1, 1, 1.2]), atol=1e-6)
    other = body.topology.joints.index("r_wrist")
    np.testing.assert_array_equal(body.parent_anchor.translation[other], longer.parent_anchor.translation[other])
    for j, (p, c) in enumerate(zip(body.topology.parents, body.topology.children)):  # the rest pose holds together
        ends = [
            apply(longer.rest[k], a.translation[j]) for k, a in ((p, longer.parent_anchor), (c, longer.child_anchor))
        ]
        np.testing.assert_allclose(*ends, atol=1e-5)
    assert segment_lengths(longer)["forearm"] > 1.05 * segment_lengths(body)["forearm"]


def test_changes_are_read_from_settings_and_written_back(tmp_path):
    path = tmp_path / "changes.toml"
    path.write_text(
        '[[change]]\ntime = 1.5\nadd = "stick"\nto = "r_hand"\nat = [0, 0, 0.06]\n'
        '[[change]]\ntime = 1\nscale = 1.8\nsizes = { l_forearm = [0.04, 0.04, 0.03, 0.03, 0.25] }\nremove = "head"\n'
    )
    settings = read_settings(path)
    assert [c.time for c in loaded(settings.changes)] == [1.0, 1.5]
    assert settings.changes[1].sizes == (("l_forearm", (0.04, 0.04, 0.03, 0.03, 0.25)),)
    path.write_text(settings_text(settings))
    assert read_settings(path) == settings
    body = prepared(human(), loaded(settings.changes))
    assert not bool(body.present[-1]) and bool(body.present[:-1].all())


@pytest.mark.parametrize(
    "text, said",
    [
        ("scale = 1", "no 'time'"),
        ("time = -1", "not negative"),
        ("time = 1\nremoved = 1", "did you mean 'remove'"),
        ("time = 1\nsizes = { head = [1, 2] }", "must be a table such as"),
        ("time = 1\nat = [1, 2]", "3 numbers"),
    ],
)
def test_a_change_that_cannot_be_is_told(tmp_path, text, said):
    path = tmp_path / "changes.toml"
    path.write_text(f"[[change]]\n{text}\n")
    with pytest.raises(SettingsError, match=said):
        read_settings(path)


@pytest.mark.parametrize(
    "change, said",
    [
        (Change(1.0, remove=("tail",)), "no limb 'tail'"),
        (Change(1.0, add="stick.toml"), "no limb 'stick.toml'"),
        (Change(1.0, to="r_hand"), "'add' is missing"),
        (Change(1.0, add="stick", to="tail"), "no limb 'tail'"),
    ],
)
def test_a_change_that_does_not_fit_the_body_is_told(change, said):
    with pytest.raises(SettingsError, match=said):
        prepared(human(), loaded([change]))


@pytest.fixture(scope="module")
def stick_log(tmp_path_factory):
    """Somebody waves with a stick from 1 to 2.4 s, and has no stick before and after."""
    body = with_stick()
    motion = placed(make_motion(body, "wave", 3.4), 2.6, 0.0, np.pi)
    present = np.ones((len(motion), body.limb_count), bool)
    present[:, -1] = (motion.time >= 1.0) & (motion.time < 2.4)
    sim = simulate(body, motion, present=present)
    path = tmp_path_factory.mktemp("stick") / "stick.mcap"
    write_simulation(sim, path)
    return sim, present, path


def stick_error(sim, tracks, frames):
    """Mean distance of the stick's ends from the truth, metres; the ends may be exchanged."""
    ends = [tracks.body.topology.sites.index(n) for n in ("stick_bottom", "stick_top")]
    errors = []
    for i in frames:
        want = np.asarray(site_points(sim.body, Poses(sim.rotation[i], sim.translation[i])))
        got = np.asarray(site_points(tracks.body, Poses(tracks.rotation[i], tracks.translation[i])))[ends]
        want = want[[sim.body.topology.sites.index(n) for n in ("stick_bottom", "stick_top")]]
        errors.append(min(np.linalg.norm(got - w, axis=1).mean() for w in (want, want[::-1])))
    return np.array(errors)


@pytest.mark.parametrize("known", [True, False])
def test_a_stick_is_picked_up_tracked_and_put_down(stick_log, known):
    sim, present, path = stick_log
    pick = Change(1.0, add="stick", to="r_hand", at=(0, 0, 0.06), grip=(0, 0, 0.4), axis=(1, 0, 0.3) if known else ())
    settings = Settings(changes=(pick, Change(2.4, remove=("stick",))), start=StartSettings(scale=1.7), detect=STILL)
    programs = len(track_visits.ready)
    tracks = track(human(), read_log(path), settings)
    assert len(track_visits.ready) - programs <= 1  # one program for with and without the stick
    there = np.isfinite(tracks.translation[:, -1]).all(1)
    np.testing.assert_array_equal(there, present[:, -1])
    assert tracks.tracked.all()
    body = np.linalg.norm(tracks.joints - sim.joints, axis=-1)
    assert np.nanmean(body) < 0.03, f"{100 * np.nanmean(body):.1f} cm"
    errors = stick_error(sim, tracks, np.flatnonzero(present[:, -1]))
    assert np.median(errors) < 0.06, f"{100 * np.median(errors):.1f} cm"


def test_without_the_stick_being_added_its_points_are_left_over(stick_log):
    sim, present, path = stick_log
    # joints that all weigh one: a shoulder that gives way lets the arm take some of the stick's points
    body = eqx.tree_at(lambda b: b.weights, human(), replace_fn=jnp.ones_like)
    tracks = track(body, read_log(path), Settings(start=StartSettings(scale=1.7), detect=STILL))
    with_it, without = present[:, -1], ~present[:, -1]
    assert tracks.evidence.explained[with_it].mean() < tracks.evidence.explained[without].mean() - 0.02


def test_a_change_keeps_the_pose_of_the_rest(stick_log):
    _, _, path = stick_log
    recording = read_log(path)
    start = StartSettings(scale=1.7)
    plain = track(human(), recording, Settings(detect=STILL, start=start))
    changed = track(human(), recording, Settings(detect=STILL, start=start, changes=(Change(0.5, remove=("r_hand",)),)))
    hand = plain.body.topology.limbs.index("r_hand")
    assert np.isnan(changed.translation[15:, hand]).all() and np.isfinite(changed.translation[:15]).all()
    others = np.delete(np.arange(15), [hand - 2, hand - 1, hand])  # the hand's points now pull at the rest of its arm
    moved = np.linalg.norm(changed.translation[15:20, others] - plain.translation[15:20, others], axis=-1)
    assert moved.max() < 0.03
    scaled = applied(human(), Change(0.0, scale=1.9))
    np.testing.assert_allclose(scaled.sizes, human().sizes * 1.9 / 1.7, rtol=1e-5)


def test_a_thing_that_changes_hands_is_told():
    one = Change(1.0, add="stick", to="r_hand")
    with pytest.raises(SettingsError, match="held differently"):
        prepared(human(), loaded([one, Change(2.0, remove=("stick",)), Change(3.0, add="stick", to="l_hand")]))
    body = prepared(human(), loaded([one, Change(2.0, remove=("stick",)), Change(3.0, add="stick", to="r_hand")]))
    assert body.limb_count == 16


def test_an_absent_limb_does_not_spoil_the_pass_backwards(stick_log):
    _, _, path = stick_log
    body = with_limbs(human(), ["l_hand"], False)
    tracks = track(body, read_log(path), Settings(start=StartSettings(scale=1.7), detect=STILL))
    hand = body.topology.limbs.index("l_hand")
    others = np.delete(np.arange(15), hand)
    assert np.isnan(tracks.translation[:, hand]).all() and np.isfinite(tracks.translation[:, others]).all()
    assert tracks.tracked.all()
