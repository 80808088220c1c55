"""Control of parallel robots through their Type 2 singularities; the planar five-bar first.

Rooms and doors (``test/test_doors.py`` holds them all):

- ``contract``: what a rig and its controller share: robot description, topics, node scaffolding.
- ``symbols``: from symbols to fast functions; records by name.
- ``mechanisms``: closures, Lagrangian and geometric models: the only place that knows a length.
- ``model``: the paper's equations, and a mechanism with its numbers.
- ``planning``, ``estimation``, ``control``: trajectories through the locus, where the platform is, and the law in its loop.
- ``ros``: the nodes. ``commands``: what ``dextar`` does.
- ``campaign``: many crossings in a plain loop, in parallel, judged.
- ``bags``, ``analysis``: a recorded run, its metrics, its figures.
- ``rig_check``, ``faults``, ``security``: a rig held to the contract, what goes wrong on purpose, who may command.

From ``symbols`` to ``control`` there is no ROS and no simulator.
"""
