"""The layout for Foxglove names what `.voodoo.mcap` has."""

import json
import re

from voodoo_jax.cli.main import main
from voodoo_jax.exporters.foxglove import QUALITY_SCHEMA, BodyMessages


def test_the_layout_shows_topics_that_there_are(capsys):
    assert main(["layout"]) == 0
    text = capsys.readouterr().out
    layout = json.loads(text)
    topics = set(BodyMessages().channels().values())
    panels = layout["configById"]
    assert set(re.findall(r"/voodoo/\w+", text)) <= topics
    shown = panels["3D!voodoo"]["topics"]
    assert {"/voodoo/body", "/voodoo/joints"} == {name for name, settings in shown.items() if settings["visible"]}
    plotted = [path["value"].split(".") for panel in panels.values() for path in panel.get("paths", [])]
    assert plotted and all(topic == "/voodoo/quality" for topic, _ in plotted)
    assert {field for _, field in plotted} <= set(QUALITY_SCHEMA["properties"])

    def leaves(tree) -> set[str]:
        return {tree} if isinstance(tree, str) else leaves(tree["first"]) | leaves(tree["second"])

    assert leaves(layout["layout"]) == set(panels)
