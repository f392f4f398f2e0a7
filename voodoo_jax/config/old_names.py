"""Old names of settings: accepted for one version, with a hint at the new ones."""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

from voodoo_jax.config.options import LOOKS_AHEAD, Settings, SettingsError

SECTIONS = {"person": "detect"}  # old -> new
# switch that was -> what is left out, by section, where it is false
SWITCHES = {
    ("detect", "ahead"): {"detect": (LOOKS_AHEAD,), "track": ("drop_unexplained",)},
    ("detect", "steady"): {"detect": ("steady_sensors",)},
    ("track", "both_ways"): {"track": (LOOKS_AHEAD,)},
    ("track", "forearms"): {"track": ("fit_forearms",)},
}


def with_new_names(content: Mapping[str, Any], base: Settings) -> dict[str, Any]:
    """The content of a settings file with new names in place of old ones; a FutureWarning for each.

    **Arguments:** `base` what the file changes.

    Raises SettingsError for a switch that is neither true nor false.
    """
    out = {name: dict(value) if isinstance(value, dict) else value for name, value in content.items()}
    for old, new in SECTIONS.items():
        if isinstance(out.get(old), dict):
            _hint(f"[{old}] is called [{new}] now")
            out[new] = out.pop(old) | out.get(new, {})
    for (section, name), left_out in SWITCHES.items():
        if not isinstance(out.get(section), dict) or name not in out[section]:
            continue
        value = out[section].pop(name)
        if not isinstance(value, bool):
            raise SettingsError(f"{section}.{name} = {value!r}: must be true or false")
        news = " and ".join(f"{where}.skip = {list(stages)}" for where, stages in left_out.items())
        _hint(f"{section}.{name} is gone; {section}.{name} = false is {news} now".replace("'", '"'))
        for where, stages in left_out.items():
            table = out.setdefault(where, {})
            rest = [stage for stage in table.get("skip", getattr(base, where).skip) if stage not in stages]
            table["skip"] = rest if value else [*rest, *stages]
    return out


def with_new_flags(argv: Sequence[str]) -> tuple[list[str], dict[str, Any]]:
    """A command line without old flags, and what these say, as the content of a settings file (in new sections)."""
    words, said = [], {}
    for word in argv:
        for old, new in SECTIONS.items():
            if word.startswith(f"--{old}."):
                _hint(f"--{old}.* is called --{new}.* now")
                word = f"--{new}.{word.removeprefix(f'--{old}.')}"
        for section, name in SWITCHES:
            flag = name.replace("_", "-")
            if word.replace("_", "-") in (f"--{section}.{flag}", f"--{section}.no-{flag}"):
                said.setdefault(section, {})[name] = ".no-" not in word.replace("_", "-")
                break
        else:
            words.append(word)
    return words, said


def _hint(text: str) -> None:
    warnings.warn(f"{text}; the old name goes with the next version", FutureWarning, stacklevel=4)
