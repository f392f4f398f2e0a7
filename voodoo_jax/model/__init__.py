"""The model of a body, and its files.

Public: `body.Body`, `body_file.human`, `body_file.load_body`, `body_file.read_body`, `attachments.attach`.
"""
