"""The benchmark: the evaluation of every agent on every task."""
