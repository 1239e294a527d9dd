"""Dynamics and control of ground robots on Pinocchio."""

__version__ = "0.1.0"
