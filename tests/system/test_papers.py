"""The list of the papers' ingredients is one of this code: each text that is taken away is there, and its test is."""

import importlib
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_each_ingredient_is_there_once_and_has_its_test(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    module = importlib.import_module("experiments.papers.mutations")
    assert len(module.INGREDIENTS) >= 24
    for one in module.INGREDIENTS:
        text = (ROOT / "voodoo_jax" / one.file).read_text()
        assert text.count(one.old) == 1 and one.old != one.new, one.what
        file, test = one.test.split("::")
        assert re.search(rf"^def {test}\(", (ROOT / file).read_text(), re.MULTILINE), one.test


def test_the_page_says_what_was_not_measured(monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    page = importlib.import_module("experiments.papers.page")
    text = page.filled({name: f"table of {name}" for name in page.NAMES[1:]})
    assert text.count("Not measured yet") == 1 and "table of mutations" in text and "{" not in text
