"""A rig and its controller share this: robot description, topics, parameters, errors,
and how the package prints.
"""
