"""A body's sizes, joints and bands are found from recordings, by gradients.

Public: `problem.problem`, `problem.solved`, `losses.loss`, `tuning.tune`, `front.fit`, `result.Fit`.
"""
