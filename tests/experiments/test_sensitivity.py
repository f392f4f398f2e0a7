"""What is switched off or changed is noticed in what is found, and stands again afterwards."""

import sys
from unittest.mock import patch

import numpy as np
import pytest

from experiments.sensitivity import Log, Outcome, look, mechanisms, numbers, row, watched
from tests.support.rooms import figure, frame, room
from voodoo_jax.config.options import Settings
from voodoo_jax.detect import body_likelihood, clearing, segmentation
from voodoo_jax.model.body_file import human


@pytest.fixture(scope="module")
def log() -> Log:
    """Somebody who walks past; of the joints there is a head alone."""
    rng = np.random.default_rng(0)
    places = [0.05 * i for i in range(8)]
    frames = [frame(np.concatenate([room(rng), figure(3.0, y)]), i) for i, y in enumerate(places)]
    heads = np.array([[[2.85, y, 1.6]] for y in places])
    return Log("walk", frames, np.array([0, 0, 1], np.float32), np.array([f.time_ns for f in frames]), heads)


@pytest.fixture(scope="module")
def found(log) -> Outcome:
    return look(log, human(), Settings())


def test_who_is_there_is_found_and_judged_by_the_truth(log, found):
    assert found.reached == 1.0 and found.people == 1 and look(log, human(), Settings()) == found


def test_what_is_switched_off_is_noticed(log, found):
    off = mechanisms()
    with patch.object(*off["segments: no poles"]), patch.object(body_likelihood, "LONGEST", 0.1):
        lost = look(log, human(), Settings())
    assert lost.people == 0 and lost.reached == 0.0 and lost.digest != found.digest
    assert "people 1 -> 0" in row("all", [(log, found, lost)])
    assert look(log, human(), Settings()) == found


def test_a_number_is_changed_wherever_it_is_and_stands_again():
    changes = numbers("body_likelihood.py")
    name = next(n for n in changes if n.startswith("body_likelihood.TELLING") and n.endswith("45"))
    with changes[name]():
        assert body_likelihood.TELLING == segmentation.TELLING == clearing.TELLING == 45
    assert body_likelihood.TELLING == segmentation.TELLING == clearing.TELLING == 30
    fields = numbers("drop_garment.py")
    stage = next(s for s in sys.modules["voodoo_jax.detect.pipeline"].POINTS if s.name == "drop_garment")
    with fields["drop_garment.wide[0] 0.2 -> 0.3"]():
        assert stage.wide == pytest.approx(0.3)
    assert stage.wide == 0.2


def test_mechanisms_that_act_are_told(log, found):
    acts: set[str] = set()
    some = {k: v for k, v in mechanisms().items() if k in ("scene: walls", "segments: beds", "clearing: flying pixels")}
    with watched(some, acts):
        assert look(log, human(), Settings()) == found
    assert "segments: beds" not in acts
