"""Summary of a log as a table, without reading its depth data."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from voodoo_jax.config.options import FeatureSettings, ReadSettings
from voodoo_jax.io.container import LogError, Place
from voodoo_jax.io.convert.sources import as_mcap
from voodoo_jax.io.log_index import Scan
from voodoo_jax.io.read_plan import make_plan
from voodoo_jax.io.topic import POSE_USE, SKIN_USE
from voodoo_jax.model.marker_names import describe_names
from voodoo_jax.records.notes import NAME, as_few, is_remark, plain

TOPICS = 500  # that are listed


@dataclass(frozen=True)
class TopicSurvey:
    """One topic of a log. `use` is its use in replay, with settings for it after a comma ("point cloud, points of head,
    weight 2"), or "not used: <reason>"."""

    topic: str
    type: str
    encoding: str
    count: int
    use: str


@dataclass(frozen=True)
class LogSurvey:
    """Topics of a log, and their use in replay. `str()` gives a table."""

    path: str
    start_ns: int  # log time of the first message, nanoseconds since 1970
    duration: float  # seconds
    topics: tuple[TopicSurvey, ...]
    warnings: tuple[str, ...]

    def __str__(self) -> str:
        start = datetime.fromtimestamp(self.start_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
        rows = [("topic", "messages", "type", "encoding", "used as")]
        rows += [
            (plain(t.topic), str(t.count), plain(t.type), plain(t.encoding), plain(t.use, 2 * NAME))
            for t in self.topics[:TOPICS]
        ]
        width = [max(len(row[i]) for row in rows) for i in range(5)]
        lines = [
            f"{plain(self.path)}: {self.duration:.2f} s from {start}, {sum(t.count for t in self.topics)} messages"
        ]
        for row in rows:
            cells = [c.rjust(w) if i == 1 else c.ljust(w) for i, (c, w) in enumerate(zip(row, width))]
            lines.append(("  " + "  ".join(cells)).rstrip())
        if len(self.topics) > TOPICS:
            lines.append(f"  and {len(self.topics) - TOPICS} topics more")
        return "\n".join(lines + [f"  note: {w[1:-1] if is_remark(w) else w}" for w in self.warnings])


def damaged(scan: Scan, problem: LogError) -> str:
    """The reason for refusing a log: damage comes before missing data, which may be a consequence."""
    damage = as_few(scan.damage)
    limits = " ".join(note for note in scan.notes if "--limits." in note and note not in damage)
    problem = LogError(f"{problem} {limits}".strip())
    if not damage or "is damaged" in str(problem):
        return str(problem)
    return f"'{scan.log.path}' is damaged, copy it again. {' '.join(damage)} The rest: {problem}"


def _named(scan: Scan, topics: Iterable[str]) -> list[str]:
    """Names of features in some topics."""
    gathered = (scan.topics[topic].gathered for topic in topics)
    return list(dict.fromkeys(name for some in gathered if some is not None for name in some.names))


def survey(path: Place, settings: ReadSettings | None = None) -> LogSurvey:
    """Lists the topics of a log, and their use with `settings`; recordings of other formats are converted temporarily.
    Raises LogError only if nothing can be read at all, or a topic in the settings is not in the log."""
    settings = settings or ReadSettings()
    with as_mcap(path, settings.types) as (log, notes):
        found = _surveyed(log, settings)
    return found if log is path else replace(found, path=str(path), warnings=(*notes, *found.warnings))


def _surveyed(path: Place, settings: ReadSettings) -> LogSurvey:
    """Of an MCAP log."""
    scan = Scan(path, settings)
    said = dict.fromkeys(scan.topics, "")
    try:
        plan = make_plan(scan, settings)
        warnings = [*scan.notes, *scan.tree.notes, *plan.notes]
        said |= {name: ", skin colour" for name in scan.skin if scan.uses[name] != SKIN_USE}
        if settings.pose_net:
            looked = {*(plan.pictures.cameras if plan.pictures else ()), *(pair.left for pair in scan.stereo)}
            said |= {name: f"{said[name]}, {POSE_USE}" for name in looked if scan.uses[name] != POSE_USE}
        warnings += describe_names(_named(scan, plan.features), FeatureSettings())
        said |= {name: said[name] + plan.parts.say(name) for name in {*plan.sensors, *plan.features}}
    except LogError as error:
        warnings = [*scan.notes, damaged(scan, error)]
    start, end = scan.log.time_range or scan.log_times or (0, 0)
    topics = [
        TopicSurvey(n, t.type, t.encoding, t.count, scan.uses[n] + said[n]) for n, t in sorted(scan.topics.items())
    ]
    return LogSurvey(scan.log.path, start, (end - start) / 1e9, tuple(topics), as_few(warnings))
