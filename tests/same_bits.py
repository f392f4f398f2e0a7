"""Digests of all that is read and tracked, so that a change that should change nothing can be known to do so.

The demo and four small simulated logs are tracked with the product's own settings and flags, and a sha256 of each array
is compared with the ones in digests.json. Last digits differ between processors and versions of the libraries, so they
are kept for each of these. Where this one is not among them, or what is found differs, the code of the last commit that
changed digests.json is tracked with here, too, and decides: nothing is ever skipped. (That commit, and not one named in
the file, for a name is another one after every rebase.)

After a change of behaviour on purpose:

    python tests/same_bits.py --write

and commit digests.json together with the change. Digests of other processors are kept if the code of before gives the
same here, and dropped if not, for they are of other behaviour. On a processor that is not known yet the same line adds
it. digests.json stays where it is: moving it would make the move the commit that is compared with.
"""

import argparse
import io
import json
import os
import platform
import shutil
import subprocess
import sys
import tarfile
import tempfile
from contextlib import suppress
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
ROOT, DIGESTS, RUNNER = HERE.parent, HERE / "digests.json", HERE / "digest_runner.py"
LIBRARIES = ("jax", "jaxlib", "numpy", "scipy", "opencv-python-headless")
# of a processor's flags those by which compilers and libraries choose instructions
CHOSEN_BY = ("sse", "ssse", "avx", "fma", "f16c", "bmi", "amx", "asimd", "sve", "neon")
Digests = dict[str, str]


class NoReference(Exception):
    """There is no code of before to compare with."""


def processor() -> str:
    """This processor's name, and a digest of the flags that instructions are chosen by."""
    lines: list[str] = []
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    named = {line.split(":")[0].strip(): line.split(":", 1)[1].strip() for line in lines if ":" in line}
    name = named.get("model name") or platform.processor() or platform.machine()
    flags = sorted(f for f in (named.get("flags") or named.get("Features", "")).split() if f.startswith(CHOSEN_BY))
    return f"{platform.machine()} {name} {sha256(' '.join(flags).encode()).hexdigest()[:8]}"


def key() -> str:
    """What digests depend on besides the code."""
    return "; ".join([processor(), *(f"{name} {version(name)}" for name in LIBRARIES)])


def kept() -> dict[str, Digests]:
    """Digests by key."""
    return json.loads(DIGESTS.read_text()) if DIGESTS.exists() else {}


def environment(tree: Path) -> dict[str, str]:
    """For a process that runs a tree's package as users do, whatever flags the tests are run with."""
    env = {name: value for name, value in os.environ.items() if not name.startswith(("XLA_", "JAX_"))}
    return env | {"PYTHONPATH": str(tree), "JAX_PLATFORMS": "cpu"}


def run(tree: Path, *words: str) -> None:
    done = subprocess.run([sys.executable, *words], env=environment(tree), capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(words)} failed with the package in {tree}:\n{done.stdout}{done.stderr}")


def made_logs(folder: Path) -> list[str]:
    """The demo's log and the simulated ones, made by the package of this tree in a process of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    run(ROOT, str(HERE / "same_bits.py"), "--logs", str(folder))
    return sorted(str(path) for path in folder.glob("*.mcap"))


def digests(tree: Path, logs: list[str], workers: int = 2) -> Digests:
    """Of what the package of a tree reads and tracks in logs."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "found.json"
        # not this folder in sys.path: the package is the tree's
        run(tree, "-P", str(RUNNER), str(tree), str(out), str(workers), *logs)
        return json.loads(out.read_text())


def git(*words: str, root: Path = ROOT) -> bytes:
    if shutil.which("git") is None:
        raise NoReference("git is not there")
    done = subprocess.run(["git", "-C", str(root), *words], capture_output=True)
    if done.returncode:
        raise NoReference(done.stderr.decode(errors="replace").strip() or f"git {' '.join(words)} failed")
    return done.stdout


