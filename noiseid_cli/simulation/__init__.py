"""Simulation: trajectories, controllers and closed-loop rollout."""
