"""Recordings with exact truth: any body, a motion, a depth camera with the noise of a real one.

Public: `recording.simulate`, `motion.make_motion`, `sensor.tof_camera`.
"""
