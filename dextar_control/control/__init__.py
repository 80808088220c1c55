"""From an estimate to torques: laws, phases, what is watched, safe stop; all in one
``step(time, q_a)``.
"""
