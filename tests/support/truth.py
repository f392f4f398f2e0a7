"""The truth of a simulation in the form of tracks."""

import numpy as np

from voodoo_jax.records.tracks import Evidence, Status, Tracks
from voodoo_jax.simulate.recording import Simulation


def truth_tracks(simulation: Simulation, source: str = "simulation") -> Tracks:
    """The truth as if it had been tracked: what a perfect tracker would return."""
    s, count = simulation, len(simulation.time_ns)
    zeros, steps = np.zeros(count, np.float32), np.zeros(count, np.int32)
    points = (s.depth > 0).sum((1, 2)).astype(np.int32)
    weight = np.ones(s.rotation.shape[:2], np.float32)
    return Tracks(
        source=source,
        fixed_frame=s.fixed_frame,
        body=s.body,
        time_ns=s.time_ns,
        rotation=s.rotation,
        translation=s.translation,
        joints=s.joints,
        status=np.full(count, Status.TRACKED, np.int8),
        evidence=Evidence(zeros, zeros + 1, steps, points, weight),
    )
