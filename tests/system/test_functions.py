"""Functions are short and take few things, or say beside them why not."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2] / "voodoo_jax"
LINES, PARAMETERS = 60, 6


def too_much(path: Path) -> list[str]:
    """Functions with more lines or parameters, and no comment above them."""
    text = path.read_text()
    lines, found = text.splitlines(), []
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.FunctionDef):
            continue
        names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
        count = len(names) - (names[:1] in (["self"], ["cls"]))
        first = node.decorator_list[0].lineno if node.decorator_list else node.lineno
        said = lines[first - 2].strip().startswith("# ") if first > 1 else False
        said = said or "# " in lines[node.lineno - 1]
        if not said and (count > PARAMETERS or node.end_lineno - node.lineno + 1 > LINES):  # pyright: ignore[reportOptionalOperand]
            found.append(f"{path.relative_to(ROOT)}: {node.name}")
    return found


@pytest.mark.parametrize("package", sorted(p.name for p in ROOT.iterdir() if p.is_dir() and p.name != "data"))
def test_functions_are_short_or_say_why_not(package):
    found = [name for path in sorted((ROOT / package).rglob("*.py")) for name in too_much(path)]
    assert not found, f"more than {LINES} lines or {PARAMETERS} parameters: split them, or say why above\n" + "\n".join(
        found
    )


def test_a_long_function_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr(f"{__name__}.ROOT", tmp_path)
    file = tmp_path / "a.py"
    body = "\n".join("    x = 1" for _ in range(70))
    file.write_text(
        f"def long():\n{body}\n\ndef many(a, b, c, d, e, f, g): ...\n\n# so\ndef said(a, b, c, d, e, f, g): ...\n"
    )
    assert too_much(file) == ["a.py: long", "a.py: many"]
