"""Fitting a body to recordings: parameters, search, files, the command."""

import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from voodoo_jax.batch import FeatureNames
from voodoo_jax.body import joint_centres, segment_lengths, with_proportions
from voodoo_jax.cli import main
from voodoo_jax.fit_frames import TruthError, held_out, read_truth
from voodoo_jax.fit_parameters import Changes, changed, height_of, parameters
from voodoo_jax.fit_progress import Progress, load_progress, save_progress
from voodoo_jax.fit_tuned import tuned_settings
from voodoo_jax.io.body_file import human, load_body, read_body, write_body
from voodoo_jax.one_by_one import one_by_one
from voodoo_jax.settings import FeatureSettings, Settings

BODY = human()


def after(free, values, **options):
    """The body after some parameters, by name, and all the parameters."""
    chosen = parameters(BODY, free, **options)
    x = np.zeros(len(chosen.names), np.float32)
    for name, value in values.items():
        x[chosen.names.index(name)] = value
    return changed(BODY, chosen.changes(jnp.asarray(x)))


def test_names_and_patterns():
    assert parameters(BODY, ["lengths.*thigh"]).names == ("lengths.thigh",)
    assert parameters(BODY, ["lengths.*thigh"], mirrored=False).names == ("lengths.l_thigh", "lengths.r_thigh")
    assert parameters(BODY, ["scale", "lengths.l_hand"]).names == ("scale", "lengths.hand")
    assert len(parameters(BODY, ["lengths", "radii"]).names) == 9 * 3
    assert "bands.hip.weight" in parameters(BODY, ["bands.*.weight"]).names
    # hinges have one axis, and a joint of the middle does not leave it
    assert "bands.knee.axes.x" not in parameters(BODY, ["bands"]).names
    assert "anchors.waist.y" not in parameters(BODY, ["joint centres"]).names
    assert "features.face.weight" in parameters(BODY, ["measurement weights"], ("face",)).names
    with pytest.raises(ValueError, match="'lenghts'.*lengths"):
        parameters(BODY, ["lenghts"])


def test_nothing_changes_at_zero():
    same = after(["scale", "lengths", "radii", "joint centres", "bands"], {})
    for name in ("sizes", "centres", "sites", "axes", "weights", "scale"):
        np.testing.assert_allclose(getattr(same, name), getattr(BODY, name), atol=1e-6)
    np.testing.assert_allclose(same.rest.translation, BODY.rest.translation, atol=1e-6)


def test_lengths_take_everything_along():
    """Against the proportions of the simulator, which hangs the limbs anew by forward kinematics."""
    long = after(["lengths"], {"lengths.thigh": np.log(1.1), "lengths.forearm": np.log(0.9)})
    other = with_proportions(BODY, {"l_thigh": 1.1, "r_thigh": 1.1, "l_forearm": 0.9, "r_forearm": 0.9})
    for name in ("sizes", "centres", "sites"):
        np.testing.assert_allclose(getattr(long, name), getattr(other, name), atol=1e-5)
    np.testing.assert_allclose(long.rest.translation, other.rest.translation, atol=1e-5)
    np.testing.assert_allclose(joint_centres(long, long.rest), joint_centres(other, other.rest), atol=1e-5)
    was, now = segment_lengths(BODY), segment_lengths(long)
    assert now["thigh"] > 1.05 * was["thigh"] and now["shank"] == pytest.approx(was["shank"], abs=1e-5)
    # the scale follows the height, so that a start that measures the height finds the size again
    assert float(long.scale) / float(BODY.scale) == pytest.approx(float(height_of(long) / height_of(BODY)), abs=1e-5)


def test_anchors_move_mirrored():
    wide = after(["joint centres"], {"anchors.hip.y": 0.01})
    names = BODY.topology.centres
    moved = np.asarray(joint_centres(wide, wide.rest) - joint_centres(BODY, BODY.rest)) / 1.7
    for side, sign in (("l", 1), ("r", -1)):
        for joint in ("hip", "knee", "talocrural"):
            np.testing.assert_allclose(moved[names.index(f"{side}_{joint}")], [0, sign * 0.01, 0], atol=1e-5)
    np.testing.assert_allclose(moved[names.index("l_elbow")], 0, atol=1e-6)


def test_a_fitted_body_survives_its_file(tmp_path):
    fitted = after(["lengths", "radii", "joint centres"], {"lengths.shank": 0.05, "radii.chest.top": 0.1})
    write_body(fitted, tmp_path / "body.toml")
    again = read_body(tmp_path / "body.toml")
    np.testing.assert_allclose(again.sizes, fitted.sizes, atol=1e-5)
    assert segment_lengths(again) == pytest.approx(segment_lengths(fitted), abs=1e-5)


