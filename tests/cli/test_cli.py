"""The command: help at once, exit statuses, sentences instead of tracebacks."""

import subprocess
import sys
import tomllib
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path

import pytest

from tests.support import logs
from voodoo_jax.cli.main import main
from voodoo_jax.config.options import Settings
from voodoo_jax.config.toml import read_settings

DEMO = str(files("voodoo_jax") / "data" / "demo.mcap")


def python(code: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("words", [["--help"], ["replay", "--help"], ["info", "--help"], ["config"]])
def test_help_imports_nothing_heavy(words):
    heavy = ("jax", "equinox", "scipy", "matplotlib", "mcap", "rosbags", "numpy", "trimesh", "cv2")
    done = python(
        "import sys, voodoo_jax.cli.main as cli\n"
        f"try:\n    cli.main({words!r})\n"
        "except SystemExit as stop:\n    assert not stop.code, stop\n"
        f"print('HEAVY', [m for m in {heavy!r} if m in sys.modules])\n"
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip().splitlines()[-1] == "HEAVY []"


@pytest.mark.parametrize("name", ["replay", "info", "demo", "config"])
def test_help_of_every_command(name, capsys):
    with pytest.raises(SystemExit) as stopped:
        main([name, "--help"])
    printed = capsys.readouterr().out
    assert stopped.value.code == 0 and f"voodoo-jax {name}" in printed
    if name == "replay":
        usual = ("--out", "--body", "--config", "--tracker", "--picture", "--report", "--help-all")
        with pytest.raises(SystemExit):
            main(["replay", "--preset", "knoop2007", "--help-all"])
        everything = capsys.readouterr().out
        assert all(word in printed and word in everything for word in usual)
        for word in ("--solve.max-steps INT", "--start.scale FLOAT"):
            assert word not in printed and word in everything
        assert "(default: 6)" in everything and printed.count("\n") <= 80


@pytest.mark.parametrize("words", [[], ["--help"]])
def test_without_a_command_the_commands_are_named(words, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(words)
    printed = capsys.readouterr().out
    assert stopped.value.code == 0 and all(name in printed for name in ("replay", "info", "demo", "config"))


def test_unknown_command(capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["repaly"])
    assert stopped.value.code == 2 and "repaly" in capsys.readouterr().err


def test_config_prints_the_defaults_as_a_file(tmp_path, capsys):
    assert main(["config"]) == 0
    text = capsys.readouterr().out
    assert set(tomllib.loads(text)) == set(asdict(Settings())) - {"changes"}
    path = tmp_path / "s.toml"
    path.write_text(text)
    assert read_settings(path) == Settings()


def test_info_on_good_and_bad_files(tmp_path, capsys):
    good = logs.depth_log(5).write(tmp_path / "good.mcap")
    assert main(["info", str(good)]) == 0
    assert "/cam/depth" in capsys.readouterr().out
    bad = tmp_path / "bad.mcap"
    bad.write_text("no log")
    assert main(["info", str(bad), str(good)]) == 1  # the good one is shown all the same
    printed = capsys.readouterr()
    assert "bad.mcap" in printed.err and "Traceback" not in printed.err and "/cam/depth" in printed.out
    assert main(["info", str(tmp_path / "missing.mcap")]) == 1
    assert "missing.mcap" in capsys.readouterr().err


def test_unknown_body(tmp_path, capsys):
    assert main(["replay", DEMO, "--out", str(tmp_path / "o"), "--body", "hunam"]) == 2
    printed = capsys.readouterr().err
    assert "hunam" in printed and "human" in printed.replace("hunam", "") and "Traceback" not in printed
    assert not (tmp_path / "o").exists()


def test_body_file_with_an_error_names_file_and_place(tmp_path, capsys):
    body = tmp_path / "mine.toml"
    body.write_text('name = "x"\nscale = -1.0\n')
    assert main(["replay", DEMO, "--out", str(tmp_path / "o"), "--body", str(body)]) == 2
    printed = capsys.readouterr().err
    assert "mine.toml" in printed and "scale" in printed


@pytest.mark.parametrize("words", [["replay", "--out", "o"], ["info"]])
def test_missing_arguments(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    try:
        status = main(words)
    except SystemExit as stopped:
        status = stopped.code
    assert status == 2
    assert "log" in capsys.readouterr().err
    assert not Path("o").exists()


@pytest.mark.parametrize("words", [["--config"], ["--config", "missing.toml"], ["--config=wrong.toml"]])
def test_settings_file_that_cannot_be_used(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("wrong.toml").write_text("[solve]\nmax_step = 3\n")
    try:
        status = main(["replay", DEMO, "--out", "o", *words])
    except SystemExit as stopped:
        status = stopped.code
    printed = capsys.readouterr().err
    assert status == 2 and "config" in printed or "toml" in printed
    assert "Traceback" not in printed and not Path("o").exists()


def test_out_is_a_file(tmp_path, capsys):
    (tmp_path / "o").write_text("mine")
    assert main(["replay", DEMO, "--out", str(tmp_path / "o")]) == 2
    assert "o'" in capsys.readouterr().err and (tmp_path / "o").read_text() == "mine"


def test_a_log_that_is_not_there(tmp_path, capsys):
    assert main(["replay", str(tmp_path / "gone.mcap"), "--out", str(tmp_path / "o")]) == 1
    printed = capsys.readouterr()
    assert "gone.mcap: FAILED" in printed.out and "0 of 1 logs tracked" in printed.out
    assert [file.name for file in (tmp_path / "o").iterdir()] == ["replay.jsonl"]


def test_python_m_runs_the_command():
    done = subprocess.run(
        [sys.executable, "-m", "voodoo_jax.cli", "config"], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0 and tomllib.loads(done.stdout)["track"]["chunk"] == Settings().track.chunk
