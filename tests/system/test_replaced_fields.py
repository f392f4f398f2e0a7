"""Fields that `dataclasses.replace` and `_replace` are given exist: no type checker looks, and what few tests run, as
long experiments, would fail only there."""

import ast
from collections.abc import Iterator
from pathlib import Path

from mcap.records import Channel, Schema
from optax import InjectHyperparamsState

FOREIGN = [set(one.__annotations__) for one in (Channel, Schema, InjectHyperparamsState)]
ROOT = Path(__file__).parents[2]
FILES = [p for folder in ("voodoo_jax", "experiments", "tests") for p in sorted((ROOT / folder).rglob("*.py"))]


def fields(trees: list[ast.Module]) -> list[set[str]]:
    """Names of the annotated fields of each class, with those of its parents (of all that have a parent's name)."""
    classes = [c for tree in trees for c in ast.walk(tree) if isinstance(c, ast.ClassDef)]

    def of(one: ast.ClassDef) -> set[str]:
        parents = {ast.unparse(base).split("[")[0].split(".")[-1] for base in one.bases} - {one.name}
        own = {s.target.id for s in one.body if isinstance(s, ast.AnnAssign) and isinstance(s.target, ast.Name)}
        return own.union(*(of(other) for other in classes if other.name in parents))

    return [of(one) for one in classes]


def replaced(tree: ast.Module) -> Iterator[tuple[int, set[str]]]:
    """Line and names of each call of `replace`, `dataclasses.replace` or `x._replace` with names."""
    for call in ast.walk(tree):
        if isinstance(call, ast.Call) and call.keywords:
            if ast.unparse(call.func).split(".")[-1] in ("replace", "_replace"):
                yield call.lineno, {k.arg for k in call.keywords if k.arg}


def test_fields_that_are_replaced_exist():
    trees = {file: ast.parse(file.read_text()) for file in FILES}
    known = FOREIGN + fields(list(trees.values()))
    calls = [(file, *found) for file, tree in trees.items() for found in replaced(tree)]
    assert len(calls) > 100
    strange = [f"{file.relative_to(ROOT)}:{line} {names}" for file, line, names in calls
               if not any(names <= each for each in known)]  # fmt: skip
    assert not strange