def test_things_that_are_held_are_not_fitted():
    from voodoo_jax.changes import attach

    armed = attach(BODY, load_body("stick"), "r_hand", (0, 0, 0.06), (0, 0, 0.4))
    assert not any("stick" in name and name.startswith(("lengths", "radii")) for name in parameters(armed, ["*"]).names)


def test_held_out_frames_are_runs_of_time():
    mask = held_out(24)
    assert mask.sum() == 6 and np.abs(np.diff(mask.astype(int))).sum() == 4
    assert not held_out(0).size


def test_a_saved_search_goes_on(tmp_path):
    now = Progress(np.array([0.1, -0.2]), 3, 1e-2, (5.0, 4.0), False)
    save_progress(now, tmp_path / "s.npz", "mine")
    again = load_progress(tmp_path / "s.npz", "mine")
    assert again is not None and again.losses == now.losses and again.step == 3
    np.testing.assert_array_equal(again.x, now.x)
    assert load_progress(tmp_path / "s.npz", "another") is None
    assert load_progress(tmp_path / "none.npz", "mine") is None


def test_truths_that_cannot_be_read(tmp_path):
    np.savez(tmp_path / "a.npz", time_ns=np.arange(2), joints=np.zeros((2, 1, 3)))
    with pytest.raises(TruthError, match="names"):
        read_truth(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", time_ns=np.arange(2), joints=np.zeros((3, 1, 3)), joint_names=np.array(["l_wrist"]))
    with pytest.raises(TruthError, match="3, 1, 3"):
        read_truth(tmp_path / "b.npz")
    with pytest.raises(TruthError, match="cannot be read"):
        read_truth(tmp_path / "none.npz")
    np.savez(tmp_path / "c.npz", time_ns=np.arange(2), joints=np.zeros((2, 1, 3)), joint_names=np.array(["l_wrist"]))
    assert read_truth(tmp_path / "c.npz").names == ("l_radiocarpal",)


def test_command_refuses(tmp_path, capsys):
    assert main(["fit", "--out", str(tmp_path / "body.toml")]) == 2
    assert "at least one log" in capsys.readouterr().err
    (tmp_path / "body.md").write_text("mine")
    assert main(["fit", "x.mcap", "--out", str(tmp_path / "body.toml")]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main(["fit", "x.mcap", "--out", str(tmp_path / "folder")]) == 2
    assert ".toml" in capsys.readouterr().err
    assert main(["fit", str(tmp_path / "none.mcap"), "--out", str(tmp_path / "b.toml")]) == 1
    assert "none.mcap" in capsys.readouterr().err


def test_changes_add_up():
    chosen = parameters(BODY, ["lengths.thigh", "lengths.l_thigh"], mirrored=False)
    by = chosen.changes(jnp.array([0.1, 0.2]))
    assert isinstance(by, Changes) and replace(chosen, names=()).maps is chosen.maps
    rows = [BODY.topology.limbs.index(n) for n in ("l_thigh", "r_thigh")]
    np.testing.assert_allclose(by.lengths[jnp.array(rows)], [0.1, 0.2])


def test_settings_that_were_found():
    """Factors of the solve's options and of features, named or not, go into settings; the body's stay out."""
    before = Settings(features=FeatureSettings(weights=("face=10", "left_hand=7")))
    features = ("face", "marker", "l_wrist", "r_wrist")
    words = ["solve.ratio", "features.*.weight", "bands.neck.weight", "lengths.thigh"]
    free = parameters(BODY, words, features)

    def after(**found):
        x = [found.get(name.removesuffix(".weight").rpartition(".")[2], 0.0) for name in free.names]
        return tuned_settings(before, BODY.topology, free.changes(jnp.array(x)), features)

    new = after(ratio=np.log(2.0), face=np.log(0.5), marker=np.log(3.0), wrist=np.log(4.0), neck=1.0, thigh=0.1)
    assert new.solve == replace(before.solve, ratio=new.solve.ratio)
    assert new.solve.ratio == pytest.approx(2 * before.solve.ratio)
    table = FeatureNames(BODY.topology, new.features)
    assert table.weights["face"] == pytest.approx(5.0)
    assert table.weights["marker"] == pytest.approx(3 * before.features.weight)
    assert table.weights["left_hand"] == 7.0
    # one parameter for both sides, whatever standard the log's names are of
    for name in ("l_wrist", "r_wrist", "l_radiocarpal"):
        found = table.find(name)
        assert found and found[1] == pytest.approx(4 * before.features.weight)
    assert after(neck=1.0, thigh=0.1) == before


def test_fit_of_the_demo(tmp_path, capsys):
    """The whole way, cut short: of a trunk that is 15 % too thin the waist comes a third of the way to the truth.

    Lengths are no measure here: who stands and waves does not show where the knees are, and the fit says so.
    """
    from importlib.resources import files

    write_body(with_proportions(BODY, {}, girth=0.85), tmp_path / "wrong.toml")
    log = str(files("voodoo_jax") / "data" / "demo.mcap")
    words = ["fit", log, "--body", str(tmp_path / "wrong.toml"), "--out", str(tmp_path / "body.toml")]
    # the demo's person is made of the body's own limbs: little noise
    words += ["--noise", "0.002", "--frames", "28", "--points", "256", "--iterations", "10", "--rounds", "2"]
    assert main([*words, "--free", "radii.chest.*", "radii.pelvis.*", "lengths.thigh"]) == 0
    assert "held out" in capsys.readouterr().out
    assert {p.name for p in tmp_path.iterdir()} == {"wrong.toml", "body.toml", "body.md", "body.png"}
    text = (tmp_path / "body.md").read_text()
    assert "95 % interval" in text and "lengths.thigh" in text and "nan" not in text
    chest = BODY.topology.limbs.index("chest")
    radius = lambda b: float(np.mean(b.sizes[chest, :2])) / float(b.scale)  # noqa: E731
    wrong, fitted = (radius(read_body(tmp_path / name)) for name in ("wrong.toml", "body.toml"))
    true = 1.05 * radius(BODY)  # see experiments/demo
    assert wrong + (true - wrong) / 3 < fitted < true


def test_no_batch_of_matrices_goes_to_lapack():
    """On a CPU: two calls with batches at the same time would wait for each other's threads for ever."""
    matrices = jnp.eye(4) + jnp.arange(3.0)[:, None, None]
    inverses = jax.jit(lambda some: one_by_one(jnp.linalg.inv, some, batch=2))
    text = inverses.lower(matrices).as_text()
    shapes = re.findall(r"getrf.*?tensor<([0-9x]+)xf32>", text)
    assert shapes and set(shapes) == {"4x4"}
    np.testing.assert_allclose(inverses(matrices), np.linalg.inv(matrices), rtol=1e-5)


def test_a_loss_of_ones_own():
    """BFGS finds the thigh that a function asks for; priors pull a little; it goes on from where it stopped."""
    from voodoo_jax.fit_loop import Part, Search
    from voodoo_jax.fit_user import minimised
    from voodoo_jax.tracking import options_from

    chosen = parameters(BODY, ["lengths.thigh", "lengths.shank"])
    row = BODY.topology.limbs.index("l_thigh")
    wanted = 1.05 * float(BODY.sizes[row, 4])
    settings = Settings()
    icp = options_from(settings.solve, settings.track).icp
    # the function does not look at the frames
    part = Part("none", BODY, None, 0)  # pyright: ignore[reportArgumentType]
    search = Search(chosen, (part,), icp, "held", (np.arange(2),), chosen.sd)
    loss = lambda body, options, frames: 1e5 * (body.sizes[row, 4] - wanted) ** 2  # noqa: E731
    heard: list[Progress] = []
    first = minimised(search, loss, Progress(np.zeros(2)), 2, heard.append)
    found = minimised(search, loss, first, 30, heard.append)
    assert found.done and len(heard) == found.step and found.losses[-1] <= found.losses[0]
    np.testing.assert_allclose(np.exp(found.x), [1.05, 1.0], atol=0.005)


def test_a_body_that_nothing_rests_with_gains_nothing():
    """A step is taken as far as frames come to rest, and the fit goes on."""
    from voodoo_jax.fit_loop import FitError, Place, Search, _along

    class Slope(Search):
        """Falls for ever; beyond 1.5 no frame comes to rest."""

        def place(self, x, starts):
            if x[0] > 1.5:
                raise FitError("only 0 of 18 frames come to rest")
            return Place(-float(x[0]), (), (), (), ())

        def gain(self, x, other, here, there):
            return here.loss - there.loss

    here = Place(0.0, (), (), (), ())
    for step, wanted in ((1.0, 1.0), (2.0, 0.5), (20.0, 0.2)):
        share, gain, there = _along(object.__new__(Slope), np.zeros(1), np.array([step]), here, ())
        if step < 20:
            assert share == wanted and gain == wanted * step == -there.loss
        else:
            assert not gain > 0
