"""Control of a planar five-bar through its Type 2 singularities.

Rooms and doors (``test/test_doors.py`` holds them):

- ``contract``: what a rig and its controller share: robot description, topics, node scaffolding.
- ``core``: model, criterion, law, estimator, planner and the loop that joins them. No ROS, no simulator.
- ``ros``: the nodes.
- ``campaign``: many crossings in a plain loop, in parallel, judged.
- ``analysis``: a recorded run, its metrics, its figure.
"""
