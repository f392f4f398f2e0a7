"""report.html: all logs of a folder, whoever wrote their lines; links that lead somewhere, drawings of bodies."""

import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from tests.exporters.test_tracks_files import make_tracks
from tests.support.browser import in_browser
from voodoo_jax.batch.outcome import Outcome, outcome_of
from voodoo_jax.batch.report import write_report
from voodoo_jax.batch.summary_file import write_summary
from voodoo_jax.exporters.npz import write_tracks_npz
from voodoo_jax.model.body import scaled
from voodoo_jax.model.body_file import load_body
from voodoo_jax.records.notes import remark
from voodoo_jax.records.tracks import Status
from voodoo_jax.viz.report_page import compared, strip, time_line, untracked


def words(page: str) -> str:
    """The text of a page as a reader sees it."""
    found: list[str] = []
    parser = HTMLParser()
    parser.handle_data = found.append  # type: ignore[method-assign]
    parser.feed(page)
    return " ".join(" ".join(found).split())


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> tuple[str, object]:
    """A report of three logs, two of them of another part of an array job, one with two people."""
    folder = tmp_path_factory.mktemp("tracks <b>")
    tracks = replace(make_tracks(), notes=("see </td> & so", remark("nothing to do")))
    sure = np.full_like(tracks.joint_confidence, 0.95)
    sure[:, tracks.body.topology.centres.index("l_knee")] = 0.4
    tracks = replace(tracks, joint_confidence=sure)
    for name in ("walk", "walk.2"):
        write_tracks_npz(tracks, folder / f"{name}.tracks.npz")
    (folder / "walk.html").touch()
    (folder / "walk.bvh").touch()
    one, two = (outcome_of("/logs/walk.mcap", str(folder / f"{n}.tracks.npz"), tracks) for n in ("walk", "walk.2"))
    write_summary([replace(one, others=(replace(two, person=2),))], str(folder), "replay-1-of-2.jsonl")
    gone = replace(one, path="/logs/gone.mcap", npz=str(folder / "gone.tracks.npz"))
    write_summary([gone, Outcome("/logs/bad.mcap", error="no <log>")], str(folder), "replay-2-of-2.jsonl")
    assert write_report(str(folder), "replay-1-of-2.jsonl") == str(folder / "report.html")
    return (folder / "report.html").read_text(), folder


def test_what_was_found_and_what_is_in_doubt_is_told(page):
    text, folder = page
    said = words(text)
    assert "3 logs: 2 tracked, 1 failed" in said and "tracks &lt;b&gt;" in text
    assert [m[1] for m in re.finditer(r"<b>([\w.]+\.mcap)</b>", text)] == ["bad.mcap", "gone.mcap", "walk.mcap"]
    assert "no <log>" in said and "see </td> & so" in said and "nothing to do" not in said and "gone.tracks.npz" in said
    assert "stature 1.830 m" in said and "person 2" in said and "91 % expected" in said
    assert "not tracked: 0.0 to 0.1 s, 1.3 s" in said
    assert said.count("0.0 to 0.1 s, 1.3 s see") == 2  # what the tracks' notes say
    assert text.count('<svg class="strip"') == 2 and text.count('class="line"') == 2


def test_it_needs_nothing_from_elsewhere_and_its_links_lead_somewhere(page):
    text, folder = page
    links = dict((word, address) for address, word in re.findall(r'<a href="([^"]*)">([^<]*)</a>', text))
    assert set(links) == {"3D view", "tracks", "bvh"}
    assert all((folder / address).exists() for address in links.values())
    assert not re.search(r"src\s*=|https?://|@import|url\(|@[A-Z]+@", text)


def test_drawings_show_the_body_where_it_is_tracked():
    tracks = make_tracks()
    shapes = re.findall(r'<polygon class="(\w)" points="([^"]*)"', strip(tracks, 3))
    assert len(shapes) == 3 * tracks.body.limb_count and {side for side, _ in shapes} == {"l", "r", "m"}
    places = np.array([[float(v) for v in corner.split(",")] for _, path in shapes for corner in path.split()])
    height = float(re.search(r'viewBox="0 0 300 (\d+)"', strip(tracks, 3))[1])  # type: ignore[index]
    assert places.min() >= 0 and places[:, 1].max() <= height
    nowhere = replace(tracks, translation=tracks.translation * np.nan, status=np.full_like(tracks.status, Status.LOST))
    assert strip(nowhere) == "" and 'class="s0" x="0" width="120"' in time_line(nowhere)
    assert untracked(nowhere) == [(0.0, pytest.approx(74 / 30, abs=1e-3))]
    bar = [(m[1], int(m[2])) for m in re.finditer(r'class="s(-?\d)" x="\d+" width="(\d+)"', time_line(tracks))]
    assert bar[0][0] == "0" and sum(width for _, width in bar) == 120 and {kind for kind, _ in bar} == {"0", "4"}


def test_two_bodies_over_each_other():
    before, after = load_body("human"), scaled(load_body("human"), 1.5)
    drawing = compared(before, after)
    shapes = re.findall(r'<polygon class="(\w+)" points="([^"]*)"', drawing)
    tops = {
        side: min(float(c.split(",")[1]) for look, path in shapes if look == side for c in path.split())
        for side, _ in shapes
    }
    # heads are above arms, and the body before is the taller one
    assert tops["before"] < tops["m"] < min(tops["l"], tops["r"])
    assert sum(look == "before" for look, _ in shapes) == 2 * before.limb_count


def test_it_runs_in_a_browser_and_logs_can_be_chosen(page, tmp_path):
    choose = """<script>
      const shown = () => rows.filter(([row]) => !row.hidden).map(([row]) => row.querySelector("b").textContent);
      words.value = "WALK"; words.dispatchEvent(new Event("input")); document.body.dataset.shown = shown();
      words.value = ""; bad.checked = true; bad.dispatchEvent(new Event("change")); document.body.dataset.bad = shown();
    </script></body>"""
    (tmp_path / "report.html").write_text(page[0].replace("</body>", choose))
    seen = in_browser(f"file://{tmp_path / 'report.html'}", tmp_path)
    assert 'data-shown="walk.mcap"' in seen and 'data-bad="bad.mcap"' in seen
