"""The HTML view: it holds the poses, needs nothing from elsewhere, is small, and runs in a browser if there is one."""

import base64
import json
import re
from dataclasses import replace

import numpy as np

from tests.support.browser import in_browser
from tests.viz.test_picture import simulated
from tests.viz.test_viewer import picture_of
from voodoo_jax.records.recording import Frame, Pairs
from voodoo_jax.records.tracks import Status
from voodoo_jax.viz.html_view import frames_shown, write_html


def contents(path) -> tuple[dict, bytes]:
    text = path.read_text()
    told = re.search(r'<script id="head" type="application/json">(.*?)</script>', text, re.S)
    blob = re.search(r'<script id="blob" type="text/plain">(.*?)</script>', text, re.S)
    assert told and blob
    return json.loads(told[1]), base64.b64decode(blob[1])


def array(blob: bytes, part: dict) -> np.ndarray:
    data = blob[part["at"] : part["at"] + part["bytes"]]
    return np.frombuffer(data, {"f4": np.float32, "i2": np.int16, "u4": np.uint32, "u1": np.uint8}[part["kind"]])


def test_it_holds_poses_points_and_markers_upright(tmp_path):
    _, tracks, recording = simulated()
    marks = Pairs(("a",), np.array([[1, 2, 3]], np.float32))
    frames = [replace(frame, pairs=marks) for frame in recording]
    # the same in a frame whose y points downwards
    turn = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], np.float32)
    status = tracks.status.copy()
    status[1] = Status.LOST
    tracks = replace(tracks, source="logs/<b>.mcap", status=status, notes=("</script><b>",))
    head, blob = contents(write_html([tracks, tracks], frames, tmp_path / "a.html"))
    assert head["name"] == "<b>.mcap" and head["notes"] == ["</script><b>"] and len(head["people"]) == 2
    person = head["people"][1]
    poses = array(blob, person["poses"]).reshape(len(tracks.time_ns), -1, 7)
    np.testing.assert_allclose(poses[..., 4:], tracks.translation, atol=1e-5)
    assert array(blob, person["tracked"]).tolist()[:3] == [1, 0, 1]
    starts = array(blob, head["starts"])
    points = array(blob, head["points"]).reshape(-1, 3)[starts[2] : starts[3]]
    np.testing.assert_allclose(points / 1000, recording.frames[2].points, atol=0.0006)
    np.testing.assert_allclose(array(blob, head["marks"]).reshape(-1, 3)[-1], [1, 2, 3])
    nowhere = replace(tracks, **{n: getattr(tracks, n) * np.nan for n in ("rotation", "translation", "joints")})
    head, _ = contents(write_html([nowhere], frames, tmp_path / "c.html"))
    assert len(head["times"]) == len(tracks.time_ns)
    turned = replace(tracks, up=turn[:, 2], translation=tracks.translation @ turn.T)
    head, blob = contents(write_html([turned], [], tmp_path / "b.html"))
    height = array(blob, head["people"][0]["poses"]).reshape(len(tracks.time_ns), -1, 7)[..., 6]
    np.testing.assert_allclose(height, tracks.translation[..., 2], atol=1e-5)


def test_ten_seconds_of_a_large_camera_are_small_and_long_logs_too(tmp_path):
    _, tracks, _ = simulated()
    rng = np.random.default_rng(0)

    def size(count: int, points: int) -> int:
        pick = np.arange(count) % len(tracks.time_ns)
        some = tracks.only(pick).having(time_ns=10**18 + np.arange(count) * 33_333_333)
        cloud = rng.normal(0, 2, (points, 3)).astype(np.float32)
        frames = (Frame(int(t), cloud, np.zeros(points, np.int32), np.zeros((1, 3), np.float32)) for t in some.time_ns)
        return write_html([some], frames, tmp_path / "a.html").stat().st_size

    assert 2e6 < size(300, 20_000) < 8e6 and size(2500, 3000) < 8e6
    assert len(frames_shown(2500)) <= 900 and frames_shown(20).tolist() == list(range(20))


def test_it_needs_nothing_from_elsewhere(tmp_path):
    _, tracks, recording = simulated("arm")
    text = write_html([tracks], recording, tmp_path / "a.html").read_text()
    assert not re.search(r"(src|href)\s*=|https?://|@import|url\(|fetch\(|XMLHttp", text.split('id="blob"')[0])
    assert "http" not in text.rsplit("</script>", 2)[-2]


def test_it_runs_in_a_browser_and_a_click_on_the_plots_jumps(tmp_path):
    _, tracks, recording = simulated()
    frames = [replace(frame, pictures=(picture_of(tracks, i),)) for i, frame in enumerate(recording.frames)]
    page = write_html([tracks], frames, tmp_path / "a.html")
    click = """<script>
      const box = plots_.getBoundingClientRect();
      plots_.setPointerCapture = () => {};
      plots_.dispatchEvent(new PointerEvent("pointerdown", { clientX: box.right - 13, clientY: box.top + 9 }));
      document.body.dataset.after = document.getElementById("time").textContent;
      const px = new Uint8Array(4 * canvas.width * canvas.height);
      const of = (much, little) => {
        let n = 0; for (let i = 0; i < px.length; i += 4) if (px[i + much] > 1.5 * px[i + little]) n++; return n; };
      if (gl) gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, px);
      document.body.dataset.drawn = gl ? `${of(0, 2)} ${of(2, 0)}` : "no WebGL";
      document.body.dataset.angles = [...document.getElementById("angle").options].map(o => o.value).join(" ");
    </script></body>"""
    page.write_text(page.read_text().replace("</body>", click.replace("plots_", 'document.getElementById("plots")')))
    seen = in_browser(f"file://{page}#t=0.2", tmp_path)
    after, drawn, angles = (re.search(rf'data-{name}="([^"]*)"', seen) for name in ("after", "drawn", "angles"))
    assert after and drawn and angles
    last = (tracks.time_ns[-1] - tracks.time_ns[0]) / 1e9
    assert after[1].startswith(f"{last:.2f} s, tracked")
    # left and right limbs, each in its colour
    assert drawn[1] == "no WebGL" or min(map(int, drawn[1].split())) > 200
    assert {"knee_flexion", "trunk_bending"} <= set(angles[1].split())
    assert 'src="data:image/jpeg;base64,/9j/' in seen
