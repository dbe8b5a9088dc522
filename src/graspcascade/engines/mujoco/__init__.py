"""Trials in MuJoCo, many at once."""
