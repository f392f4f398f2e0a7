"""Segments: slices know where they begin, splices copy, put writes."""

import numpy as np

from voodoo_jax.records.segment import Segment


def numbered(count: int, first: int = 0) -> Segment:
    """A segment whose cost is the number of the frame in the recording."""
    segment = Segment.blank(first + count, 2)
    segment.cost[:] = np.arange(first + count)
    return segment[first:]


def test_slices_know_where_they_begin():
    segment = numbered(10, first=5)
    assert (segment.first, segment.end, len(segment)) == (5, 15, 10)
    part = segment[3:-1]
    assert (part.first, part.end) == (8, 14) and part.cost.tolist() == list(range(8, 14))
    assert segment[:0].first == 5 and not len(segment[:0]) and segment[:0]


def test_splices_leave_the_segment_as_it_was():
    segment, other = numbered(10), numbered(4, first=100)
    taken = np.array([True, False, False, True])
    spliced = segment.spliced(2, other, taken)
    assert spliced.cost.tolist() == [0, 1, 100, 3, 4, 103, 6, 7, 8, 9] and spliced.first == 0
    assert segment.cost.tolist() == list(range(10))
    assert segment[2:6].picked(other, taken).cost.tolist() == [100, 3, 4, 103]


def test_joined_and_put_back():
    segment = numbered(10)
    assert segment[:4].joined(segment[4:]).cost.tolist() == segment.cost.tolist()
    whole = Segment.blank(10, 2)
    whole.put(segment[3:7])
    assert whole.cost.tolist() == [0, 0, 0, 3, 4, 5, 6, 0, 0, 0]
    whole[5:].put(segment[8:])
    assert whole.cost.tolist() == [0, 0, 0, 3, 4, 5, 6, 0, 8, 9]
