"""Hooks of the documentation's build (mkdocs.yml): pages from elsewhere in the repository, generated text, and links.

The pages are written so that their links work on a code host, where `../experiments/README.md` is a file. The site has
another layout, so links are rewritten here. Notebooks become pages with the outputs that they are kept with. Comments
in the pages name what is generated:

    <!-- output: config -->              what `voodoo-jax config` prints
    <!-- include: experiments/x.md -->   a page of the repository, without its title
    <!-- api: track -->                  the reference of a public name of voodoo_jax
    <!-- fields: Tracks -->              the fields of a public class, with the comments beside them
"""

import ast
import base64
import json
import os
import posixpath
import re
import subprocess
import sys
import tokenize
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import get_plugin_logger
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
log = get_plugin_logger(__name__)  # a warning ends a build with --strict
SCOREBOARD = "experiments/scoreboard.md"
NOT_MEASURED = """# Scoreboard

Not measured yet for this version. `python -m experiments.scoreboard RECORDINGS` measures and writes this page.
"""
# files outside docs/ that are pages or pictures of the site
ELSEWHERE = ("CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md", "experiments/**/*.md", "experiments/**/*.png")
COMMENT = re.compile(r"^<!-- (output|include|api|fields): (.+) -->$", re.MULTILINE)
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\[\]]*\])*)\]\(([^()\s#]+)(#[^()\s]*)?\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the files that lie outside docs/, under their paths in the repository."""
    for pattern in ELSEWHERE:
        for path in sorted(ROOT.glob(pattern)):
            uri = path.relative_to(ROOT).as_posix()
            if "/out/" not in uri:
                files.append(File.generated(config, uri, abs_src_path=str(path)))
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        for uri, content in notebook_page(path).items():
            files.append(File.generated(config, uri, content=content))
    if not (ROOT / SCOREBOARD).exists():
        files.append(File.generated(config, SCOREBOARD, content=NOT_MEASURED))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Fills in what is generated and rewrites links to files outside docs/."""
    uri = page.file.src_uri
    here = "" if page.file.generated_by is not None else "docs"
    markdown = rewritten(markdown, posixpath.dirname(posixpath.join(here, uri)), uri, files)
    if uri == "api.md":
        check_all_named(markdown)
    return COMMENT.sub(lambda match: generated(match[1], match[2], uri, files), markdown)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Signatures in the reference under their public names, where a function has another name in its module."""
    if page.file.src_uri == "api.md":
        for public, (_, name) in public_names().items():
            html = html.replace(f'<span class="nf">{name}</span>', f'<span class="nf">{public}</span>')
    return html


def notebook_page(path: Path) -> dict[str, str | bytes]:
    """A notebook as a page with its pictures: uri -> content."""
    uri, text, pictures = f"notebooks/{path.stem}.md", [], {}
    for cell in json.loads(path.read_text())["cells"]:
        source = "".join(cell["source"])
        text.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                name = f"{path.stem}-{len(pictures) + 1}.png"
                pictures[f"notebooks/{name}"] = base64.b64decode("".join(data["image/png"]))
                text.append(f"![]({name})")
            elif output.get("name") != "stderr" and (said := "".join(output.get("text") or data.get("text/plain", ""))):
                text.append(f"```text\n{said.rstrip()}\n```")
    return {uri: "\n\n".join(text), **pictures}


def generated(kind: str, what: str, uri: str, files: Files) -> str:
    """The text in place of a comment."""
    if kind == "output":
        language = "toml" if what.startswith("config") else "text"
        return f"```{language}\n{printed(what)}\n```"
    if kind == "include":
        path = ROOT / what
        text = path.read_text() if path.exists() else NOT_MEASURED
        text = re.sub(r"^#", "##", re.sub(r"\A# .*\n+", "", text), flags=re.MULTILINE)  # below the page's own heading
        return rewritten(text, posixpath.dirname(what), uri, files)
    module, name = public_names()[what]
    if kind == "fields":
        return field_table(ROOT / "voodoo_jax" / f"{module.replace('.', '/')}.py", name)
    return f"::: voodoo_jax.{module}.{name}\n    options:\n      heading: {what}\n      toc_label: {what}\n"


def printed(arguments: str) -> str:
    """What the command `voodoo-jax ARGUMENTS` of this working tree prints."""
    plain = {"COLUMNS": "110", "NO_COLOR": "1", "TERM": "dumb", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "voodoo_jax.cli", *arguments.split()]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | plain, cwd=ROOT)
    if done.returncode:
        log.warning("voodoo-jax %s ended with %d: %s", arguments, done.returncode, done.stderr[-500:])
    return done.stdout.strip("\n")


def public_names() -> dict[str, tuple[str, str]]:
    """Public name -> module and name there, from the table in voodoo_jax/__init__.py; nothing is imported."""
    for node in ast.parse((ROOT / "voodoo_jax/__init__.py").read_text()).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "_PUBLIC":
            return ast.literal_eval(node.value)
    raise LookupError("voodoo_jax/__init__.py has no table _PUBLIC")


def field_table(path: Path, name: str) -> str:
    """The annotated fields of a class as a table: name, type, and the comment beside or above each."""
    with tokenize.open(path) as file:
        lines = file.readlines()
    comments = {
        token.start[0]: token.string.lstrip("# ").strip()
        for token in tokenize.generate_tokens(iter(lines).__next__)
        if token.type == tokenize.COMMENT
    }
    rows = []
    for node in next(n for n in ast.parse("".join(lines)).body if isinstance(n, ast.ClassDef) and n.name == name).body:
        if isinstance(node, ast.AnnAssign):
            at = node.lineno - 1
            above = []
            while at in comments and lines[at - 1].lstrip().startswith("#"):
                above.insert(0, comments[at])
                at -= 1
            said = " ".join([*above, comments.get(node.end_lineno or node.lineno, "")]).strip()
            if not said:
                log.warning("the public field '%s.%s' has no comment", name, ast.unparse(node.target))
            rows.append(f"| `{ast.unparse(node.target)}` | `{ast.unparse(node.annotation)}` | {said} |")
    return "\n".join(["| field | type | meaning |", "|---|---|---|", *rows])


def check_all_named(markdown: str) -> None:
    """Warns of public names that the reference leaves out, and of names in it that are not public."""
    named = {match[2] for match in COMMENT.finditer(markdown) if match[1] == "api"}
    for name in sorted(named ^ public_names().keys()):
        log.warning("docs/api.md and voodoo_jax/__init__.py differ in the name '%s'", name)


def rewritten(text: str, folder: str, uri: str, files: Files) -> str:
    """Text of a file in `folder` of the repository as part of the page `uri`: links to pages of the site lead there,
    links to other files of the repository become plain text."""

    def link(match: re.Match) -> str:
        mark, label, target, anchor = match[1], match[2], match[3], match[4] or ""
        if ":" in target:
            return match[0]
        path = posixpath.normpath(posixpath.join(folder, target))
        page = site_page(path)
        if files.get_file_from_path(page) is not None:
            return f"{mark}[{label}]({posixpath.relpath(page, posixpath.dirname(uri) or '.')}{anchor})"
        if (ROOT / path).exists():
            return label if label.strip("`") == path else f"{label} (`{path}`)"
        return match[0]  # a broken link, which mkdocs reports

    return LINK.sub(link, text)


def site_page(path: str) -> str:
    """The file of the site for a path in the repository."""
    if path in ("README.md", "."):
        return "index.md"
    if path.endswith(".ipynb"):
        path = path.replace(".ipynb", ".md")
    if (ROOT / path).is_dir():
        path = posixpath.join(path, "README.md")
    return path.removeprefix("docs/")
