"""Self-contained pages from this package's files."""

from importlib import resources

from voodoo_jax.records.notes import Html, filled


def template(name: str) -> Html:
    """Text of a file of this package."""
    return Html(resources.files("voodoo_jax.viz").joinpath(name).read_text(encoding="utf-8"))


def page(name: str, title: str, body: Html) -> Html:
    """A self-contained page, with the common style and that of viz/NAME.css."""
    styles = Html(template("page.css") + template(f"{name}.css"))
    return filled(template("page.html"), STYLE=styles, BODY=Html(body.rstrip("\n")), TITLE=title)
