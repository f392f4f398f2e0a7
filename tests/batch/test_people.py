"""Two people in one log: files, topics and lines of both; what an earlier run has left of others goes."""

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from voodoo_jax import Settings, read_log, read_tracks, replay_logs, track, track_people
from voodoo_jax.batch.log_job import check_names, remove_others
from voodoo_jax.batch.output_paths import folders_within
from voodoo_jax.config.options import DetectSettings
from voodoo_jax.io.container import LogError
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import human
from voodoo_jax.simulate.mcap import write_simulation
from voodoo_jax.simulate.motion import make_motion, placed
from voodoo_jax.simulate.recording import Simulation, in_one_picture, simulate
from voodoo_jax.simulate.sensor import tof_camera

BOTH = ("pair.tracks.npz", "pair.2.tracks.npz")


@pytest.fixture(scope="module")
def pair(tmp_path_factory) -> tuple[Path, tuple[Simulation, Simulation]]:
    """A tall one who waves and a short one who bows, side by side."""
    people = []
    for stature, motion, y in ((1.9, "wave", 0.5), (1.62, "bow", -0.45)):
        body = scaled(human(), stature)
        people.append(simulate(body, placed(make_motion(body, motion, 2.0, 15.0), 3.7, y, np.pi), tof_camera(1.2, 0.0)))
    path = tmp_path_factory.mktemp("pair") / "pair.mcap"
    return write_simulation(in_one_picture(*people), path), (people[0], people[1])


@pytest.fixture(scope="module")
def replayed(pair, tmp_path_factory):
    out = tmp_path_factory.mktemp("out")
    return out, replay_logs([pair[0]], out, quiet=True)[0]


def test_each_is_tracked_in_their_own_size(pair, replayed):
    found = [read_tracks(replayed[0] / name) for name in BOTH]
    assert [t.person for t in found] == [1, 2] and {t.people for t in found} == {2}
    for known in pair[1]:
        errors = [np.linalg.norm(t.joints - known.joints, axis=-1).mean() for t in found]
        best = found[int(np.argmin(errors))]
        assert min(errors) < 0.06 < 0.4 < max(errors)
        assert best.tracked.all() and abs(float(best.body.scale) - float(known.body.scale)) < 0.05


def test_both_are_told_of(replayed):
    out, outcome = replayed
    rows = [json.loads(line) for line in (out / "replay.jsonl").read_text().splitlines()]
    assert [(row["person"], Path(row["tracks"]).name) for row in rows] == list(zip((1, 2), BOTH))
    assert str(outcome).count("pair.mcap, person ") == 2
    with open(out / "pair.voodoo.mcap", "rb") as stream:
        reader = make_reader(stream)
        topics = {c.topic for c in reader.get_summary().channels.values()}  # pyright: ignore
        attached = {a.name for a in reader.iter_attachments()}
    names = ("tf", "poses", "body", "quality", "joints")
    assert topics == {f"/voodoo/{name}" for name in names} | {f"/voodoo/2/{name}" for name in names}
    assert attached == {"body.toml", "body.2.toml"}


def test_a_second_run_tracks_nothing_and_one_person_alone_leaves_no_other(pair, replayed):
    out, outcome = replayed
    again = replay_logs([pair[0]], out, quiet=True, picture=True, export=["csv"])[0]
    assert again.skipped and [o.size for o in again.people] == [o.size for o in outcome.people]
    # what is made of tracks that are there is made of everybody's
    assert {path.name for path in out.glob("*.csv")} == {"pair.csv", "pair.2.csv"}
    damaged = bytearray((out / BOTH[1]).read_bytes())
    with np.load(out / BOTH[1]) as tracks:
        damaged[tracks.zip.getinfo("rotation.npy").header_offset + 500] ^= 1  # of what no outcome shows
    (out / BOTH[1]).write_bytes(damaged)
    assert not replay_logs([pair[0]], out, quiet=True)[0].skipped
    alone = Settings(detect=DetectSettings(people=1))
    assert not replay_logs([pair[0]], out, settings=alone, quiet=True)[0].others
    assert not (out / BOTH[1]).exists() and len((out / "replay.jsonl").read_text().splitlines()) == 1


def test_in_python_a_list_of_tracks(pair):
    recording = read_log(pair[0])
    one, two = track_people(human(), recording)
    assert (one.person, two.person) == (1, 2) and len(one.time_ns) == len(two.time_ns) == len(recording)
    alone = track_people(human(), recording, Settings(detect=DetectSettings(people=1)))
    np.testing.assert_array_equal(alone[0].joints, track(human(), recording).joints)
    assert len(alone) == 1


def test_no_log_has_the_name_of_the_second_person_in_another():
    assert folders_within(dict.fromkeys(["/x/a.mcap", "/x/a.2.mcap", "/x/b.3.mcap"], "")) == {
        "/x/a.mcap": "", "/x/a.2.mcap": "a.2", "/x/b.3.mcap": "",
    }  # fmt: skip


def test_another_logs_tracks_are_neither_overwritten_nor_removed(tmp_path):
    np.savez(tmp_path / "a.2.tracks.npz", time_ns=np.zeros(0))  # of a log `a.2`
    remove_others(str(tmp_path / "a.tracks.npz"), 1)
    with pytest.raises(LogError, match="of another log"):
        check_names(str(tmp_path / "a.tracks.npz"), 2)
