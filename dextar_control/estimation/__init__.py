"""Estimators of the platform's state and assembly mode, from the active joints and
from external positions.
"""
