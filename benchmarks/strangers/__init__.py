"""Libraries that know nothing of moral-envs train on it: one script per stranger.

They run in a virtual environment of their own, on the wheel of moral-envs and without moral-algorithms;
``run.sh`` makes it and runs them all, and ``README.md`` says what came out and what had to be worked
around.
"""
