"""What a promise is, what measuring it takes, and how figures of two runs are compared."""

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

Figures = dict[str, float]
# the committed figures by promise: those of this processor, or of each that is known where it has none
Before = Mapping[str, Sequence[Mapping[str, float]]]


class Job(Hashable, Protocol):
    """One piece of measuring, done in a worker process. Equal jobs of several promises are done once."""

    def run(self) -> Any: ...


@dataclass(frozen=True)
class Data:
    """Where recordings are, and how much of them is to be measured."""

    recordings: Path | None  # a folder as the README of the recordings describes it; None: only what can be simulated
    quick: bool = False  # a part of each promise, for the gate of CI
    others: Path | None = None  # a folder with people and clips of which logs are made, see promises/others.py
    draw: int = 1  # of these

    def logs(self, folder: str = "") -> list[Path]:
        """The recordings with a truth in a folder below, by name; none where there is no such folder."""
        if self.recordings is None:
            return []
        return sorted(p for p in (self.recordings / folder).glob("*.mcap") if p.with_suffix(".truth.npz").exists())

    def part(self, items: Sequence[Any], count: int) -> list[Any]:
        """All of them, or when quick `count` of them, evenly spread."""
        if not self.quick or len(items) <= count:
            return list(items)
        return [items[round(k * (len(items) - 1) / max(1, count - 1))] for k in range(count)]

    @property
    def cases(self) -> Path | None:
        """The folder of cases from the field, beside the recordings."""
        folder = None if self.recordings is None else self.recordings.parent / "cases"
        return folder if folder is not None and folder.is_dir() else None


@dataclass(frozen=True)
class Figure:
    """A number by which a promise is judged."""

    name: str  # with its unit
    limit: float | None  # what is promised; None: it is told, nothing is promised
    better: Literal["less", "more"] = "less"
    tolerance: float = math.inf  # by so much it may be worse than the figure of before; infinite: it never gates
    digits: int = 2
    relative: bool = False  # the tolerance is a share of the figure of before

    def kept(self, value: float) -> bool:
        """Whether the promise is kept. A number that could not be measured keeps none."""
        return self.limit is None or (value <= self.limit if self.better == "less" else value >= self.limit)

    def text(self, value: float | None) -> str:
        """The number as a table shows it."""
        return "-" if value is None or math.isnan(value) else f"{value:.{self.digits}f}"

    def fallen(self, value: float, before: float) -> bool:
        """Whether it is worse than before by more than its tolerance."""
        if math.isinf(self.tolerance) or math.isnan(before):
            return False
        worse = value - before if self.better == "less" else before - value
        return math.isnan(value) or worse > self.tolerance * (abs(before) if self.relative else 1.0)


@dataclass(frozen=True)
class Promise:
    """Something that this project says of itself, and how it is measured."""

    name: str
    sentence: str  # as the README and the documentation say it
    data: str  # what it is measured on
    figures: tuple[Figure, ...]
    jobs: Callable[[Data], Sequence[Job]]  # none: what it needs is not there
    measure: Callable[[list[Any]], Mapping[str, float]]  # outcomes in the order of the jobs to values by figure
    details: Callable[[list[Any]], list[str]] | None = None  # outcomes to lines that say what is behind the figures
    alone: bool = False  # measures time or memory: its jobs run one at a time, with nothing else beside

    @property
    def gates(self) -> bool:
        """Whether any of its figures can stop a change."""
        return any(not math.isinf(figure.tolerance) for figure in self.figures)


@dataclass(frozen=True)
class Measured:
    """A promise and what was found."""

    promise: Promise
    values: Figures  # empty: not measured
    seconds: float = 0.0  # of all its jobs
    why: str = ""  # why it was not measured
    details: tuple[str, ...] = ()  # what is behind the figures


def verdict(figure: Figure, value: float) -> str:
    """Kept, broken, or told where nothing is promised."""
    return "told" if figure.limit is None else "kept" if figure.kept(value) else "**broken**"


def fallen(found: Sequence[Measured], before: Before) -> list[str]:
    """A line for each figure that is worse than before by more than its tolerance, or that is missing now. Where there
    are figures of several processors, it is worse than each of them."""
    lines = []
    for one in found:
        for figure in one.promise.figures:
            olds = [old[figure.name] for old in before.get(one.promise.name, ()) if figure.name in old]
            value = one.values.get(figure.name, math.nan)
            if olds and all(figure.fallen(value, old) for old in olds):
                allowed = f"{100 * figure.tolerance:g} %" if figure.relative else f"{figure.tolerance:g}"
                was = " and ".join(figure.text(old) for old in olds)
                lines.append(
                    f"{one.promise.name}: {figure.name} is {figure.text(value)}, was {was} "
                    f"(at most {allowed} worse is allowed)"
                )
    return lines


def limit_text(figure: Figure) -> str:
    """A limit as the table shows it."""
    if figure.limit is None:
        return "-"
    return f"{'≤' if figure.better == 'less' else '≥'} {figure.limit:g}"


def rows(found: Sequence[Measured], before: Before) -> list[list[str]]:
    """A row for each figure: promise, figure, limit, last, now, verdict."""
    out = []
    for one in found:
        old = next(iter(before.get(one.promise.name, ())), {})
        name = one.promise.name
        if not one.values:
            out.append([name, one.why, "", "", "", "not measured"])
        for figure in one.promise.figures if one.values else ():
            value = one.values.get(figure.name, math.nan)
            numbers = [figure.text(old.get(figure.name)), figure.text(value)]
            out.append([name, figure.name, limit_text(figure), *numbers, verdict(figure, value)])
            name = ""
    return out
