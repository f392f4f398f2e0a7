"""Tests, experiments and notebooks use public names only."""

import ast
import json
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
OURS = ("voodoo_jax", "experiments", "tests")
FILES = [
    *(p for part in ("tests", "experiments") for p in sorted((ROOT / part).rglob("*.py"))),
    *sorted((ROOT / "notebooks").glob("*.ipynb")),
]


def private_names(source: str) -> list[str]:
    """Names with an underscore that are imported from the project, or asked of one of its modules."""
    tree = ast.parse(source)
    modules, found = set(), []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in OURS:
            found += [a.name for a in node.names if a.name.startswith("_") and not a.name.startswith("__")]
            modules |= {a.asname or a.name for a in node.names if a.name.islower()}
    found += [
        f"{node.value.id}.{node.attr}"
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in modules
        and node.attr.startswith("_") and not node.attr.startswith("__")
    ]  # fmt: skip
    return found


def source_of(path: Path) -> str:
    if path.suffix == ".py":
        return path.read_text()
    cells = json.loads(path.read_text())["cells"]
    lines = [line for c in cells if c["cell_type"] == "code" for line in "".join(c["source"]).splitlines()]
    return "\n".join(line for line in lines if not line.startswith(("%", "!")))


def test_no_private_name_is_used():
    found = {str(path.relative_to(ROOT)): names for path in FILES if (names := private_names(source_of(path)))}
    assert not found


@pytest.mark.parametrize(
    "source, names",
    [
        ("from voodoo_jax.io import _x", ["_x"]),
        ("from voodoo_jax.io import container\ncontainer._y", ["container._y"]),
        ("from voodoo_jax.io import container\ncontainer.y\nself._z\nimport os\nos._exit", []),
    ],
)
def test_what_is_private(source, names):
    assert private_names(source) == names
