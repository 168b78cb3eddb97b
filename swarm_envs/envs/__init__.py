"""Part of swarm_envs."""
