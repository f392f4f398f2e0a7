"""Long recordings: tracked in spans, their points in files."""

import mmap
import tempfile
import tracemalloc
import weakref
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
import platformdirs
import pytest

from tests.support.rooms import FLOOR
from tests.support.small_logs import SETTINGS, small_body, small_log
from voodoo_jax.config.options import DetectSettings
from voodoo_jax.detect import stage
from voodoo_jax.detect.body_likelihood import Build
from voodoo_jax.detect.disk_buffer import WITHOUT, spilled
from voodoo_jax.detect.tracklets import Tracklets
from voodoo_jax.io.log_reader import read_log
from voodoo_jax.records.observation import BodyObservation
from voodoo_jax.records.scene import Scene
from voodoo_jax.storage import scratch
from voodoo_jax.trackers.front import track
from voodoo_jax.trackers.shared import sequence


def cloud(i: int, count: int, parts: bool = True) -> BodyObservation:
    rng = np.random.default_rng(i)
    points = rng.standard_normal((count, 3)).astype(np.float32)
    part = rng.integers(-1, 2, count).astype(np.int32) if parts else None
    before = rng.standard_normal((7, 3)).astype(np.float32) if parts else None
    return BodyObservation(
        i, points, np.zeros(count, np.int64), np.zeros((1, 3), np.float32), part=part, parts=("body",), before=before,
        before_sensor=None if before is None else np.zeros(len(before), np.int8),
    )  # fmt: skip


def in_file(array: np.ndarray) -> bool:
    while isinstance(array, np.ndarray) and array.base is not None:
        array = array.base
    return isinstance(array, (mmap.mmap, memoryview)) or isinstance(getattr(array, "obj", None), mmap.mmap)


def test_frames_come_back_as_they_were():
    frames = [cloud(i, count, i % 3 > 0) for i, count in enumerate([100, 0, 1, 333, 50, 0, 7])]
    kept = spilled(frames, block=3000)
    assert len(kept) == len(frames) and in_file(kept[0].points) and in_file(kept[-1].points)
    for a, b in zip(frames, kept, strict=True):
        assert a.time_ns == b.time_ns and a.parts == b.parts and np.array_equal(a.origins, b.origins)
        for name in WITHOUT:
            one, other = getattr(a, name), getattr(b, name)
            assert (one is None) == (other is None)
            if one is not None:
                np.testing.assert_array_equal(one, other)
                assert one.dtype == other.dtype and one.shape == other.shape


def test_memory_does_not_grow_with_the_number_of_frames():
    def stream(count: int) -> Iterator[BodyObservation]:
        return (cloud(i, 5000, False) for i in range(count))

    peaks = []
    for count in (50, 400):
        tracemalloc.start()
        kept = spilled(stream(count), block=1 << 20)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert len(kept) == count
    # what is left of a frame's 100 kB
    assert (peaks[1] - peaks[0]) / 350 < 1000


def test_frames_are_alike_wherever_they_wait():
    """To the last bit of what is computed of them: their order in memory is kept."""
    frames = [cloud(0, 300), cloud(1, 300)]
    frames[1] = replace(frames[1], points=np.asfortranarray(frames[1].points))
    for one, other in zip(frames, spilled(frames, block=100), strict=True):
        assert in_file(other.points) and one.points.strides == other.points.strides
        np.testing.assert_array_equal(one.points, other.points)


def test_one_window_is_in_memory_at_a_time(monkeypatch):
    """However many stages look at windows one after the other."""
    monkeypatch.setattr(stage, "WINDOW", 10)
    born: list[weakref.ref] = []

    def measured() -> Iterator[BodyObservation]:
        for i in range(45):
            frame = cloud(i, 10)
            born.append(weakref.ref(frame))
            yield frame

    class Same(stage.WindowStage):
        def change(self, window, target):
            return window

    class Copied(stage.WindowStage):
        def change(self, window, target):
            return list(window)

    target = Tracklets(Scene(FLOOR, (), True), Build(1.7, 0.5), DetectSettings())
    frames: Iterable[BodyObservation] = measured()
    for each in (Same(), Copied(), Same()):
        frames = each(frames, target)
    times, most = [], 0
    for frame in frames:
        times.append(frame.time_ns)
        most = max(most, sum(ref() is not None for ref in born))
    assert times == list(range(45)) and most <= 12


def test_points_wait_in_the_users_cache(monkeypatch, tmp_path):
    """And not in a RAM disk, unless somebody says where temporary files go."""
    made, maker = [], tempfile.TemporaryFile
    monkeypatch.setattr(tempfile, "TemporaryFile", lambda **options: [made.append(options), maker(**options)][1])
    monkeypatch.setattr(platformdirs, "user_cache_path", lambda *_, **__: tmp_path / "cache")
    monkeypatch.setattr(scratch, "in_memory", lambda folder: False)
    monkeypatch.delenv(scratch.VARIABLE, raising=False)
    kept = spilled([cloud(0, 100)], block=100)
    monkeypatch.setenv(scratch.VARIABLE, str(tmp_path / "mine"))
    assert in_file(kept[0].points) and in_file(spilled([cloud(0, 100)], block=100)[0].points)
    assert [options["dir"] for options in made] == [str(tmp_path / "cache" / "scratch"), str(tmp_path / "mine")]
    assert not list((tmp_path / "cache" / "scratch").iterdir())


def test_where_no_file_can_be_written_points_stay_in_memory(monkeypatch):
    def full(*_: object, **__: object):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryFile", full)
    kept = spilled([cloud(i, 100) for i in range(5)], block=100)
    assert len(kept) == 5 and not in_file(kept[0].points)


@pytest.fixture(scope="module")
def swinging(tmp_path_factory):
    return read_log(small_log(tmp_path_factory.mktemp("long") / "arm.mcap", 90))


def test_spans_go_on_where_the_last_one_ended(swinging, monkeypatch):
    """A long passage is tracked there and back span by span, with nothing lost at the seams."""
    settings = replace(SETTINGS, track=replace(SETTINGS.track, skip=()))
    done = []
    whole = track(small_body(), swinging, settings, done.append)
    assert sum(done) == 2 * len(swinging)
    monkeypatch.setattr(sequence, "SPAN", 48)
    done.clear()
    parts = track(small_body(), swinging, settings, done.append)
    assert sum(done) == 2 * len(swinging)
    assert whole.tracked.all() and parts.tracked.all() and np.isfinite(parts.evidence.passes_apart).all()
    apart = np.linalg.norm(whole.joints - parts.joints, axis=-1)
    assert apart.max() < 0.02 and np.median(apart) < 0.001
