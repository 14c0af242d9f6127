"""Multi-Objective Reinforced Active Learning (MORAL) on Stable-Baselines3."""
