"""Replay through the real command: contract of the files, errors against the truth, many logs, several kinds of log."""

import contextlib
import io
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from scipy.spatial.transform import Rotation

import voodoo_jax.trackers.shared.runner
from experiments.scoreboard.simulated import write_log
from tests.support import logs
from voodoo_jax.batch.output_paths import folders_within, logs_of
from voodoo_jax.batch.replay import output_paths, replay
from voodoo_jax.cli.main import main
from voodoo_jax.config.options import Settings
from voodoo_jax.detect.pipeline import find_body
from voodoo_jax.geometry.rigid import Poses
from voodoo_jax.io.log_reader import open_log, read_log
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human, load_body
from voodoo_jax.records.tracks import Status
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.simulate.recording import render, simulate
from voodoo_jax.simulate.room import Room
from voodoo_jax.simulate.sensor import TOF_NOISE, add_noise, tof_camera

DEMO = Path(str(files("voodoo_jax") / "data" / "demo.mcap"))
DEMO_TRUTH = DEMO.with_name("demo.truth.npz")
CENTIMETRE = 0.01


class Run(NamedTuple):
    status: int
    out: Path
    printed: str
    errors: str
    compiled: int = 0

    def arrays(self, stem: str) -> dict[str, np.ndarray]:
        with np.load(self.out / f"{stem}.tracks.npz", allow_pickle=False) as file:
            return dict(file)


def run(out: Path, *words) -> Run:
    """`voodoo-jax replay` in this process, what it prints included."""
    with contextlib.redirect_stdout(io.StringIO()) as printed, contextlib.redirect_stderr(io.StringIO()) as errors:
        status = main(["replay", *map(str, words), "--out", str(out)])
    return Run(status, out, printed.getvalue(), errors.getvalue())


def joint_errors(arrays, truth_file) -> np.ndarray:
    """[frame, joint] metres, by stamp and name; says nothing about frames that are not tracked."""
    with np.load(truth_file) as truth:
        order = [arrays["joint_names"].tolist().index(name) for name in truth["names"]]
        np.testing.assert_array_equal(arrays["time_ns"], truth["time_ns"])
        return np.linalg.norm(arrays["joints"][:, order] - truth["joints"], axis=-1)


def person(motion: str, seconds: float, stature: float, camera=None, noise=TOF_NOISE, seed=0, yaw=np.pi, rate=15.0):
    """A person 3.6 m in front of the first camera, all of her in view."""
    body = scaled(human(), stature)
    moved = placed(make_motion(body, motion, seconds, rate), 3.6, 0.0, yaw)
    return simulate(body, moved, camera or tof_camera(1.0, 0.07), noise, Room(), seed)


