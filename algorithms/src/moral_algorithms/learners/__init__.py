"""Learners: experts, adversarial inverse reinforcement learning and MORAL, on Stable-Baselines3's PPO."""
