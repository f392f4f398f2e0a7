"""Cases from the field."""

from collections.abc import Sequence

from experiments.scoreboard.board import Data, Figure, Promise
from experiments.scoreboard.cases import CASES, CHEAP, CONTROLS, Case, CaseFound


def jobs(data: Data) -> list[Case]:
    """A job for each case that is there; quick: for some that take little."""
    if data.cases is None or data.recordings is None:
        return []
    names = [name for name in (CHEAP if data.quick else CASES) if (data.cases / name).is_dir()]
    return [Case(data.cases / name, data.recordings) for name in names]


def measure(cases: Sequence[CaseFound]) -> dict[str, float]:
    """Cases that are not as they should be."""
    return {
        "cases wrong": sum(bool(case.wrong) for case in cases),
        "controls wrong": sum(bool(case.wrong) for case in cases if case.name in CONTROLS),
        "logs wrong unsaid": sum(case.unsaid for case in cases),
    }


def details(cases: Sequence[CaseFound]) -> list[str]:
    """What is wrong, case by case."""
    unsaid = lambda case: f" ({case.unsaid} wrong unsaid)" if case.unsaid else ""  # noqa: E731
    return [f"{case.name}{unsaid(case)}: {case.wrong}" for case in cases if case.wrong or case.unsaid]


PROMISE = Promise(
    name="field_cases",
    sentence="Logs as people elsewhere have them are tracked, or what is wrong with them is said. Mostly not so today.",
    data="25 cases beside the recordings",
    figures=(
        Figure("cases wrong", 0, tolerance=1, digits=0),  # hard logs jump between processors
        Figure("controls wrong", 0, tolerance=0, digits=0),
        Figure("logs wrong unsaid", 0, tolerance=1, digits=0),
    ),
    jobs=jobs,
    measure=measure,
    details=details,
)
