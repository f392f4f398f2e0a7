"""A body's sizes, joints and bands are found from recordings, by gradients.

Public: `fit.fit`, `result.Fit`, `custom_loss.solve_frames`.
"""
