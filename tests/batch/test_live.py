"""The command `live` on a file that is being recorded, and through a Foxglove WebSocket."""

import io
import os
import signal
import threading
import time
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from tests.support.helpers import wait_for
from tests.support.small_logs import FLAGS, arrays_of, assert_same, small_log
from tests.support.waving import SMALL, waving_log
from voodoo_jax.cli.main import main
from voodoo_jax.exporters.foxglove import FoxgloveServer
from voodoo_jax.exporters.npz import read_tracks_npz
from voodoo_jax.io.container import LogError
from voodoo_jax.io.live.sources import open_source

VARIED = ("particles", "hypotheses", "layers", "refine", "points")  # as other tests do: one program for all
FRAMES = 60  # at 20 Hz
SHORT = [word if word != "16" else "4" for word in FLAGS]  # chunks as long as those of live: one program for both


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> tuple[Path, bytes]:
    path = small_log(tmp_path_factory.mktemp("recorded") / "arm.mcap", FRAMES)
    return path, path.read_bytes()


def recorder(path: Path, data: bytes, seconds: float, then=lambda: None) -> threading.Thread:
    """Writes a file bit by bit."""

    def record() -> None:
        for at in range(0, len(data), len(data) // 40):
            with open(path, "ab") as file:
                file.write(data[at : at + len(data) // 40])
            time.sleep(seconds / 40)
        then()

    path.parent.mkdir(exist_ok=True)
    path.write_bytes(b"")
    thread = threading.Thread(target=record, daemon=True)
    thread.start()
    return thread


def live(*words: object) -> int:
    return main(["live", *map(str, words), *SHORT])


def without_an_image(path: Path, topic: str, number: int) -> bytes:
    """The log without one message of a topic."""
    out, seen, channels = io.BytesIO(), 0, {}
    writer = Writer(out)
    writer.start()
    with open(path, "rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            if channel.id not in channels:
                kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, kind)
            seen += channel.topic == topic
            if channel.topic != topic or seen != number:
                writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
    writer.finish()
    return out.getvalue()


def topics(path: Path) -> dict[str, int]:
    with open(path, "rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None and summary.statistics is not None
        counts = summary.statistics.channel_message_counts
        return {summary.channels[i].topic: n for i, n in counts.items()}


def test_a_growing_file_is_tracked_as_its_replay(recorded, tmp_path, capsys):
    path, data = recorded
    out, grows = tmp_path / "live", tmp_path / "arm.mcap"
    thread = recorder(grows, data, 1.0)
    assert live(grows, "--out", out) == 0
    thread.join()
    said = capsys.readouterr()
    assert "latency" in said.err and "(95 %)" in said.err and f"{FRAMES} frames" in said.out
    assert main(["replay", str(path), "--out", str(tmp_path / "replay"), "--online", "--workers", "1", *SHORT]) == 0
    assert_same(arrays_of(out), arrays_of(tmp_path / "replay"))
    assert topics(out / "arm.voodoo.mcap") == topics(tmp_path / "replay" / "arm.voodoo.mcap")


def test_ctrl_c_ends_it_with_results(recorded, tmp_path, capsys):
    path, data = recorded
    grows = tmp_path / "arm.mcap"
    whole = len(data) - len(data) // 10  # never finished
    shows = tmp_path / "out" / "arm.voodoo.mcap"

    def interrupt() -> None:
        wait_for(lambda: shows.exists() and shows.stat().st_size > 20_000)  # what was given out can be read meanwhile
        source = open_source(str(shows), 1.0)
        read.extend(channel.topic for _, channel, _ in source.poll(1.0))
        source.close()
        os.kill(os.getpid(), signal.SIGINT)

    read: list[str] = []
    recorder(grows, data[:whole], 0.5, interrupt)
    assert live(grows, "--out", tmp_path / "out", "--idle", 100) == 0
    tracks = read_tracks_npz(tmp_path / "out" / "arm.tracks.npz")
    assert {"/voodoo/tf", "/voodoo/body", "/voodoo/joints"} <= set(read)
    assert 20 <= len(tracks.time_ns) < FRAMES and tracks.tracked.mean() > 0.9
    assert "ready; Ctrl-C ends it" in capsys.readouterr().err


@pytest.mark.parametrize("tracker", ["flexible", "both"])
def test_images_are_tracked_as_in_their_replay(tracker, tmp_path, capsys):
    path, _ = waving_log(tmp_path, 24)
    path.write_bytes(without_an_image(path, "/colour/image/compressed", 10))
    flags = ["--tracker", tracker, *(f"--flexible.{k}={getattr(SMALL, k)}" for k in VARIED)]
    thread = recorder(tmp_path / "grows" / "waving.mcap", path.read_bytes(), 1.0)
    assert main(["live", str(tmp_path / "grows" / "waving.mcap"), "--out", str(tmp_path / "live"), *flags]) == 0
    thread.join()
    replay = ["replay", str(path), "--out", str(tmp_path / "replay"), "--online", "--workers", "1", *flags]
    assert main(replay) == 0
    assert_same(arrays_of(tmp_path / "live"), arrays_of(tmp_path / "replay"))
    assert read_tracks_npz(tmp_path / "live" / "waving.tracks.npz").tracked.mean() > 0.8


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        ((), 2, "name a growing .mcap file"),
        (("none.mcap",), 1, "no file"),
        (("none.mcap", "--serve", 70000), 2, "must be a port"),
        (("none.mcap", "--idle", 0), 2, "above 0"),
        (("none.mcap", "--read.skin"), 2, "read.skin"),
        (("none.mcap", "--read.pose-net", "mediapipe"), 2, "read.pose_net"),
        (("ws://127.0.0.1:9",), 1, "no connection"),
    ],
)
def test_what_cannot_be_done_is_said(words, status, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    if str(words[:1]).startswith("('ws"):
        pytest.importorskip("websockets")
    assert live(*words) == status
    assert said in capsys.readouterr().err


def test_a_foxglove_server_is_read_and_another_one_shows_the_tracks(recorded, tmp_path, capsys):
    """A log is played into one server, tracked from there, and given out by the other one."""
    foxglove = pytest.importorskip("foxglove")
    pytest.importorskip("websockets")
    path, _ = recorded
    context = foxglove.Context()
    server = foxglove.start_server(host="127.0.0.1", port=0, context=context)
    channels, items = {}, []
    with open(path, "rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            if channel.id not in channels:
                made = foxglove.Schema(name=schema.name, encoding=schema.encoding, data=schema.data)
                channels[channel.id] = foxglove.Channel(
                    channel.topic, schema=made, message_encoding=channel.message_encoding, context=context
                )
            items.append((channel.id, message.data, message.log_time))

    def play() -> None:
        time.sleep(0.5)
        for number, data, log_time in items:
            channels[number].log(data, log_time=log_time)
            time.sleep(0.01)
        time.sleep(0.5)
        server.stop()

    threading.Thread(target=play, daemon=True).start()
    url = f"ws://127.0.0.1:{server.port}"
    assert live(url, "--out", tmp_path / "out", "--serve", 0) == 0
    assert "in Foxglove" in capsys.readouterr().err
    (found,) = (tmp_path / "out").glob("127.0.0.1-*.tracks.npz")
    tracks = read_tracks_npz(found)
    assert len(tracks.time_ns) == FRAMES and tracks.tracked.mean() > 0.9
    shown = FoxgloveServer(0)
    try:
        client = open_source(shown.url, 1.0)
        said = []
        wait_for(
            lambda: (shown.frame(tracks.only(slice(5, 6))), said.extend(client.poll(0.1)), len(said) >= 5)[-1], 20.0
        )
        assert {channel.topic for _, channel, _ in said} >= {"/voodoo/tf", "/voodoo/body", "/voodoo/joints"}
        assert {message.log_time for _, _, message in said} == {int(tracks.time_ns[5])}
        client.close()
    finally:
        shown.close()


def test_no_server_is_told():
    pytest.importorskip("websockets")
    with pytest.raises(LogError, match="Is the server"):
        open_source("ws://127.0.0.1:9", 1.0)
