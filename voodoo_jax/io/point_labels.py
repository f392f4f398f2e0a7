"""Settings of a topic: the part of the person that its points are on, and their weight."""

import re
from collections import Counter

import numpy as np
from jaxtyping import Int32

from voodoo_jax.config.options import ReadSettings
from voodoo_jax.config.toml import check_pairs
from voodoo_jax.io.topic import DEPTH_USES, POSE_USE, SKIN_USE, Topic
from voodoo_jax.records.messages import PAIRS, RAYS, Cloud

FREE, BODY = "free", "body"
_LABEL_NAME = re.compile(r"(\w+_)?(label|class|segment)(s|_?ids?)?", re.IGNORECASE)


def label_field(cloud: object, settings: ReadSettings) -> str:
    """Name of the label field of a cloud; "" if there is none or no labels are set."""
    if not isinstance(cloud, Cloud):
        return ""
    if settings.label_field:
        return settings.label_field if settings.label_field in cloud.fields else ""
    return next((n for n in cloud.fields if settings.labels and _LABEL_NAME.fullmatch(n)), "")


class Parts:
    """Parts and weights of the topics of one log. `names`: what the points' numbers stand for, see `Frame.parts`.

    `notes`: settings for topics that are not in this log. Raises SettingsError for invalid texts.
    """

    def __init__(self, topics: dict[str, Topic], uses: dict[str, str], settings: ReadSettings):
        self._of_topic = check_pairs("read.parts", settings.parts)
        labels = check_pairs("read.labels", settings.labels)
        weights = check_pairs("read.weights", settings.weights)
        self._weights = {name: float(weight) for name, weight in weights.items()}
        self._labels = {int(value): part for value, part in labels.items()}
        self._fields = {
            n: f for n in topics if uses[n] in DEPTH_USES and (f := label_field(topics[n].sample, settings))
        }
        given = [part for name, part in self._of_topic.items() if uses.get(name) in DEPTH_USES]
        given += (self._labels.values() or [BODY]) if self._fields else []
        self.names: tuple[str, ...] = tuple(p for p in dict.fromkeys(given) if p != FREE)
        self._unknown: Counter[str] = Counter()  # points by topic
        self._examples: dict[str, set[float]] = {}  # some of their values
        self.notes: list[str] = []
        for option, named in (("parts", self._of_topic), ("weights", self._weights)):
            for name in named:
                wanted = DEPTH_USES if option == "parts" else (*DEPTH_USES, RAYS, PAIRS, SKIN_USE, POSE_USE)
                if uses.get(name) not in wanted:
                    why = f"'{name}' is {uses[name]}" if name in uses else f"the log has no topic '{name}'"
                    self.notes.append(f"read.{option} has no effect: {why}.")
        clouds = {n: topics[n].sample for n in topics if uses[n] == "point cloud" and n not in self._of_topic}
        without = [n for n in sorted(clouds) if n not in self._fields]
        if without and (settings.label_field or self._labels):
            what = f"'{settings.label_field}'" if settings.label_field else "named like label"
            has = "; ".join(f"'{n}' has {', '.join(clouds[n].fields)}" for n in without)
            self.notes.append(f"No field {what}, so that all points are free: {has}.")

    def say(self, topic: str) -> str:
        """The settings of a topic, to append to its use; "" for none."""
        words = ""
        if (part := self._of_topic.get(topic, FREE)) != FREE:
            words += f", points of {part}"
        elif topic in self._fields and topic not in self._of_topic:
            words += f", parts by its field '{self._fields[topic]}'"
        return words + (f", weight {self._weights[topic]:g}" if topic in self._weights else "")

    def of_topic(self, topic: str) -> str:
        """The part on which all points of a topic are; "free" without a setting."""
        return self._of_topic.get(topic, FREE)

    def weight(self, topic: str) -> float:
        """Weight of each measurement of a topic."""
        return self._weights.get(topic, 1.0)

    def weighted(self, topics: tuple[str, ...]) -> bool:
        """Whether any of the topics has a weight other than 1."""
        return any(self.weight(name) != 1 for name in topics)

    def field(self, topic: str) -> str:
        """The label field of a topic; "" for none."""
        return "" if topic in self._of_topic else self._fields.get(topic, "")

    def numbers(self, topic: str, labels: np.ndarray | None, count: int) -> Int32[np.ndarray, " point"]:
        """The part of each of `count` points of a topic, an index in `names`, -1: free. `labels` [point]: the values of
        its field; values without an entry are counted, except for 0, the usual value for background."""
        part = np.full(count, -1, np.int32)
        if labels is None:
            if self.of_topic(topic) != FREE:
                part[:] = self.names.index(self.of_topic(topic))
            return part
        if not self._labels:
            with np.errstate(invalid="ignore"):
                part[(labels != 0) & (labels == labels)] = self.names.index(BODY)
            return part
        unknown = labels != 0
        for value, name in self._labels.items():
            here = labels == value
            unknown &= ~here
            if name != FREE:
                part[here] = self.names.index(name)
        if unknown.any():
            self._unknown[topic] += int(unknown.sum())
            some = self._examples.setdefault(topic, set())
            some.update(np.unique(labels[unknown])[: max(0, 6 - len(some))].tolist())
        return part

    def forget(self) -> None:
        """Resets the counts."""
        self._unknown.clear()
        self._examples.clear()

    def losses(self) -> list[str]:
        """One sentence for each topic with values that have no entry."""
        notes = []
        for topic, count in self._unknown.items():
            some = sorted(self._examples[topic])
            values = ", ".join([f"{value:g}" for value in some[:5]] + ["..."] * (len(some) > 5))
            notes.append(
                f"'{topic}': {count} points are free because read.labels has no entry for their value of "
                f"'{self._fields[topic]}' ({values})."
            )
        return notes
