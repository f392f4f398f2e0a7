"""Many logs: chosen, distributed and resumed; failures are isolated.

Public: `replay.replay`, `track_many.track_many`, `outcome.Outcome`.
"""
