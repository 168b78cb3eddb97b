"""Part of swarm_envs."""

if __name__ == "training":
    raise ImportError("import swarm_envs.training instead: the bare name 'training' collides with other packages")
