"""Names of the stages of detection and tracking, as settings may name them."""

from difflib import get_close_matches

from voodoo_jax.config.options import LOOKS_AHEAD, Settings, SettingsError
from voodoo_jax.detect import pipeline as detection
from voodoo_jax.trackers.icp import pipeline as icp

SECTIONS = {"detect": detection.stages, "track": icp.stages}  # section of the settings -> its stages


def check_stages(settings: Settings) -> None:
    """Raises SettingsError for a name in `track.skip` or `detect.skip` that no stage has."""
    for section, stages in SECTIONS.items():
        known = [LOOKS_AHEAD, *(stage.name for stage in stages())]
        for name in getattr(settings, section).skip:
            if name not in known:
                near = get_close_matches(name, known, 1)
                hint = f"did you mean '{near[0]}'?" if near else f"there are {', '.join(known)}"
                raise SettingsError(f"{section}.skip: there is no stage '{name}'; {hint}")
