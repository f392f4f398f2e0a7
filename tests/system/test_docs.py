"""What README and docs/ tell people to type exists: commands, flags, settings, public names."""

import ast
import importlib.util
import re
import tomllib
from pathlib import Path

import pytest

import voodoo_jax as vj
from voodoo_jax.cli.main import main
from voodoo_jax.config.options import Settings
from voodoo_jax.config.toml import read_settings

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"voodoo-jax (\w+)((?: [^#\n|&>]*)?)")
FLAG = re.compile(r"(?<![\w-])--[a-z][\w.-]*\w")


def blocks(language: str) -> list[tuple[str, str]]:
    """Name of the page and text of every fenced block of a language."""
    found = [(page.name, match) for page in PAGES for match in BLOCK.finditer(page.read_text())]
    return [(name, match[2]) for name, match in found if match[1] == language]


def flags(command: str, capsys) -> set[str]:
    """The flags that a command has, as its help says."""
    with pytest.raises(SystemExit) as end:
        main([command, "--help-all"])
    assert end.value.code == 0, f"voodoo-jax {command} is no command"
    return set(FLAG.findall(capsys.readouterr().out))


def test_commands_and_their_flags_exist(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    said = {(page, *match.groups()) for page, text in blocks("sh") for match in COMMAND.finditer(text)}
    known = {name: flags(name, capsys) for name in sorted({command for _, command, _ in said})}
    assert {"demo", "replay", "info", "fit", "config"} <= known.keys()
    wrong = {
        (page, command, flag)
        for page, command, rest in said
        for flag in FLAG.findall(rest)
        if flag not in known[command]
    }
    assert not wrong
    # settings that are named in the running text
    dotted = {(page.name, flag) for page in PAGES for flag in FLAG.findall(page.read_text()) if "." in flag}
    assert dotted and not {(page, flag) for page, flag in dotted if flag not in known["replay"]}


def test_settings_files_are_read(tmp_path):
    texts = [text for _, text in blocks("toml") if re.match(r"\[(\w+|\[change\])\]", text)]
    assert len(texts) >= 2
    for text in texts:
        (tmp_path / "settings.toml").write_text(text)
        assert read_settings(tmp_path / "settings.toml", Settings()) != Settings()


def test_bodies_are_read(tmp_path):
    texts = [text for _, text in blocks("toml") if text.startswith("name =")]
    assert texts
    for text in texts:
        (tmp_path / "body.toml").write_text(text)
        assert vj.read_body(tmp_path / "body.toml").limb_count > 1


def test_python_names_are_public():
    texts = [text for _, text in blocks("python")]
    used = {name for text in texts for name in re.findall(r"\bvj\.(\w+)", text)}
    assert "track" in used and used <= set(vj.__all__)
    for text in texts:
        compile(text, "documentation", "exec")


def test_versions_and_extras_agree():
    """pyproject, citation, changelog; what texts and the Dockerfile install."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    version = project["version"]
    assert f"version: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert re.search(r"^## \[?([\d.]+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)[1] == version  # type: ignore[index]
    extras = set(project["optional-dependencies"])
    texts = [path.read_text() for path in (*PAGES, ROOT / "Dockerfile")]
    asked = {
        name
        for text in texts
        for found in re.findall(r"(?:\.|/src|voodoo_jax)\[([\w,]+)\]", text)
        for name in found.split(",")
    }
    assert {"all", "view", "mkv"} <= asked | extras and asked <= extras
    everything = re.fullmatch(r"voodoo_jax\[(.*)\]", project["optional-dependencies"]["all"][0])
    assert everything and set(everything[1].split(",")) == extras - {"all", "ray", "pose", "dev", "docs", "fuzz"}


def test_links_of_the_readme_lead_somewhere_from_a_package_index():
    spec = importlib.util.spec_from_file_location("absolute_links", ROOT / "docs" / "absolute_links.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    text = module.absolute((ROOT / "README.md").read_text(), "https://host/o/n", "v1")
    links = re.findall(r"\]\(([^)\s]+)\)", text)
    assert len(links) > 20 and all(link.startswith(("https://", "#")) for link in links)
    for kind in ("raw", "blob"):
        found = [link.split(f"/{kind}/v1/")[1] for link in links if f"/{kind}/v1/" in link]
        assert found and all((ROOT / path).exists() for path in found)
    text = module.installed(text)
    assert "pip install -q voodoo_jax &&" in text and text.count("-e ") == text.count('-e ".[d')  # of a clone only


# phrases of a language of our own: persons without a noun, passives without an agent, words that hide the subject
PHRASES = [
    r"\b(?:of|for|to|from|by|with|than|as|where|and|on|at|over|under|beside|that) who (?!else)",
    r"(?:^|[.:;|] )who (?:is|has|lies|stands|sits|walks|bends|turns|gets|begins|pushes|carries|crawls)\b",
    r"\btells? (?:of|nothing|it)\b", r"\btold (?:by|apart|from|to be)\b", r"\b(?:is|are|was|were) (?:told|asked)\b",
    r"\bsays? nothing\b", r"\bnobody has\b", r"\bwhat is (?:low|far|carried|said|missing|left|in doubt)\b",
    r"\bhow sure\b", r"\bbecomes of\b", r"\bas far as it goes\b", r"\bcosts? (?:itself|themselves)\b",
    r"\bput right\b", r"\bno look into\b", r"\bin passing\b", r"\bso many (?!steps)", r"\bgoes on\b", r"\banew\b",
    r"\b(?:some|no)body\b", r"\basked for\b", r"\bthe redder\b", r"\bwhat is (?:seen|known|measured)\b",
]  # fmt: skip


def phrases(text: str) -> list[str]:
    """Lines of a page, without blocks of code, that have one of PHRASES."""
    prose = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    return [line for line in prose.splitlines() if re.search("|".join(PHRASES), line, re.IGNORECASE)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages_are_in_plain_english(page):
    assert not phrases(page.read_text())


def test_settings_are_in_plain_english(capsys):
    assert main(["config"]) == 0
    assert not phrases(capsys.readouterr().out)


def docstrings(path: Path) -> list[str]:
    """The docstrings of a file, each as one line."""
    nodes = [
        n for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, (ast.Module, ast.ClassDef, ast.FunctionDef))
    ]
    return [" ".join(found.split()) for node in nodes if (found := ast.get_docstring(node))]


@pytest.mark.parametrize(
    "package", sorted(p.name for p in (ROOT / "voodoo_jax").iterdir() if (p / "__init__.py").exists())
)
def test_docstrings_are_in_plain_english(package):
    files = sorted((ROOT / "voodoo_jax" / package).rglob("*.py"))
    found = [f"{path.name}: {line}" for path in files for text in docstrings(path) for line in phrases(text)]
    assert not found, "\n".join(found)


def test_phrases_are_found():
    assert phrases("Who lies on the floor is found.") and phrases("The floor is that of who stands on it.")
    assert not phrases("A person lying on the floor is found.\n```sh\n# who stands\n```\nPeople who sit are tracked.")
