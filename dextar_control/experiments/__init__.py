"""Experiments with the nodes or without them: the demo, benches, campaigns and faults,
on one way to start a stack.
"""
