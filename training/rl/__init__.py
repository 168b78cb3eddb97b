"""Reinforcement learning: one policy for all drones, trained by Stable-Baselines3's PPO."""
