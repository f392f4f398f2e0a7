"""Old names of settings do for one version what they did, and say what they are called now."""

from dataclasses import replace

import pytest

from voodoo_jax.cli import main as cli
from voodoo_jax.config.old_names import with_new_flags
from voodoo_jax.config.options import Settings, SettingsError
from voodoo_jax.config.presets import preset
from voodoo_jax.config.toml import read_settings

DEFAULT = Settings()


def read(tmp_path, text: str, base: Settings = DEFAULT) -> Settings:
    path = tmp_path / "old.toml"
    path.write_text(text)
    return read_settings(path, base)


@pytest.mark.parametrize(
    "text, detect, track",
    [
        ("[person]\nahead = false", ("looks_ahead",), ("drop_unexplained",)),
        ("[person]\nsteady = false", ("steady_sensors",), ()),
        ("[track]\nboth_ways = false", (), ("looks_ahead",)),
        ('[track]\nforearms = false\nskip = ["restart_limbs"]', (), ("restart_limbs", "fit_forearms")),
        ("[track]\nboth_ways = true\nforearms = true\n[person]\nahead = true", (), ()),
    ],
)
def test_switches_that_were_are_stages_left_out(tmp_path, text, detect, track):
    with pytest.warns(FutureWarning, match="old name goes"):
        found = read(tmp_path, text)
    assert (found.detect.skip, found.track.skip) == (detect, track)


def test_a_section_keeps_its_values(tmp_path):
    with pytest.warns(FutureWarning, match=r"\[person\] is called \[detect\] now"):
        found = read(tmp_path, "[person]\nlink = 0.2\npoints = 300\n[detect]\npoints = 400")
    assert found == replace(DEFAULT, detect=replace(DEFAULT.detect, link=0.2, points=400))


def test_true_undoes_what_the_base_leaves_out(tmp_path):
    assert preset("knoop2007").track.skip == ("looks_ahead",)
    with pytest.warns(FutureWarning):
        assert read(tmp_path, "[track]\nboth_ways = true", preset("knoop2007")).track.skip == ()


def test_a_switch_is_true_or_false(tmp_path):
    with pytest.raises(SettingsError, match="old.toml: track.both_ways = 1: must be true or false"):
        read(tmp_path, "[track]\nboth_ways = 1")


def test_old_flags():
    with pytest.warns(FutureWarning):
        words, said = with_new_flags(
            ["replay", "a.mcap", "--person.points", "99", "--track.no-both-ways", "--person.no_ahead", "--out", "x"]
        )
    assert words == ["replay", "a.mcap", "--detect.points", "99", "--out", "x"]
    assert said == {"track": {"both_ways": False}, "detect": {"ahead": False}}


def test_the_command_takes_old_flags_with_a_hint(monkeypatch, capsys):
    seen = []
    monkeypatch.setattr(cli, "run_replay", lambda command: seen.append(command.settings) or 0)
    assert cli.main(["replay", "a.mcap", "--person.points", "99", "--track.no-forearms"]) == 0
    assert seen[0].detect.points == 99 and seen[0].track.skip == ("fit_forearms",)
    hints = capsys.readouterr().err
    assert "--detect.*" in hints and 'track.skip = ["fit_forearms"]' in hints
    assert cli.main(["replay", "a.mcap", "--online"]) == 0 and seen[1] == replace(DEFAULT, online=True)
    assert not capsys.readouterr().err
