"""The benchmark: every agent on every task, in one table of episodes."""
