"""Items of a stream that are made in another thread while the ones before are used."""

import threading
import time

import pytest

from voodoo_jax.config.limited import limited, limits
from voodoo_jax.config.options import LimitSettings
from voodoo_jax.storage.cores import ahead


def test_all_come_in_order_and_some_are_made_before_they_are_asked_for():
    made = []

    def items():
        for k in range(20):
            made.append((k, threading.current_thread() is threading.main_thread(), limits().pixels))
            yield k

    with limited(LimitSettings(pixels=77)):
        stream = ahead(items(), 4)
        assert next(stream) == 0
        until = time.monotonic() + 10
        while len(made) < 6 and time.monotonic() < until:  # one given, four waiting, one in hand
            time.sleep(0.01)
        assert len(made) == 6
        assert list(stream) == [*range(1, 20)]
    assert made == [(k, False, 77) for k in range(20)]


def test_what_goes_wrong_comes_in_its_turn():
    def items():
        yield from (1, 2)
        raise KeyError("three")

    stream = ahead(items(), 4)
    assert [next(stream), next(stream)] == [1, 2]
    with pytest.raises(KeyError, match="three"):
        next(stream)


def test_who_stops_asking_ends_the_thread():
    before, ended = threading.active_count(), []

    def items():
        try:
            yield from range(1000)
        finally:
            ended.append(True)

    stream = ahead(items(), 2)
    assert next(stream) == 0
    stream.close()
    del stream
    assert threading.active_count() == before and ended == [True]
