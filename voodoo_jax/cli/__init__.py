"""The command `voodoo-jax`: words become calls, errors become sentences and an exit status.

Public: `main.main`.
"""
