"""Options: what can be set, named sets of it, and its files. Standard library only.

Public: `options.Settings`, `presets.preset`, `presets.online`, `toml.read_settings`, `toml.settings_text`.
"""
