"""Names of stages that settings may leave out; a wrong one is answered before a log is read."""

from dataclasses import replace

import pytest

import voodoo_jax as vj
from voodoo_jax.cli.main import main
from voodoo_jax.config.options import Settings, SettingsError
from voodoo_jax.trackers.stages import SECTIONS, check_stages


def skipping(section: str, *names: str) -> Settings:
    settings = Settings()
    return replace(settings, **{section: replace(getattr(settings, section), skip=names)})


@pytest.mark.parametrize("section", SECTIONS)
def test_every_stage_can_be_left_out(section):
    for stage in SECTIONS[section]():
        settings = skipping(section, stage.name)
        check_stages(settings)
        assert settings.skips(section, stage.name, stage.looks_ahead)
        assert not Settings().skips(section, stage.name, stage.looks_ahead)
    check_stages(skipping(section, "looks_ahead"))


@pytest.mark.parametrize("section", SECTIONS)
def test_no_look_ahead(section):
    for settings in (skipping(section, "looks_ahead"), vj.online(Settings())):
        assert not settings.looks_ahead(section)
        for stage in SECTIONS[section]():
            assert settings.skips(section, stage.name, stage.looks_ahead) == stage.looks_ahead


def test_a_wrong_name_is_answered_with_the_nearest(tmp_path, capsys):
    with pytest.raises(
        SettingsError, match="track.skip: there is no stage 'choose_facin'; did you mean 'choose_facing'?"
    ):
        check_stages(skipping("track", "choose_facin"))
    with pytest.raises(SettingsError, match="there are looks_ahead, cut_off_size, lying_down, later_start"):
        check_stages(skipping("track", "xyzxyz"))
    with pytest.raises(SettingsError, match="did you mean 'restart_limbs'"):
        vj.replay_logs(["missing.mcap"], tmp_path / "out", settings=skipping("track", "restart_limb"))
    assert not (tmp_path / "out").exists()
    words = ["replay", str(tmp_path / "missing.mcap"), "--out", str(tmp_path / "out"), "--track.skip", "choose_facin"]
    assert main(words) == 2
    assert "did you mean 'choose_facing'" in capsys.readouterr().err
