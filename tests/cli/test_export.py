"""The command `export`: files where they are asked for, and sentences where that does not work."""

from tests.exporters.test_tracks_files import make_tracks
from voodoo_jax.cli.main import main
from voodoo_jax.exporters.npz import write_tracks_npz


def test_export_writes_beside_the_tracks_or_elsewhere(tmp_path, capsys):
    (tmp_path / "day").mkdir()
    write_tracks_npz(make_tracks(), tmp_path / "day" / "a.tracks.npz")
    assert main(["export", str(tmp_path / "day" / "a.tracks.npz"), "--as", "csv"]) == 0
    assert capsys.readouterr().out.strip().endswith("a.csv") and (tmp_path / "day" / "a.csv").exists()
    assert main(["export", str(tmp_path / "day"), "--as", "bvh,trc", "--out", str(tmp_path / "there")]) == 0
    assert {path.name for path in (tmp_path / "there").iterdir()} == {"a.bvh", "a.trc"}
    words = ["--as", "bvh,trc", "--names", "common", "--rig", "humanoid", "--pose", "a"]
    assert main(["export", str(tmp_path / "day"), *words]) == 0
    assert "left_wrist" in (tmp_path / "day" / "a.trc").read_text()
    assert "LeftLowerArm" in (tmp_path / "day" / "a.bvh").read_text()
    assert "4 of 75 frames are not tracked: in bvh they repeat the last pose." in capsys.readouterr().out


def test_what_cannot_be_exported_is_said(tmp_path, capsys):
    (tmp_path / "a.tracks.npz").write_bytes(b"no tracks")
    (tmp_path / "empty").mkdir()
    for words, status, said in (
        (["--as", "csv"], 2, "name tracks"),
        ([str(tmp_path / "a.tracks.npz")], 2, "name tracks"),
        ([str(tmp_path / "a.tracks.npz"), "--as", "fbx"], 2, "no format 'fbx'"),
        ([str(tmp_path / "empty"), "--as", "csv"], 2, "no tracks"),
        ([str(tmp_path / "a.tracks.npz"), "--as", "csv"], 1, "not a tracks file"),
        ([str(tmp_path / "none.tracks.npz"), "--as", "csv"], 1, "none.tracks.npz"),
    ):
        assert main(["export", *words]) == status
        assert said in capsys.readouterr().err
