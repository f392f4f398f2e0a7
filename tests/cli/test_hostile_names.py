"""A name that harms terminals, in what every command says; the list of commands is that of the command line."""

import typing

import pytest

from voodoo_jax.cli.commands import Command
from voodoo_jax.cli.main import main

NAME = "a\x1b[31m\u202eb\x07"
COMMANDS = {typing.get_args(kind)[1].name: typing.get_args(kind)[0] for kind in typing.get_args(Command)}
# words after each command, {} is the name; a command that is not here fails
WORDS = {
    "demo": ["--out", "{}/file"], "replay": ["{}.mcap", "--out", "out", "--workers", "1"],
    "live": ["{}.mcap", "--idle", "0.1", "--out", "out"], "info": ["{}.mcap"], "view": ["{}.mcap", "{}.tracks.npz"],
    "export": ["{}.tracks.npz", "--as", "csv"], "convert": ["{}.trc", "--out", "{}.mcap"],
    "fit": ["{}.mcap", "--out", "{}.toml"],
    "body": ["{}.urdf", "--out", "{}.toml"],
    "config": ["--config", "{}.toml"], "layout": [],
}  # fmt: skip


@pytest.mark.parametrize("name", COMMANDS)
def test_nothing_that_is_printed_harms_a_terminal(name, tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    (tmp_path / NAME).write_text("a file where a folder is meant")
    for ending in ("mcap", "tracks.npz", "urdf", "toml"):
        (tmp_path / f"{NAME}.{ending}").write_text(f"<robot name='{NAME}'>" if ending == "urdf" else f"[{NAME}]\n")
    lines = ["PathFileType", "Units", f"{NAME}furlong", f"Frame#\tTime\t{NAME}", "", "1\t0\t1\t2\t3"]
    (tmp_path / f"{NAME}.trc").write_text("\n".join(lines))
    words = [word.replace("{}", NAME) for word in WORDS[name]]
    assert (main([name, *words]) != 0) == (name != "layout")
    said = "".join(capfd.readouterr())
    assert said and all(c.isprintable() or c == "\n" for c in said), repr(said)
    if name not in ("layout", "demo"):
        assert r"\x1b[31m\u202eb\x07" in said
