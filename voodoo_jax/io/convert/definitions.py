"""Message definitions for bags without them: SQLite bags of ROS 2 before Iron, with drivers' own types.

`driver_types.msg` has types of common drivers, as their packages define them (Livox, RealSense, ZED, vision_msgs 4,
point_cloud_interfaces, mocap4r2_msgs); others can be given as files.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rosbags.typesys import TypesysError, get_types_from_msg

from voodoo_jax.io.convert.target import ConvertError
from voodoo_jax.storage.troubles import small_text

BUILT_IN, FIRST = Path(__file__).with_name("driver_types.msg"), "livox_ros_driver2/msg/CustomMsg"
WAY_OUT = "give its definition, the .msg file of its package: --read.types FILE.msg (voodoo-jax convert: --types)"


def register(store: Any, wanted: Sequence[str], given: Sequence[str]) -> set[str]:
    """Adds missing definitions to a typestore, first those of the given files; returns the names in `wanted` that it
    now knows. Raises ConvertError for a file without definitions."""
    missing = {name for name in wanted if name not in store.fielddefs}
    if missing:
        types = get_types_from_msg(small_text(BUILT_IN), FIRST) | _of_files(given, missing)
        store.register({name: fields for name, fields in types.items() if name not in store.fielddefs})
    return {name for name in missing if name in store.fielddefs}


def _of_files(given: Sequence[str], missing: set[str]) -> dict[str, Any]:
    """Types that files define, each with those beside it in its folder."""
    found: dict[str, Any] = {}
    for place in map(Path, given):
        try:
            package = _package(place, missing)
            for path in [*sorted(place.parent.glob("*.msg")), place]:
                found |= get_types_from_msg(small_text(path), f"{package}/msg/{path.stem}")
        except (OSError, ValueError, KeyError, TypesysError) as problem:
            raise ConvertError(f"read.types: '{place}' is not a message definition (.msg): {problem}") from problem
    return found


def _package(path: Path, missing: set[str]) -> str:
    """Of a definition: as its folder says (PACKAGE/msg/TYPE.msg), or as the bag does that lacks it."""
    if path.parent.name == "msg":
        return path.resolve().parent.parent.name
    return next((name.split("/")[0] for name in sorted(missing) if name.endswith(f"/{path.stem}")), path.parent.name)
