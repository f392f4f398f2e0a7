"""Tracks articulated bodies, people first, in recorded 3D sensor logs: VooDoo (Knoop et al. 2006, 2007) in JAX.

import voodoo_jax as vj
recording = vj.read_log("log.mcap")
tracks = vj.track(vj.human(), recording)
vj.show(tracks, recording)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from voodoo_jax._version import __version__ as __version__

if TYPE_CHECKING:
    from voodoo_jax.batch.replay import replay
    from voodoo_jax.batch.track_many import track_many as track_many
    from voodoo_jax.config.fit_options import FitSettings as FitSettings
    from voodoo_jax.config.options import Change as Change
    from voodoo_jax.config.options import Settings as Settings
    from voodoo_jax.config.output_style import Style as Style
    from voodoo_jax.config.presets import online as online
    from voodoo_jax.config.presets import preset as preset
    from voodoo_jax.detect.opening import read_log as read_log
    from voodoo_jax.exporters.formats import export as export
    from voodoo_jax.exporters.npz import read_tracks_npz, write_tracks_npz
    from voodoo_jax.fitting.front import fit as fit
    from voodoo_jax.fitting.losses import loss as loss
    from voodoo_jax.fitting.problem import problem as problem
    from voodoo_jax.fitting.problem import solved as solved
    from voodoo_jax.fitting.tuning import tune as tune
    from voodoo_jax.io.log_reader import LogError as LogError
    from voodoo_jax.io.log_reader import survey as survey
    from voodoo_jax.model.attachments import attach as attach
    from voodoo_jax.model.body import Body as Body
    from voodoo_jax.model.body import joint_centres as joint_centres
    from voodoo_jax.model.body_file import human as human
    from voodoo_jax.model.body_file import load_body as load_body
    from voodoo_jax.model.body_file import read_body as read_body
    from voodoo_jax.model.body_file import write_body as write_body
    from voodoo_jax.model.foreign.sources import body_from as body_from
    from voodoo_jax.records.recording import Recording as Recording
    from voodoo_jax.records.tracks import Evidence as Evidence
    from voodoo_jax.records.tracks import Tracks as Tracks
    from voodoo_jax.trackers.front import track as track
    from voodoo_jax.trackers.front import track_people as track_people
    from voodoo_jax.trackers.smoothing import smooth as smooth
    from voodoo_jax.viz.figures import picture
    from voodoo_jax.viz.figures import show as show

    read_tracks, write_tracks = read_tracks_npz, write_tracks_npz
    save_picture, replay_logs = picture, replay

# name -> (module, name there); imported on first use, so that the command's --help need not wait for jax.
# No name may be that of a module here: importing the module would take its place.
_PUBLIC = {
    "Body": ("model.body", "Body"),
    "Change": ("config.options", "Change"),
    "FitSettings": ("config.fit_options", "FitSettings"),
    "LogError": ("io.log_reader", "LogError"),
    "Recording": ("records.recording", "Recording"),
    "Settings": ("config.options", "Settings"),
    "Style": ("config.output_style", "Style"),
    "Tracks": ("records.tracks", "Tracks"),
    "Evidence": ("records.tracks", "Evidence"),
    "attach": ("model.attachments", "attach"),
    "body_from": ("model.foreign.sources", "body_from"),
    "export": ("exporters.formats", "export"),
    "fit": ("fitting.front", "fit"),
    "human": ("model.body_file", "human"),
    "joint_centres": ("model.body", "joint_centres"),
    "loss": ("fitting.losses", "loss"),
    "load_body": ("model.body_file", "load_body"),
    "online": ("config.presets", "online"),
    "preset": ("config.presets", "preset"),
    "problem": ("fitting.problem", "problem"),
    "read_body": ("model.body_file", "read_body"),
    "read_log": ("detect.opening", "read_log"),
    "read_tracks": ("exporters.npz", "read_tracks_npz"),
    "replay_logs": ("batch.replay", "replay"),
    "save_picture": ("viz.figures", "picture"),
    "show": ("viz.figures", "show"),
    "smooth": ("trackers.smoothing", "smooth"),
    "solved": ("fitting.problem", "solved"),
    "survey": ("io.log_reader", "survey"),
    "track": ("trackers.front", "track"),
    "track_many": ("batch.track_many", "track_many"),
    "track_people": ("trackers.front", "track_people"),
    "tune": ("fitting.tuning", "tune"),
    "write_body": ("model.body_file", "write_body"),
    "write_tracks": ("exporters.npz", "write_tracks_npz"),
}
__all__ = sorted(_PUBLIC)


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        module, attribute = _PUBLIC[name]
        return getattr(import_module(f"voodoo_jax.{module}"), attribute)
    raise AttributeError(f"module 'voodoo_jax' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted([*_PUBLIC, "__version__"])