def reference(root: Path = ROOT) -> str:
    """The last commit that changed digests.json: its code behaves as they say."""
    try:
        commit = git("log", "-1", "--format=%H", "--", "tests/digests.json", root=root).decode().strip()
        if not commit:
            raise NoReference("no commit has tests/digests.json")
        if git("rev-parse", "--is-shallow-repository", root=root).strip() == b"true":
            # the oldest commit that is there seems to have made all files
            git("rev-parse", "--verify", "--quiet", f"{commit}^", root=root)
    except NoReference as problem:
        raise NoReference(
            f"There are no digests for this processor and these libraries that fit ({key()}), and no code of before to "
            f"compare with ({problem}). It takes a clone with its history (git fetch --unshallow); or run "
            "`python tests/same_bits.py --write` with code that is known to be right."
        ) from None
    return commit


def reference_digests(logs: list[str]) -> tuple[str, Digests]:
    """The commit to compare with, and what its package makes of the logs here."""
    commit = reference()
    with tempfile.TemporaryDirectory() as folder:
        with tarfile.open(fileobj=io.BytesIO(git("archive", "--format=tar", commit))) as tar:
            tar.extractall(folder, filter="data")
        return commit, digests(Path(folder), logs)


def differences(before: Digests, now: Digests) -> list[str]:
    """A line for each array that is another one, is missing, or is new."""
    shown = lambda text: text.rsplit(" ", 1)[0] if text else "none"  # noqa: E731
    return [
        f"{name}: {shown(before.get(name, ''))} before, {shown(now.get(name, ''))} now"
        for name in sorted(before.keys() | now.keys())
        if before.get(name) != now.get(name)
    ]


def changed(logs: list[str], now: Digests) -> str:
    """What has changed, in sentences; nothing if nothing has. Raises NoReference."""
    if kept().get(key()) == now:
        return ""
    commit, before = reference_digests(logs)
    if not (found := differences(before, now)):
        return ""
    return "\n".join([
        f"{len(found)} of {len(now)} arrays differ from those of commit {commit[:12]} (where nothing else, in values).",
        "If that is on purpose: python tests/same_bits.py --write, and commit digests.json with the change.", *found,
    ])  # fmt: skip


def still_valid(others: dict[str, Digests], before: Digests, now: Digests) -> dict[str, Digests]:
    """Of other processors' digests those that are of the behaviour of now, by what was and what is on this one."""
    return others if before == now else {}


def write(logs: list[str]) -> None:
    """Puts this processor's digests into digests.json."""
    now, there = digests(ROOT, logs), kept()
    others = {name: found for name, found in there.items() if name != key()}
    if others:
        before = there[key()] if key() in there else reference_digests(logs)[1]
        valid = still_valid(others, before, now)
        if not valid:
            print(f"The behaviour has changed: digests of {len(others)} other processors or versions are dropped.")
        others = valid
    DIGESTS.write_text(json.dumps(dict(sorted((others | {key(): now}).items())), indent=1) + "\n")
    print(f"{len(now)} digests for {key()}")


# The simulated logs


