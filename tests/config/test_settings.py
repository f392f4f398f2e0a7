"""Settings: files, their errors, flags over files, and a meaning for every option."""

import tomllib
from dataclasses import asdict, fields, replace

import pytest

from voodoo_jax.cli import commands
from voodoo_jax.cli import main as cli
from voodoo_jax.config.options import (
    Change,
    DetectSettings,
    FlexibleSettings,
    Settings,
    SettingsError,
    SolveSettings,
    StartSettings,
    TrackSettings,
)
from voodoo_jax.config.presets import preset
from voodoo_jax.config.toml import help_texts, read_settings, settings_text

CHANGED = replace(
    Settings(),
    detect=DetectSettings(link=0.2, forget=7),
    solve=SolveSettings(solver="per_limb", robust_scale=float("inf"), near_side=False, epsilon=1e-12),
    start=StartSettings(scale=1.83),
    flexible=FlexibleSettings(particles=50, depth_noise=(0.1, 0.2, 0.3)),
    tracker="flexible",
    online=True,
)


def as_lists(values: dict) -> dict:
    return {
        stage: {k: list(v) if isinstance(v, tuple) else v for k, v in of.items()} if isinstance(of, dict) else of
        for stage, of in values.items()
    }


@pytest.mark.parametrize("settings", [Settings(), CHANGED], ids=["defaults", "changed"])
def test_round_trip(tmp_path, settings):
    text = settings_text(settings)
    stages = {stage: values for stage, values in asdict(settings).items() if stage != "changes"}
    assert tomllib.loads(text) == as_lists(stages)
    path = tmp_path / "s.toml"
    path.write_text(text)
    assert read_settings(path) == settings


def test_texts_with_quotes_and_lists_survive(tmp_path):
    settings = replace(Settings(), read=replace(Settings().read, topics=('/a "b"', "/c\\d/ä\n"), fixed_frame="ö'"))
    path = tmp_path / "s.toml"
    path.write_text(settings_text(settings), encoding="utf-8")
    assert read_settings(path) == settings


def test_a_file_changes_only_what_it_names(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text("[track]\ndamping = 1\n")  # a whole number where a number is asked for
    got = read_settings(path, CHANGED)
    assert got == replace(CHANGED, track=TrackSettings(damping=1.0)) and isinstance(got.track.damping, float)
    path.write_text("")
    assert read_settings(path) == Settings()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[solv]\nmax_steps = 3", ["[solv]", "did you mean 'solve'?"]),
        ("[xyz]\n", ["[xyz]", "there are read", ", track,"]),
        ("max_steps = 3", ["max_steps", "not a section"]),
        ("solve = 3", ["[solve]", "not a section"]),
        ("[solve]\nmax_step = 3", ["[solve]", "'max_step'", "did you mean 'max_steps'?"]),
        ("[start]\nqqq = 3", ["'qqq'", "scale, headings, frames, seconds, directions"]),
        ("[solve]\nmax_steps = 2.5", ["solve.max_steps = 2.5", "whole number"]),
        ("[solve]\nmax_steps = true", ["solve.max_steps", "whole number"]),
        ("[solve]\nnear_side = 1", ["solve.near_side = 1", "true or false"]),
        ("[solve]\nratio = 'x'", ["solve.ratio", "a number", "0.6"]),
        ("[solve]\nratio = true", ["solve.ratio", "a number"]),
        ("[solve]\nratio = -0.1", ["solve.ratio = -0.1", "negative"]),
        ("[solve]\nratio = nan", ["solve.ratio = nan"]),
        ("[solve]\nratio = 1e38", ["solve.ratio = 1e+38", "at most 1000000"]),
        ("[solve]\nratio = inf", ["solve.ratio = inf", "at most 1000000"]),
        (f"[solve]\nratio = {'9' * 400}", ["solve.ratio = inf", "at most 1000000"]),
        (f"[solve]\nmax_steps = {'9' * 6000}", ["not a TOML file"]),
        (f"[solve]\nratio = {'[' * 3000}", ["not a TOML file"]),
        ("[detect]\nforget = 5000000000", ["detect.forget", "at most 2147483647"]),
        ("[start]\nscale = 1e-30", ["start.scale = 1e-30", "at least 0.001"]),
        ("[start]\nlater = [inf]", ["start.later", "at most 1e+06"]),
        ("[read]\nscale = ['/a=0']", ["read.scale", "metres per unit"]),
        ("[read]\ndelays = ['/a=1e38']", ["read.delays", "seconds"]),
        ("[read]\nmirror = ['/a=up']", ["read.mirror", "x, y, z or none"]),
        ("[[change]]\ntime = inf", ["number 1: time = inf", "below 1e+06"]),
        ("[[change]]\ntime = 1\nscale = 1e-300", ["scale = 1e-300", "above 0.001"]),
        ("[[change]]\ntime = 1\nsizes = {a = [1e-30, 1, 1, 1, 1]}", ["sizes", "a table such as"]),
        ("[detect]\npoints = -5", ["detect.points = -5", "negative"]),
        ("[solve]\nsolver = 'Coupled'", ["solve.solver", "'coupled'", "'per_limb'"]),
        ("[solve]\nsolver = ['coupled']", ["solve.solver", "'coupled'", "'per_limb'"]),
        ("[read]\ntopics = '/depth'", ["read.topics", "list of texts"]),
        ("[read]\ntopics = [1]", ["read.topics", "list of texts"]),
        ("[start]\nlater = [1.0, 'x']", ["start.later", "list of numbers"]),
        ("[start]\nlater = [-1]", ["start.later", "not negative"]),
        ("[read]\nfixed_frame = 1", ["read.fixed_frame", "a text"]),
        ("[read\n", ["not a TOML file"]),
    ],
)
def test_errors_say_where_what_and_what_instead(tmp_path, text, words):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(SettingsError) as caught:
        read_settings(path)
    for word in ["mine.toml", *words]:
        assert word in str(caught.value)


