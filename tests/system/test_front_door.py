"""The front door, word for word: what a notebook that is written from the design would say."""

from importlib.resources import files

import jax
import matplotlib
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from voodoo_jax.config.fit_options import FitSettings

SECONDS = 1.6  # of the demo
TRACKED = """
import voodoo_jax as vj
recording = vj.read_log("bow.mcap")                    # host side: frames, stamps, sensors; prints what it holds
body = vj.human()                                      # or vj.read_body("arm.toml")
tracks = vj.track(body, recording)                     # start, size, poses, status, residuals, covariance
vj.show(tracks, recording)                             # a picture or an interactive view
"""
FITTED = """
fit = vj.fit(body, [recording], free=["lengths", "bands.*.weight"]); fit.body, fit.report
"""
GRADIENT = "jax.grad(lambda b: vj.loss.reprojection(b, frame))(body)   # everything between is differentiable"


def beginning(path):
    """The first part of the demo's log."""
    with open(str(files("voodoo_jax") / "data" / "demo.mcap"), "rb") as old, open(path, "wb") as new:
        writer, ids, start = Writer(new), {}, None
        writer.start()
        for schema, channel, message in make_reader(old).iter_messages():
            start = message.log_time if start is None else start
            if message.log_time > start + SECONDS * 1e9:
                break
            if channel.id not in ids:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
                ids[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, kind)
            writer.add_message(ids[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()


def test_the_front_door_runs_word_for_word(tmp_path, monkeypatch, request):
    matplotlib.use("Agg")
    monkeypatch.chdir(tmp_path)
    # the same lines with less work
    monkeypatch.setattr("voodoo_jax.fitting.front.FitSettings", lambda: FitSettings(frames=8, points=128, iterations=1))
    beginning("bow.mcap")
    names: dict = {"jax": jax}
    exec(TRACKED, names)
    # other tests' programs are not in question any more: compiled in a hurry, run once
    jax.config.update("jax_disable_most_optimizations", True)
    request.addfinalizer(lambda: jax.config.update("jax_disable_most_optimizations", False))
    monkeypatch.setenv("VOODOO_JAX_COMPILE_CACHE", str(tmp_path / "cache"))
    exec(FITTED, names)
    vj, tracks, body, fit = (names[key] for key in ("vj", "tracks", "body", "fit"))
    assert tracks.tracked.all() and str(tracks) and str(names["recording"])
    assert "lengths.thigh" in fit.report and "bands.knee.weight" in fit.report and fit.body.limb_count == 15
    body = names["body"] = tracks.body
    problem = vj.problem(tracks.body, names["recording"])
    names["frame"] = vj.loss.frame(problem, len(tracks.time_ns) // 2)
    slope = eval(GRADIENT, names)
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(slope)]
    assert all(np.isfinite(leaf).all() for leaf in leaves)
    # against a central difference, along the steepest sizes
    steep = np.abs(slope.sizes) > np.quantile(np.abs(slope.sizes), 0.8)
    step = np.sign(np.asarray(slope.sizes)) * steep * 5e-5
    # by the programs of the gradient, which are there: to compile the loss alone takes 12 s more
    both = jax.value_and_grad(lambda b: vj.loss.reprojection(b, names["frame"]))
    loss = [float(both(_with_sizes(body, body.sizes + d))[0]) for d in (step, -step)]
    assert float(np.sum(np.asarray(slope.sizes) * step)) == pytest.approx((loss[0] - loss[1]) / 2, rel=0.2)
    with pytest.raises(ValueError, match="frames 0 to"):
        vj.loss.frame(problem, 10**6)


def _with_sizes(body, sizes):
    import equinox as eqx

    return eqx.tree_at(lambda b: b.sizes, body, sizes)
