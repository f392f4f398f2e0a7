"""Settings by name: the defaults, those of each tracker and each paper, and those without a look into the future."""

from dataclasses import replace
from importlib import resources

from voodoo_jax.config.options import ReadSettings, Settings, SettingsError
from voodoo_jax.config.toml import read_settings

PRESETS = ("default", "knoop2007", "flexible", "both", "hecht2009")


def preset(name: str) -> Settings:
    """Settings by name: "default"; "knoop2007", the chain and the values of Knoop 2007 as far as it gives them;
    "flexible", the defaults of the flexible tracker; "both", those of both trackers together; "hecht2009", the system
    of Hecht, Azad and Dillmann 2009.

    Those of papers do not follow the defaults. The body of "knoop2007" is the built-in "human10". Raises SettingsError.
    """
    if name not in PRESETS:
        raise SettingsError(f"there is no preset '{name}'; there are {', '.join(PRESETS)}")
    if name == "flexible":
        return Settings(tracker="flexible", read=ReadSettings(images=True, matching="none"))
    if name == "both":
        return Settings(tracker="both", read=ReadSettings(images=True))
    if name == "default":
        return Settings()
    with resources.as_file(resources.files("voodoo_jax.config.preset_files") / f"{name}.toml") as path:
        return read_settings(path)


def online(settings: Settings, lag: float = 0.0) -> Settings:
    """Settings that use no later frames, except for the half second after each start, in which starts and sizes are
    compared.

    **Arguments:** `lag` seconds by which results may be late: that much of what follows a frame is used as well.
    """
    return replace(settings, online=True, online_lag=lag or settings.online_lag)
