"""Contenders of same_work: each module has build(work, points, ...) -> run(), all frames once, last poses."""
