"""Part of swarm_envs."""

if __name__ == "baselines":
    raise ImportError("import swarm_envs.baselines instead: the bare name 'baselines' collides with other packages")
