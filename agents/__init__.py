"""Part of swarm_envs."""

if __name__ == "agents":
    raise ImportError("import swarm_envs.agents instead: the bare name 'agents' collides with other packages")
