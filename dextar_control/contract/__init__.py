"""What a rig and its controller share: robot description, topics, errors, node
scaffolding.
"""
