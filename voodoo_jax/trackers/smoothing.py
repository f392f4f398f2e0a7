"""Smoothing of finished tracks in both directions of time: a separate step, never part of the tracker. Host side."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Float32, Int64
from scipy.spatial.transform import Rotation

from voodoo_jax.records.stretches import stretches
from voodoo_jax.records.tracks import Tracks


def smooth(tracks: Tracks, seconds: float = 0.033) -> Tracks:
    """Tracks with joints and poses averaged over neighbouring frames, weighted by a Gaussian of the time between them.

    Without delay: as many frames after as before count. Around each limb's motion a straight line is fitted (local
    linear regression), so that steady motion stays as it is, at the ends too. Gaps of half a second or more, and frames
    without a pose, are not smoothed across. Everything else of the tracks (status, residuals, body) stays.

    **Arguments:** `seconds` standard deviation of the Gaussian; 0: nothing is changed.

    Raises ValueError if it is negative.
    """
    if not seconds >= 0:
        raise ValueError(f"seconds = {seconds}: the width of the smoothing must not be negative")
    if seconds == 0 or not len(tracks.time_ns):
        return tracks
    translation, joints = (_smoothed(tracks.time_ns, x, seconds) for x in (tracks.translation, tracks.joints))
    rotation = np.stack([_turned(tracks.time_ns, q, seconds) for q in np.moveaxis(tracks.rotation, 1, 0)], 1)
    return replace(tracks, translation=translation, joints=joints, rotation=rotation.astype(np.float32))


def _runs(time_ns: Int64[np.ndarray, " frame"], there: np.ndarray) -> list[slice]:
    """Consecutive frames that belong together."""
    return [slice(*run) for run in stretches(there, np.diff(time_ns, prepend=time_ns[:1]) >= 500_000_000)]


def _average(time: Float[np.ndarray, " frame"], values: Float[np.ndarray, "frame dim"], seconds: float) -> np.ndarray:
    """Local linear regression at every frame; `time` in seconds. Neighbours beyond four deviations do not count."""
    out = np.empty_like(values)
    first = np.searchsorted(time, time - 4 * seconds)
    last = np.searchsorted(time, time + 4 * seconds, "right")
    for i, (a, b) in enumerate(zip(first, last)):
        t = time[a:b] - time[i]
        w = np.exp(-0.5 * (t / seconds) ** 2)
        s0, s1, s2 = w.sum(), (w * t).sum(), (w * t * t).sum()
        spread = s0 * s2 - s1 * s1
        # two frames or more determine a line; one alone is its own average
        w = w * (s2 - s1 * t) / spread if spread > 1e-12 * s0 * seconds**2 else w / s0
        out[i] = w @ values[a:b]
    return out


def _smoothed(time_ns, values: Float[np.ndarray, "frame item 3"], seconds: float) -> Float[np.ndarray, "..."]:
    out = values.copy()
    for item in range(values.shape[1]):
        for run in _runs(time_ns, np.asarray(np.isfinite(values[:, item]).all(-1))):
            time = (time_ns[run] - time_ns[run.start]) / 1e9
            out[run, item] = _average(time, values[run, item].astype(float), seconds)
    return out


def _turned(time_ns, rotation: Float32[np.ndarray, "frame 4"], seconds: float) -> np.ndarray:
    """Quaternions wxyz of one limb, averaged as vectors of one hemisphere and scaled to unit length."""
    out = rotation.astype(float)
    for run in _runs(time_ns, np.asarray(np.isfinite(rotation).all(-1))):
        q = Rotation.from_quat(out[run], scalar_first=True).as_quat(scalar_first=True)
        flips = np.cumprod(np.concatenate([[1.0], np.where((q[1:] * q[:-1]).sum(1) < 0, -1.0, 1.0)]))
        mean = _average((time_ns[run] - time_ns[run.start]) / 1e9, q * flips[:, None], seconds)
        out[run] = mean / np.linalg.norm(mean, axis=1, keepdims=True)
    return out
