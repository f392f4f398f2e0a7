"""Reads sensor logs as frames. Never imports JAX.

Public: `log_reader.open_log`, `log_reader.read_log`, `log_summary.survey`, `log_reader.LogError`.
"""