def test_not_a_text_file_or_not_there(tmp_path):
    path = tmp_path / "s.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SettingsError, match="not a TOML file"):
        read_settings(path)
    with pytest.raises(OSError):
        read_settings(tmp_path / "missing.toml")


def test_every_option_has_a_meaning():
    lines = settings_text().splitlines()
    for stage in fields(Settings):
        cls = Change if stage.name == "changes" else type(getattr(Settings(), stage.name))
        if stage.name in ("online", "online_lag", "tracker"):
            assert any(help_texts(Settings)[stage.name] in line for line in lines)
            continue
        texts = help_texts(cls)
        for option in fields(cls):
            assert len(texts.get(option.name, "")) > 12, f"{stage.name}.{option.name}"
            assert any(texts[option.name] in line for line in lines)


class Got(Exception):
    pass


@pytest.fixture
def given(monkeypatch):
    """The settings with which replay would run."""

    def stop(command):
        raise Got(command)

    monkeypatch.setattr(cli, "run_replay", stop)

    def run(*words: str) -> commands.Replay:
        with pytest.raises(Got) as caught:
            cli.main(["replay", "a.mcap", "b.mcap", "--out", "o", *words])
        return caught.value.args[0]

    return run


def test_flags_override_the_file_and_the_file_the_defaults(tmp_path, given):
    path = tmp_path / "s.toml"
    path.write_text("[solve]\nmax_steps = 7\nratio = 0.4\n[read]\ntopics = ['/a', '/b']\n")
    for words in (["--config", str(path)], [f"--config={path}"]):
        command = given(*words, "--solve.max-steps", "9", "--start.scale", "1.8", "--solve.no-near-side")
        solve = replace(SolveSettings(), max_steps=9, ratio=0.4, near_side=False)
        read = replace(Settings().read, topics=("/a", "/b"))
        assert command.settings == replace(Settings(), solve=solve, read=read, start=StartSettings(scale=1.8))
    assert [str(p) for p in command.logs] == ["a.mcap", "b.mcap"] and str(command.results.out) == "o"


def test_without_flags_the_defaults(given):
    command = given()
    assert command.settings == Settings() and command.config is None
    assert cli.body_name(command) == "human"


