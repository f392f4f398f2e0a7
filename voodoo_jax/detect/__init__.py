"""What in the scene is the body: ordered stages from frames to observations.

Public: `pipeline.find_body`, `pipeline.find_people`.
"""
