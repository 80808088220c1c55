"""Faults, tried and counted: what is put between rig and controller or done to their
processes, and the judgement of it.
"""
