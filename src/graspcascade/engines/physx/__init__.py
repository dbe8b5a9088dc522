"""Trials in PhysX on the CPU, through the package `sapien`."""
