"""The promises, in the order in which the table shows them: one file each, or one of several (`file/part`)."""

from importlib import import_module

from experiments.scoreboard.board import Promise

NAMES = (
    "demo", "fusion", "depth_only", "online", "every_third_frame", "sizes", "confidence", "covariance", "others",
    "markers", "stereo", "flexible", "both", "stereo_confidence", "hecht2009", "knoop2007", "people", "real_markers",
    "up", "keypoints", "kinect1", "real_sensors", "field_cases", "several_sensors", "sensors_agree", "single_scan",
    "held_things", "stillness", "animals", "fit_right", "fit_wrong", "fit_noise", "fit_simulated", "fit_weights",
    "speed", "start_up", "memory", "layouts", "users_work", "work_ratios",
)  # fmt: skip


def all_promises() -> list[Promise]:
    """All of them."""
    files = (import_module(f"experiments.scoreboard.promises.{name}") for name in NAMES)
    return [one for file in files for one in getattr(file, "PROMISES", None) or (file.PROMISE,)]
