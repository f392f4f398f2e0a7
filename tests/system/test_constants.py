"""Numbers that decide something say where they come from; how many do not may only fall."""

import ast
from pathlib import Path

import voodoo_jax

ROOT = Path(voodoo_jax.__file__).parent
PACKAGES = ("detect", "kernels", "markers", "sensors", "solve", "trackers")  # where numbers decide what comes out
# words by which a comment beside a number, or a docstring of a stage, names a source: a paper, a library, an
# experiment, a measurement, that it follows from others, that it was set by hand, or that it decides nothing
SOURCES = (
    "paper", "doi", "horn", "experiments/", "measured", "by hand", "ieee", "jax", "opencv", "mediapipe", "float32",
    "chi2", "derived", "any gives the same",
)  # fmt: skip
WITHOUT = 177  # when this was first counted; moves into stages, sources and deletions lower it


def constants(path: Path) -> list[tuple[str, bool]]:
    """Module-level numbers of a file, and whether the comment on their line or above says where they come from."""
    lines = path.read_text().splitlines()
    found = []
    for node in ast.parse("\n".join(lines)).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        leaves = [leaf for leaf in ast.walk(node.value) if isinstance(leaf, ast.Constant)]
        numbers = [leaf for leaf in leaves if isinstance(leaf.value, int | float) and not isinstance(leaf.value, bool)]
        if not numbers or len(numbers) < len(leaves):
            continue
        said = [lines[node.end_lineno - 1 if node.end_lineno else node.lineno - 1].partition("#")[2]]
        at = node.lineno - 2
        while at >= 0 and lines[at].startswith("#"):
            said.append(lines[at])
            at -= 1
        found.append(
            (f"{path.relative_to(ROOT)}: {ast.unparse(target)}", any(s in " ".join(said).lower() for s in SOURCES))
        )
    return found


def test_numbers_without_a_source_become_fewer():
    every = [c for name in PACKAGES for path in sorted((ROOT / name).rglob("*.py")) for c in constants(path)]
    without = [name for name, sourced in every if not sourced]
    assert len(every) > 50  # else nothing was looked at
    assert len(without) <= WITHOUT, "say beside each where it comes from:\n" + "\n".join(without)
    assert len(without) >= WITHOUT - 5, f"there are {len(without)} now: lower WITHOUT in {__file__}"
