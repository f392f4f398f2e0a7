"""Work on several cores: the same results in the same order as one after the other."""

import threading

import pytest

from voodoo_jax.config.limited import limited, limits
from voodoo_jax.config.options import LimitSettings
from voodoo_jax.storage import cores


@pytest.mark.parametrize("count", [1, 2, 3])
def test_work_on_several_cores_comes_in_its_order(monkeypatch, count):
    monkeypatch.setattr(cores, "own_cores", lambda: count)
    both = threading.Barrier(min(count, 2))

    def work(number: int) -> tuple[int, int]:
        if number < 2:
            both.wait(10)  # two are done at the same time, where there are two cores
        return number, limits().topics

    with limited(LimitSettings(topics=7)):
        assert cores.at_once(work, range(5)) == [(k, 7) for k in range(5)]
    assert cores.at_once(work, []) == []


@pytest.mark.parametrize("count", [1, 3])
def test_what_work_raises_is_raised(monkeypatch, count):
    monkeypatch.setattr(cores, "own_cores", lambda: count)
    done = []

    def work(number: int) -> None:
        if number == 1:
            raise KeyboardInterrupt
        done.append(number)

    with pytest.raises(KeyboardInterrupt):
        cores.at_once(work, range(100))
    assert len(done) < 99


@pytest.mark.parametrize("count", [1, 2])
def test_work_that_is_begun_goes_on_aside(monkeypatch, count):
    monkeypatch.setattr(cores, "own_cores", lambda: count)
    go = threading.Event()

    def work(number: int) -> tuple[int, int]:
        if count > 1:
            assert go.wait(10)  # until what begun it goes on
        return number, limits().topics

    with limited(LimitSettings(topics=7)):
        result = cores.begun(work, 3)
    go.set()
    assert result() == (3, 7)


@pytest.mark.parametrize("count", [1, 2])
def test_what_work_that_is_begun_raises_is_raised(monkeypatch, count):
    monkeypatch.setattr(cores, "own_cores", lambda: count)
    with pytest.raises(ZeroDivisionError):
        cores.begun(divmod, 1, 0)()


def test_who_takes_turns_works_in_its_own_thread(monkeypatch):
    monkeypatch.setattr(cores, "own_cores", lambda: 3)
    found = []

    def work() -> None:
        cores.take_turns()
        found.append({threading.get_ident(), cores.begun(threading.get_ident)()})
        found[0].update(cores.at_once(lambda _: threading.get_ident(), range(5)))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert len(found[0]) == 1 and cores.begun(threading.get_ident)() != threading.get_ident()  # only that thread
