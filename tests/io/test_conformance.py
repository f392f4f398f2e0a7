"""The files of MCAP's conformance tests, made from what is in them, and the same with packed chunks."""

import hashlib

import pytest

from experiments.fuzz.conformance import all_layouts, misread
from experiments.fuzz.layouts import layouts, written
from voodoo_jax.io.log_reader import LogError, read_log

# of the official files, by name: of tests/conformance/data/*/*.mcap in github.com/foxglove/mcap, which are in Git LFS
OFFICIAL = "eabcfbf8e6525dd4022cb979a3d1793443a31f427cc163be4ddb98e295cd8d01"


def test_the_files_are_the_official_ones():
    made = sorted((layout.name, hashlib.sha256(written(layout)).hexdigest()) for layout in layouts())
    assert len(made) == 416
    assert hashlib.sha256("".join(f"{name} {digest}\n" for name, digest in made).encode()).hexdigest() == OFFICIAL


def test_all_are_read_right(tmp_path):
    everything = all_layouts()
    assert len(everything) == 416 + 2 * 308
    assert {layout.name: wrong for layout in everything if (wrong := misread(layout, tmp_path))} == {}


@pytest.mark.parametrize("case", ["NoData", "OneAttachment", "OneMetadata"])
def test_files_without_messages_are_refused(tmp_path, case):
    path = tmp_path / "empty.mcap"
    for layout in layouts():
        if layout.case == case:
            path.write_bytes(written(layout))
            with pytest.raises(LogError, match="holds no messages. Nothing was recorded"):
                read_log(path)
