"""Many recordings in memory, or one with many settings or bodies, tracked as one batch on all devices. Host side."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
from tqdm.auto import tqdm

from voodoo_jax.batch.lanes import in_lanes, usual_lanes
from voodoo_jax.compile.cache_dir import users_cache
from voodoo_jax.config.options import Settings
from voodoo_jax.detect.pipeline import find_body
from voodoo_jax.model.body import Body
from voodoo_jax.records.recording import Recording
from voodoo_jax.records.tracks import Tracks, for_users
from voodoo_jax.solve.scan import Visit
from voodoo_jax.trackers.base import Task, alone, check_arguments, source_of, tracker_of
from voodoo_jax.trackers.of_points import track_person
from voodoo_jax.trackers.stages import check_stages


# 69 lines, a third of them what it takes and gives
@users_cache()
def track_many(
    bodies: Body | Sequence[Body],
    recordings: Recording | Sequence[Recording],
    settings: Settings | Sequence[Settings] | None = None,
    *,
    lanes: int = 0,
    quiet: bool = False,
) -> list[Tracks]:
    """Tracks many recordings as one batch, or one recording with many bodies or settings: an argument given once is
    used for all.

    Each recording has its own starts and passes; one run of one program tracks the waiting frames of all of them. All
    of JAX's devices are used: several GPUs, or a processor's cores after `jax.config.update("jax_num_cpu_devices", n)`.
    On a processor, `replay_logs` is faster for logs in files, since its workers also read on all cores.

    **Arguments:** `lanes` number of recordings tracked at once; 0: one on each device, 32 if it is a GPU.

    **Returns:** for each the result of `track`, up to rounding; for one number of lanes equal to the last bit,
    independent of the other recordings.

    Raises ValueError if sequences differ in length, and the errors of `track`, with a note on the recording.
    """
    listed = lambda x: tuple(x) if isinstance(x, Sequence) and not isinstance(x, str) else (x,)  # noqa: E731
    given = [listed(x) for x in (bodies, recordings, settings or Settings())]
    check_arguments(*given[:2])
    if min(map(len, given)) == 0:
        return []
    count = max(map(len, given))
    if any(len(some) not in (1, count) for some in given):
        lengths = ", ".join(f"{len(some)} {name}" for some, name in zip(given, ("bodies", "recordings", "settings")))
        raise ValueError(f"{lengths}: each must have one entry, or as many as the others")
    for one in given[2]:
        assert isinstance(one, Settings)
        check_stages(one)
    if lanes < 0:
        raise ValueError(f"lanes = {lanes}: must be 1 or more, or 0 for a number that suits the devices")
    cases = list(zip(*(some * (count // len(some)) for some in given)))
    devices = len(jax.devices())
    lanes = devices * -(-min(lanes or usual_lanes(), count) // devices)
    people: dict[tuple, Any] = {}  # found once for all settings that change nothing about it

    def task(number: int) -> Callable[[Visit], Tracks]:
        body, recording, own = cases[number]

        def tracked(visit: Visit) -> Tracks:
            try:
                if own.tracker != "icp":
                    found = tracker_of(own).track(Task(body, source_of(recording), alone(own)), recording)
                    return for_users(found[0], recording)
                key = id(recording), id(body), own.detect, own.online, own.start.scale
                if key not in people:
                    people[key] = find_body(recording, recording.up, body, own, recording.up_is_given)
                scene, seen = people[key]
                tracks = track_person(Task(body, source_of(recording), own, visit=visit), scene, seen)
                return for_users(tracks, recording)
            except Exception as problem:
                problem.add_note(f"Number {number} of {count} (from 0): '{recording.path}'")
                raise

        return tracked

    out: dict[int, Tracks] = {}
    with tqdm(total=count, unit="recording", disable=quiet or None, leave=False) as bar:
        for number, tracks in in_lanes([task(k) for k in range(count)], lanes):
            out[number] = tracks
            bar.update()
    return [out[number] for number in range(count)]