def test_a_preset_is_what_files_and_flags_start_from(tmp_path, given):
    paper = preset("knoop2007")
    command = given("--preset", "knoop2007")
    assert command.settings == paper and cli.body_name(command) == "human10"
    path = tmp_path / "s.toml"
    path.write_text("[solve]\nratio = 0.4\n")
    command = given(f"--config={path}", "--preset=knoop2007", "--solve.max-steps", "9", "--body", "arm")
    assert command.settings == replace(paper, solve=replace(paper.solve, ratio=0.4, max_steps=9))
    assert cli.body_name(command) == "arm"
    with pytest.raises(SettingsError, match="knoop2007"):
        preset("knoop2008")


def test_the_papers_values_are_the_papers():
    """Knoop 2007: sec. 7 weights and 6 steps, sec. 4.3 r, secs. 3.2 and 5.2 the chain; nothing of our own on top."""
    paper = preset("knoop2007")
    assert set(paper.features.weights) >= {"face=30", "left_hand=20", "right_hand=20"}
    assert paper.solve.max_steps == 6 and 0.4 < paper.solve.ratio < 0.7 and paper.solve.solver == "per_limb"
    assert paper.solve.overlap == "exclusive" and paper.solve.robust_scale == float("inf")
    assert not paper.solve.near_side and paper.solve.floor == 0 and paper.track.damping == 0 and paper.read.laser


@pytest.mark.parametrize("words", [["--solve.max-steps", "many"], ["--solve.solver", "best"], ["--solve.typo", "1"]])
def test_wrong_flags_are_refused(words, capsys):
    with pytest.raises(SystemExit) as stopped:
        cli.main(["replay", "a.mcap", "--out", "o", *words])
    assert stopped.value.code == 2 and words[0].split(".")[1] in capsys.readouterr().err


@pytest.mark.parametrize(
    "text, said",
    [
        ("to = 'no_limb'\nadd = 'stick'", "no_limb"),
        ("to = 'r_hand'\nadd = 'none.toml'", "none.toml"),
        ("remove = ['no_limb']", "no_limb"),
        ("sizes = {no_limb = [0.1, 0.1, 0.1, 0.1, 0.1]}", "no_limb"),
        ("to = 'r_hand'\nadd = 'stick'\naxis = [0, 0, 0]", "axis"),
    ],
)
def test_changes_are_tried_before_the_logs(text, said, tmp_path, capsys):
    path = tmp_path / "mine.toml"
    path.write_text(f"[[change]]\ntime = 1\n{text}\n")
    assert cli.main(["replay", "a.mcap", "--out", str(tmp_path / "o"), "--config", str(path)]) == 2
    assert said in capsys.readouterr().err and not (tmp_path / "o").exists()


@pytest.mark.parametrize("words", [["--solve.max-steps", "-3"], ["--detect.link", "-0.1"], ["--start.scale", "nan"]])
def test_flags_are_checked_as_the_file_is(words, tmp_path, capsys):
    """The same value must not be an error in a file and be taken as a flag."""
    assert cli.main(["replay", str(tmp_path / "none.mcap"), "--out", str(tmp_path / "o"), *words]) == 2
    printed = capsys.readouterr().err
    assert words[0].removeprefix("--").replace("-", "_") in printed and "must" in printed
    assert not (tmp_path / "o").exists()


def test_a_paper_of_the_flexible_tracker_implies_it(given):
    paper = given("--preset", "hecht2009").settings
    assert paper.tracker == "flexible" and given("--preset", "flexible").settings.tracker == "flexible"
    flexible = paper.flexible  # secs. III-A and IV-A
    assert (flexible.particles, flexible.head_particles, flexible.depth_share) == (200, 100, 0.25)
    assert flexible.depth_noise == (0.15, 0.5, 1.0) and 0.5 <= flexible.velocity <= 0.8
    assert flexible.follow_level == flexible.follow_up == 0.8 and flexible.refine == 0
    assert given("--tracker", "flexible", "--flexible.particles", "50").settings.flexible.particles == 50


def test_values_of_the_flexible_tracker_are_checked(tmp_path):
    path = tmp_path / "s.toml"
    for text, said in (
        ("tracker = 'kalman'", "'icp', 'flexible'"),
        ("[flexible]\ndepth_noise = [1.0]", "three numbers"),
        ("[flexible]\nlayers = 0", "at least 1"),
    ):
        path.write_text(text)
        with pytest.raises(SettingsError, match=said):
            read_settings(path)
