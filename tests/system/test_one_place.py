"""What must stand in one place stands there: views of bytes, printing, markup, foreign parsers, files of arrays."""

import ast
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

import voodoo_jax

ROOT = Path(voodoo_jax.__file__).parent
READERS = ("io", "model", "exporters", "geometry", "sensors", "batch", "fitting", "storage", "records")


def calls(*packages: str) -> Iterator[tuple[str, ast.Call]]:
    for path in sorted(ROOT.rglob("*.py")):
        name = path.relative_to(ROOT).as_posix()
        if not packages or name.split("/")[0] in packages:
            yield from ((name, node) for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call))


def called(node: ast.Call) -> str:
    return ast.unparse(node.func)


def test_arrays_over_bytes_are_made_by_one_function():
    bare = re.compile(r"(^|\.)(as_strided|frombuffer|sliding_window_view|memmap|fromfile)$|^np\.ndarray$")
    found = {name for name, node in calls(*READERS) if bare.search(called(node))}
    assert found == {"geometry/arrays_file.py"}


def test_arrays_are_read_from_files_by_one_function():
    own = {"cli/demo.py"}  # files of this package, and what it has just written
    assert {name for name, node in calls() if called(node) in ("np.load", "numpy.load", "pickle.load")} - own <= {
        "batch/worker_process.py", "batch/process_pool.py",  # what our own processes say
    }  # fmt: skip


def test_one_place_prints():
    said = ("print", "tqdm.write", "sys.stdout.write", "sys.stderr.write")
    found = {(name, ast.unparse(node)) for name, node in calls() if called(node) in said}
    beside_bars = {name for name, text in found if text.startswith("tqdm.write(shown(")}
    assert beside_bars == {"batch/replay.py", "batch/ray_cluster.py"}
    assert {name for name, _ in found} - beside_bars == {"cli/printing.py"}
    bars = [ast.unparse(node) for name, node in calls() if called(node).endswith("set_description")]
    assert all("shown(" in text or "logs'" in text for text in bars), bars


def test_one_place_puts_text_into_markup():
    for path in sorted(ROOT.rglob("*.py")):
        name = path.relative_to(ROOT).as_posix()
        tree = ast.parse(path.read_text())
        if name not in ("records/notes.py", "viz/report_page.py"):  # drawings are numbers and words of ours
            for node in ast.walk(tree):
                if isinstance(node, ast.JoinedStr):
                    text = "".join(str(part.value) for part in node.values if isinstance(part, ast.Constant))
                    assert not re.search(r"</?(a|b|p|h\d|td|tr|th|li|ul|img|span|div|table|script)[ >]", text), name
        assert "from html import" not in path.read_text() or name == "records/notes.py", name


def test_foreign_files_are_parsed_behind_the_guard_only():
    """Libraries that parse them are imported by the modules of which guard.py runs functions, and by nobody else."""
    parsers = re.compile(r"^(av|apsw|sqlite3|rosbags\.(highlevel|rosbag1|rosbag2).*)$|^trimesh$|^xml\.")
    found = set()
    for path in sorted(ROOT.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            if any(map(parsers.match, names)):
                found.add(path.relative_to(ROOT).as_posix())
    writes = {"exporters/foxglove.py", "exporters/gltf.py", "exporters/skeleton.py", "viz/viewer.py"}
    behind = {"io/convert/clouds.py", "io/convert/kinect_video.py", "io/convert/ros_bags.py"}
    behind |= {"model/foreign/urdf.py", "model/foreign/skinned_mesh.py"}
    assert behind <= found <= behind | writes
    loads = {name for name, node in calls() if called(node) in ("trimesh.load", "av.open", "ezc3d.c3d")}
    own = {"exporters/c3d.py"}  # writes them
    assert (
        loads == behind - {"model/foreign/skinned_mesh.py", "io/convert/ros_bags.py"} | {"io/convert/markers.py"} | own
    )


@pytest.mark.parametrize("name", ["io", "model", "storage"])
def test_files_are_opened_by_one_function(name):
    """`open` for reading stands only where an MCAP log is read again and again, once check_head has passed it."""
    known = {"io/container.py", "io/live/sources.py", "storage/troubles.py", "storage/urls.py", "storage/atomic.py"}
    for path, node in calls(name):
        mode = ast.unparse(node.args[1]) if len(node.args) > 1 else "'r'"
        if called(node) == "open" and "w" not in mode:
            assert path in known, path


def test_the_repository_has_no_files_that_a_run_has_made():
    """Whole folders were committed once that a profiler had written into the checkout."""
    checkout = ROOT.parent
    if not (checkout / ".git").exists():
        pytest.skip("not a checkout")
    tracked = subprocess.run(["git", "ls-files"], cwd=checkout, capture_output=True, text=True, check=True).stdout
    top = {name.split("/")[0] for name in tracked.splitlines()}
    assert {name for name in top if not name.startswith(".")} == {
        "pyproject.toml", "voodoo_jax", "experiments", "tests", "notebooks", "README.md", "docs", "ros2", "LICENSE",
        "CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "SECURITY.md", "Dockerfile", "mkdocs.yml",
    }  # fmt: skip