def write_logs(folder: Path) -> None:
    """All logs, by the package's own simulation. Imported here: what is above runs without the package."""
    from scipy.spatial.transform import Rotation

    import voodoo_jax
    from tests.support.colour_logs import Board, picture, ros_compressed, ros_info
    from tests.support.logs import START, Log, ros_calibration, ros_image, ros_marker, ros_markers, ros_tf
    from voodoo_jax.model.body import scaled, site_points
    from voodoo_jax.model.body_file import human
    from voodoo_jax.model.marker_sets import PLUG_IN_GAIT
    from voodoo_jax.simulate.mcap import write_simulation
    from voodoo_jax.simulate.motion import make_motion, placed, pose_body
    from voodoo_jax.simulate.recording import simulate
    from voodoo_jax.simulate.room import Box, Room
    from voodoo_jax.simulate.sensor import Camera

    (demo,) = Path(str(voodoo_jax.__file__)).parent.rglob("demo*.mcap")
    shutil.copyfile(demo, folder / "demo.mcap")
    body, rng = scaled(human(), 1.72), np.random.default_rng(0)

    # somebody bows before a chair that touches their legs
    chair = Room(boxes=(Box(3.2, 0.0, (0.4, 0.45, 0.45)), Box(3.43, 0.0, (0.06, 0.45, 0.9))))
    bowing = placed(make_motion(body, "bow", 1.2, 12.0), 2.85, 0.0, np.pi)
    write_simulation(simulate(body, bowing, room=chair, seed=1), folder / "chair.mcap")

    # waving between two cameras that face each other
    waving, log = placed(make_motion(body, "wave", 1.0, 10.0), 3.0, 0.0, np.pi / 2), Log()
    for seed, (name, x, yaw) in enumerate((("front", 0.0, 0.0), ("back", 6.0, np.pi))):
        view = Camera(160, 124, 182.0, 182.0, 79.5, 61.5, (x, 0.0, 1.0), 0.07, yaw)
        sim = simulate(body, waving, view, room=Room(wall=6.6, boxes=()), seed=seed, start_ns=START)
        q = tuple(Rotation.from_matrix(view.rotation).as_quat())
        log.add("/tf_static", START, ros_tf((START, "base", name, view.position, q)))
        k = np.array([[view.fx, 0, view.cx], [0, view.fy, view.cy], [0, 0, 1]])
        log.add(f"/{name}/camera_info", START, ros_calibration(name, k, size=(124, 160)))
        for t, image in zip(sim.time_ns.tolist(), sim.depth):
            log.add(f"/{name}/depth", t, ros_image(t, name, image / 1000))
    log.items.sort(key=lambda item: item[1])
    log.write(folder / "directions.mcap")

    # a walk by markers alone, those of one knee and the thighs missing, with 1 mm of noise
    walking, log = placed(make_motion(body, "walk", 1.0, 40.0), 1.0, -2.0, 2.0), Log()
    names = {m: body.topology.sites.index(s) for m, s in PLUG_IN_GAIT.items() if m not in ("LKNE", "LTHI", "RTHI")}
    for i in range(len(walking)):
        poses, stamp = pose_body(body, walking.root[i], walking.rotations[i]), START + i * 25_000_000
        points = np.asarray(site_points(body, poses), np.float64)
        points = points + rng.normal(0, 0.001, points.shape)
        log.add("/markers", stamp, ros_markers(*(ros_marker(stamp, "lab", n, points[k]) for n, k in names.items())))
    log.write(folder / "markers.mcap")

    # somebody made of textured boards, who steps to the side before a wall, seen by a stereo pair
    k, base, log = np.array([[400.0, 0.0, 159.5], [0.0, 400.0, 119.5], [0.0, 0.0, 1.0]]), 0.12, Log()
    log.add("/tf_static", START, ros_tf((START, "base", "left_optical", (0.0, 0.0, 0.9), (-0.5, 0.5, -0.5, 0.5))))
    log.add("/rig/left/camera_info", START, ros_info("left_optical", k, (240, 320)))
    log.add("/rig/right/camera_info", START, ros_info("right_optical", k, (240, 320), p03=-k[0, 0] * base))
    for i in range(5):
        stamp, x = START + i * 66_000_000, 0.03 * i
        limbs = [  # depth, low and high corner; y is down from the cameras
            (3.10, (-0.09, -0.80), (0.09, -0.58)), (3.05, (-0.20, -0.56), (0.20, 0.10)),
            (3.10, (-0.34, -0.54), (-0.25, 0.10)), (3.10, (0.25, -0.54), (0.34, 0.10)),
            (3.10, (-0.18, 0.10), (-0.04, 0.90)), (3.10, (0.04, 0.10), (0.18, 0.90)),
        ]  # fmt: skip
        boards = [Board(4.2), *(Board(z, (a + x, b), (c + x, d)) for z, (a, b), (c, d) in limbs)]
        for side, place in (("left", (0.0, 0.0, 0.0)), ("right", (base, 0.0, 0.0))):
            image = ros_compressed(stamp, f"{side}_optical", picture(boards, k, (240, 320), place), ".png", "png")
            log.add(f"/rig/{side}/image_raw/compressed", stamp, image)
    log.write(folder / "stereo.mcap")


def main() -> None:
    parser = argparse.ArgumentParser(description="Digests of all that is read and tracked; without a flag: compares.")
    parser.add_argument("--write", action="store_true", help="this processor's digests into digests.json")
    parser.add_argument("--logs", type=Path, help="only make the logs, in this folder")
    asked = parser.parse_args()
    if asked.logs:
        write_logs(asked.logs)
        return
    with tempfile.TemporaryDirectory() as folder:
        logs = made_logs(Path(folder))
        try:
            problem = write(logs) if asked.write else changed(logs, digests(ROOT, logs))
        except NoReference as none:
            problem = str(none)
    if problem:
        sys.exit(problem)


if __name__ == "__main__":
    main()
