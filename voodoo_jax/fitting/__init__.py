"""Fits a body's sizes, joints and bands to recordings, by gradients.

Public: `problem.problem`, `problem.solved`, `losses.loss`, `tuning.tune`, `front.fit`, `result.Fit`.
"""
