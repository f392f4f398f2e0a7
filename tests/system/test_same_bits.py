"""Nothing changes by accident: digests of all arrays of five logs, against those of before. See same_bits.py."""

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests import digest_runner, same_bits
from tests.digest_runner import digest
from tests.same_bits import NoReference, changed, differences, reference, still_valid

LOGS = {"chair", "demo", "directions", "markers", "stereo"}


@pytest.fixture(scope="module")
def logs(tmp_path_factory) -> list[str]:
    return same_bits.made_logs(tmp_path_factory.mktemp("logs"))


def test_the_same_bits_as_before(logs):
    """Against the digests of this processor, and if there are none, or others, against the code of before."""
    found = same_bits.digests(same_bits.ROOT, logs)
    assert {name.split(":")[0] for name in found} == LOGS
    assert {"chair: joints", "markers: rotation", "stereo: read/points", "demo: joint_covariance"} <= found.keys()
    try:
        problem = changed(logs, found)
    except NoReference as none:
        problem = str(none)
    assert not problem, problem


def test_digests_tell_values_types_and_shapes():
    zeros = np.zeros((2, 3), np.float32)
    assert digest(zeros) == digest(zeros.copy()) == digest(np.zeros((2, 6), np.float32)[:, ::2])
    others = -zeros, np.nextafter(zeros, np.float32(1)), zeros.T, zeros.view(np.int32), zeros.astype(np.float64)
    assert len({digest(x) for x in (zeros, *others)}) == 1 + len(others)


def test_what_differs_is_named(monkeypatch):
    """A known processor with the same digests runs no code of before; one with others does, and that decides."""
    now = {"a: x": digest(np.ones(2)), "a: y": digest(np.ones(2))}
    before = {"a: x": digest(np.zeros(2)), "a: z": digest(np.ones(2))}
    assert [line.split(":")[1].strip() for line in differences(before, now)] == ["x", "y", "z"]
    ran = []

    def older(logs):
        ran.append(logs)
        return "0123456789abcdef", older.found

    monkeypatch.setattr(same_bits, "reference_digests", older)
    monkeypatch.setattr(same_bits, "kept", lambda: {same_bits.key(): now})
    older.found = before
    assert changed([], now) == "" and not ran
    for known in ({}, {same_bits.key(): before}):
        monkeypatch.setattr(same_bits, "kept", lambda known=known: known)
        older.found = before
        said = changed([], now)
        assert "3 of 2 arrays differ from those of commit 0123456789ab" in said and "--write" in said
        older.found = now
        assert changed([], now) == ""
    assert len(ran) == 4


def test_writing_drops_other_processors_digests_where_the_behaviour_has_changed(monkeypatch, tmp_path):
    now, before = {"a: x": "1"}, {"a: x": "0"}
    assert still_valid({"other": before}, before, now) == {} and still_valid({"other": now}, now, now) == {"other": now}
    file = tmp_path / "digests.json"
    monkeypatch.setattr(same_bits, "DIGESTS", file)
    monkeypatch.setattr(same_bits, "digests", lambda tree, logs: now)
    monkeypatch.setattr(same_bits, "reference_digests", lambda logs: ("commit", now))
    for there, left in (
        ({}, []),
        ({"other": before}, ["other"]),  # this one is new, and the code of before gives the same on it
        ({"other": before, same_bits.key(): now}, ["other"]),
        ({"other": before, same_bits.key(): before}, []),
    ):
        file.write_text(json.dumps(there))
        same_bits.write([])
        found = json.loads(file.read_text())
        assert found.pop(same_bits.key()) == now and list(found) == left


@pytest.fixture
def repository(tmp_path) -> Path:
    """Three commits, of which the first and the second changed digests.json."""
    for k in range(3):
        (tmp_path / "tests").mkdir(exist_ok=True)
        (tmp_path / "tests" / "digests.json").write_text(str(min(k, 1)))
        (tmp_path / "code").write_text(str(k))
        for words in (["init", "-q"], ["add", "-A"], ["commit", "-q", "-m", str(k)]):
            who = ["-c", "user.name=n", "-c", "user.email=e@example.org", "-c", "commit.gpgsign=false"]
            subprocess.run(["git", *who, *words], cwd=tmp_path, check=True)
    return tmp_path


def test_the_code_of_before_is_that_of_the_last_digests(repository, tmp_path_factory):
    said = subprocess.run(["git", "log", "--format=%H"], cwd=repository, check=True, capture_output=True, text=True)
    last, second, _ = said.stdout.split()
    assert reference(repository) == second
    for depth, expected in (
        (2, None),
        (3, second),
    ):  # of the second commit's parent nothing is known in the first clone
        clone = tmp_path_factory.mktemp("clone") / "clone"
        command = ["git", "clone", "-q", f"--depth={depth}", f"file://{repository}", str(clone)]
        subprocess.run(command, check=True)
        if expected:
            assert reference(clone) == expected
        else:
            with pytest.raises(NoReference, match="unshallow"):
                reference(clone)


def test_without_history_it_fails_with_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    with pytest.raises(NoReference, match="no code of before to compare with"):
        reference(tmp_path)


def test_the_runner_uses_public_names_only():
    """It has to run with the files of any commit."""
    imported = [line for line in Path(digest_runner.__file__).read_text().splitlines() if "voodoo_jax" in line]
    assert [line for line in imported if line.startswith(("import", "from"))] == ["import voodoo_jax as vj"]
