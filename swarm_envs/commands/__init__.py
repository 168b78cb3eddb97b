"""The subcommands of `swarm-envs`, one module each; `swarm_envs.cli` lists them."""
