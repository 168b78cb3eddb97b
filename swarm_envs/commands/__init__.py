"""What the longer subcommands of `swarm-envs` do; `swarm_envs.cli` lists them all."""
