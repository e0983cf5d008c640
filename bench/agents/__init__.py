"""``python -m bench agents``: a team of agents as processes, fed with real keyframes, killed and watched."""
