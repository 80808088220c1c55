"""Where the platform is, in which assembly mode, and how sure that is: from active
joints, and from a camera.
"""
