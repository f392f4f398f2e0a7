"""Who may not look ahead: front or back is told by the half second that a start takes."""

from tests.trackers.icp.refine.test_choose_facing import BODY, swinging
from voodoo_jax.config.presets import online
from voodoo_jax.trackers.icp.start.first_facing import FirstFacing
from voodoo_jax.trackers.icp.start.hypothesis import StartHypothesis
from voodoo_jax.trackers.icp.start.stage import Search


def begun(first, second, cost: float = 1.0, noise: float = 0.02) -> Search:
    start = StartHypothesis(0, BODY, first, cost, noise, rival=StartHypothesis(0, BODY, second, 1.3 * cost, noise))
    return Search(0, start, (start,))


def test_a_start_in_doubt_is_turned_where_its_rival_is_right(tmp_path):
    _, run, truth, turned = swinging(tmp_path / "log.mcap")
    wrong, right = begun(turned, truth), begun(truth, turned)
    stage, size = FirstFacing(), run.body
    assert stage(run, wrong) is wrong  # offline all frames are asked later
    run.settings = online(run.settings)
    best = stage(run, wrong).best
    assert best.poses is truth and best.rival and run.body is size
    assert best.rival.poses is turned and best.rival.rival is None
    assert stage(run, right) is right
    sure = begun(turned, truth, 0.02**2)
    assert stage(run, sure) is sure
