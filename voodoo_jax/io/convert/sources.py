"""Which recordings of other formats are converted, and by what."""

import os
from collections.abc import Sequence
from pathlib import Path

from voodoo_jax.io.convert.target import ConvertError
from voodoo_jax.records.notes import SENTENCE, plain

FASTEST, SLOWEST = 1e6, 1e-6  # files a second
FILES = {
    ".bag": "ROS 1 bag", ".db3": "ROS 2 bag (SQLite)", ".mkv": "Azure Kinect or Femto", ".c3d": "C3D", ".trc": "TRC",
    ".json": "skeletons of a Kinect, Nuitrack or ZED", ".skeleton": "NTU RGB+D", ".csv": "Motive, or columns NAME_x",
}  # fmt: skip


def is_foreign(path: str | os.PathLike[str]) -> bool:
    """Whether a file, or the folder of an SQLite bag, can be converted in passing, by its ending; other folders have to
    be converted by name."""
    path = Path(path)
    return (path.suffix.lower() in FILES and path.is_file()) or (path.is_dir() and any(path.glob("*.db3")))


def convert(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    camera: str | os.PathLike[str] | None = None,
    rate: float = 0.0,
    types: Sequence[str] = (),
) -> list[str]:
    """Writes a recording of another format as an MCAP log; nothing is left where that does not work.

    **Arguments:** `source` a ROS 1 bag (.bag, also RealSense's), an SQLite bag of ROS 2 (.db3, or its folder), a
    recording of an Azure Kinect or Femto (.mkv), C3D, TRC, skeletons (.json of a Kinect, Nuitrack or ZED, .skeleton
    of NTU RGB+D), tables of points (.csv of Motive, or with columns NAME_x, NAME_y, NAME_z), or a folder of depth
    images or point clouds (PCD, PLY); `camera` the images' camera file (see depth_images.py); `rate` files, or rows of
    a table, a second where there are no times; `types` files that define messages (.msg), for bags that do not.

    **Returns:** what was left out or changed, one sentence each. Raises ConvertError, OSError.
    """
    if not 0 <= rate <= FASTEST or 0 < rate < SLOWEST:
        raise ConvertError(
            f"--rate {rate}: must be from {SLOWEST:g} to {FASTEST:g} Hz, or 0: the files' names are times"
        )
    try:
        return _converted(Path(source), Path(target), camera, rate, types)
    except (ConvertError, OSError):
        raise
    except Exception as problem:  # each kind of file has its own
        text = f"'{source}' cannot be converted: unexpected {type(problem).__name__}: {problem}"
        raise ConvertError(plain(text, SENTENCE)) from problem


def _converted(
    source: Path, target: Path, camera: str | os.PathLike[str] | None, rate: float, types: Sequence[str]
) -> list[str]:
    from voodoo_jax.io.convert import clouds, depth_images, kinect_video, markers, ros_bags, skeletons, tables

    if not source.exists():
        raise ConvertError(f"there is no file or folder '{source}'")
    if source.is_dir():
        if any(source.glob("*.db3")):
            return ros_bags.convert(source, target, types)
        if any(source.glob("*.mcap")):
            raise ConvertError(f"'{source}' holds MCAP logs already: give it to replay as it is")
        if any(path.suffix.lower() in clouds.ENDINGS for path in source.iterdir()):
            return clouds.convert(source, target, rate)
        return depth_images.convert(source, target, Path(camera) if camera else None, rate)
    if not source.is_file():
        raise ConvertError(f"'{source}' is a pipe or a device: give a file")
    kind = source.suffix.lower()
    if kind in (".bag", ".db3"):
        return ros_bags.convert(source, target, types)
    if kind == ".mkv":
        return kinect_video.convert(source, target, Path(camera) if camera else None)
    if kind in (".json", ".skeleton"):
        return skeletons.convert(source, target)
    if kind == ".csv":
        return tables.convert(source, target, rate)
    if kind == ".c3d":
        return markers.convert_c3d(source, target)
    if kind == ".trc":
        return markers.convert_trc(source, target)
    known = ", ".join(f"{name} ({end})" for end, name in FILES.items())
    known += ", folders of a ROS 2 bag, of depth images (PNG) or of point clouds (PCD, PLY)"
    raise ConvertError(f"'{source}': such files are not converted; what is: {known}")
