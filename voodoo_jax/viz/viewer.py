"""A log and its tracks in a browser, served by this process (viser): cloud, bodies, markers, camera image."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from voodoo_jax.exporters.limb_shapes import loft, profile, side_of
from voodoo_jax.records.recording import Recording
from voodoo_jax.records.tracks import Tracks
from voodoo_jax.viz.html_view import limb_confidence, rows_at
from voodoo_jax.viz.overlay import drawn_over

SIDES = {"left": (210, 86, 43), "right": (47, 98, 207), "middle": (150, 155, 163)}  # red, green, blue; as in reports
UNKNOWN = (150, 155, 163)
MOST_POINTS = 20_000  # of a frame: more do not show more
MOST_WIDE = 640  # pixels of the camera image in the panel
STEP = 0.01  # seconds between looks at the clock


class Viewer:
    """A server that shows a recording and the tracks of the people in it; `frame` chooses what is shown.

    Raises ImportError without viser.
    """

    def __init__(self, recording: Recording, people: Sequence[Tracks] = (), port: int = 8080, host: str = "127.0.0.1"):
        import viser

        if not len(recording):
            raise ValueError(f"nothing to show: {recording.path} has no frame")
        self.recording, self.people = recording, list(people)
        self.times = np.array([f.time_ns for f in recording], np.int64)
        self.server = viser.ViserServer(host=host, port=port, verbose=False)
        self.server.scene.set_up_direction(tuple(np.asarray(recording.up, float)))
        self.rows = [rows_at(tracks.time_ns, self.times) for tracks in self.people]
        self._confidence = [limb_confidence(tracks) for tracks in self.people]
        self.limbs = [self._meshes(k, tracks) for k, tracks in enumerate(self.people)]
        self._panel()
        self._look_from_the_sensor()
        self.show(0)

    def _meshes(self, person: int, tracks: Tracks) -> list[Any]:
        limbs = []
        for limb, name in enumerate(tracks.body.topology.limbs):
            points, faces = loft(profile(tracks.body, limb))
            mesh = points.astype(np.float32), faces.astype(np.uint32)
            where, colour = f"/person {person + 1}/{name}", SIDES[side_of(name)]
            limbs.append(self.server.scene.add_mesh_simple(where, *mesh, color=colour))
        return limbs

    def _panel(self) -> None:
        gui, last = self.server.gui, len(self.times) - 1
        self.playing = gui.add_checkbox("play", False)
        self.frame = gui.add_slider("frame", min=0, max=max(last, 1), step=1, initial_value=0)
        self.speed = gui.add_slider("speed", min=0.1, max=3.0, step=0.1, initial_value=1.0)
        self.by = gui.add_dropdown("colours", ("left and right", "confidence"))
        self.said = gui.add_markdown("")
        self.picture = None
        if any(frame.pictures for frame in self.recording):
            self.picture = gui.add_image(np.zeros((2, 2, 3), np.uint8), format="jpeg")
        for handle in (self.frame, self.by):
            handle.on_update(lambda _: self.show(int(self.frame.value)))

    def _look_from_the_sensor(self) -> None:
        origins = next((f.origins for f in self.recording if len(f.origins)), None)
        places = [t.translation.reshape(-1, 3) for t in self.people] or [f.points for f in self.recording.frames[:1]]
        places = np.concatenate(places).astype(float) - (self.recording.origin if self.people else 0)
        places = places[np.isfinite(places).all(1)]
        target = np.median(places, 0) if len(places) else np.zeros(3)
        camera = self.server.initial_camera
        camera.up = np.asarray(self.recording.up, float)
        camera.look_at = target
        camera.position = np.asarray(target + [2.0, 2.0, 1.0] if origins is None else origins[0], float)

    def show(self, i: int) -> None:
        """Shows frame `i` of the recording."""
        frame, scene = self.recording.frames[min(i, len(self.times) - 1)], self.server.scene
        points = frame.points[:: max(1, -(-len(frame.points) // MOST_POINTS))]
        marks = [frame.pairs.points] if len(frame.pairs.points) else []
        with self.server.atomic():
            scene.add_point_cloud("/cloud", points, (120, 126, 135), point_size=0.008, point_shape="circle")
            scene.add_point_cloud(
                "/markers",
                np.concatenate([*marks, np.zeros((0, 3))]),
                (242, 194, 0),
                point_size=0.02,
                point_shape="circle",
            )
            words = [f"**{(self.times[i] - self.times[0]) / 1e9:.2f} s**"]
            for k, tracks in enumerate(self.people):
                words.append(f"person {k + 1}: {self._pose(k, tracks, int(self.rows[k][i]))}")
            self.said.content = "\n\n".join(words)
        if self.picture is not None and frame.pictures:
            rows = [int(rows[i]) for rows in self.rows]
            image = drawn_over(frame.pictures[0], self.people, rows, self.recording.origin)
            self.picture.image = image[
                :: max(1, image.shape[1] // MOST_WIDE), :: max(1, image.shape[1] // MOST_WIDE), ::-1
            ]

    def _pose(self, person: int, tracks: Tracks, row: int) -> str:
        """Moves the meshes of one person; returns a line on the frame."""
        for limb, mesh in enumerate(self.limbs[person]):
            there = row >= 0 and bool(np.isfinite(tracks.rotation[row, limb]).all())
            mesh.visible = there
            if there:
                mesh.wxyz = tracks.rotation[row, limb].astype(float)
                mesh.position = tracks.translation[row, limb].astype(float) - self.recording.origin
                mesh.color = self._colour(person, tracks, row, limb)
        if row < 0:
            return "not here"
        off = tracks.evidence.residual[row]
        residual = f", residual {1000 * off:.0f} mm" if np.isfinite(off) else ""
        return f"{'tracked' if tracks.tracked[row] else 'not tracked'}{residual}"

    def _colour(self, person: int, tracks: Tracks, row: int, limb: int) -> tuple[int, int, int]:
        if self.by.value == "left and right":
            return SIDES[side_of(tracks.body.topology.limbs[limb])]
        sure = float(self._confidence[person][row, limb])
        return UNKNOWN if not np.isfinite(sure) else (int(220 * (1 - sure)) + 30, int(170 * sure) + 30, 50)

    def play(self) -> None:
        """Plays while `playing` is ticked, in real time; does not return."""
        began = None
        while True:
            time.sleep(STEP)
            if not self.playing.value:
                began = None
                continue
            now, i = time.monotonic(), int(self.frame.value)
            if began is None or i >= len(self.times) - 1:
                i = 0 if i >= len(self.times) - 1 else i
                began = now, self.times[i]
            at = began[1] + (now - began[0]) * 1e9 * self.speed.value
            self.frame.value = int(min(np.searchsorted(self.times, at), len(self.times) - 1))
