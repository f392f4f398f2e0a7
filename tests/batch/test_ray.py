"""Many logs on Ray: the same results from a cluster of one machine and of two, one of which is lost."""

import importlib.util
import json
import subprocess
import sys
from types import SimpleNamespace

import pytest

from tests.support.small_logs import FLAGS, SETTINGS, arrays_of, assert_same, small_body, small_log
from voodoo_jax.batch.log_job import Job
from voodoo_jax.batch.outcome import Outcome
from voodoo_jax.batch.ray_cluster import done_on, say_what_lacks
from voodoo_jax.batch.replay import replay
from voodoo_jax.cli.main import main
from voodoo_jax.config.ray_tasks import RayTasks

needs_ray = pytest.mark.skipif(
    importlib.util.find_spec("ray") is None, reason='ray is not installed (80 MB): pip install -e ".[ray]"'
)


@needs_ray
def test_the_command_starts_a_cluster_of_its_own(tmp_path):
    """In a process of its own: Ray leaves threads and handlers behind. The answer about what is no log comes back."""
    (tmp_path / "no.mcap").write_text("a diary")
    words = ["replay", str(tmp_path / "no.mcap"), "--out", str(tmp_path / "ray"), *FLAGS, "--engine", "ray"]
    command = [sys.executable, "-P", "-W", "error", "-m", "voodoo_jax.cli", *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.returncode == 1 and "0 of 1 logs tracked" in done.stdout, done.stderr
    assert "no.mcap: FAILED" in done.stdout and "MCAP" in done.stdout
    assert "no machine of the cluster" not in done.stderr


@needs_ray
def test_a_log_whose_machine_is_lost_is_done_by_another(tmp_path):
    """From and to an object store: to the bit what is tracked here. Progress is heard of both machines."""
    logs = [small_log(tmp_path / f"{name}.mcap", 40, seed) for seed, name in enumerate("ab")]
    replay(logs, tmp_path / "here", small_body(), SETTINGS, quiet=True)
    places = [f"local://{path}" for path in (tmp_path / "there", *logs)]
    command = [sys.executable, "-m", "tests.support.ray_of_two", *places]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    assert told["errors"] == ["", ""]
    began_anew = {number for number, share in told["heard"] if share == 0}
    assert len(began_anew) == 1 and {n for n, share in told["heard"] if 0 < share < 1} == {0, 1}
    assert_same(arrays_of(tmp_path / "there"), arrays_of(tmp_path / "here"))


class Lost(Exception):
    pass


class FakeRay:
    """A cluster of one machine with four cores that loses the tasks of logs whose names begin with "bad"."""

    exceptions = SimpleNamespace(RayError=Lost)

    def __init__(self):
        self.asked, self.begun = {}, []

    def nodes(self):
        return [{"Alive": True, "Resources": {"CPU": 4.0}}, {"Alive": False, "Resources": {"CPU": 4.0, "GPU": 8.0}}]

    def remote(self, **asked):
        self.asked = asked | self.asked  # the first: that of the tasks
        return lambda _: SimpleNamespace(options=lambda name: SimpleNamespace(remote=self._begin), remote=lambda: None)

    def _begin(self, job, number, board):
        self.begun.append(number)
        return (len(self.begun), job.log)

    def wait(self, running, timeout):
        return running[:1], running[1:]

    def get(self, task):
        if task[1].startswith("bad"):
            raise Lost("no heartbeat")
        return Outcome(task[1])


def test_a_log_that_is_lost_too_often_is_given_up_and_the_others_are_done():
    ray = FakeRay()
    jobs = [Job(log, "", small_body(), SETTINGS, 0.0, "", (), False) for log in ("bad", "good", "worse")]
    heard = []
    tasks = RayTasks(num_cpus=2, num_gpus=0.5, retries=2)
    found = dict(done_on(ray, jobs, lambda number, share: heard.append((number, share)), tasks, {}))
    assert ray.begun == [0, 1, 2, 0, 0] and not found[1].error and not found[2].error
    assert "lost 3 times" in found[0].error and "Lost: no heartbeat" in found[0].error
    assert heard.count((0, 0.0)) == 2 and [n for n, share in heard if share == 1] == [1, 2, 0]
    assert (ray.asked["num_cpus"], ray.asked["num_gpus"], ray.asked["max_retries"]) == (2, 0.5, 0)
    variables = ray.asked["runtime_env"]["env_vars"]
    assert variables["OMP_NUM_THREADS"] == "2" and "JAX_PLATFORMS" not in variables


def test_that_no_machine_has_what_a_log_asks_for_is_said(capsys):
    say_what_lacks(FakeRay(), RayTasks(num_cpus=4))
    assert capsys.readouterr().err == ""
    say_what_lacks(FakeRay(), RayTasks(num_cpus=2, num_gpus=1))  # the one with GPUs is not alive
    assert "no machine of the cluster has 2 CPU and 1 GPU" in capsys.readouterr().err


@pytest.mark.parametrize(
    "flags, problem",
    [
        (["--ray-cpus", "0"], "must be 1 or more"),
        (["--ray-gpus", "1.5"], "a share of one GPU"),
        (["--ray-retries", "-1"], "must not be negative"),
    ],
)
def test_what_cannot_be_asked_for_is_said(flags, problem, tmp_path, capsys):
    (tmp_path / "a.mcap").write_text("no log")
    words = ["replay", str(tmp_path / "a.mcap"), "--out", str(tmp_path / "o"), "--engine", "ray", *flags]
    assert main(words) == 2
    assert problem in capsys.readouterr().err


def test_without_ray_it_is_said_what_to_install(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "ray", None)
    (tmp_path / "a.mcap").write_text("no log")
    assert main(["replay", str(tmp_path / "a.mcap"), "--out", str(tmp_path / "o"), "--engine", "ray"]) == 2
    printed = capsys.readouterr().err
    assert 'pip install "voodoo_jax[ray]"' in printed and "--engine local" in printed and "Traceback" not in printed
