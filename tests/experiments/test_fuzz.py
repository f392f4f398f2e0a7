"""Damaged and hostile logs: what each kind must come to, and some hundred of them by chance (all with --long)."""

import re
import sys

import pytest

from experiments.common import DEMO
from experiments.fuzz.__main__ import FRAMES, chosen, tried
from experiments.fuzz.atheris_target import main, try_log
from experiments.fuzz.contents import everything
from experiments.fuzz.judged import faults
from experiments.fuzz.kinds import Input
from experiments.fuzz.logs import base_of, written
from experiments.fuzz.trying import PEAK, Watched

SEED, COUNT = 40, 250  # of the short run
NO_POSE = "transforms without finite and possible numbers were left out"
# what was once read wrong, took minutes or gigabytes, or was printed as it is: its name, how many frames come of it
# (0: it is refused), and what is said
ONCE_WRONG = [
    ("bomb/zstd 1 GiB/told 1073741824/index True", 7, "unpacks to 1073741824 bytes, more than.*--limits.chunk_bytes"),
    ("bomb/lz4 3 GiB/index False", 7, "--limits.chunk_bytes"),
    ("image/encoding control/all", 0, r"not used: encoding .*\\x1b"),
    ("jpeg/30000 x 30000 said", 0, "900000000 pixels.*--limits.pixels.*damaged"),
    ("log time/2^63", 0, "is damaged.*impossible log time"),
    ("names/topic control", 15, ""),
    ("png/garbage 9", 0, "damaged"),
    ("png/60000 x 60000 said", 0, "3600000000 pixels.*--limits.pixels"),
    ("protobuf/pose far", 0, "damaged.*no finite and possible numbers"),
    ("rvl/16384 x 16384, all", 0, "damaged.*--limits.pixels"),
    ("schema/100,000 fields//depth/image", 0, "damaged.*--limits.schema_bytes"),
    ("schema/loop//tf_static", 15, "holds itself"),
    ("schema name/" + "x" * 30 + "//depth/camera_info", 0, "without calibration"),
    ("stamp/one negative", 15, "1 stamps are of no clock"),
    ("tf/quaternion 1e200", 15, NO_POSE),
    ("tf/quaternion 1e-200", 15, NO_POSE),
    ("tf/translation 1e+20", 15, NO_POSE),
    ("tf/translation 1e+38", 15, NO_POSE),
    ("tf/translation 1e+300", 15, NO_POSE),
]


@pytest.fixture(scope="module")
def base():
    return base_of(DEMO / "demo.mcap", FRAMES)


@pytest.fixture(scope="module")
def by_name(base):
    return {one.name: one for one in everything(base, SEED)}


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    with Watched("read", tmp_path_factory.mktemp("fuzz")) as process:
        yield process


def asked(watched: Watched, data: bytes) -> dict:
    path = watched.folder / "x.mcap"
    path.write_bytes(data)
    return watched.ask(path)


def test_what_was_once_wrong(base, by_name, watched):
    clean, wrong = asked(watched, written(base.log)), []
    for name, frames, said in ONCE_WRONG:
        found = asked(watched, by_name[name].make())
        bad = faults(by_name[name], found, clean)
        words = found.get("error", "") + " ".join(found.get("notes", []))
        if bad or found.get("count", 0) != frames or not re.search(said, words) or found["seconds"] > 20:
            wrong.append((name, bad, found.get("count", 0), words[:300]))
        assert len(found.get("error", "")) < 3000
    assert not wrong


def test_the_sound_log_is_read(base, watched):
    found = asked(watched, written(base.log))
    assert found["count"] == FRAMES and found["notes"] == [] and not faults(Input("sound", bytes), found, found)


def test_some_hundred(base, request):
    """No crash, no trace, nothing wrong that nobody is told of; within the budget of docs/limits.md."""
    every = request.config.getoption("--long")
    some = chosen(base, SEED, 2000 if every else COUNT)
    inputs = [one for one in some if every or not one.large]
    results = list(tried(inputs, base, "track" if every else "read"))
    assert len(results) == len(inputs) > 0.9 * (2000 if every else COUNT)
    assert {one.name: wrong for one, _, wrong in results if wrong} == {}
    # it is not all refused, or all read: the damage is neither nothing nor everything
    refused = sum(bool(found["error"]) for _, found, _ in results)
    assert 0.1 < refused / len(results) < 0.9


def test_the_same_seed_makes_the_same(base):
    one, other, another = (chosen(base, seed, 40) for seed in (1, 1, 2))
    assert [a.name for a in one] == [b.name for b in other] != [c.name for c in another]
    first = [one.make() for one in everything(base, 1) if one.name in ("bits/zstd/3", "cdr//depth/image/2")]
    again = [one.make() for one in everything(base, 1) if one.name in ("bits/zstd/3", "cdr//depth/image/2")]
    others = [one.make() for one in everything(base, 2) if one.name in ("bits/zstd/3", "cdr//depth/image/2")]
    assert len(first) == 2 and first == again and all(a != b for a, b in zip(first, others, strict=True))


@pytest.mark.parametrize(
    "changes, fault",
    [
        ({"trace": "ValueError"}, "traceback"),
        ({"peak": PEAK + 1}, "memory"),
        ({"seconds": 61.0}, "time"),
        ({"finite": False}, "not finite"),
        ({"far": 2000.0}, "absurd"),
        ({"error": "no calibration"}, "refused without a word of damage"),
        ({"error": "damaged: \x1b[31m"}, "control characters"),
        ({"count": 2}, "silent loss"),
        ({"frames": {"1": 7, "2": 8, "3": 10}}, "changed frames"),
        ({"joints": {"1": [[0.0, 0.0, 0.4]]}}, "silent change"),
    ],
)
def test_faults_are_found(changes, fault):
    clean = {
        "info": "a table", "error": "", "trace": "", "notes": [], "peak": 1, "seconds": 0.1, "count": 3, "finite": True,
        "frames": {"1": 7, "2": 8, "3": 9}, "joints": {"1": [[0.0, 0.0, 0.0]]},
    }  # fmt: skip
    one = Input("bits/1", bytes, damaged=True)
    assert faults(one, clean, clean) == [] and fault in faults(one, clean | changes, clean)
    assert faults(one, {"crash": -9}, clean) == ["crash (-9)"] and "hang" in faults(one, {"hang": 200.0}, clean)[0]


def test_a_process_that_dies_is_a_crash(tmp_path):
    """And the next log is tried in another one."""
    with Watched("read", tmp_path) as process:
        (tmp_path / "x.mcap").write_bytes(b"")
        assert "is empty" in process.ask(tmp_path / "x.mcap")["error"]
        process.kill()
        assert process.ask(tmp_path / "x.mcap") == {"crash": -9}
        assert "is empty" in process.ask(tmp_path / "x.mcap")["error"]


def test_the_target_of_the_fuzzer(base, by_name, monkeypatch):
    """It is the same without the fuzzer, which need not be installed."""
    assert try_log(written(base.log)) == FRAMES and try_log(b"") == 0
    for name in ("bits/lz4/2", "cut/zstd/1", "records/footer/inside/index False", "cloud/offset 2^32", "stamp/wild"):
        assert try_log(by_name[name].make()) <= FRAMES
    monkeypatch.setitem(sys.modules, "atheris", None)
    with pytest.raises(SystemExit, match=r'pip install "voodoo_jax\[fuzz\]"'):
        main([])
