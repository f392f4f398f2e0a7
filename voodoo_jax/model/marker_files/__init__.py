"""Marker sets and key points as data, one TOML file each; model.marker_names describes the format."""
