"""Many logs: which, by whom, resumed, each on its own.

Public: `replay.replay`, `track_many.track_many`, `outcome.Outcome`.
"""
