"""Finds the body in the scene: ordered stages from frames to observations.

Public: `pipeline.find_body`, `pipeline.find_people`.
"""