@pytest.fixture(scope="session")
def demo_run(tmp_path_factory) -> Run:
    """The installed command on the recording that comes with the package, in a process of its own."""
    out = tmp_path_factory.mktemp("demo") / "made" / "on the way"
    command = [str(Path(sys.executable).with_name("voodoo-jax")), "replay", str(DEMO), "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    return Run(done.returncode, out, done.stdout, done.stderr)


@pytest.fixture(scope="module")
def wave_log(tmp_path_factory) -> Path:
    simulation = person("wave", 2.0, 1.83)
    path = write_simulation(simulation, tmp_path_factory.mktemp("wave") / "wave.mcap")  # and its truth
    return write_log(path, {"depth": simulation})


def programs() -> int:
    """How many compiled programs there are of the tracker."""
    return len(voodoo_jax.trackers.shared.runner.track_visits.ready)


@pytest.fixture(scope="module")
def many_run(tmp_path_factory, wave_log) -> Run:
    """A broken log between a Foxglove and a ROS 2 one."""
    folder = tmp_path_factory.mktemp("many")
    broken = folder / "broken.mcap"
    broken.write_text("This is a diary, not a log.\n")
    before = programs()
    # in this process, where programs can be counted
    done = run(folder / "out", wave_log, broken, DEMO, "--workers", "1")
    return done._replace(compiled=programs() - before)


def test_demo_meets_the_contract(demo_run):
    assert demo_run.status == 0, demo_run.errors
    assert "1 of 1 logs tracked" in demo_run.printed and "demo.mcap: 117 frames" in demo_run.printed
    got = demo_run.arrays("demo")
    frames = len(got["time_ns"])
    assert got["time_ns"].dtype == np.int64 and got["tracked"].dtype == bool and got["tracked"].shape == (frames,)
    assert got["joints"].shape == (frames, len(got["joint_names"]), 3)
    wanted = {f"{s}_{j}" for s in "lr" for j in ("shoulder", "elbow", "radiocarpal", "hip", "knee", "talocrural")}
    assert {"skullbase", "vc7"} | wanted <= set(got["joint_names"].tolist())
    stamps = [frame.time_ns for frame in open_log(DEMO).frames()]
    np.testing.assert_array_equal(got["time_ns"], stamps)
    found, (truth,) = json.loads(str(got["body_json"])), [json.loads(str(np.load(DEMO_TRUTH)["dims"]))]
    assert abs(found["stature"] - truth["stature"]) <= 2.5 * CENTIMETRE
    assert set(found["segment_lengths"]) == {"upper_arm", "forearm", "thigh", "shank"}
    for name, length in found["segment_lengths"].items():
        assert abs(length - truth[name]) <= 2 * CENTIMETRE, name


def test_demo_is_tracked_well(demo_run):
    got = demo_run.arrays("demo")
    errors = joint_errors(got, DEMO_TRUTH)
    assert got["tracked"].mean() >= 0.99
    assert errors.mean() <= 2.5 * CENTIMETRE
    assert (errors <= 10 * CENTIMETRE).mean() >= 0.99


def test_the_picture_file_shows_the_same(demo_run):
    """`.voodoo.mcap` as a viewer reads it gives the joints of `.tracks.npz`, at the same stamps."""
    got = demo_run.arrays("demo")
    at = {int(t): i for i, t in enumerate(got["time_ns"])}
    shown = np.full(got["joints"].shape, np.nan)
    with open(demo_run.out / "demo.voodoo.mcap", "rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, _, message, tf in reader.iter_decoded_messages(topics=["/voodoo/tf"]):
            for t in tf.transforms:
                if t.child_frame_id.startswith("voodoo/joint/"):
                    joint = got["joint_names"].tolist().index(t.child_frame_id.removeprefix("voodoo/joint/"))
                    place = t.translation
                    shown[at[message.log_time], joint] = place.x, place.y, place.z
        settings = next(m for m in reader.iter_metadata() if m.name == "voodoo_jax").metadata
    np.testing.assert_allclose(shown, got["joints"], atol=1e-3)
    assert settings["track.chunk"] == str(Settings().track.chunk) and settings["fixed_frame"] == "base"


def test_nothing_is_left_half_written(demo_run, many_run):
    assert sorted(p.name for p in demo_run.out.iterdir()) == [
        "demo.tracks.npz",
        "demo.voodoo.mcap",
        "replay.jsonl",
    ]
    names = ["demo.tracks.npz", "demo.voodoo.mcap", "replay.jsonl", "wave.tracks.npz", "wave.voodoo.mcap"]
    assert sorted(p.name for p in many_run.out.iterdir()) == names


def test_a_broken_log_does_not_stop_the_others(many_run):
    assert many_run.status == 1
    assert "2 of 3 logs tracked" in many_run.printed
    sentence = next(line for line in many_run.printed.splitlines() if line.startswith("broken.mcap: FAILED"))
    assert "not" in sentence and "MCAP" in sentence and "unexpected" not in sentence and "Error" not in sentence
    assert "not tracked: broken.mcap" in many_run.errors


def test_one_compilation_for_all_logs(many_run):
    """Two people of different size, logs of different kind and length: one program for starts and tracking."""
    assert many_run.arrays("demo")["tracked"].all() and many_run.arrays("wave")["tracked"].all()
    assert many_run.compiled <= 1


def test_results_do_not_depend_on_process_or_other_logs(demo_run, many_run):
    alone, together = demo_run.arrays("demo"), many_run.arrays("demo")
    assert alone.keys() == together.keys()
    for name in alone.keys() - {"seconds", "digest"}:
        np.testing.assert_array_equal(alone[name], together[name], err_msg=name)


def test_foxglove_log(many_run, wave_log):
    errors = joint_errors(many_run.arrays("wave"), wave_log.with_name("wave.truth.npz"))
    assert errors.mean() <= 2 * CENTIMETRE
    # from the third frame on: the arm goes up at once, and the start takes the person to stand still
    assert np.percentile(errors[2:], 99) <= 6 * CENTIMETRE
    assert abs(json.loads(str(many_run.arrays("wave")["body_json"]))["stature"] - 1.83) <= 2.5 * CENTIMETRE


def test_results_do_not_depend_on_chunks(many_run, wave_log, tmp_path):
    short = run(tmp_path, wave_log, "--track.chunk", "8", "--picture")
    assert short.status == 0 and (tmp_path / "wave.png").stat().st_size > 10_000
    for name in ("joints", "rotation", "residual", "explained", "limb_weight"):
        np.testing.assert_allclose(
            short.arrays("wave")[name], many_run.arrays("wave")[name], atol=1e-6, rtol=1e-6, err_msg=name
        )
    for name in ("status", "steps", "points", "time_ns"):
        np.testing.assert_array_equal(short.arrays("wave")[name], many_run.arrays("wave")[name])


def test_same_files_are_refused_before_any_work(tmp_path):
    first, second = tmp_path / "demo.mcap", tmp_path / "demo"
    for path in (first, second):
        shutil.copy(DEMO, path)
    refused = run(tmp_path / "out", first, second)
    assert refused.status == 2 and "demo.tracks.npz" in refused.errors and not (tmp_path / "out").exists()
    with pytest.raises(ValueError, match="different --out folders"):
        replay([first, second], tmp_path / "out", quiet=True)


def test_folders_of_logs_of_one_name():
    logs = ["/x/mon/walk.mcap", "/x/tue/walk.mcap", "/x/walk.mcap", "/x/tue/run.mcap", "s3://x/bow.mcap", "/bow.mcap"]
    assert folders_within(dict.fromkeys(logs, "")) == dict(zip(logs, ["mon", "tue", "", "", "s3/x", ""]))


def test_results_lie_where_paths_say(tmp_path):
    paths = [tmp_path / "logs" / name for name in ("a.mcap", "mon/a.mcap", "mon/am/b.mcap")]
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    logs, folder = [str(path) for path in paths], str(tmp_path / "logs")
    below = [(folder, log) for log in logs]
    wanted = dict(zip(logs, ["", "mon", "mon/am"]))
    assert logs_of(below) == wanted == folders_within(wanted)
    # whatever else is there, and one log if it is named besides
    assert logs_of(below[2:]) == {logs[2]: "mon/am"}
    assert logs_of([(logs[1], logs[1]), *below]) == wanted == logs_of([*below, (logs[1], logs[1])])
    assert logs_of([(f"{folder}/mon", logs[2])]) == {logs[2]: "am"} and logs_of([(logs[2],) * 2]) == {logs[2]: ""}
    assert logs_of([("s3://b/x/*/a.mcap", f"s3://b/x/{day}/a.mcap") for day in "12"]) == {
        "s3://b/x/1/a.mcap": "1", "s3://b/x/2/a.mcap": "2",
    }  # fmt: skip
    # a bag and a file of it
    assert list(logs_of([("/x/bag", "/x/bag"), ("/x/bag/bag_0.mcap", "/x/bag/bag_0.mcap")])) == ["/x/bag"]


def test_output_names():
    assert [p.name for p in output_paths("/x/a.b.mcap", "o")] == ["a.b.tracks.npz", "a.b.voodoo.mcap"]


def test_point_clouds_with_a_frame_of_nothing(wave_log, tmp_path):
    """The same measurements as clouds of a laser scanner's driver; one message is empty, one all NaN."""
    log = logs.Log()
    origin = np.array([0.0, 0.0, 1.0])
    recording = read_log(wave_log)
    first = recording.frames[0].time_ns
    log.add("/tf", first, logs.foxglove_tfs(logs.foxglove_tf(first, "base", "scanner", tuple(origin), (0, 0, 0, 1))))
    for i, frame in enumerate(recording):
        points = frame.points - origin
        points = points[:0] if i == 20 else points * np.nan if i == 22 else points
        log.add("/scan", frame.time_ns, logs.foxglove_cloud(frame.time_ns, "scanner", points, padding=4))
    cloud = log.write(tmp_path / "cloud.mcap")
    tracked = run(tmp_path / "out", cloud)
    assert tracked.status == 0, tracked.printed
    got = tracked.arrays("cloud")
    gone = np.isin(got["time_ns"], [recording.frames[i].time_ns for i in (20, 22)])
    assert not got["tracked"][gone].any() and got["tracked"][~gone].all()
    with np.load(wave_log.with_name("wave.truth.npz")) as truth:
        here = np.isin(truth["time_ns"], got["time_ns"])
        errors = np.linalg.norm(got["joints"] - truth["joints"][here], axis=-1)
    assert np.isfinite(got["joints"]).all() and errors.mean() <= 2 * CENTIMETRE


def test_an_empty_room(tmp_path):
    """Nobody there: said so, exit status 1, and tracks of nobody are written all the same."""
    camera, room = tof_camera(1.0, 0.07), Room()
    body = human()
    behind = Poses(body.rest.rotation, body.rest.translation - np.array([50.0, 0, 0], np.float32))
    exact = render(body, behind, camera, room)
    images = np.stack([add_noise(*exact, camera, TOF_NOISE, np.random.default_rng(i)) for i in range(20)])
    one = person("stand", 0.1, 1.8)
    stamps = int(one.time_ns[0]) + np.arange(20) * 66_666_667
    truth = {name: np.repeat(getattr(one, name)[:1], 20, 0) for name in ("rotation", "translation", "joints")}
    log = write_simulation(replace(one, depth=images, time_ns=stamps, **truth), tmp_path / "empty.mcap")
    nobody = run(tmp_path / "out", log)
    assert nobody.status == 1
    assert "NOTHING TRACKED" in nobody.printed and "No object of the body's height was found" in nobody.printed
    assert "not tracked: empty.mcap" in nobody.errors
    got = nobody.arrays("empty")
    assert not got["tracked"].any() and np.isnan(got["joints"]).all()
    assert (got["status"] == Status.NOT_STARTED).all() and len(got["time_ns"]) == len(images)


def test_a_log_that_takes_too_long_is_given_up(wave_log, tmp_path):
    done = run(tmp_path / "out", wave_log, "--log-timeout", "0.01")
    assert done.status == 1
    assert "stopped after 0.01 s" in done.printed and "--log-timeout" in done.printed
    assert not list((tmp_path / "out").rglob("*.npz"))


def test_two_cameras(tmp_path):
    """Two sensors of one log become one cloud, one sees the person from the front, one from her side."""
    cameras = {
        "front": tof_camera(1.0, 0.07),
        "side": replace(tof_camera(1.1, 0.07), position=(3.6, -3.4, 1.1), yaw=np.pi / 2),
    }
    log, sims = logs.Log(), {}
    for number, (name, camera) in enumerate(cameras.items()):
        sim = sims[name] = person("wave", 2.0, 1.75, camera, seed=number, rate=10.0)
        start, frame = int(sim.time_ns[0]), f"{name}_optical"
        turn = tuple(Rotation.from_matrix(camera.rotation).as_quat().tolist())
        log.add("/tf_static", start, logs.ros_tf((start, "base", frame, camera.position, turn)))
        k = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
        size = (camera.height, camera.width)
        log.add(f"/{name}/camera_info", start, logs.ros_calibration(frame, k, size=size))
        for stamp, image in zip(sim.time_ns.tolist(), sim.depth):
            stamp += 4_000_000 * number  # not in step
            log.add(f"/{name}/depth", stamp, logs.ros_image(stamp, frame, image / 1000))
    path = log.write(tmp_path / "two.mcap")
    recording = read_log(path)
    _, people = find_body(recording, recording.up, human(), Settings())
    shares = [np.bincount(f.sensor, minlength=2) for f in people]
    assert len(recording.sensors) == 2 and min(s.min() for s in shares) > 100
    both = run(tmp_path / "out", path)
    assert both.status == 0, both.printed
    got, truth = both.arrays("two"), sims["front"].joints
    errors = np.linalg.norm(got["joints"] - truth, axis=-1)
    assert got["tracked"].all() and errors[2:].mean() <= 2 * CENTIMETRE


def test_another_body(tmp_path):
    """A robot's arm, its reach given; a box with more points stands in the room too."""
    body = load_body("arm")
    moved = placed(make_motion(body, "swing", 1.5, 20.0), 1.8, 0.0, 2.3)
    sim = simulate(body, moved, tof_camera(0.7, 0.15))
    path = write_simulation(sim, tmp_path / "arm.mcap")
    tracked = run(tmp_path / "out", path, "--body", "arm", "--start.scale", "0.8")
    assert tracked.status == 0, tracked.printed
    got = tracked.arrays("arm")
    summary = json.loads(str(got["body_json"]))
    assert summary["name"] == "arm" and summary["reach"] == pytest.approx(0.8)
    errors = joint_errors(got, path.with_name("arm.truth.npz"))
    assert got["tracked"].all() and errors.mean() <= 2 * CENTIMETRE
