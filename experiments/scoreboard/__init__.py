"""Every promise that the project makes, measured: python -m experiments.scoreboard RECORDINGS"""
