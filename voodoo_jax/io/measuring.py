"""Converts messages of depth topics to points in the fixed frame."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Float32, Int32

from voodoo_jax.config.options import ReadSettings
from voodoo_jax.geometry import lens
from voodoo_jax.geometry.depth_edges import on_sheets
from voodoo_jax.io.calibrations import BODY_OPTICAL, calibration_of, fitted, lens_of, moved
from voodoo_jax.io.decode.image_codec import raw_of
from voodoo_jax.io.point_labels import Parts
from voodoo_jax.io.topic import Topic
from voodoo_jax.io.transforms import HOLD_NS, TransformTree
from voodoo_jax.records.messages import Cloud, Image, stride


@dataclass(frozen=True)
class Measured:
    """One message in the fixed frame."""

    points: Float[np.ndarray, "point 3"]  # metres
    origin: Float[np.ndarray, "3"]  # of the sensor
    part: Int32[np.ndarray, " point"]  # see Frame


@dataclass
class Measuring:
    """Interpretation of the depth topics of a log, and the geometry of their pixels."""

    topics: dict[str, Topic]
    tree: TransformTree
    fixed_frame: str
    settings: ReadSettings
    parts: Parts
    scales: dict[str, float]  # metres per unit, where it is not the usual
    radial: dict[str, bool]  # whether the values of depth images are distances along the rays
    mirrored: dict[str, int]  # the axis along which a topic is mirrored
    moved: dict[str, tuple[float, float]] = field(default_factory=dict)  # principal points, see detect.crops; pixels
    of_body: frozenset[str] = frozenset()  # images in a frame of their camera's body: x ahead, z up
    smeared: frozenset[str] = frozenset()  # depth images without what lies in their smeared edges
    assumed: dict[str, str] = field(default_factory=dict)  # of calibrations; shared by all readers of a log, as `rays`
    rays: dict[tuple, np.ndarray] = field(default_factory=dict)
    turned: dict[tuple, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=dict)

    def depth(self, topic: str, image: Image, every: int = 1) -> Float32[np.ndarray, "row column"] | None:
        """Depth of a subsampled depth image, metres; None for another kind of image."""
        raw = raw_of(image)
        if raw is None:
            return None
        if (axis := self.mirrored.get(topic)) in (0, 1):  # x: left to right, y: upside down
            raw = raw[:, ::-1] if axis == 0 else raw[::-1]
        return raw[::every, ::every].astype(np.float32) * np.float32(self.scales.get(topic, image.unit))

    def measured(
        self, topic: str, content: Cloud | Image, stamp_ns: int, losses: Counter[tuple[str, str]]
    ) -> Measured | None:
        """The points of a message in the fixed frame; None without a transform. `losses` counts messages left out, by
        topic and reason."""
        s = self.settings
        found = self.tree.lookup(self.fixed_frame, content.frame, stamp_ns)
        if found is None:
            seconds = f"{HOLD_NS / 1e9:g} s"
            why = f"left out, no transform from '{content.frame}' to '{self.fixed_frame}' within {seconds} of the stamp"
            losses[topic, why] += 1
            return None
        rotation, translation = found
        if topic in self.of_body:
            rotation = rotation @ BODY_OPTICAL
        labels = None
        if isinstance(content, Image):
            k = stride(*content.shape, s.max_points)
            if (depth := self.depth(topic, content, k)) is None:
                raise ValueError(f"encoding changed to {content.encoding}")
            if topic in self.smeared:
                rows = self._pixel_rays(topic, content, k)[:, 0, 1]
                depth[on_sheets(depth, float(np.nanmedian(np.diff(rows))), k)] = 0
            z = depth.ravel()
            rays, nearest, farthest = self._directions(topic, content, k, rotation)
            with np.errstate(invalid="ignore"):  # NaN fails every comparison
                keep = np.flatnonzero((z >= nearest) & (z <= farthest))
            depth, xyz = z[keep], np.empty((3, len(keep)), np.float32)
            for axis, place in enumerate(translation.astype(np.float32)):
                # one by one: all three at once take three times as long; clipped (all exist): at once where it is to be
                mine = np.take(rays[axis], keep, out=xyz[axis], mode="clip")
                np.add(np.multiply(mine, depth, out=mine), place, out=mine)
            points = xyz.T  # by coordinate in memory: all that looks at many points is several times as fast
        else:
            points = content.points(s.max_points)
            if topic in self.scales:
                points *= self.scales[topic]
            if topic in self.mirrored:
                points[:, self.mirrored[topic]] *= -1
            if field := self.parts.field(topic):
                if field in content.fields:
                    labels = content.field(field, s.max_points)
                else:
                    losses[topic, f"without the field '{field}': all their points are free"] += 1
            with np.errstate(invalid="ignore", over="ignore"):
                square = np.einsum("ni,ni->n", points, points)
                # NaN fails every comparison; a range of exactly 0 is a driver's word for nothing seen
                keep = (square >= s.min_range**2) & (square <= s.max_range**2) & (square > 0)
            if content.pose is not None:
                translation = rotation @ content.pose[1] + translation
                rotation = rotation @ content.pose[0]
            points, labels = points[keep] @ rotation.T + translation, None if labels is None else labels[keep]
        part = self.parts.numbers(topic, labels, len(points))
        return Measured(points, translation, part)

    def _directions(
        self, topic: str, image: Image, k: int, rotation: Float[np.ndarray, "3 3"]
    ) -> tuple[Float32[np.ndarray, "3 pixel"], Float32[np.ndarray, " pixel"], Float32[np.ndarray, " pixel"]]:
        """Of each pixel the way to a depth of 1 m, in the fixed frame's directions, and the least and the greatest
        depth that count, more than 0."""
        key = topic, image.shape, k
        before = self.turned.get(key)
        if before is None or not np.array_equal(before[0], rotation):
            xy = self._pixel_rays(topic, image, k).reshape(-1, 2)
            rays = np.column_stack([xy, np.ones(len(xy))])
            if self.radial.get(topic):
                rays /= np.linalg.norm(rays, axis=1, keepdims=True)
            limits = self._depths(rays) if before is None else before[2:]
            self.turned[key] = rotation, (rotation @ rays.T).astype(np.float32), *limits
        return self.turned[key][1:]

    def _depths(
        self, rays: Float[np.ndarray, "pixel 3"]
    ) -> tuple[Float32[np.ndarray, " pixel"], Float32[np.ndarray, " pixel"]]:
        """The least and the greatest depth that count, of each pixel with its way to a depth of 1 m; metres."""
        length = np.sqrt(np.einsum("ni,ni->n", rays, rays))
        # exactly 0 is a driver's word for nothing seen
        nearest = np.maximum((self.settings.min_range / length).astype(np.float32), np.finfo(np.float32).tiny)
        return nearest, (self.settings.max_range / length).astype(np.float32)

    def _pixel_rays(self, topic: str, image: Image, k: int) -> np.ndarray:
        key = (topic, image.shape, k)
        if key not in self.rays:
            c = calibration_of(self.topics, topic)
            assert c is not None
            size = c.width, c.height
            c, assumed = fitted(c, image.shape)
            if topic in self.moved and any(self.moved[topic]):
                c = moved(c, self.moved[topic])
                assumed = (
                    f"assumed to be cropped {abs(self.moved[topic][1]):.0f} pixels off its centre: then the floor is "
                    "level (if not, give its calibration by read.camera)"
                )
            if assumed:
                own = f"{image.shape[1]} x {image.shape[0]}"
                self.assumed[topic] = f"'{topic}' is {own} pixels, its calibration {size[0]} x {size[1]}: {assumed}."
            height, width = image.shape
            self.rays[key] = lens.pixel_rays(*lens_of(topic, c), c.model, width, height, k)
        return self.rays[key]
