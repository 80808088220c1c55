"""Laws, phases, watches and the safe stop: from an estimate to torques."""
