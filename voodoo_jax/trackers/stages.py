"""Names of the stages of detection and tracking, as settings may name them."""

from voodoo_jax.config.options import LOOKS_AHEAD, Settings, SettingsError
from voodoo_jax.config.toml import nearest
from voodoo_jax.detect import pipeline as detection
from voodoo_jax.trackers.icp import pipeline as icp

SECTIONS = {"detect": detection.stages, "track": icp.stages}  # section of the settings -> its stages


def check_stages(settings: Settings) -> None:
    """Raises SettingsError for a name in `track.skip` or `detect.skip` that no stage has."""
    for section, stages in SECTIONS.items():
        known = [LOOKS_AHEAD, *(stage.name for stage in stages())]
        for name in getattr(settings, section).skip:
            if name not in known:
                raise SettingsError(f"{section}.skip: there is no stage '{name}'{nearest(name, known)}")
